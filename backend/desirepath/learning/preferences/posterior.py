"""What answers say about somebody's preference weights: a particle posterior over preference weights, after every
answer: choices of two, and whatever else people say (`evidence`).

Pure and deterministic: the same answers give the same posterior. What is asked next lives in `choosing.py`, what the
weights take effect in `conditioned.py`. All ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.evidence.evidence import Evidence, Habits
from desirepath.learning.preferences.measures import MEASURES, typical_differences
from desirepath.learning.preferences.objectives import OPPOSITES, SIZE, gains, names_of, sides_of
from desirepath.learning.preferences.spans import SPANS_S
from desirepath.simulation.setups import get_setup

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
MOST_OBJECTIVES = 3


@dataclass(frozen=True)
class PosteriorConfig:
    """The prior, and how many particles carry it. All ours.

    objectives: prior probability that somebody has one, two or three objectives; their shares are uniform on the
    simplex. rationality: a pair that differs by one typical difference is told apart with probability
    sigmoid(rationality); log-uniform in this range, from hardly at all to without fail. lapse_rate: mean of the
    exponential prior of the share of answers that are given without looking, cut off at `highest_lapse_rate`; half of
    these are wrong. noticed, clear: where people may say that two do not differ, or how clearly, from which difference
    on, in typical ones, one is better at all, and how much more it takes to be clearly better; log-uniform likewise.
    spans: prior probability that somebody judges each of SPANS_S, the whole trajectory or only its beginning.
    """

    particles: int = 20_000
    seed: int = 0
    objectives: tuple[float, float, float] = (0.5, 0.3, 0.2)
    carried_by: tuple[float, float, float] = (0.3, 0.35, 0.35)  # share of the particles for each number of objectives
    rationality: tuple[float, float] = (0.5, 100.0)
    lapse_rate: float = 0.08
    highest_lapse_rate: float = 0.5
    noticed: tuple[float, float] = (0.05, 1.0)
    clear: tuple[float, float] = (0.1, 3.0)
    spans: tuple[float, ...] = (0.8, 0.1, 0.1)
    spans_carried_by: tuple[float, ...] = (0.5, 0.25, 0.25)  # share of the particles for each span
    least_effective: float = 0.1  # of the particles: below, they are drawn anew and moved
    moves: int = 4
    smallest_weight: float = 0.2  # a smaller preference weight (the largest is 1) is left out
    left_right_symmetry: bool = False  # somebody would answer a mirrored query alike, so nobody prefers a side


def supports(*, left_right_symmetry: bool = False, setup: str = "study_room") -> list[tuple[int, ...]]:
    """All sets of one to three objectives that somebody can prefer at once, by index; with symmetry none has a side."""
    possible = [k for k in range(SIZE) if not (left_right_symmetry and k in sides_of(setup))]
    return [
        chosen
        for size in range(1, MOST_OBJECTIVES + 1)
        for chosen in combinations(possible, size)
        if not any(a in chosen and b in chosen for a, b in OPPOSITES)
    ]


@dataclass(frozen=True)
class Posterior:
    """What is believed after some answers; `updated` gives the next one.

    weights: (n, 9) float32 >= 0, each particle's shares, summing to 1. rationality, lapse_rate: (n,) float32.
    span: (n,) which of SPANS_S it judges. log_mass: (n,) float64, unnormalised. differences (answers, spans, 7) and
    chosen (answers,) are what was learned from: measures of A minus B in the setup's unit, of as much as each span
    sees, and whether A was chosen; evidence: all other answers. criteria (n, 2): `noticed` and `clear` of the
    configuration, none before there is such evidence.

    Wherever differences are asked for, those of whole trajectories (n, 7) do: then all spans see the same.
    """

    setup: str
    config: PosteriorConfig
    weights: Floats
    rationality: Floats
    lapse_rate: Floats
    span: NDArray[np.int64]
    log_mass: Doubles
    differences: Doubles = field(default_factory=lambda: np.zeros((0, len(SPANS_S), len(MEASURES))))
    chosen: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    draws: int = 0
    evidence: tuple[Evidence, ...] = ()
    criteria: Floats = field(default_factory=lambda: np.zeros((0, 2), dtype=np.float32))

    @classmethod
    def prior(cls, setup: str, config: PosteriorConfig | None = None) -> Posterior:
        """What is believed before any answer. Every set of objectives has equally many particles among those of its
        size.
        """
        config = config or PosteriorConfig()
        typical_differences(get_setup(setup).name)
        random = np.random.default_rng([config.seed, 21])
        possible = supports(left_right_symmetry=config.left_right_symmetry, setup=setup)
        weights, log_mass = [], []
        for size, (mass, carried) in enumerate(zip(config.objectives, config.carried_by, strict=True), start=1):
            sets = [chosen for chosen in possible if len(chosen) == size]
            each = max(1, round(config.particles * carried / len(sets)))
            for chosen in sets:
                shares = np.zeros((each, SIZE), dtype=np.float32)
                shares[:, chosen] = random.dirichlet(np.ones(size), each)
                weights.append(shares)
                log_mass.append(np.full(each, math.log(mass / len(sets) / each)))
        n = sum(len(part) for part in weights)
        low, high = np.log(config.rationality)
        # Evenly spread, in random order: fewer accidents than independent draws.
        rationality = np.exp(low + (high - low) * (random.permutation(n) + 0.5) / n)
        cut = -math.expm1(-config.highest_lapse_rate / config.lapse_rate)
        lapse_rate = -config.lapse_rate * np.log1p(-cut * (random.permutation(n) + 0.5) / n)
        places = (random.permutation(n) + 0.5) / n
        span = np.searchsorted(np.cumsum(config.spans_carried_by)[:-1], places)
        rarer = np.log(np.divide(config.spans, config.spans_carried_by))
        return cls(
            setup,
            config,
            np.concatenate(weights),
            rationality.astype(np.float32),
            lapse_rate.astype(np.float32),
            span,
            np.concatenate(log_mass) + rarer[span],
        )

    @classmethod
    def from_answers(
        cls, setup: str, differences: Doubles, choices: Sequence[bool], config: PosteriorConfig | None = None
    ) -> Posterior:
        """The posterior after answers to pairs whose measures differ by (n, spans, 7) A minus B; choices: was A chosen?

        Raises LearningError if the numbers of both do not agree.
        """
        posterior = cls.prior(setup, config)
        if len(differences) != len(choices):
            raise LearningError(f"choices = {len(choices)}: {len(differences)} pairs need as many")
        for difference, choice in zip(differences, choices, strict=True):
            posterior = posterior.updated(difference, bool(choice))
        return posterior

    def updated(self, difference: Doubles, a_chosen: bool) -> Posterior:
        """The posterior after one more answer. difference: (spans, 7) measures of A minus those of B."""
        differences = np.concatenate([self.differences, _by_span(np.asarray(difference, dtype=np.float64)[None])])
        chosen = np.append(self.chosen, a_chosen)
        likelihood = self.choice_probabilities(differences[-1:])[:, 0]
        seen = np.log(likelihood if a_chosen else 1 - likelihood, dtype=np.float64)
        after = replace(self, log_mass=self.log_mass + seen, differences=differences, chosen=chosen)
        return after._refreshed()

    def observed(self, evidence: Evidence) -> Posterior:
        """The posterior after one more answer of another kind."""
        told = self._with_criteria()
        seen = told._log_likelihood_of(evidence, told._state())
        return replace(told, log_mass=told.log_mass + seen, evidence=(*told.evidence, evidence))._refreshed()

    def bits_of(self, evidence: Evidence) -> float:
        """How far that answer moves what is believed, bits: the divergence of the posterior after it from this one."""
        told, before = self._with_criteria(), self.masses()
        seen = told._log_likelihood_of(evidence, told._state())
        together = np.exp(seen) @ before
        after = before * np.exp(seen) / together
        return float((after @ seen - np.log(together)) / math.log(2))

    def _with_criteria(self) -> Posterior:
        return self if len(self.criteria) else replace(self, criteria=_draw_criteria(len(self.weights), self.config))

    def _refreshed(self) -> Posterior:
        """With enough particles that count."""
        enough = self.effective_particles() >= self.config.least_effective * len(self.weights)
        return self if enough else self._rejuvenate()

    def masses(self) -> Doubles:
        """(n,) the particles' probabilities."""
        masses: Doubles = np.exp(self.log_mass - self.log_mass.max())
        masses /= masses.sum()
        return masses

    def effective_particles(self) -> float:
        """How many particles of equal mass would carry as much."""
        return float(1.0 / np.square(self.masses()).sum())

    def shares(self) -> Doubles:
        """(9,) expected share of each objective in the preference; sums to 1."""
        return self.masses() @ self.weights.astype(np.float64)

    def mean_weights(self) -> Floats:
        """(9,) preference weights for a conditioned policy: the largest 1, small ones none, opposites never both."""
        return weights_of_shares(self.shares(), self.config.smallest_weight)

    def importance(self) -> dict[str, float]:
        """Expected share of each objective, by name: what the answers were about."""
        return {name: float(share) for name, share in zip(names_of(self.setup), self.shares(), strict=True)}

    def foremost(self) -> Doubles:
        """(9,) probability of each objective to have the largest share; sums to 1."""
        most = self.weights.argmax(axis=1)
        return np.bincount(most, weights=self.masses(), minlength=SIZE).astype(np.float64)

    def dominant(self) -> str:
        """The objective that most probably has the largest share.

        Not the one with the largest expected share: an objective that may be all or nothing has a large one, too.
        """
        return names_of(self.setup)[int(self.foremost().argmax())]

    def predict(self, differences: Doubles) -> Doubles:
        """(n,) probability that A is chosen from pairs whose measures differ by (n, spans, 7).

        Of differences of whole trajectories (n, 7): by somebody who looks at all of them.
        """
        return self.masses() @ self.choice_probabilities(differences)

    def entropy_bits(self) -> float:
        """How undecided it is which objective dominates: 0 if that is known, log2(9) = 3.2 if nothing is."""
        foremost = self.foremost()
        present = foremost[foremost > 0]
        return float(-(present * np.log2(present)).sum())

    def sample(self, n: int) -> Posterior:
        """A posterior of n particles of equal mass, for what need not be exact."""
        random = np.random.default_rng([self.config.seed, 22, len(self.chosen) + len(self.evidence)])
        rows = _systematic(self.masses(), n, random)
        return replace(self, **{name: of[rows] for name, of in self._state().items()}, log_mass=np.zeros(n))

    def _state(self) -> dict[str, Any]:
        """What each particle is, by name."""
        names = ("weights", "rationality", "lapse_rate", "span", *(("criteria",) if len(self.criteria) else ()))
        return {name: getattr(self, name) for name in names}

    def choice_probabilities(self, differences: Doubles) -> Floats:
        """(particles, n) float32: each particle's probability that A is chosen."""
        return _choice_probabilities(
            self.weights, self.rationality, self.lapse_rate, self.span, self._gains(_by_span(differences))
        )

    def _gains(self, differences: Doubles) -> Floats:
        """(spans, n, 9) of differences (n, spans, 7)."""
        scaled = differences / typical_differences(self.setup)
        return np.stack([gains(scaled[:, k]) for k in range(len(SPANS_S))]).astype(np.float32)

    def _log_likelihood_of(self, evidence: Evidence, state: dict[str, NDArray[Any]]) -> Doubles:
        """(particles,) of one answer that is no choice of two."""
        better = self._gains(evidence.measured - evidence.measured.mean(axis=0))
        worth = np.empty((len(state["weights"]), better.shape[1]))
        rationality = state["rationality"][:, None]
        for k, gained in enumerate(better):
            of = state["span"] == k
            worth[of] = (state["weights"][of] * rationality[of]) @ gained.T
        criteria = np.cumsum(state["criteria"], axis=1, dtype=np.float64) * rationality
        return evidence.log_likelihood(worth, Habits(state["lapse_rate"].astype(np.float64), criteria))

    def _rejuvenate(self) -> Posterior:
        """As many particles, of equal mass, each moved a few times by Metropolis steps that leave the posterior be."""
        random = np.random.default_rng([self.config.seed, 23, self.draws])
        n = len(self.weights)
        rows = _systematic(self.masses(), n, random)
        state = {name: of[rows] for name, of in self._state().items()}
        seen = self._gains(self.differences) * np.where(self.chosen, 1, -1).astype(np.float32)[:, None]
        prior_of_span = np.log(self.config.spans)

        def log_likelihood(state: dict[str, NDArray[Any]]) -> Doubles:
            chooses = {name: of for name, of in state.items() if name != "criteria"}
            logs: Doubles = np.log(_choice_probabilities(**chooses, better=seen)).sum(axis=1, dtype=np.float64)
            return logs + sum(self._log_likelihood_of(evidence, state) for evidence in self.evidence)

        now = log_likelihood(state)
        for move in range(self.config.moves):
            weights = _move_weights(
                state["weights"], random, self.config, swap=move % 2 == 1, sides=sides_of(self.setup)
            )
            (rationality, lapse_rate), favour = _move_response_model(
                state["rationality"], state["lapse_rate"], self.config, random
            )
            span = random.integers(len(SPANS_S), size=n)
            proposals: list[tuple[dict[str, NDArray[Any]], Doubles]] = [
                ({"weights": weights}, np.zeros(n)),
                ({"rationality": rationality, "lapse_rate": lapse_rate}, favour),
                ({"span": span}, prior_of_span[span] - prior_of_span[state["span"]]),
            ]
            if self.evidence:
                proposals.append(({"criteria": _move_criteria(state["criteria"], self.config, random)}, np.zeros(n)))
            for changes, prior_ratio in proposals:
                then = log_likelihood(state | changes)
                accepted = np.log(random.random(n)) < then - now + prior_ratio
                for name, changed in changes.items():
                    old = state[name]
                    state[name] = np.where(accepted[:, None] if old.ndim == 2 else accepted, changed, old)
                now = np.where(accepted, then, now)
        return replace(self, **state, log_mass=np.zeros(n), draws=self.draws + 1)


def _by_span(differences: Doubles) -> Doubles:
    """(n, spans, 7) of differences (n, spans, 7), or (n, 7) of which every span sees the same."""
    if differences.ndim == 3:
        return differences
    return np.repeat(differences[:, None], len(SPANS_S), axis=1)


def _choice_probabilities(
    weights: Floats, rationality: Floats, lapse_rate: Floats, span: NDArray[np.int64], better: Floats
) -> Floats:
    """(particles, n) of gains (spans, n, 9): `choice_probabilities` of as much as each particle judges."""
    probabilities = np.empty((len(weights), better.shape[1]), dtype=np.float32)
    for k, gained in enumerate(better):
        of = span == k
        probabilities[of] = choice_probabilities(weights[of], rationality[of], lapse_rate[of], gained)
    return probabilities


def choice_probabilities(weights: Floats, rationality: Floats, lapse_rate: Floats, better: Floats) -> Floats:
    """(particles, n): (1 - eps) sigmoid(beta w . g) + eps / 2, of gains g (n, 9) of A over B."""
    advantage = np.clip((weights * rationality[:, None]) @ better.T, -30, 30)
    careful = 1 / (1 + np.exp(-advantage))
    # Never quite certain, so that no particle dies of one answer.
    return np.clip((1 - lapse_rate[:, None]) * careful + lapse_rate[:, None] / 2, 1e-6, 1 - 1e-6)


def _systematic(masses: Doubles, n: int, random: np.random.Generator) -> NDArray[np.int64]:
    """n rows drawn by mass, evenly spread."""
    places = (np.arange(n) + random.random()) / n
    return np.minimum(np.searchsorted(np.cumsum(masses), places), len(masses) - 1)


def _move_weights(
    weights: Floats, random: np.random.Generator, config: PosteriorConfig, *, swap: bool, sides: Sequence[int]
) -> Floats:
    """Proposals that the prior likes as much: the sum of two objectives' shares split anew, or exchanged.

    swap: one of the two places is any objective, so that an objective can turn into another one; impossible sets stay.
    sides: places of the objectives that prefer one.
    """
    n = len(weights)
    rows = np.arange(n)
    first = (random.random((n, SIZE)) * (weights > 0)).argmax(axis=1)
    proposed = weights.copy()
    if swap:
        second = random.integers(SIZE, size=n)
        proposed[rows, first], proposed[rows, second] = weights[rows, second], weights[rows, first]
    else:
        others = (weights > 0) & (np.arange(SIZE) != first[:, None])
        second = (random.random((n, SIZE)) * others).argmax(axis=1)
        second = np.where(others.any(axis=1), second, first)
        both = weights[rows, first] + weights[rows, second]
        split = np.where(
            random.random(n) < 0.5,
            random.random(n),
            _reflect(weights[rows, first] / both + random.normal(0, 0.1, n), 0.0, 1.0),
        ).astype(np.float32)
        split = np.clip(split, 1e-3, 1 - 1e-3)  # an objective never vanishes in a move
        alone = first == second
        proposed[rows, first], proposed[rows, second] = both * split, both * (1 - split)
        proposed[alone] = weights[alone]
    impossible = (proposed[:, sides] > 0).any(axis=1) & config.left_right_symmetry
    for a, b in OPPOSITES:
        impossible |= (proposed[:, a] > 0) & (proposed[:, b] > 0)
    proposed[impossible] = weights[impossible]
    return proposed


def _move_response_model(
    rationality: Floats, lapse_rate: Floats, config: PosteriorConfig, random: np.random.Generator
) -> tuple[tuple[Floats, Floats], Doubles]:
    """Proposed rationality and lapse rates, and the logarithm of how much more the prior likes them."""
    n = len(rationality)
    low, high = np.log(config.rationality)
    r = np.exp(_reflect(np.log(rationality) + random.normal(0, 0.5, n), low, high)).astype(np.float32)
    m = _reflect(lapse_rate + random.normal(0, config.lapse_rate / 2, n), 0.0, config.highest_lapse_rate).astype(
        np.float32
    )
    favour: Doubles = ((lapse_rate - m) / config.lapse_rate).astype(np.float64)
    return (r, m), favour


def _draw_criteria(n: int, config: PosteriorConfig) -> Floats:
    """(n, 2) of the prior."""
    low, high = np.log([config.noticed, config.clear]).T
    places = np.random.default_rng([config.seed, 24]).random((n, 2))
    criteria: Floats = np.exp(low + (high - low) * places).astype(np.float32)
    return criteria


def _move_criteria(criteria: Floats, config: PosteriorConfig, random: np.random.Generator) -> Floats:
    """Proposals that the prior likes as much."""
    moved = np.log(criteria) + random.normal(0, 0.4, criteria.shape)
    bounds = (np.log(config.noticed), np.log(config.clear))
    parts = [_reflect(moved[:, k], *bounds[k]) for k in range(2)]
    proposed: Floats = np.exp(np.stack(parts, axis=1)).astype(np.float32)
    return proposed


def _reflect(values: NDArray[np.floating[Any]], low: float, high: float) -> Doubles:
    """Values that stepped over a border, mirrored back."""
    inside: Doubles = low + np.abs((values - low + (high - low)) % (2 * (high - low)) - (high - low))
    return inside


def weights_of_shares(shares: NDArray[np.floating[Any]], smallest: float = PosteriorConfig.smallest_weight) -> Floats:
    """(9,) shares -> (9,) float32 in [0, 1]: of opposites what the larger has more, the largest 1, the small ones 0."""
    weights = np.asarray(shares, dtype=np.float64).copy()
    for a, b in OPPOSITES:
        both = min(weights[a], weights[b])
        weights[a] -= both
        weights[b] -= both
    top = weights.max()
    if top <= 0:
        return np.zeros(SIZE, dtype=np.float32)
    weights /= top
    weights[weights < smallest] = 0
    return weights.astype(np.float32)

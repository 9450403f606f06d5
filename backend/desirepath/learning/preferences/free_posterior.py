"""What answers say where the nine objectives may not say it: a mixture of ways to explain them, weighed by how well
each predicted every answer before it was given.

The ways: the particle posterior over the nine (`posterior.py`), and Gaussian processes (`advantage_process.py`), over
the named measures, over the embedding of trajectories (`learning/measures`), and over both with a prior from
other people (`population_prior.py`), each at several strengths of preference. Pure and deterministic. All ours.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp, ndtr

from desirepath.learning.errors import LearningError
from desirepath.learning.measures.named import NAMES as NAMED
from desirepath.learning.measures.pairs import PairDifferences, reference_differences
from desirepath.learning.preferences.advantage_process import AdvantageProcess, Seen, entropy_bits
from desirepath.learning.preferences.measures import typical_differences
from desirepath.learning.preferences.objectives import gains
from desirepath.learning.preferences.population_prior import IN_GENERAL, WeightPrior, shipped_priors
from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig

Doubles = NDArray[np.float64]
NAMED_WAY, EMBEDDING_WAY = "named", "embedding"
PREDICTING = 2_000  # of the particles: what predicting needs not have more of
SAMPLES = 1_000  # of all that is believed, where questions are chosen by what is to be predicted


SOMETHING_ELSE = 0.5
"""From this probability on, answers count as being about something that is not among the nine objectives."""


@dataclass(frozen=True)
class FreeConfig:
    """nine: prior probability that the objectives say it; families: that one of the priors of simulated people does,
    where a setup has them (`population_prior.py`); before, general: of what is left beside the nine, that earlier
    participants' does, or people in general's, where one is given; the rest is the named measures' and the embedding's.
    strengths: variances of a typical pair's advantage in log odds, with their prior probabilities. sharper: how many
    times surer than Laplace's approximation the answers bear out, after 8 answers and per e-fold more. Chosen on the
    tuning families of `people/card.yaml`, `sharper` on each with the others' priors, `general` (of 0.2, 0.4, 0.6, 0.8)
    beside the raters."""

    nine: float = 0.5
    families: float = 0.3
    before: float = 0.6
    general: float = 0.2
    strengths: tuple[float, ...] = (8.0, 64.0, 512.0)
    prior: tuple[float, ...] = (0.25, 0.4, 0.35)
    sharper: tuple[float, float] = (1.9, -0.2)
    posterior: PosteriorConfig = PosteriorConfig()  # noqa: RUF009, frozen


@dataclass(frozen=True)
class _Way:
    """One way beside the nine, at one strength. prior: log probability before any answer."""

    name: str
    process: AdvantageProcess
    prior: float


@dataclass(frozen=True)
class FreePosterior:
    """What is believed after some answers. objectives: the posterior over the nine. nine_log_evidence: log probability
    of the answers by it. differences, chosen: what was learned from, whether A was chosen. before: what earlier
    participants weighed, if that may be known."""

    setup: str
    config: FreeConfig
    objectives: Posterior
    nine_log_evidence: float
    differences: PairDifferences | None
    chosen: NDArray[np.bool_]
    before: WeightPrior | None = None

    @classmethod
    def prior(cls, setup: str, config: FreeConfig | None = None, before: WeightPrior | None = None) -> FreePosterior:
        """What is believed before any answer."""
        config = config or FreeConfig()
        objectives = Posterior.prior(setup, config.posterior)
        return cls(setup, config, objectives, 0.0, None, np.zeros(0, dtype=np.bool_), before)

    @classmethod
    def from_answers(
        cls,
        differences: PairDifferences,
        chosen: Sequence[bool] | NDArray[np.bool_],
        config: FreeConfig | None = None,
        before: WeightPrior | None = None,
    ) -> FreePosterior:
        """After answers to these pairs; chosen: was the first of the two chosen? Raises LearningError if the numbers of
        both do not agree."""
        if len(differences) != len(chosen):
            raise LearningError(f"choices = {len(chosen)}: {len(differences)} pairs need as many")
        posterior = cls.prior(differences.setup, config, before)
        for k, choice in enumerate(chosen):
            posterior = posterior.updated(differences[[k]], bool(choice))
        return posterior

    @property
    def left_right_symmetry(self) -> bool:
        return self.config.posterior.left_right_symmetry

    def updated(self, difference: PairDifferences, a_chosen: bool) -> FreePosterior:
        """After one more answer, to one pair."""
        probability = float(self.objectives.predict(difference.seen)[0])
        return FreePosterior(
            self.setup,
            self.config,
            self.objectives.updated(difference.seen[0], a_chosen),
            self.nine_log_evidence + math.log(probability if a_chosen else 1 - probability),
            difference if self.differences is None else self.differences.joined(difference),
            np.append(self.chosen, a_chosen),
            self.before,
        )

    def predict(self, differences: PairDifferences) -> Doubles:
        """(n,) probability that the first of each pair is chosen."""
        masses, predicted = self._masses, [self._few.predict(differences.seen)]
        sharper = self._sharper
        for way, seen in self._of(differences):
            predicted.append(way.process.predict(seen, sharper))
        return masses @ np.stack(predicted)

    def probability_better(self, differences: PairDifferences, by: float = 0.0) -> float:
        """That the first of these pairs are on average preferred to the second by more than `by`, in what a typical
        pair of the setup differs by for this person: one policy's rollouts against another's in the same scenes. That
        these scenes are a sample is counted in."""
        if not len(differences):
            return 0.5
        advantages = self._of_the_nine(differences)
        probable = [_probability_above(advantages, by * _typical(self._of_the_nine(self._reference)) if by else 0.0)]
        typical = [way.process.advantages(seen) for way, seen in self._of(self._reference)] if by else []
        for k, (way, seen) in enumerate(self._of(differences)):
            whole = (seen[0].mean(keepdims=True), seen[1].mean(0, keepdims=True))
            mean, variance = (float(part[0]) for part in way.process.advantages(whole))
            of_scenes = float(way.process.advantages(seen)[0].var()) / len(differences) if len(self.chosen) else 0.0
            least = by * math.sqrt(float((np.square(typical[k][0]) + typical[k][1]).mean())) if by else 0.0
            probable.append(float(ndtr((mean - least) / math.sqrt(variance + of_scenes + 1e-12))))
        return float(self._masses @ np.array(probable))

    def advantages(self, differences: PairDifferences) -> tuple[Doubles, Doubles]:
        """(n,) how much better the first of each pair is expected to be, in log odds, and its standard deviation."""
        nine = self._of_the_nine(differences)
        means, squares = [nine.mean(0)], [np.square(nine).mean(0)]
        for way, seen in self._of(differences):
            mean, variance = way.process.advantages(seen)
            means.append(mean)
            squares.append(np.square(mean) + variance)
        expected: Doubles = self._masses @ np.stack(means)
        return expected, np.sqrt(np.maximum(self._masses @ np.stack(squares) - np.square(expected), 1e-12))

    def information_bits(self, differences: PairDifferences) -> Doubles:
        """(n,) mutual information (bits) between the answer to each pair and what is not known yet (Houlsby 2011)."""
        few = self._few
        probabilities = [few.choice_probabilities(differences.seen).astype(np.float64)]
        predicted, certain = [probabilities[0].mean(0)], [entropy_bits(probabilities[0]).mean(0)]
        for way, seen in self._of(differences):
            probable, doubt = way.process.predict_and_doubt(seen)
            predicted.append(probable)
            certain.append(doubt)
        bits: Doubles = entropy_bits(self._masses @ np.stack(predicted)) - self._masses @ np.stack(certain)
        return np.maximum(bits, 0.0)

    def bits_about(self, differences: PairDifferences, others: PairDifferences) -> Doubles:
        """(n,) bits that the answer to each pair is expected to tell about the answer to one of the others: what may
        not be predicted otherwise counts, not all that is unknown (`information_bits`)."""
        random = np.random.default_rng([self.config.posterior.seed, 23, len(self.chosen)])
        both = differences.joined(others)
        counts = np.floor(self._masses * SAMPLES + random.random()).astype(int)
        few = self.objectives.sample(int(counts[0])) if counts[0] else None
        drawn = [few.choice_probabilities(both.seen).astype(np.float64)] if few is not None else []
        for (way, seen), count in zip(self._of(both), counts[1:], strict=True):
            if count:
                drawn.append(expit(way.process.sampled(seen, random, int(count))).T)
        probable = np.concatenate(drawn)
        return bits_about_others(probable[:, : len(differences)], probable[:, len(differences) :])

    def ways(self) -> dict[str, float]:
        """Probability of each way to explain the answers; sums to 1."""
        shares = {"nine": float(self._masses[0])}
        for way, mass in zip(self._ways, self._masses[1:], strict=True):
            shares[way.name] = shares.get(way.name, 0.0) + float(mass)
        return shares

    def something_else(self) -> float:
        """Probability that what the answers are about is not among the nine."""
        return 1.0 - float(self._masses[0])

    def named_weights(self) -> dict[str, float]:
        """By named measure, how much more (above 0) or less of it is preferred: the posterior mean in standard
        deviations of a typical pair, the largest 1 or -1; empty before any answer."""
        ways = [(way, m) for way, m in zip(self._ways, self._masses[1:], strict=True) if way.name == NAMED_WAY]
        if self.differences is None or not ways:
            return {}
        together = np.sum([m * way.process.weights() / math.sqrt(way.process.strength) for way, m in ways], axis=0)
        largest = float(np.abs(together).max()) or 1.0
        return {name: float(weight) / largest for name, weight in zip(NAMED, together, strict=True)}

    @cached_property
    def _few(self) -> Posterior:
        return self.objectives.sample(PREDICTING)

    @cached_property
    def _sharper(self) -> float:
        """At least 1: how much surer than the approximation says."""
        at_eight, per_fold = self.config.sharper
        return max(1.0, at_eight + per_fold * math.log(max(len(self.chosen), 8) / 8)) if len(self.chosen) else 1.0

    @cached_property
    def _priors(self) -> dict[str, WeightPrior]:
        """By name of the way, those that have one from other people."""
        before = [self.before] if self.before is not None else []
        return {prior.name: prior for prior in (*shipped_priors(self.setup), *before)}

    @cached_property
    def _shares(self) -> dict[str, float]:
        """Prior probability of each way; sums to 1 - nine."""
        config, families = self.config, [prior.name for prior in shipped_priors(self.setup)]
        left = 1 - config.nine
        shares = {}
        if self.before is not None:
            shares[self.before.name] = left * (config.general if self.before.name == IN_GENERAL else config.before)
        left -= sum(shares.values())
        of_families = config.families / (1 - config.nine) * left if families else 0.0
        shares |= {name: of_families / len(families) for name in families}
        return shares | dict.fromkeys((NAMED_WAY, EMBEDDING_WAY), (left - of_families) / 2)

    @cached_property
    def _ways(self) -> list[_Way]:
        signs = np.where(self.chosen, 1.0, -1.0)
        ways = []
        for name, share in self._shares.items():
            seen = (np.zeros(0), np.zeros((0, 1))) if self.differences is None else self._see(self.differences, name)
            for strength, probable in zip(self.config.strengths, self.config.prior, strict=True):
                process = AdvantageProcess.after(strength, seen, signs)
                ways.append(_Way(name, process, math.log(max(share * probable, 1e-300))))
        return ways

    def _of(self, differences: PairDifferences) -> Iterator[tuple[_Way, Seen]]:
        """Every way with what it sees of these pairs."""
        seen = {name: self._see(differences, name) for name in self._shares}
        for way in self._ways:
            yield way, seen[way.name]

    def _of_the_nine(self, differences: PairDifferences) -> NDArray[np.float32]:
        """(PREDICTING, n) how much better the first of each pair is by the nine alone, by particle."""
        scaled = differences.seen[:, 0] / typical_differences(self.setup)
        return self._few.weights @ gains(scaled).T.astype(np.float32)

    @cached_property
    def _reference(self) -> PairDifferences:
        return reference_differences(self.setup, self.left_right_symmetry)

    def _see(self, differences: PairDifferences, way: str) -> Seen:
        if way in self._priors:
            return self._priors[way].seen(differences)
        return np.zeros(len(differences)), differences.named if way == NAMED_WAY else differences.embedding

    @cached_property
    def _masses(self) -> Doubles:
        """(1 + ways,) probability of the nine, then of each Gaussian process."""
        logs = np.array(
            [math.log(self.config.nine) + self.nine_log_evidence]
            + [way.process.log_evidence + way.prior for way in self._ways]
        )
        masses: Doubles = np.exp(logs - logsumexp(logs))
        return masses


def _typical(advantages: NDArray[np.float32]) -> Doubles:
    """(particles,) what a pair's advantage (columns) is, whichever side has it: root of the mean square."""
    typical: Doubles = np.sqrt(np.square(advantages, dtype=np.float64).mean(1))
    return typical


def _probability_above(advantages: NDArray[np.float32], least: Doubles | float) -> float:
    """Mean over particles (rows) that their mean over scenes (columns) is above the least, the scenes being a
    sample."""
    means = advantages.mean(1, dtype=np.float64)
    errors = advantages.std(1, dtype=np.float64) / math.sqrt(advantages.shape[1]) + 1e-9
    return float(ndtr((means - least) / errors).mean())


def bits_about_others(own: Doubles, others: Doubles) -> Doubles:
    """(n,) mutual information (bits) between the answer to each pair and the answer to one of m others, on average over
    these. own (samples, n), others (samples, m): probability that the first is chosen, by each sample of what is
    believed. Expected predictive information gain (Bickford Smith et al. 2023)."""
    both = own.T @ others / len(own)
    first, second = own.mean(0)[:, None], others.mean(0)[None]
    common = (
        _part(both, first * second)
        + _part(first - both, first * (1 - second))
        + _part(second - both, (1 - first) * second)
        + _part(1 - first - second + both, (1 - first) * (1 - second))
    )
    bits: Doubles = np.maximum(common.mean(1), 0.0)
    return bits


def _part(joint: Doubles, apart: Doubles) -> Doubles:
    joint, apart = np.maximum(joint, 1e-12), np.maximum(apart, 1e-12)
    return joint * np.log2(joint / apart)

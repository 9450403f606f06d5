"""Which query to ask next: at random, where the particles disagree most, or where an answer tells most.

What an answer then says lives in `posterior.py`. All ours; mutual information as in
active preference learning, joint over a batch so that it holds no two queries that tell the same. What an answer tells
of the foremost objective counts twice: else queries about shares, care and lapses come early, and it stays in doubt.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.posterior import Posterior

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Strategy = Literal["random", "disagreement", "information"]
STRATEGIES: tuple[str, ...] = get_args(Strategy)
PARTICLES = 2_000  # of the posterior, drawn for choosing: 500 candidates take a few hundredths of a second
FUTURES = 64  # answers to the queries chosen so far, of which a batch takes the mean


@dataclass(frozen=True)
class NextQuery:
    """index: which candidate. bits: the mutual information between its answer and the particles."""

    index: int
    bits: float


@dataclass(frozen=True)
class StoppingRule:
    """Little is left to learn: the best next query promised less than `below_bits` for `in_a_row` answers.

    Never before `at_least` answers. Defaults are ours.
    """

    below_bits: float = 0.1
    in_a_row: int = 3
    at_least: int = 8

    def met(self, best_bits: Sequence[float]) -> bool:
        """best_bits: what the best next query promised after each answer so far."""
        if len(best_bits) < max(self.at_least, self.in_a_row):
            return False
        return all(bits < self.below_bits for bits in best_bits[len(best_bits) - self.in_a_row :])


def information_bits(posterior: Posterior, differences: Doubles) -> Doubles:
    """(n,) mutual information (bits) between the answer to each query and what is not known yet.

    differences: (n, spans, 7) measures of A minus those of B.
    """
    few = posterior.sample(PARTICLES)
    choice_probabilities = few.choice_probabilities(differences)
    masses = np.full((1, PARTICLES), 1 / PARTICLES, dtype=np.float32)
    return _information(masses, choice_probabilities, _entropy_bits(choice_probabilities))


def best_information(posterior: Posterior, differences: Doubles) -> float:
    """Bits that the answer to the best of these queries promises."""
    return float(information_bits(posterior, differences).max())


def next_query(posterior: Posterior, differences: Doubles, strategy: str, random: np.random.Generator) -> NextQuery:
    """The query to ask next, out of candidates whose measures differ by (n, spans, 7) A minus B.

    Raises LearningError for no candidates or an unknown strategy.
    """
    index = choose_queries(posterior, differences, 1, strategy, random)[0]
    return NextQuery(index, float(information_bits(posterior, differences[index : index + 1])[0]))


def asked_in_turn(
    posterior: Posterior,
    differences: Doubles,
    answers: Sequence[bool] | NDArray[np.bool_],
    candidates: Sequence[int],
    count: int,
    strategy: str,
    random: np.random.Generator,
) -> Iterator[tuple[int, Posterior]]:
    """Ask `count` of the candidates one after the other, each chosen on the answers before it.

    differences: (n, spans, 7) A minus B of all queries. answers: whether A is preferred, of all. Yields each query's
    number and the posterior after its answer. Raises LearningError as `next_query`.
    """
    left = list(candidates)
    for _ in range(count):
        k = left.pop(next_query(posterior, differences[left], strategy, random).index)
        posterior = posterior.updated(differences[k], bool(answers[k]))
        yield k, posterior


def choose_queries(
    posterior: Posterior, differences: Doubles, count: int, strategy: str, random: np.random.Generator
) -> list[int]:
    """`count` different queries out of candidates (n, spans, 7), in the order of choice, before any is answered.

    Greedy: the next one is best on average over answers that the particles expect to the ones chosen before, so what
    those would tell already counts no more. Raises LearningError for too few candidates or an unknown strategy.
    """
    if strategy not in STRATEGIES:
        raise LearningError(f"strategy = {strategy!r}: known are {', '.join(STRATEGIES)}")
    if not 1 <= count <= len(differences):
        raise LearningError(f"count = {count}: of {len(differences)} candidates, between 1 and all can be chosen")
    if strategy == "random":
        return [int(k) for k in random.choice(len(differences), count, replace=False)]
    few = posterior.sample(PARTICLES)
    choice_probabilities = few.choice_probabilities(differences)
    entropies = _entropy_bits(choice_probabilities)
    foremost = few.weights.argmax(axis=1)
    futures = FUTURES if count > 1 else 1
    masses = np.full((futures, PARTICLES), 1 / PARTICLES, dtype=np.float32)
    truths = random.integers(PARTICLES, size=futures)
    chosen: list[int] = []
    while True:
        if strategy == "information":
            value = _about_foremost(masses, choice_probabilities, foremost) + _information(
                masses, choice_probabilities, entropies
            )
        else:
            value = _disagreement(masses, choice_probabilities)
        value[chosen] = -np.inf
        chosen.append(int(value.argmax()))
        if len(chosen) == count:
            return chosen
        seen = choice_probabilities[:, chosen[-1]]
        says_a = random.random(futures) < seen[truths]
        masses *= np.where(says_a[:, None], seen[None], 1 - seen[None])
        masses /= masses.sum(axis=1, keepdims=True)


def _information(masses: Floats, choice_probabilities: Floats, entropies: Floats) -> Doubles:
    """(n,) H[E p] - E H[p], averaged over the rows of masses (futures, particles)."""
    bits: Doubles = (_entropy_bits(masses @ choice_probabilities) - masses @ entropies).mean(axis=0, dtype=np.float64)
    return np.maximum(bits, 0.0)


def _about_foremost(masses: Floats, choice_probabilities: Floats, foremost: NDArray[np.int64]) -> Doubles:
    """(n,) mutual information with which objective is the foremost, averaged over the rows of masses.

    foremost: (particles,) that objective of each.
    """
    bits = _entropy_bits(masses @ choice_probabilities)
    for objective in np.unique(foremost):
        of = foremost == objective
        share = np.maximum(masses[:, of].sum(axis=1, keepdims=True), 1e-12)
        bits -= share * _entropy_bits(masses[:, of] @ choice_probabilities[of] / share)
    mean: Doubles = bits.mean(axis=0, dtype=np.float64)
    return mean


def _disagreement(masses: Floats, choice_probabilities: Floats) -> Doubles:
    """(n,) variance of the particles' predictions, averaged over the rows of masses."""
    variance: Doubles = (masses @ np.square(choice_probabilities) - np.square(masses @ choice_probabilities)).mean(
        axis=0, dtype=np.float64
    )
    return variance


def _entropy_bits(choice_probabilities: Floats) -> Floats:
    """Entropy (bits) of answers with these probabilities, strictly between 0 and 1."""
    certain = np.clip(choice_probabilities, 1e-6, 1 - 1e-6)
    entropy: Floats = -(certain * np.log2(certain) + (1 - certain) * np.log2(1 - certain))
    return entropy

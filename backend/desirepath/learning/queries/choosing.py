"""Which query to ask next: what a strategy of choosing is, and when asking ends.

Each strategy is one file in `strategies`; another package's comes by an entry point of `desirepath.query_strategies`.
What answers say lives in `preferences/posterior.py` (weights of the objectives) and `free_posterior.py` (beyond them).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from desirepath.registries import Registry

if TYPE_CHECKING:
    from desirepath.learning.measures.pairs import PairDifferences
    from desirepath.learning.preferences.free_posterior import FreePosterior
    from desirepath.learning.preferences.posterior import Posterior

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
PARTICLES = 2_000  # of the posterior, drawn for choosing: 500 candidates take a few hundredths of a second

P = TypeVar("P")
D = TypeVar("D", Doubles, "PairDifferences")


@dataclass(frozen=True)
class NextQuery:
    """index: which of those that are left. bits: the mutual information between its answer and what is not known."""

    index: int
    bits: float


@dataclass(frozen=True)
class Candidates(Generic[D]):
    """all: how the pairs of a query set differ, A minus B; left: rows of those that may still be asked."""

    all: D
    left: Sequence[int]

    @property
    def differences(self) -> D:
        """Of those that are left, in their order."""
        found: D = self.all[list(self.left)]
        return found


class QueryStrategy(ABC, Generic[P, D]):
    """Asks the query of the highest value next. A strategy gives the values, or overrides `ask_next`.

    beyond: goes by a `FreePosterior` and `PairDifferences`, not by a `Posterior` and the objectives' measures.
    """

    beyond: ClassVar[bool]

    def values(self, posterior: P, candidates: Candidates[D]) -> Doubles:
        """(n,) what each query that is left is worth asking, by the posterior after all answers so far."""
        raise NotImplementedError

    @abstractmethod
    def bits(self, posterior: P, differences: D) -> Doubles:
        """(n,) mutual information (bits) between the answer to each pair and what is not known yet."""

    def ask_next(self, posterior: P, candidates: Candidates[D], random: np.random.Generator) -> NextQuery:
        """One of those that are left, of which there is one at least."""
        del random  # a strategy that draws overrides this
        index = int(self.values(posterior, candidates).argmax())
        return NextQuery(index, float(self.bits(posterior, candidates.all[[candidates.left[index]]])[0]))

    def best_bits(self, posterior: P, candidates: Candidates[D]) -> float:
        """Bits that the answer to the most telling query that is left promises."""
        return float(self.bits(posterior, candidates.differences).max())


class ObjectivesStrategy(QueryStrategy["Posterior", Doubles]):
    """Goes by the weights of the objectives. Candidates are (n, spans, 7) measures of A minus those of B."""

    beyond = False

    def bits(self, posterior: Posterior, differences: Doubles) -> Doubles:
        return information_bits(posterior, differences)


class BeyondStrategy(QueryStrategy["FreePosterior", "PairDifferences"]):
    """Goes by whatever the answers may be about: the objectives, named measures, an embedding."""

    beyond = True

    def bits(self, posterior: FreePosterior, differences: PairDifferences) -> Doubles:
        return posterior.information_bits(differences)


STRATEGIES: Registry[QueryStrategy[Any, Any]] = Registry(
    "desirepath.query_strategies", "desirepath.learning.queries.strategies", "STRATEGY"
)
"""By the name that protocols choose it by."""


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
    return mutual_information(posterior.sample(PARTICLES).choice_probabilities(differences)).astype(np.float64)


def mutual_information(choice_probabilities: Floats) -> Floats:
    """(n,) H[E p] - E H[p] over particles as likely as each other; choice_probabilities: (particles, n)."""
    particles = len(choice_probabilities)
    masses = np.full(particles, 1 / particles, dtype=np.float32)
    bits = entropy_bits(masses @ choice_probabilities) - masses @ entropy_bits(choice_probabilities)
    return np.maximum(bits, np.float32(0))


def entropy_bits(choice_probabilities: Floats) -> Floats:
    """Entropy (bits) of answers with these probabilities, strictly between 0 and 1."""
    certain = np.clip(choice_probabilities, 1e-6, 1 - 1e-6)
    entropy: Floats = -(certain * np.log2(certain) + (1 - certain) * np.log2(1 - certain))
    return entropy

"""What every likelihood is: the log probability of one answer, for many people at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
Feedback = Literal["evaluative", "comparative", "corrective", "demonstrative", "descriptive"]
"""What the literature calls an answer of that kind (Metz et al. 2023, among others)."""
LEAST = 1e-6  # never quite impossible, so that no particle dies of one answer


@dataclass(frozen=True)
class Habits:
    """How n people answer. lapse_rate (n,): share of answers without looking, any of those possible. criteria (n, 2),
    log odds: from which advantage on one of two is better at all, and from which on it is clearly better."""

    lapse_rate: Doubles
    criteria: Doubles


@dataclass(frozen=True, eq=False)
class Evidence(ABC):
    """One answer. measured (k, spans, 7): what its alternatives measure, of as much as each span sees."""

    feedback: ClassVar[Feedback]
    measured: Doubles

    @abstractmethod
    def log_likelihood(self, worth: Doubles, habits: Habits) -> Doubles:
        """(n,) of this answer. worth (n, k): log odds that each alternative has over another one, up to a constant."""


def with_lapses(careful: Doubles, lapse_rate: Doubles, possible: int) -> Doubles:
    """(n,) log probability of an answer that has probability `careful` where somebody looks, and else is one of
    `possible`."""
    return np.log(np.clip((1 - lapse_rate) * careful + lapse_rate / possible, LEAST, 1.0))


def of_best(worth: Doubles) -> Doubles:
    """(n,) probability that the first of (n, k) alternatives is taken: Luce's choice (1959), Boltzmann's of what they
    are worth."""
    ahead = worth - worth.max(axis=1, keepdims=True)
    probability: Doubles = np.exp(ahead[:, 0]) / np.exp(ahead).sum(axis=1)
    return probability


def of_level(position: Doubles, criteria: Doubles, level: int) -> Doubles:
    """(n,) probability of a level, 0 the lowest, where somebody is at `position` (n,) with logistic noise and rising
    criteria (n, levels - 1) part the levels: the cumulative link (McCullagh 1980)."""
    below = 1 / (1 + np.exp(-np.clip(criteria - position[:, None], -30, 30)))
    edges = np.concatenate([np.zeros((len(below), 1)), below, np.ones((len(below), 1))], axis=1)
    probability: Doubles = edges[:, level + 1] - edges[:, level]
    return probability

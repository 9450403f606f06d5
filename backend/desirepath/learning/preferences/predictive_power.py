"""Whether answers are predicted well enough to say anything of what somebody prefers: decided here for every page, job
and export. What predicts them is `posterior.py`'s and `free_posterior.py`'s. Ours.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

CONVINCING = 5.0
"""How many times more probable answers must be by their predictions than by a coin. Predicted one step ahead, the odds
of whoever answers by a coin are a martingale, whatever is asked next, and so are those of whoever clicks one letter
where sides are drawn by lot: they get here with a probability of at most 1 / 5 (Ville's inequality), after 15 answers
with one of about 0.02 (experiments/notebook), the level of a test."""
MOST = 700.0  # natural logarithm; larger odds have no float


def odds_against_chance(likelihoods: NDArray[np.float64]) -> float:
    """How many times more probable answers are by what was predicted than by a coin. likelihoods: (n,) probability of
    each answer as it was given, predicted from those before it."""
    return math.exp(min(float(np.log(2 * np.clip(likelihoods, 1e-9, 1.0)).sum()), MOST))


def better_than_chance(odds: float) -> bool:
    """Whether answers with these odds say something."""
    return odds >= CONVINCING

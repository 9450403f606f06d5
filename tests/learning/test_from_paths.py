"""From drawn paths to weights: those whose rollouts measure like the paths become probable."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.preferences.from_paths import WeightsOfPaths
from desirepath.learning.preferences.measures import typical_differences

TYPICAL = typical_differences("study_room")


def candidates(n=60, scenes=5):
    """Weights of the first two objectives; what their rollouts measure follows the first share."""
    first = np.linspace(0, 1, n)
    shares = np.zeros((n, 9))
    shares[:, 0], shares[:, 1] = first, 1 - first
    measured = np.broadcast_to(first[:, None, None] * 4 * TYPICAL, (n, scenes, 7)).copy()
    return WeightsOfPaths("study_room", shares, measured, np.full(n, 1 / n))


def spread(known: WeightsOfPaths, mass: np.ndarray) -> float:
    """Standard deviation of the first share."""
    share = known.shares[:, 0]
    return float(np.sqrt(mass @ np.square(share - mass @ share)))


def test_four_paths_tell_the_weights_whose_rollouts_they_are_like():
    known = candidates()
    mass = known.given(np.array([0, 1, 2, 4]), known.measured[42, [0, 1, 2, 4]])
    assert mass.sum() == pytest.approx(1)
    assert (mass @ known.shares)[0] == pytest.approx(known.shares[42, 0], abs=0.03)
    assert spread(known, mass) < 0.1


def test_one_path_tells_less_than_four_and_none_nothing():
    known = candidates()

    def spread_after(scenes):
        return spread(known, known.given(np.array(scenes, np.int64), known.measured[30][scenes]))

    assert spread_after([0, 1, 2, 3]) < spread_after([0]) < spread_after([])
    assert spread_after([]) == pytest.approx(known.shares[:, 0].std())

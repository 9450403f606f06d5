"""From drawn paths to weights: those whose rollouts measure like the paths become probable."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.learning.preferences.from_paths import WeightsOfPaths, credible
from desirepath.learning.preferences.measures import typical_differences

TYPICAL = typical_differences("study_room")


def candidates(n=60, scenes=5):
    """Weights of the first two objectives; what their rollouts measure follows the first share."""
    first = np.linspace(0, 1, n)
    shares = np.zeros((n, 9))
    shares[:, 0], shares[:, 1] = first, 1 - first
    measured = np.broadcast_to(first[:, None, None] * 4 * TYPICAL, (n, scenes, 7)).copy()
    return WeightsOfPaths("study_room", shares, measured, np.full(n, 1 / n))


def test_four_paths_tell_the_weights_whose_rollouts_they_are_like():
    known = candidates()
    mass = known.given(np.array([0, 1, 2, 4]), known.measured[42, [0, 1, 2, 4]])
    assert mass.sum() == pytest.approx(1)
    assert (mass @ known.shares)[0] == pytest.approx(known.shares[42, 0], abs=0.03)
    low, high = credible(known.shares, mass)
    assert low[0] <= known.shares[42, 0] <= high[0]
    assert high[0] - low[0] < 0.3


def test_one_path_tells_less_than_four_and_none_nothing():
    known = candidates()

    def width(scenes):
        mass = known.given(np.array(scenes, np.int64), known.measured[30][scenes])
        low, high = credible(known.shares, mass)
        return high[0] - low[0]

    assert width([0, 1, 2, 3]) < width([0]) < width([])
    assert width([]) == pytest.approx(0.9, abs=0.05)

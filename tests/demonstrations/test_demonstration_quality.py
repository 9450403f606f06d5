"""Flags of demonstrations: what is drawn twice, too near, unlike the others or in jerks is pointed out."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.demonstrations.demonstration import Demonstration, demonstration_from
from desirepath.demonstrations.demonstration_quality import qualities
from desirepath.demonstrations.stroke import Stroke
from desirepath.simulation.demonstration_scenes import demonstration_scene


def drawn(bend_m: float, speeds: tuple[float, ...] = (0.2,)) -> Demonstration:
    """An arc in the corridor's first place, `bend_m` to the left at its middle, its speeds spread evenly along it."""
    scene = demonstration_scene("corridor", 0)
    u = np.linspace(0.0, 1.0, 160)
    x = scene.start.x + (scene.goal.x - scene.start.x) * u
    y = scene.start.y + (scene.goal.y - scene.start.y) * u + bend_m * np.sin(np.pi * u)
    along = np.interp(u, np.linspace(0.0, 1.0, len(speeds)), speeds)
    return demonstration_from(Stroke(np.stack([x, y], axis=1), along, 6.0 * u), scene)


def test_a_calm_path_with_room_has_no_flag_and_true_numbers() -> None:
    demonstration = drawn(0.75)
    (quality,) = qualities([demonstration], ["P1"])
    assert quality.flags == ()
    assert quality.length_m == pytest.approx(demonstration.spline.length_m, abs=0.5)  # it ends within the goal radius
    assert quality.mean_speed == pytest.approx(0.2, abs=0.005)
    # The person stands at (0, -0.6), radius 0.3, the robot passes at y = 0.75.
    assert quality.human_m == pytest.approx(1.35 - 0.3 - 0.18, abs=0.03)
    assert quality.apart_m is None


def test_what_is_drawn_twice_is_found_within_its_situation_only() -> None:
    twice = [drawn(0.75), drawn(0.77), drawn(0.75)]
    within = qualities(twice, ["P1", "P1", "P2"])
    assert [one.same_as for one in within] == [None, 0, None]
    assert within[1].flags == ("duplicate",)


def test_near_jerky_and_unlike_the_others() -> None:
    near, jerky, other, usual = (
        drawn(-0.05),
        drawn(0.75, (0.1, 0.1, 0.1, 0.25, 0.1, 0.25, 0.1, 0.25, 0.1, 0.1, 0.1, 0.25, 0.1, 0.1, 0.25, 0.1, 0.25, 0.1)),
        drawn(1.1),
        drawn(0.7),
    )
    assert qualities([near], [0])[0].flags == ("clearance",)
    assert qualities([jerky], [0])[0].flags == ("jerk",)
    assert qualities([usual], [0])[0].flags == ()
    assert "outlier" in qualities([near, other], [0, 0])[1].flags
    with pytest.raises(ValueError, match="groups"):
        qualities([near], [])

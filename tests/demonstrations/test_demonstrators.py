"""The programmed demonstrators draw what their names say, in every pair, and never the same twice."""

from __future__ import annotations

import math

import numpy as np
import pytest

from desirepath.demonstrations.demonstrators import STYLES, demonstrate, draw_stroke
from desirepath.simulation.demonstration_scenes import demonstration_scene, pairs_of
from desirepath.simulation.setups import demonstration_setups
from desirepath.simulation.trajectory import Outcome, Trajectory


def beside_person(drive: Trajectory) -> tuple[float, float]:
    """(smallest distance to the person, angle there from where the person looks, absolute)."""
    person = drive.scene.person.pose
    offsets = drive.poses[:, :2] - np.array([person.x, person.y])
    distances = np.linalg.norm(offsets, axis=1)
    nearest = offsets[np.argmin(distances)]
    turned = math.atan2(nearest[1], nearest[0]) - person.yaw
    return float(distances.min()), abs((turned + math.pi) % (2 * math.pi) - math.pi)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("setup", demonstration_setups())
def test_each_style_succeeds_in_every_pair_and_keeps_about_the_preferred_distance(setup: str, style: str) -> None:
    for pair in range(pairs_of(setup)):
        made = demonstrate(style, demonstration_scene(setup, pair), 0)
        assert made.trajectory.outcome == Outcome.SUCCESS
        assert (made.style, made.simulated, made.seed) == (style, True, 0)
        assert beside_person(made.trajectory)[0] > 0.9  # people prefer 1.1 +- 0.2 m


def test_passing_behind_is_behind_and_the_field_of_view_is_before() -> None:
    scene = demonstration_scene("room", 1)  # the person looks across the way
    _, before = beside_person(demonstrate("field_of_view", scene, 0).trajectory)
    _, behind = beside_person(demonstrate("behind", scene, 0).trajectory)
    assert before < math.pi / 2 < behind


def test_the_wall_follower_stays_near_walls_where_others_do_not() -> None:
    def away(style: str) -> float:
        made = demonstrate(style, demonstration_scene("room", 0), 0)
        room = made.scene.room
        assert room is not None
        return float(
            (np.array([room.length, room.width]) / 2 - np.abs(made.trajectory.poses[:, :2])).min(axis=1).mean()
        )

    assert away("wall_follower") < 0.8 < away("slow_near_person")


def test_who_is_slow_near_the_person_is_fast_elsewhere() -> None:
    made = demonstrate("slow_near_person", demonstration_scene("corridor", 0), 0)
    person = made.scene.person.pose
    distances = np.linalg.norm(made.trajectory.poses[:-1, :2] - np.array([person.x, person.y]), axis=1)
    assert made.executed_speeds[distances < 1.2].mean() < 0.13
    assert made.executed_speeds[distances > 2.6].mean() > 0.22


def test_a_seed_is_a_stroke_and_another_seed_another() -> None:
    scene = demonstration_scene("room", 2)
    first, again, other = (draw_stroke("behind", scene, seed).points for seed in (3, 3, 4))
    assert (first == again).all()
    assert len(first) != len(other) or np.abs(first - other).max() > 0.005


def test_unknown_styles_are_named() -> None:
    with pytest.raises(ValueError, match="field_of_view"):
        draw_stroke("elegant", demonstration_scene("room", 0), 0)

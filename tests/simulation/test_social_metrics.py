"""The metrics of social navigation, on paths whose values follow from geometry."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.simulation.scene import Person, Pose, Scene
from desirepath.simulation.social_metrics import LONGEST_TTC_S, SocialMetrics, join, social_metrics

DT = 0.2
SCENE = Scene("open_field", 0, Pose(0.0, 0.0, 0.0), Pose(4.0, 0.0), 0.4, Person(Pose(2.0, 0.0)))
CONTACT = 0.18 + SCENE.person.radius


def measured(
    xy: list[tuple[float, float]], scene: Scene = SCENE, *, success: bool = True, turned: float = 0
) -> SocialMetrics:
    path = np.array(xy, dtype=float)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    return social_metrics(
        [path],
        [scene],
        success=np.array([success]),
        path_length=np.array([length]),
        accumulated_angle=np.array([turned]),
        dt=DT,
    )


def line(y: float, *, speed: float = 0.5, metres: float = 4.0) -> list[tuple[float, float]]:
    return [(k * speed * DT, y) for k in range(round(metres / speed / DT) + 1)]


def test_personal_space_is_counted_by_entries_and_by_seconds() -> None:
    past = measured(line(0.9))
    chord_m = 2 * math.sqrt(1.2**2 - 0.9**2)
    assert past.personal_space_violations == [1]
    assert past.personal_space_time[0] == pytest.approx(chord_m / 0.5, abs=DT)
    twice = line(0.9) + line(0.9)[::-1]
    assert measured(twice).personal_space_violations == [2]
    assert measured(line(1.3)).personal_space_violations == measured(line(1.3)).personal_space_time == [0]


def test_time_to_collision_is_until_the_surfaces_touch_at_this_pace() -> None:
    towards = measured([(0.0, 0.0), (0.1, 0.0)])  # 1.9 m between the centres, half a metre per second
    assert towards.min_time_to_collision[0] == pytest.approx((1.9 - CONTACT) / 0.5)
    assert measured([(0.1, 0.0), (0.0, 0.0)]).min_time_to_collision == [LONGEST_TTC_S]
    assert measured(line(CONTACT + 0.01)).min_time_to_collision == [LONGEST_TTC_S]
    assert measured(line(0.1)).min_time_to_collision == [0]


def test_stalling_jerk_and_irregularity() -> None:
    waits = line(1.5, metres=2.0) + [(2.0, 1.5)] * 5
    assert measured(waits).stalled_time[0] == pytest.approx(5 * DT)
    steady = measured(line(1.5))
    assert steady.stalled_time == [0]
    assert steady.mean_jerk[0] == pytest.approx(0, abs=1e-9)
    jolt = [(0.0, 2.0), (0.1, 2.0), (0.2, 2.0), (0.5, 2.0)]  # 0.5, 0.5, 1.5 m/s: 0 and 5 m/s^2
    assert measured(jolt).mean_jerk[0] == pytest.approx(5 / DT)
    assert measured(line(1.5), turned=2.0).path_irregularity[0] == pytest.approx(2.0 / 4.0)
    faces_away = replace(SCENE, start=Pose(0.0, 0.0, math.pi))
    assert measured(line(1.5), faces_away, turned=math.pi).path_irregularity == pytest.approx([0])


def test_success_weighted_by_path_length() -> None:
    assert measured(line(0.0)).spl == pytest.approx([1])
    detour = [(0.0, 0.0), (0.0, 2.0), (4.0, 2.0), (4.0, 0.0)]
    assert measured(detour).spl == pytest.approx([0.5])
    assert measured(detour, success=False).spl == [0]


def test_many_rollouts_of_different_lengths_are_measured_each_for_itself() -> None:
    both = social_metrics(
        [np.array(line(0.9)), np.array(line(1.5, metres=2.0))],
        [SCENE, SCENE],
        success=np.array([True, False]),
        path_length=np.array([4.0, 2.0]),
        accumulated_angle=np.zeros(2),
        dt=DT,
    )
    alone = join([measured(line(0.9)), measured(line(1.5, metres=2.0), success=False)])
    for name, values in vars(both).items():
        assert values == pytest.approx(getattr(alone, name)), name

"""Homes: four rooms with doors, all of them reachable, furniture that leaves the doors free, nothing shown twice."""

from __future__ import annotations

import math

import numpy as np
import pytest

from desirepath.simulation import home_interiors as homes
from desirepath.simulation import kernels as k
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import draw_scene, draw_scenes, scene_to_row


def rooms_of(row: k.Row) -> list[tuple[float, float, float, float]]:
    """The four rooms of a home's row: free floor between its walls, metres."""
    values = np.asarray(row, dtype=np.float64)
    half_x, half_y = float(values[k.ROOM_HALF_X]), float(values[k.ROOM_HALF_Y])

    def wall(number: int) -> tuple[float, float]:
        o = k.FIRST_BOX + k.BOX_COLUMNS * number
        return float(values[o + k.BOX_X]), float(values[o + k.BOX_Y])

    t, x, ends = homes.WALL_M / 2, wall(0)[0], (wall(3)[1], wall(5)[1])
    return [
        rectangle
        for y, (begin, end) in zip(ends, ((-half_x, x - t), (x + t, half_x)), strict=True)
        for rectangle in ((begin, -half_y, end, y - t), (begin, y + t, end, half_y))
    ]


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return draw_scenes("home", range(60))


def test_a_home_has_four_rooms_and_in_them_what_homes_have(scenes: list[Scene]):
    for scene in scenes:
        rooms = rooms_of(scene_to_row(scene))
        assert len(rooms) == 4
        held = [
            sorted(o.kind for o in scene.obstacles[homes.WALLS :] if r[0] < o.pose.x < r[2] and r[1] < o.pose.y < r[3])
            for r in rooms
        ]
        expected = [homes._LIVING, homes._DINING_ROOM, homes._BEDROOM, homes._STUDY]
        assert sorted(held) == sorted(sorted(kinds) for kinds in expected)


def test_start_goal_and_person_are_in_one_room_as_far_apart_as_the_thesis_says(scenes: list[Scene]):
    for scene in scenes:
        way = math.dist((scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y))
        assert 1.5 < way < 6.0
        rooms = rooms_of(scene_to_row(scene))
        places = [(p.x, p.y) for p in (scene.start, scene.goal, scene.person.pose)]
        assert any(all(r[0] < x < r[2] and r[1] < y < r[3] for x, y in places) for r in rooms)


def test_a_robot_gets_through_every_door(scenes: list[Scene]):
    for scene in scenes:
        row = scene_to_row(scene)
        row[k.PERSON_X] = math.inf
        row[k.GOAL_RADIUS] = 0.2
        for x0, y0, x1, y1 in rooms_of(row):
            free = [
                (x, y)
                for x in np.arange(x0 + 0.4, x1 - 0.4, 0.3)
                for y in np.arange(y0 + 0.4, y1 - 0.4, 0.3)
                if k.surface_distance(row, x, y) > 0.35
            ]
            reached = 0
            for x, y in free[:: max(1, len(free) // 3)]:
                row[k.GOAL_X], row[k.GOAL_Y] = x, y
                reached += bool(k.reachable(row, 0.2))
            assert reached > 0


def test_homes_differ_in_size_doors_and_what_is_where(scenes: list[Scene]):
    assert len({scene.room.length for scene in scenes if scene.room}) == len(scenes)
    beds = {(o.pose.x > 0, o.pose.y > 0) for scene in scenes for o in scene.obstacles if o.kind == "bed"}
    assert len(beds) == 4


def test_the_home_of_a_seed_is_what_it_always_was():
    scene = draw_scene("home", 2026)
    assert (scene.start.x, scene.start.y) == (-1.059853, 2.770615)
    assert (scene.room.length, scene.room.width) == (10.221774, 7.614194)

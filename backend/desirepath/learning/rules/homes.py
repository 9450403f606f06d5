"""Homes that rules are told and measured in: furnished, with named rooms, and a person who sits, stands or walks. The
study room's robot drives in them, trained as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.rules.rule import Condition, Rule
from desirepath.simulation import kernels as k
from desirepath.simulation.home_interiors import KINDS, WALLS
from desirepath.simulation.scene import Person, Pose, Scene
from desirepath.simulation.scenes import check_scene, draw_scene, scene_to_row
from desirepath.simulation.setups import get_setup
from desirepath.simulation.walks import Walk

HOME, SETUP = "home", "study_room"
SEAT_HEIGHT_M = 1.3  # of somebody who sits
WALKING_M_S, TURNING_S = 0.6, 1.0
SHORTEST_WALK_M, LONGEST_WALK_M, BESIDE_M = 1.0, 3.0, 0.12
WALKS_FOR_S = 90.0
_FIRST = {"living_room": WALLS, "kitchen": WALLS + 5, "bedroom": WALLS + 11, "study": WALLS + 14}
"""Rooms by the first piece of furniture that stands in each."""
DOORWAY, BEFORE_DOOR_M = "doorway", 0.5  # to either side of the wall
_AT_DOOR = ((0, 1), (1, 2), (3, 4), (5, 6))  # walls by whose ends a door is
ALIASES: dict[str, str] = {"dining_room": "kitchen"}  # where the dining table stands


@dataclass(frozen=True)
class Area:
    """A room by name: smallest and largest x and y (m)."""

    name: str
    low: tuple[float, float]
    high: tuple[float, float]

    def holds(self, x: float, y: float) -> bool:
        return self.low[0] <= x <= self.high[0] and self.low[1] <= y <= self.high[1]


@lru_cache(maxsize=512)
def rule_scene(seed: int) -> Scene:
    """A home from a seed, in which the study room's robot drives; the person sits, stands or walks."""
    scene = draw_scene(HOME, seed)
    person = scene.person
    scene = replace(scene, setup=SETUP, goal_radius=get_setup(SETUP).goal_radius_m)
    if seed % 3 == 0:
        scene = replace(scene, person=Person(person.pose, person.radius, SEAT_HEIGHT_M, sits=True))
    elif seed % 3 == 1:
        scene = _walking(scene)
    check_scene(scene)
    return scene


def _walking(scene: Scene) -> Scene:
    """The scene with its person walking to and fro, as far as there is room; as it was where there is none."""
    row, at = scene_to_row(scene), scene.person.pose
    row[k.PERSON_X] = math.inf
    best, along = 0.0, 0.0
    for angle in np.linspace(-math.pi, math.pi, 24, endpoint=False).tolist():
        length = 0.0
        while length < LONGEST_WALK_M:
            x, y = at.x + (length + 0.1) * math.cos(angle), at.y + (length + 0.1) * math.sin(angle)
            if k.surface_distance(row, x, y) < scene.person.radius + BESIDE_M:
                break
            if math.dist((x, y), (scene.start.x, scene.start.y)) < 1.0:
                break
            length += 0.1
        if length > best:
            best, along = length, angle
    if best < SHORTEST_WALK_M:
        return scene
    times, xs, ys, yaws = [0.0], [at.x], [at.y], [along]
    there = True
    while times[-1] < WALKS_FOR_S:
        reach = best if there else 0.0
        times += [times[-1] + best / WALKING_M_S, times[-1] + best / WALKING_M_S + TURNING_S]
        xs += [at.x + reach * math.cos(along)] * 2
        ys += [at.y + reach * math.sin(along)] * 2
        yaws += [yaws[-1], yaws[-1] + math.pi]
        there = not there
    facing = Pose(at.x, at.y, math.remainder(along, 2 * math.pi))
    return replace(
        scene,
        person=replace(scene.person, pose=facing),
        walk=Walk(tuple(times), tuple(xs), tuple(ys), tuple(yaws)),
    )


@lru_cache(maxsize=512)
def rooms_of(scene: Scene) -> tuple[Area, ...]:
    """The rooms of a home by name, and its doorways; none of a scene that is no home."""
    if tuple(one.kind for one in scene.obstacles) != KINDS or scene.room is None:
        return ()
    half_x, half_y = scene.room.length / 2, scene.room.width / 2
    across, left, right = scene.obstacles[0].pose.x, scene.obstacles[3].pose.y, scene.obstacles[5].pose.y
    areas = []
    for name, first in _FIRST.items():
        at = scene.obstacles[first].pose
        in_left = at.x < across
        wall_y = left if in_left else right
        low = (-half_x if in_left else across, -half_y if at.y < wall_y else wall_y)
        high = (across if in_left else half_x, wall_y if at.y < wall_y else half_y)
        areas.append(Area(name, low, high))
    corners = [np.array(one.corners()) for one in scene.obstacles[:WALLS]]
    for one, other in _AT_DOOR:
        low, high = _gap(corners[one], corners[other])
        areas.append(Area(DOORWAY, low, high))
    return tuple(areas)


def _gap(one: NDArray[np.float64], other: NDArray[np.float64]) -> tuple[tuple[float, float], tuple[float, float]]:
    """The door between two walls in a line, of their corners (4, 2), with the floor before and behind it."""
    ends = sorted(
        (one.max(axis=0), one.min(axis=0), other.max(axis=0), other.min(axis=0)), key=lambda end: float(end.sum())
    )
    along = int(np.argmax(np.ptp(np.concatenate([one, other]), axis=0)))
    first, second = float(ends[1][along]), float(ends[2][along])
    middle = float(np.concatenate([one, other])[:, 1 - along].mean())
    across = (middle - BEFORE_DOOR_M, middle + BEFORE_DOOR_M)
    (x_low, x_high), (y_low, y_high) = ((first, second), across) if along == 0 else (across, (first, second))
    return (x_low, y_low), (x_high, y_high)


def unavailable(rule: Rule, scenes: tuple[Scene, ...]) -> list[Condition]:
    """What these scenes cannot tell: of the rule's conditions, and of the places of its zones, as conditions."""
    rooms = {area.name for scene in scenes for area in rooms_of(scene)}
    things = {one.kind for scene in scenes for one in scene.solids()} | {"furniture", "person"}
    people = any(scene.crowd for scene in scenes)
    doors = [one for one in rule.zones if one.kind == "room" and one.of == DOORWAY]  # no way leads around all of them
    can = {
        "sitting": any(scene.person.sits for scene in scenes),
        "walking": any(scene.walk for scene in scenes),
        "standing": True,
        "others": people,
        "hurry": False,
    }
    places = [
        Condition(kind="room" if zone.kind == "room" else "near", of=zone.of)
        for zone in rule.zones
        if zone.of is not None and zone not in doors
    ]
    never = [Condition(kind="room", of=DOORWAY)] if doors else []
    return never + [
        one
        for one in dict.fromkeys((*rule.when, *places))
        if not (
            can.get(one.kind, False)
            or (one.kind == "room" and ALIASES.get(str(one.of), one.of) in rooms)
            or (one.kind == "near" and one.of in things)
        )
    ]


PLACES = (7_200_102, 7_200_034, 7_200_320, 7_200_126, 7_200_068, 7_200_011)
"""Seeds of the homes that people tell rules in: in the first three somebody sits, walks, stands."""


@lru_cache(maxsize=1)
def rule_places() -> tuple[Scene, ...]:
    """The homes of a step of kind `rules`, the same for everybody."""
    return tuple(rule_scene(seed) for seed in PLACES)

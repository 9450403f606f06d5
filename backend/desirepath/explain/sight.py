"""What a robot's lidar sees of each thing of a scene, pose by pose: who provides which ray, and a scan without them.

Each thing is scanned alone by the engine's own lidar, so a scan of any of them together is the minimum over those: no
second ray caster, and what is hidden behind something provides no ray. Scores of things are `attribution.py`'s.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.fast import Floats, beams_of
from desirepath.simulation.scene import Obstacle, Person, Pose, Scene
from desirepath.simulation.scenes import ground_of, scene_to_row
from desirepath.simulation.setups import Setup, get_setup, require_lidar
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
NOBODY = Person(Pose(1e6, 1e6))
"""Far outside every lidar's range."""
FAR, AHEAD = 1.0, 0.0  # scaled inputs: as far as distances are scaled by, straight ahead
PERSON, GOAL = "person", "goal"
BUILDING = "building"  # whatever its map has
WALLS = ("wall east", "wall west", "wall north", "wall south")  # `Room.walls`: +x, -x, +y, -y


def thing_names(scene: Scene) -> list[str]:
    """The scene's obstacles by kind, numbered where there are several, its walls, its map, the person."""
    number, kinds = Counter[str](), Counter(obstacle.kind for obstacle in scene.obstacles)
    names = []
    for obstacle in scene.obstacles:
        number[obstacle.kind] += 1
        several = kinds[obstacle.kind] > 1
        names.append(f"{obstacle.kind} {number[obstacle.kind]}" if several else obstacle.kind)
    return [*names, *(WALLS if scene.room else ()), *((BUILDING,) if scene.ground else ()), PERSON]


@dataclass(frozen=True)
class Sight:
    """T moments of one robot in one scene.

    things: names. observations: (T, obs) float32 as the setup scales them. ranges: (T, things, sectors) float64, m: the
    pooled scan of each thing alone, the lidar's range where it is not hit.
    """

    setup: Setup
    things: tuple[str, ...]
    observations: Floats
    ranges: Doubles

    @property
    def first_ray(self) -> int:
        """Index of the first lidar input."""
        return self.setup.polar_size

    @cached_property
    def provider(self) -> NDArray[np.int64]:
        """(T, sectors) which thing a pooled ray ends at, by index; -1: none within range."""
        nearest = self.ranges.argmin(axis=1)
        hit = self.ranges.min(axis=1) < self.setup.robot.lidar.range_m
        return np.where(hit, nearest, -1)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(T, things) whether any pooled ray ends there."""
        which = np.arange(len(self.things))[None, :, None]
        hit: NDArray[np.bool_] = (self.provider[:, None, :] == which).any(axis=2)
        return hit

    def without(self, removed: NDArray[np.bool_]) -> Floats:
        """(T, obs) what would be observed had the things (T, things) been taken out of the room.

        Who takes out the person also takes out what the robot is told of where they stand, if it is: as far as it is
        ever said, straight ahead.
        """
        ranges = np.where(removed[:, :, None], self.setup.robot.lidar.range_m, self.ranges).min(axis=1)
        changed = self.observations.copy()
        changed[:, self.first_ray :] = ranges / self.setup.robot.lidar.range_m
        if self.setup.person_inputs is not None:
            gone = removed[:, self.things.index(PERSON)]
            for which, value in zip(self.setup.person_inputs, (FAR, AHEAD), strict=True):
                changed[gone, which] = value
        return changed


def sight_of(trajectory: Trajectory) -> Sight:
    """What was seen at each step of a trajectory. Raises SetupError where the setup observes no lidar."""
    scene = trajectory.scene
    setup = get_setup(scene.setup)
    require_lidar(setup)
    steps = len(trajectory.actions)
    poses = trajectory.poses[:steps].astype(np.float64)
    people = scene.person_poses(trajectory.times[:steps])
    solids = scene.solids()
    beams = beams_of(setup)
    things = tuple(thing_names(scene))
    ranges = np.empty((steps, len(things), setup.robot.lidar.sectors))
    for number, solid in enumerate(solids):
        ranges[:, number] = k.seen_along(scene_to_row(_only(scene, [solid], NOBODY)), poses, beams)
    ground, nothing = ground_of(scene), scene_to_row(_only(scene, [], NOBODY))
    if ground is not None:
        ranges[:, things.index(BUILDING)] = k.seen_along(nothing, poses, beams, ground)
    row = scene_to_row(_only(scene, [], scene.person))
    for step, (x, y, yaw) in enumerate(poses):
        row[k.PERSON_X], row[k.PERSON_Y] = people[step, :2]
        ranges[step, -1] = k.seen_ranges(row, x, y, yaw, beams)
    return Sight(setup, things, trajectory.observations, ranges)


def _only(scene: Scene, solids: Sequence[Obstacle], person: Person) -> Scene:
    return replace(scene, obstacles=tuple(solids), room=None, person=person, walk=None)

"""The social-cost controller: the cheapest way over a map in which closeness to a person costs, more so before them.

The map and its search live in `cost_map.py`. The person-shaped cost is the Gaussian of Kirby, Simmons and Forlizzi
(2009), wider to the front, at the size it has for who stands; its weight and the path follower are ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.cost_map import cheapest_path, cost_to_go, free_grid
from desirepath.simulation import kernels as k
from desirepath.simulation.scene import Person, Pose, Scene, SceneError
from desirepath.simulation.setups import SetupError, get_setup

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
FIRST_WALL = 7  # of the observation; +x, -x, +y, -y


@dataclass(frozen=True)
class SocialCostConfig:
    """How much closeness costs, and how the path is followed."""

    weight: float = 4.0  # extra cost per metre on the person's place
    front_m: float = 0.5  # standard deviations of the Gaussian: 1/2, 2/3 and 1/2 of it
    side_m: float = 1 / 3
    back_m: float = 0.25
    spare_m: float = 0.05
    lookahead_m: float = 0.35
    turn_gain: float = 2.5  # 1/s
    fastest_turn: float = 1.5  # rad/s
    moved_m: float = 0.05  # a person who moved so far, or turned so far, is planned around anew
    turned_rad: float = 0.2


class SocialCost:
    """The controller for one scene with walls around it: its observations in, actions out. It knows the map and where
    its goal lies.

    Where walls are not observed it has to be told where it is: `steer`, not `act`.
    """

    def __init__(self, scene: Scene) -> None:
        self._setup = get_setup(scene.setup)
        self._scene, self._config = scene, SocialCostConfig()
        self._plan(scene.person.pose)

    def _plan(self, person: Pose) -> None:
        self._person = person
        scene = replace(self._scene, person=replace(self._scene.person, pose=person), walk=None)
        self._grid = free_grid(scene, spare_m=self._config.spare_m)
        self._costs = cost_to_go(self._grid, lambda places: self._price(places, scene.person), scene.goal)

    def _price(self, places: Doubles, person: Person) -> Doubles:
        config, pose = self._config, person.pose
        dx, dy = places[:, 0] - pose.x, places[:, 1] - pose.y
        ahead = dx * math.cos(pose.yaw) + dy * math.sin(pose.yaw)
        aside = dy * math.cos(pose.yaw) - dx * math.sin(pose.yaw)
        along = np.where(ahead > 0, config.front_m, config.back_m)
        gaussian = np.exp(-0.5 * ((ahead / along) ** 2 + (aside / config.side_m) ** 2))
        return np.asarray(1.0 + config.weight * gaussian)

    def act(self, observations: Floats) -> Floats:
        """observations (n, obs) of the scene's setup, of this scene -> actions (n, 2) in [-1, 1].

        Raises SetupError where walls are not observed.
        """
        if not self._setup.solids:
            raise SetupError(f"setup {self._setup.name}: walls are not observed, so the robot cannot tell where it is")
        return np.stack([self._act(seen.astype(np.float64)) for seen in observations])

    def _act(self, seen: Doubles) -> Floats:
        pose = self.located(seen)
        return self.steer(pose, self._person_seen(seen, pose))

    def steer(self, pose: Pose, person: Pose) -> Floats:
        """The action (2,) in [-1, 1] of a robot that is there, with the person there."""
        config, limits = self._config, self._setup.robot.limits
        moved = math.dist((person.x, person.y), (self._person.x, self._person.y)) > config.moved_m
        if moved or abs(k.wrap(person.yaw - self._person.yaw)) > config.turned_rad:
            self._plan(person)
        target = cheapest_path(self._grid, self._costs, pose, longest_m=config.lookahead_m)[-1]
        if math.dist(target, (pose.x, pose.y)) < config.lookahead_m / 2:
            target = np.array([self._scene.goal.x, self._scene.goal.y])
        error = k.wrap(math.atan2(target[1] - pose.y, target[0] - pose.x) - pose.yaw)
        w = max(-config.fastest_turn, min(config.fastest_turn, config.turn_gain * error))
        share = max(0.0, math.cos(error)) ** 2
        return np.array([2 * share - 1, w / limits.w_max], dtype=np.float32)

    def located(self, seen: Doubles) -> Pose:
        """The robot's pose from the closest points of the walls +x and +y."""
        scale, room = self._setup.distance_scale_m, self._scene.room
        if room is None:
            raise SceneError("room", None, "only in a room do its walls say where the robot is")
        to_x, to_y = seen[FIRST_WALL] * scale, seen[FIRST_WALL + 6] * scale
        yaw = math.atan2(-seen[FIRST_WALL + 2], seen[FIRST_WALL + 1])
        return Pose(room.length / 2 - to_x, room.width / 2 - to_y, yaw)

    def _person_seen(self, seen: Doubles, robot: Pose) -> Pose:
        distance = seen[0] * self._setup.distance_scale_m
        bearing = robot.yaw + math.atan2(seen[2], seen[1])
        yaw = k.wrap(robot.yaw + math.atan2(seen[6], seen[5]))
        return Pose(robot.x + distance * math.cos(bearing), robot.y + distance * math.sin(bearing), yaw)

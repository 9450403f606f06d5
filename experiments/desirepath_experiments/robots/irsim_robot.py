"""A scene as a world of ir-sim (Han et al., MIT licence; nobody here wrote it), and the robot that drives in it.

What ir-sim does otherwise than the fast engine: headings are followed in steps of STEP_S (Euler) and not along exact
arcs; circles are polygons of 64 corners; a robot that is told to accelerate does so by and by; a collision is noticed
at the end of a step; cells of a map stop robots as discs and rays as squares.
"""

from __future__ import annotations

import math
import tempfile
from collections import deque
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image
from shapely.strtree import STRtree

from desirepath.deploy.inputs import Command, Odometry, Scan
from desirepath.simulation.disturbed import Disturbances, slipping
from desirepath.simulation.scene import Scene, SceneError
from desirepath.simulation.scenes import map_of
from desirepath.simulation.setups import CONTROL_DT_S, Setup, get_setup

with redirect_stdout(None):  # it prints which windows it cannot open
    import irsim
    from irsim.util.random import set_seed

STEP_S = 0.02
MARGIN_M = 1.0  # of the world around what is in it


def world_of(scene: Scene, folder: Path, noise_m: float = 0.0, step_s: float = STEP_S) -> dict[str, Any]:
    """The scene as ir-sim's YAML; a map's picture goes into the folder. Raises SceneError where somebody walks."""
    if scene.walk is not None or scene.crowd is not None:
        raise SceneError("walk", scene.walk, "people stand still in these worlds")
    setup = get_setup(scene.setup)
    world: dict[str, Any] = {"step_time": step_s, "sample_time": step_s, "collision_mode": "stop"}
    here = map_of(setup)
    if here is not None:
        free = np.where(here.blocked, 0, 255).astype(np.uint8)
        Image.fromarray(np.ascontiguousarray(free.T[::-1])).save(folder / "map.png")
        width, height = here.size_m
        world |= {"width": width, "height": height, "offset": list(here.origin)}
        world["obstacle_map"] = str(folder / "map.png")
    else:
        places = [scene.start, scene.goal, scene.person.pose, *(solid.pose for solid in scene.solids())]
        low = [min(getattr(place, axis) for place in places) - MARGIN_M for axis in "xy"]
        high = [max(getattr(place, axis) for place in places) + MARGIN_M for axis in "xy"]
        world |= {"width": high[0] - low[0], "height": high[1] - low[1], "offset": low}
    person = {"shape": {"name": "circle", "radius": scene.person.radius}, "state": _state(scene.person.pose)}
    solids = [
        {"shape": {"name": "rectangle", "length": one.length, "width": one.width}, "state": _state(one.pose)}
        for one in scene.solids()
    ]
    return {"world": world, "robot": [_robot(setup, scene, noise_m)], "obstacle": [person, *solids]}


def _robot(setup: Setup, scene: Scene, noise_m: float) -> dict[str, Any]:
    robot, limits, lidar = setup.robot, setup.robot.limits, setup.robot.lidar
    shape: dict[str, Any] = {"name": "circle", "radius": robot.radius_m}
    if robot.footprint is not None:
        shape = {"name": "polygon", "vertices": [list(corner) for corner in robot.footprint]}
    # ir-sim puts a beam on either end of the field of view: of a whole turn, the last one is the first again
    apart = 2 * math.pi / lidar.beams_of_a_turn
    sensor: dict[str, Any] = {
        "type": "lidar2d",
        "range_min": lidar.min_range_m,
        "range_max": lidar.range_m,
        "angle_range": lidar.beams * apart,
        "number": lidar.beams + 1,
        "offset": [lidar.x_m, lidar.y_m, lidar.yaw_rad],
    }
    if noise_m:
        sensor |= {"noise": True, "std": noise_m}
    return {
        "kinematics": {"name": "diff"},
        "shape": shape,
        "state": _state(scene.start),
        "goal": _state(scene.goal),
        "vel_max": [limits.v_max, limits.w_max],
        "vel_min": [min(limits.v_min, 0.0), -limits.w_max],
        "acce": [limits.v_change or math.inf, limits.w_change or math.inf],
        "sensors": [sensor],
    }


def _state(pose: Any) -> list[float]:
    return [float(pose.x), float(pose.y), float(pose.yaw)]


class IrSimRobot:
    """A robot in the world of one scene: told a command, it drives; asked, it says what its lidar and wheels say.

    now_s: its clock. hit: whether it has touched anything, which stops it for good. Odometry is where it is, as a
    localisation knows it, and how fast its wheels turn: slip is not in v and w, slow wheels are.
    """

    def __init__(
        self, scene: Scene, disturbances: Disturbances | None = None, seed: int = 0, step_s: float = STEP_S
    ) -> None:
        self.scene, self.setup, self._step_s = scene, get_setup(scene.setup), step_s
        self._disturbed = disturbances or Disturbances()
        self._chance = np.random.default_rng([seed, 0xD157])
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "world.yaml"
            lidar = self.setup.robot.lidar
            noise = math.hypot(lidar.noise_m, self._disturbed.noise_m)
            file.write_text(yaml.safe_dump(world_of(scene, Path(folder), noise, step_s)))
            self._env = irsim.make(str(file), headless=True, log_level="CRITICAL", seed=seed)
        set_seed(seed)
        for one in self._env.obstacle_list:
            if one.shape == "map":  # a corner where lines go straight on doubles the time of a scan, and says nothing
                one.linestrings = [line.simplify(0) for line in one.linestrings]
                one.geometry_tree = STRtree(one.linestrings)
        self._robot = self._env.robot
        self._late = round(self._disturbed.delay_s / self._step_s)
        self._commands: deque[Command] = deque([Command(0.0, 0.0)] * (self._late + 1), maxlen=self._late + 1)
        self._lost = np.zeros((1, 2))
        self._wheels = (0.0, 0.0)
        self.steps, self.hit = 0, False

    @property
    def now_s(self) -> float:
        return self.steps * self._step_s

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y, yaw: metres, radians."""
        x, y, yaw = self._robot.state[:3, 0]
        return float(x), float(y), float(yaw)

    @property
    def goal_distance_m(self) -> float:
        return math.dist(self.pose[:2], (self.scene.goal.x, self.scene.goal.y))

    def scan(self) -> Scan:
        """What the lidar saw after the last step, as a LaserScan."""
        said = self._env.get_lidar_scan()
        ranges = np.where(said["valid"], said["ranges"], np.inf)
        return Scan(
            self.now_s,
            float(said["angle_min"]),
            float(said["angle_increment"]),
            float(said["range_min"]),
            float(said["range_max"]),
            ranges,
        )

    def odometry(self) -> Odometry:
        return Odometry(self.now_s, *self.pose, *self._wheels)

    def drive(self, command: Command, for_s: float = CONTROL_DT_S) -> None:
        """Go on for so long with this command; the lidar looks at the end."""
        count = round(for_s / self._step_s)
        for n in range(count):
            self._commands.append(command)
            if self.steps % round(CONTROL_DT_S / self._step_s) == 0:
                self._lost = self._disturbed.slip * self._chance.random((1, 2))
            self.steps += 1
            if not self.hit:
                self._step(last=n == count - 1)

    def _step(self, last: bool) -> None:
        """ir-sim's own step, with sensors where they are asked for: they take most of its time."""
        given, part = self._commands[0], 1 - self._disturbed.slow
        v, w = np.array([part * given.v]), np.array([part * given.w])
        moved = np.array(slipping(v, w, self.setup.robot.radius_m, self._lost))
        if last:
            self._env.step(moved)
        else:
            self._robot.step(moved, sensor_step=False)
            self._robot.check_collision_status()
        real = self._robot.velocity[:2, 0]
        exact = self._disturbed.slip == 0
        self._wheels = (float(real[0]), float(real[1])) if exact else (float(v[0]), float(w[0]))
        self.hit = bool(self._robot.collision_flag)

    def place(self, x: float, y: float, yaw: float) -> None:
        """Put it somewhere and look, for comparing what is seen."""
        self._robot.set_state([x, y, yaw])
        self._robot.sensor_step()

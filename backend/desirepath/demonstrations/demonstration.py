"""From a stroke to a demonstration: commands along the spline, the robot's rollout, transitions (ch. 2, steps 2-7).

The stroke and its spline live in `stroke.py`. Everything here follows from stroke and scene alone, without chance:
the same two give the same transitions, bit for bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.stroke import Doubles, PathSpline, Stroke, StrokeProblem, drawn_limits, fit_spline
from desirepath.npz import Arrays
from desirepath.simulation import kernels as k
from desirepath.simulation.fast import Floats, replay
from desirepath.simulation.scene import Pose, Scene, SceneError
from desirepath.simulation.scenes import ground_of, scene_to_row
from desirepath.simulation.setups import CONTROL_DT_S, Setup, get_setup
from desirepath.simulation.stored import StoredArrays
from desirepath.simulation.trajectory import Outcome, Trajectory

AUGMENTED = 15  # ch. 2, step 7
FARTHEST_FROM_SPLINE_M = 0.02  # ours; a path that cannot be driven this closely is too tight
BETWEEN_M = 0.01  # how densely a path is looked at for contacts


@dataclass(frozen=True)
class Demonstration(StoredArrays):
    """One drawn path, executed.

    stroke: as drawn. drawn_in: the scene it was drawn in. spline: the smooth path with speeds.
    commands: (T, 2) m/s and rad/s along the whole spline. trajectory: the rollout, in the scene whose start is the
    spline's beginning and whose goal lies at its end, so that it ends in success, within the goal radius of the end.
    seed, style: of the programmed demonstrator that drew it (simulated); None and "" for a person's.
    """

    stroke: Stroke
    drawn_in: Scene
    spline: PathSpline
    commands: Doubles
    trajectory: Trajectory
    seed: int | None = None
    style: str = ""

    @property
    def scene(self) -> Scene:
        """Where it was executed."""
        return self.trajectory.scene

    @property
    def simulated(self) -> bool:
        return bool(self.style)

    @property
    def executed_speeds(self) -> Doubles:
        """(T,) m/s, the forward speed of every step of the rollout."""
        return self.commands[: len(self.trajectory.actions), 0]

    noun, file_format = "demonstration", "desirepath-demonstration-1"

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        return {"drawn_in": self.drawn_in.as_dict(), "seed": self.seed, "style": self.style}, {
            "stroke_points": self.stroke.points,
            "stroke_speeds": self.stroke.speeds,
            "stroke_times_s": self.stroke.times_s,
            "spline_knots": self.spline.knots,
            "spline_coefficients": self.spline.coefficients,
            "speed_knots": self.spline.speed_knots,
            "speed_coefficients": self.spline.speed_coefficients,
            "commands": self.commands,
            "trajectory": np.frombuffer(self.trajectory.to_bytes(), dtype=np.uint8),
        }

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> Demonstration:
        scene = Scene.from_dict(header["drawn_in"])
        return cls(
            stroke=Stroke(*(arrays[f"stroke_{name}"] for name in ("points", "speeds", "times_s"))),
            drawn_in=scene,
            spline=PathSpline(
                arrays["spline_knots"],
                arrays["spline_coefficients"],
                arrays["speed_knots"],
                arrays["speed_coefficients"],
                drawn_limits(scene.setup),
            ),
            commands=arrays["commands"],
            trajectory=Trajectory.from_bytes(arrays["trajectory"].tobytes()),
            seed=header["seed"],
            style=header["style"],
        )

    def as_dict(self) -> dict[str, Any]:
        """For reading with other programs: raw stroke, commands, rollout; SI units, JSON-ready."""
        return {
            "format": self.file_format,
            "scene": self.scene.as_dict(),
            "drawn_in": self.drawn_in.as_dict(),
            "seed": self.seed,
            "style": self.style,
            "stroke": self.stroke.as_dict(),
            "spline": {
                "degree": 3,
                "knots": self.spline.knots.tolist(),
                "coefficients": self.spline.coefficients.tolist(),
                "speed_knots": self.spline.speed_knots.tolist(),
                "speed_coefficients": self.spline.speed_coefficients.tolist(),
            },
            "commands": self.commands.tolist(),
            "poses": self.trajectory.poses.tolist(),
        }


def commands_along(spline: PathSpline, *, begin_m: float = 0.0) -> Doubles:
    """(T, 2) commands m/s, rad/s from `begin_m` along the spline to its end (ch. 2, steps 2 and 3).

    Each step of length delta_d = v(k) dt turns by the path's change of direction over it: w = v delta_alpha / delta_d.
    The last one ends within one step of the spline's end.
    """
    places = [begin_m]
    speeds = []
    while True:
        speed = float(spline.speeds(np.array([places[-1]]))[0])
        following = places[-1] + speed * CONTROL_DT_S
        if following > spline.length_m:
            break
        places.append(following)
        speeds.append(speed)
    turns = np.diff(spline.headings(np.array(places)))
    forward = np.array(speeds)
    return np.stack([forward, forward * turns / (forward * CONTROL_DT_S)], axis=1)


def execute(start: Pose, commands: Doubles) -> Doubles:
    """(T + 1, 3) poses of a robot that executes commands (T, 2) in empty space."""
    poses = np.empty((len(commands) + 1, 3))
    poses[0] = start.x, start.y, start.yaw
    for t, (v, w) in enumerate(commands):
        x, y, yaw = poses[t]
        poses[t + 1, :2] = k.arc(x, y, yaw, v * CONTROL_DT_S, w * CONTROL_DT_S)
        poses[t + 1, 2] = yaw + w * CONTROL_DT_S
    return poses


def as_actions(setup: Setup, commands: Doubles) -> Floats:
    """(T, 2) commands in m/s and rad/s as actions in [-1, 1]."""
    limits = setup.robot.limits
    forward = 2 * (commands[:, 0] - limits.v_min) / (limits.v_max - limits.v_min) - 1
    return np.stack([forward, commands[:, 1] / limits.w_max], axis=1).astype(np.float32)


def demonstration_from(stroke: Stroke, scene: Scene, *, seed: int | None = None, style: str = "") -> Demonstration:
    """The stroke executed in its scene. Raises StrokeProblem naming what is wrong and where."""
    spline = fit_spline(stroke, scene)
    setup = get_setup(scene.setup)
    commands = commands_along(spline)
    start = _pose_on(spline, 0.0)
    poses = execute(start, commands)
    _check_turns(setup, poses, commands)
    _check_free(scene, spline)
    if len(commands) > setup.max_steps:
        raise StrokeProblem(
            "too_slow",
            f"driving it takes {len(commands) * CONTROL_DT_S:.0f} s, an episode has "
            f"{setup.max_steps * CONTROL_DT_S:.0f} s",
            poses[setup.max_steps],
            duration_s=len(commands) * CONTROL_DT_S,
            limit_s=setup.max_steps * CONTROL_DT_S,
        )
    _check_close(spline, commands, poses)
    goal = Pose(float(poses[-1, 0]), float(poses[-1, 1]), k.wrap(float(poses[-1, 2])))
    try:
        (trajectory,) = replay(setup, [replace(scene, start=start, goal=goal)], [as_actions(setup, commands)])
    except SceneError as problem:
        raise StrokeProblem("unreadable", str(problem), (goal.x, goal.y)) from None
    if trajectory.outcome == Outcome.COLLISION:
        raise _collision(scene, trajectory.poses[-1, :2].astype(float), len(trajectory.actions))
    return Demonstration(stroke, scene, spline, commands, trajectory, seed, style)


def augment(demonstration: Demonstration, n: int = AUGMENTED) -> list[Trajectory]:
    """The rollout `n` times, the j-th begun j / n of a step further along the spline (ch. 2, step 7).

    The first is the demonstration's own. A shifted one that would touch something is left out.
    """
    spline, setup = demonstration.spline, get_setup(demonstration.scene.setup)
    step = float(spline.speeds(np.zeros(1))[0]) * CONTROL_DT_S
    begins = [j * step / n for j in range(1, n)]
    scenes = [replace(demonstration.scene, start=_pose_on(spline, begin)) for begin in begins]
    actions = [as_actions(setup, commands_along(spline, begin_m=begin)) for begin in begins]
    shifted = replay(setup, scenes, actions) if begins else []
    return [demonstration.trajectory, *(t for t in shifted if t.outcome == Outcome.SUCCESS)]


def _pose_on(spline: PathSpline, s: float) -> Pose:
    where = np.array([s])
    x, y = spline.points(where)[0]
    return Pose(float(x), float(y), k.wrap(float(spline.headings(where)[0])))


def _check_turns(setup: Setup, poses: Doubles, commands: Doubles) -> None:
    sharpest = int(np.argmax(np.abs(commands[:, 1])))
    rate = abs(float(commands[sharpest, 1]))
    if rate > setup.robot.limits.w_max:
        raise StrokeProblem(
            "too_tight",
            f"the robot would have to turn at {rate:.1f} rad/s, it can {setup.robot.limits.w_max:.1f}",
            poses[sharpest],
            turn_rate_rad_s=rate,
            limit_rad_s=setup.robot.limits.w_max,
        )


def _check_free(scene: Scene, spline: PathSpline) -> None:
    path = spline.points(np.arange(0.0, spline.length_m, BETWEEN_M))
    row, radius, ground = scene_to_row(scene), get_setup(scene.setup).robot.radius_m, ground_of(scene)
    for x, y in path:
        near_solid = k.surface_distance(row, x, y, ground) < radius
        near_person = k.person_distance(row, x, y) < radius + scene.person.radius
        if near_solid or (near_person and scene.walk is None):  # who walks may be elsewhere by then: the rollout tells
            raise _collision(scene, np.array([x, y]), None)


def _check_close(spline: PathSpline, commands: Doubles, poses: Doubles) -> None:
    places = np.concatenate([[0.0], np.cumsum(commands[:, 0] * CONTROL_DT_S)])
    apart = np.linalg.norm(spline.points(places) - poses[:, :2], axis=1)
    worst = int(np.argmax(apart))
    if apart[worst] > FARTHEST_FROM_SPLINE_M:
        raise StrokeProblem(
            "too_tight",
            f"the robot would leave the path by {100 * apart[worst]:.0f} cm: the bends are too sharp for it",
            poses[worst],
            distance_m=float(apart[worst]),
            limit_m=FARTHEST_FROM_SPLINE_M,
        )


def _collision(scene: Scene, at: NDArray[np.float64], step: int | None) -> StrokeProblem:
    row = scene_to_row(scene)
    person = scene.person_poses([step * CONTROL_DT_S if step is not None else 0.0])[0]
    gaps = {"person": math.dist(person[:2], at) - scene.person.radius}
    if scene.room is not None:
        gaps["wall"] = float((np.array([scene.room.length, scene.room.width]) / 2 - np.abs(at)).min())
    if (ground := ground_of(scene)) is not None:
        gaps["wall"] = float(k.ground_distance(ground, at[0], at[1]))
    for i, obstacle in enumerate(scene.obstacles):
        gaps[obstacle.kind] = min(
            gaps.get(obstacle.kind, math.inf), k.box_distance(row, k.FIRST_BOX + k.BOX_COLUMNS * i, at[0], at[1])
        )
    thing = min(gaps, key=lambda name: gaps[name])
    after = {"after_s": step * CONTROL_DT_S} if step is not None else {}
    return StrokeProblem(
        "collides",
        f"the robot would touch the {thing} at {at[0]:.2f}, {at[1]:.2f} m",
        at,
        thing=thing,
        clearance_m=float(gaps[thing]) - get_setup(scene.setup).robot.radius_m,
        **after,
    )

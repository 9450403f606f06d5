"""The same policy in the same scenes in the fast engine and on a robot of somebody else's simulator, and why they
differ: `desirepath benchmark robot`."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from desirepath.cli.science import find_policy
from desirepath.deploy.controller import Controller
from desirepath.deploy.inputs import Command, Odometry, Person, Scan
from desirepath.learning.policies.bundles import bundle_files
from desirepath.learning.policies.policy import DrivingPolicy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.acting import begin
from desirepath.simulation.disturbed import Disturbances, DisturbedEngine
from desirepath.simulation.fast import FastEngine, make_engine
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.robots.irsim_robot import IrSimRobot
from desirepath_experiments.robots.topics import TopicsController

Doubles = NDArray[np.float64]
FINE_STEP_S = 0.002
NUDGE_M = 0.001
SILENT_SCENES, SILENT_AFTER = 10, 12  # control steps
Share = Annotated[float, Field(ge=0, le=0.9)]


@dataclass(frozen=True)
class RobotConfig:
    """What drives where, and what the robot gets wrong."""

    setup: str = "study_room"
    policy: Annotated[str, Field(description="By name, id or file; empty: the setup's base policy.")] = ""
    scenes: Annotated[int, Field(ge=1, le=2_000)] = 200
    seed: Annotated[int, Field(ge=0, le=9_999, description="Of the scenes, which chose nothing.")] = 0
    noise: Annotated[float, Field(ge=0, le=1, description="Standard deviation of a lidar range, m.")] = 0.0
    delay_s: Annotated[float, Field(ge=0, le=1, description="From a command to the wheels.")] = 0.0
    slip: Annotated[Share, Field(description="Largest share of a wheel's turning that moves nothing.")] = 0.0
    slow_wheels: Annotated[Share, Field(description="Share that wheels lack of the commanded speed.")] = 0.0

    through: Annotated[
        Literal["process", "topics", "engine"],
        Field(description="The controller here, or `drive` over ROS 2 in lock step (.venv-tools); or no robot at all."),
    ] = "process"
    zones: Annotated[bool, Field(description="Over topics: with the stop zone and the keep-out distance.")] = True

    @property
    def disturbances(self) -> Disturbances:
        return Disturbances(self.noise, self.delay_s, self.slip, self.slow_wheels)


class Acting(Protocol):
    """A controller: `desirepath.deploy.Controller`, here or at the other end of topics."""

    @property
    def observation(self) -> NDArray[np.float32]: ...
    def reset(self) -> None: ...
    def step(
        self, scan: Scan, odometry: Odometry, goal: tuple[float, float], people: Sequence[Person] = ()
    ) -> Command: ...


class Driven(NamedTuple):
    """One scene: how it ended, where the robot was before the first step and after each, (steps + 1, 3), what was
    observed there, (steps, obs), and how long each command took, seconds."""

    outcome: Outcome
    poses: Doubles
    observations: NDArray[np.float32]
    took_s: list[float]


def drive(robot: IrSimRobot, acting: Acting) -> Driven:
    """From the start to the end, judged as the fast engine judges."""
    acting.reset()
    poses, seen = [robot.pose], []
    took: list[float] = []
    outcome = Outcome.TIMEOUT
    for _ in range(robot.setup.max_steps):
        command = _ask(robot, acting, took)
        seen.append(acting.observation.copy())
        robot.drive(command)
        poses.append(robot.pose)
        if robot.hit:
            outcome = Outcome.COLLISION
            break
        if robot.goal_distance_m <= robot.scene.goal_radius:
            outcome = Outcome.SUCCESS
            break
    return Driven(outcome, np.array(poses), np.array(seen), took)


def _ask(robot: IrSimRobot, acting: Acting, took: list[float] | None = None) -> Command:
    """What to do where the robot is; how long that took, s, is added."""
    scene, scan, odometry = robot.scene, robot.scan(), robot.odometry()
    person = Person(scene.person.pose.x, scene.person.pose.y)
    began = time.perf_counter()
    command = acting.step(scan, odometry, (scene.goal.x, scene.goal.y), [person])
    if took is not None:
        took.append(time.perf_counter() - began)
    return command


def drive_engine(engine: FastEngine, policy: DrivingPolicy) -> tuple[NDArray[np.int8], list[Doubles]]:
    """Outcome and path (steps + 1, 2) of every environment, each until it ends."""
    steer = begin(policy.rollout_policy, engine.n_envs, engine)
    actions = np.zeros((engine.n_envs, 2), dtype=np.float32)
    while not engine.dones.all():
        running = np.flatnonzero(~engine.dones)
        actions[running] = steer(engine.observations[running], running)
        engine.step(actions)
    return engine.outcomes.copy(), [engine.path(i) for i in range(engine.n_envs)]


def benchmark_robot(config: RobotConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Simulated, all of it: engine_success, robot_success: shares of the scenes. Where both arrive: median_distance_m
    from the robot's path to the engine's, the mean of a scene; median_person_m: by how much their smallest distances to
    the person differ. p99_latency_ms: from scan and odometry to the command.

    ended: engine's end/robot's end -> scenes; rows: of each scene, so that policies can be compared scene by scene.
    otherwise: how many that end otherwise on the robot end as in the engine where ir-sim's steps are ten times finer,
    and in how many scenes the engine itself ends otherwise when the robot starts 1 mm beside. observed: how far what
    the controller made of the robot's scan and odometry is from what the engine observes at the same poses.
    """
    progress = progress or Progress()
    setup = get_setup(config.setup)
    policy = find_policy(config.policy or f"{config.setup}/base")
    scenes = scene_set(config.setup, config.scenes, purpose=Purpose.BENCHMARK, seed=config.seed)
    disturbed = config.disturbances != Disturbances()

    def in_engine() -> FastEngine:
        given: dict[str, Any] = {"auto_reset": False, "scenes": scenes}
        if not disturbed:
            return make_engine(setup, len(scenes), **given)
        return DisturbedEngine(setup, len(scenes), config.disturbances, seed=config.seed, **given)

    engine = in_engine()
    engine_ends, paths = drive_engine(engine, policy)
    rows = [{"scene": scene.seed, "engine": _word(end)} for scene, end in zip(scenes, engine_ends, strict=True)]
    result: dict[str, Any] = {
        "simulated": True,
        "setup": setup.name,
        "policy": config.policy or f"{config.setup}/base",
        "seed": config.seed,
        "scenes": len(scenes),
        "disturbances": asdict(config.disturbances),
        "engine_success": float((engine_ends == Outcome.SUCCESS).mean()),
        "rows": rows,
    }
    if config.through == "engine":
        return result
    nudged = in_engine()
    nudged.start_at(np.array([(s.start.x + NUDGE_M, s.start.y, s.start.yaw) for s in scenes]))
    nudged_ends, _ = drive_engine(nudged, policy)

    with _acting(policy, config) as acting:
        driven = []
        for n, scene in enumerate(scenes):
            driven.append(drive(IrSimRobot(scene, config.disturbances, config.seed + n), acting))
            if n % 20 == 19:
                arrive = np.mean([one.outcome == Outcome.SUCCESS for one in driven])
                progress.tell(f"{n + 1} scenes; {arrive:.1%} arrive")
        ends = np.array([one.outcome for one in driven], dtype=np.int8)
        others = np.flatnonzero(ends != engine_ends)
        over_topics = _over_topics(acting, scenes) if isinstance(acting, TopicsController) else {}
        finer = [
            drive(IrSimRobot(scenes[i], config.disturbances, config.seed + int(i), FINE_STEP_S), acting).outcome
            for i in others
        ]
    both = np.flatnonzero((ends == Outcome.SUCCESS) & (engine_ends == Outcome.SUCCESS))
    took = np.concatenate([one.took_s for one in driven])
    for row, end in zip(rows, ends, strict=True):
        row["robot"] = _word(end)
    result |= {
        "robot_success": float((ends == Outcome.SUCCESS).mean()),
        "median_distance_m": _median([_apart(driven[i].poses[:, :2], paths[i]) for i in both]),
        "median_person_m": _median(
            [abs(_to_person(driven[i].poses[:, :2], scenes[i]) - _to_person(paths[i], scenes[i])) for i in both]
        ),
        "p99_latency_ms": float(1_000 * np.quantile(took, 0.99)),
        "ended": Counter(f"{row['engine']}/{row['robot']}" for row in rows),
        "otherwise": {
            "as_engine_with_finer_steps": int(sum(a == b for a, b in zip(finer, engine_ends[others], strict=True))),
            "engine_otherwise_1_mm_beside": int((nudged_ends != engine_ends).sum()),
        },
    }
    result |= over_topics
    if not disturbed and not over_topics:
        result["observed"] = compare_observations(scenes[:20], driven[:20])
    return result


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def _word(outcome: int) -> str:
    return Outcome(int(outcome)).name.lower()


def _to_person(path: Doubles, scene: Scene) -> float:
    return float(np.hypot(path[:, 0] - scene.person.pose.x, path[:, 1] - scene.person.pose.y).min())


def _apart(path: Doubles, other: Doubles) -> float:
    """Mean distance (m) of a path's points (n, 2) from another path."""
    a, b = other[:-1], other[1:]
    along = b - a
    squared = np.maximum((along**2).sum(axis=1), 1e-12)
    part = np.clip(((path[:, None] - a) * along).sum(axis=2) / squared, 0, 1)
    return float(np.linalg.norm(path[:, None] - a - part[..., None] * along, axis=2).min(axis=1).mean())


def compare_observations(scenes: Sequence[Scene], driven: Sequence[Driven]) -> dict[str, Any]:
    """At every pose that the robots were at: what the engine observes there, and how far off the controller's is."""
    setup = get_setup(scenes[0].setup)
    off = []
    for scene, one in zip(scenes, driven, strict=True):
        poses = one.poses[:-1]
        engine = make_engine(setup, len(poses), auto_reset=False, scenes=[scene] * len(poses))
        off.append(np.abs(engine.start_at(poses).astype(np.float64) - one.observations))
    apart = np.concatenate(off)
    lidar = apart[:, setup.polar_size :] * setup.robot.lidar.range_m
    bearing = np.minimum(apart[:, 1], 2 - apart[:, 1]) * np.pi
    found = {
        "states": len(apart),
        "goal_m": float(apart[:, 0].max() * setup.distance_scale_m),
        "goal_rad": float(bearing.max()),
        "lidar_median_m": float(np.median(lidar)),
        "lidar_p99_m": float(np.quantile(lidar, 0.99)),
        "lidar_share_5_cm_off": float((lidar > 0.05).mean()),
    }
    if setup.with_person:
        found["person_m"] = float(apart[:, 2].max() * setup.distance_scale_m)
    return found


def _over_topics(acting: TopicsController, scenes: Sequence[Scene]) -> dict[str, Any]:
    """refused: why the node stood, before or on the way. stop_s: told to stand so long after the last scan. p99: from
    the scan on its topic to the command on its. scans_sent_again: that no command answered at first."""
    refused, took = Counter(acting.refusals), acting.latencies_s.copy()
    sent = {"scans": acting.scans, "scans_sent_again": acting.sent_again}
    silent = []
    for scene in scenes[:SILENT_SCENES]:
        robot = IrSimRobot(scene)
        acting.reset()
        for _ in range(SILENT_AFTER):
            command = _ask(robot, acting)
            robot.drive(command)
        if command != Command(0.0, 0.0):
            silent.append(acting.silence_s())
    stop_s = {"drives": len(silent), "longest": max(silent, default=None)}
    return {"refused": refused, "stop_s": stop_s, **sent, "p99_latency_ms": float(1_000 * np.quantile(took, 0.99))}


@contextmanager
def _acting(policy: DrivingPolicy, config: RobotConfig) -> Iterator[Controller | TopicsController]:
    """As a robot loads it: of the bundle that `policies export` writes."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in bundle_files(policy).items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        if config.through == "process":
            yield Controller.load(folder)
        else:
            zones = () if config.zones else ("--collision-s", "0", "--keep-out-m", "0")
            with TopicsController(Path(folder), zones) as there:
                yield there

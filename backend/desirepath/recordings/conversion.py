"""Recordings as trajectories of a setup, on plain data: what was recorded, at control steps, and nothing else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.recordings.recording import BOUNDS, Bounds, Goal, Recording, RecordingError, Thing, Track
from desirepath.recordings.resampling import METHOD, TRAVEL, resample, step_times
from desirepath.simulation.kernels import crosses_itself
from desirepath.simulation.pedestrians import MOST_PEDESTRIANS, Crowd, Pedestrian, PedestrianError
from desirepath.simulation.recorded import Recorded
from desirepath.simulation.scene import OBSTACLE_KINDS, Obstacle, Person, Pose, Scene, UnrecordedPerson
from desirepath.simulation.setups import CONTROL_DT_S, Setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.simulation.walks import FASTEST_M_S, Walk, WalkError

Doubles = NDArray[np.float64]
FEWEST_STEPS = 5
HEIGHT_M = 1.0  # of obstacles whose height was not recorded
EDGE_S = 0.5  # who is not seen for longer than this at a run's begin or end is said to stand there
STANDS_M = 0.05  # who never is farther from the mean place stands


@dataclass(frozen=True)
class Converted:
    """A trajectory of a recording, and what whoever imports it should know. scene: the recording's."""

    trajectory: Trajectory
    scene: str
    warnings: tuple[str, ...]


def convert(recording: Recording, setup: Setup, bounds: Bounds = BOUNDS) -> Converted:
    """Raises RecordingError for a run that is too short, too long, or a walk that nobody can have walked."""
    file, run = recording.source.file, recording.run
    robot = recording.robot
    duration = float(robot.times_s[-1] - robot.times_s[0]) if len(robot.times_s) else 0.0
    if duration < FEWEST_STEPS * CONTROL_DT_S:
        needed = f"at least {FEWEST_STEPS * CONTROL_DT_S:g} s are needed; is the unit of time right?"
        raise RecordingError(file, f"run {run!r}, duration", round(duration, 3), needed)
    if duration > bounds.run_s:
        problem = f"at most {bounds.run_s:g} s, since people watch it to its end; cut it into `runs` in the mapping"
        raise RecordingError(file, f"run {run!r}, duration", round(duration, 3), problem)
    if (waits := np.diff(robot.times_s)).max() > bounds.gap_s:
        problem = (
            f"nothing is known of the robot for so many seconds; at most {bounds.gap_s:g}: cut it into `runs` there"
        )
        raise RecordingError(file, f"run {run!r}, gap", round(float(waits.max()), 3), problem)
    at_s = step_times(float(robot.times_s[0]), float(robot.times_s[-1]))
    poses = resample(robot.times_s, robot.poses, at_s)
    has, how = ["poses"], [METHOD, *recording.how]
    warnings: list[str] = []
    if np.isfinite(robot.poses[:, 2]).all():
        has.append("heading")
    else:
        how.append(f"the robot: {TRAVEL}")
    person, walk, crowd = _people(recording, at_s, poses, how, warnings)
    if recording.people:
        has.append("people")
    if recording.things:
        has.append("obstacles")
    goal = recording.goal
    if goal is None:
        goal = Goal(float(poses[-1, 0]), float(poses[-1, 1]), float(poses[-1, 2]))
        how.append("the goal was not recorded: it is where the robot ended")
        warnings.append(
            f"run {run!r}: no goal was recorded, so it is where the robot ended; `goal` in the mapping names it"
        )
    else:
        has.append("goal")
    radius = goal.radius
    if radius is None:
        radius = setup.goal_radius_m
        how.append(f"the goal's radius is the setup's, {radius:g} m")
    reached = "goal" in has and math.dist(poses[-1, :2], (goal.x, goal.y)) <= radius
    steps = len(poses) - 1
    found = Trajectory(
        scene=Scene(
            setup=setup.name,
            seed=0,
            start=_pose(poses[0]),
            goal=Pose(goal.x, goal.y, goal.yaw),
            goal_radius=radius,
            person=person,
            obstacles=tuple(_obstacle(thing, how) for thing in recording.things),
            walk=walk,
            crowd=crowd,
        ),
        outcome=Outcome.SUCCESS if reached else Outcome.RUNNING,
        poses=poses.astype(np.float32),
        observations=np.zeros((steps, 0), dtype=np.float32),
        actions=np.zeros((steps, 0), dtype=np.float32),
        rewards=np.full(steps, np.nan, dtype=np.float32),
        next_observations=np.zeros((steps, 0), dtype=np.float32),
        dones=np.append(np.zeros(steps - 1, dtype=np.bool_), reached),
        self_intersections=_crossings(poses[:, :2], setup),
        dt=CONTROL_DT_S,
        recorded=Recorded(
            recording.source.file, recording.source.format, recording.source.sha256, run, tuple(has), tuple(_once(how))
        ),
    )
    return Converted(found, recording.scene, tuple(warnings))


def _once(sentences: Sequence[str]) -> list[str]:
    return list(dict.fromkeys(sentences))


def _pose(row: Doubles) -> Pose:
    return Pose(float(row[0]), float(row[1]), float(row[2]))


def _people(
    recording: Recording, at_s: Doubles, robot: Doubles, how: list[str], warnings: list[str]
) -> tuple[Person, Walk | None, Crowd | None]:
    """The person, who is whoever comes nearest to the robot, how they walk, and the others."""
    if not recording.people:
        return UnrecordedPerson(), None, None
    how.append("bodies of people have 0.3 m radius and 1.7 m height, which were not recorded")
    ways = {who: _way(recording, who, seen, at_s, how, warnings) for who, seen in sorted(recording.people.items())}
    nearest = min(ways, key=lambda who: float(np.linalg.norm(ways[who][:, :2] - robot[:, :2], axis=1).min()))
    others = [who for who in ways if who != nearest]
    if len(others) > MOST_PEDESTRIANS:
        where = f"run {recording.run!r}, people"
        problem = f"at most {MOST_PEDESTRIANS + 1} are shown; name who is not in `leave_out` of the mapping"
        raise RecordingError(recording.source.file, where, len(ways), problem)
    try:
        walk = _walk(ways[nearest])
        crowd = tuple(_pedestrian(ways[who]) for who in others)
    except (WalkError, PedestrianError) as wrong:
        where = f"run {recording.run!r}, people"
        problem = f"{wrong}; is the unit right? `leave_out` in the mapping leaves somebody out"
        raise RecordingError(recording.source.file, where, None, problem) from None
    return Person(_pose(ways[nearest][0])), walk, Crowd("path", crowd) if crowd else None


def _way(recording: Recording, who: str, seen: Track, at_s: Doubles, how: list[str], warnings: list[str]) -> Doubles:
    """(n, 3) where they were at times (n,); where nobody saw them, where they were seen first or last."""
    way = resample(seen.times_s, seen.poses, at_s)
    if not np.isfinite(seen.poses[:, 2]).all():
        how.append(f"person {who!r}: {TRAVEL}; +x for who stands")
    unseen = max(float(seen.times_s[0] - at_s[0]), float(at_s[-1] - seen.times_s[-1]), 0.0)
    holes = float(np.diff(seen.times_s).max(initial=0.0))
    if unseen > EDGE_S:
        sentence = f"person {who!r} was not seen for {unseen:.1f} s at the begin or end, and stands there meanwhile"
        how.append(sentence)
        warnings.append(f"run {recording.run!r}: {sentence}")
    if holes > 2 * EDGE_S:
        sentence = f"person {who!r} was not seen for {holes:.1f} s in between, and goes straight on meanwhile"
        how.append(sentence)
        warnings.append(f"run {recording.run!r}: {sentence}")
    fastest = float(np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1).max(initial=0.0)) / CONTROL_DT_S
    if fastest > FASTEST_M_S:
        problem = f"m/s; at most {FASTEST_M_S:g} m/s are shown. Is the unit right? `leave_out` leaves somebody out"
        raise RecordingError(
            recording.source.file, f"run {recording.run!r}, speed of person {who!r}", round(fastest, 2), problem
        )
    return way


def _walk(way: Doubles) -> Walk | None:
    """Knots at control steps; None for who stands."""
    if np.abs(way[:, :2] - way[0, :2]).max() <= STANDS_M:
        return None
    times = np.arange(len(way)) * CONTROL_DT_S
    columns = [tuple(float(v) for v in values) for values in (times, way[:, 0], way[:, 1], np.unwrap(way[:, 2]))]
    return Walk(*columns)


def _pedestrian(way: Doubles) -> Pedestrian:
    walk = _walk(way)
    gone = float(np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1).sum())
    mean = min(gone / ((len(way) - 1) * CONTROL_DT_S), FASTEST_M_S) if walk is not None else 0.0
    return Pedestrian(((float(way[0, 0]), float(way[0, 1])),), mean, float(way[0, 2]), walk)


def _obstacle(thing: Thing, how: list[str]) -> Obstacle:
    if thing.height is None:
        how.append(f"heights of obstacles were not recorded: shown {HEIGHT_M:g} m high, walls 2 m")
    kind = thing.kind.lower() if thing.kind.lower() in OBSTACLE_KINDS else "box"
    height = thing.height or (2.0 if kind == "wall" else HEIGHT_M)
    return Obstacle(kind, Pose(thing.x, thing.y, thing.yaw), thing.length, thing.width, height)


def _crossings(path: Doubles, setup: Setup) -> int:
    """How often a path (n, 2) crosses itself, counted as engines do."""
    path = np.ascontiguousarray(path)
    longest = float(np.linalg.norm(np.diff(path, axis=0), axis=1).max())
    age = setup.self_intersection_min_age_steps
    return sum(bool(crosses_itself(path, k, age, longest)) for k in range(1, len(path)))

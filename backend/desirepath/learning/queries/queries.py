"""Queries: one scene, two ensemble members, same start and goal; filtered so that an answer can mean something.

Here live making, filtering and storing them, and the segment baseline of Christiano et al. Who answers lives in
`oracles.py`, the study or the data; what an answer teaches lives in the reward models.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.cards import stored_config
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import DrivingPolicy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.npz import Arrays
from desirepath.simulation.fast import rollout
from desirepath.simulation.recorded import Recorded
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.stored import StoredArrays
from desirepath.simulation.trajectory import Outcome, Trajectory

Floats = NDArray[np.float32]
PATH_SAMPLES = 32


@dataclass(frozen=True)
class Query:
    """One scene and two trajectories, A and B; `members` says which ensemble member rolled out which.

    Recorded trajectories each have a scene of their own, alike but for where robot and people were; `scene` is A's.
    """

    scene: Scene
    trajectory_a: Trajectory
    trajectory_b: Trajectory
    members: tuple[int, int]

    def digest(self) -> str:
        """sha256 over both trajectories, the query's identity in the store."""
        joined = self.trajectory_a.digest() + self.trajectory_b.digest()
        return hashlib.sha256(joined.encode()).hexdigest()


@dataclass(frozen=True)
class QueryConfig:
    """What queries are made and which are dropped. The first three filters are the thesis's (6.4.2), the rest ours.

    count: scenes. trajectories: of each scene so many, every two of them a query; 3 for probes of transitivity.
    """

    count: int = 200
    trajectories: int = 2
    seed: int = 0
    max_duration_s: float = 12.0  # ours: people watch both trajectories of every query
    min_duration_s: float = 3.0  # ours: a trajectory that is over at once shows nothing
    min_gap_m: float = 0.5  # ours: two trajectories closer than this everywhere, and about equally long, look the same
    min_duration_ratio: float = 1.3  # ours: ... unless one takes this much longer
    scenes_per_round: int = 256
    max_scenes: int = 10_000

    def as_dict(self) -> dict[str, Any]:
        return stored_config(self)


@dataclass(frozen=True)
class QuerySet(StoredArrays):
    """Queries of one setup, and how many candidate pairs each filter dropped."""

    setup: str
    queries: tuple[Query, ...]
    filtered: dict[str, int]

    def __len__(self) -> int:
        return len(self.queries)

    noun, file_format, raises = "query set", "desirepath-queries-1", LearningError

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        """Compact.

        Poses, actions and rewards are stored as they are (float32). Observations are rounded to float16 (at 6 m lidar
        range that is 3 mm, at 10 m goal distance 5 mm) and shared between steps: the next observation of a step is the
        observation of the following one. Sets made by `generate_queries` are rounded before they are returned, so
        that a round trip is exact.
        """
        trajectories = [t for query in self.queries for t in (query.trajectory_a, query.trajectory_b)]
        header: dict[str, object] = {
            "setup": self.setup,
            "filtered": self.filtered,
            "queries": [{"scene": query.scene.as_dict(), "members": list(query.members)} for query in self.queries],
        }
        if any(one.recorded for one in trajectories):
            header["recorded"] = [one.recorded and one.recorded.as_dict() for one in trajectories]
            header["scenes"] = [one.scene.as_dict() for one in trajectories]  # two runs never begin exactly alike
        observations = [np.concatenate([t.observations, t.next_observations[-1:]]) for t in trajectories]
        return header, {
            "steps": np.array([len(t.actions) for t in trajectories], dtype=np.int32),
            "outcomes": np.array([t.outcome for t in trajectories], dtype=np.int8),
            "self_intersections": np.array([t.self_intersections for t in trajectories], dtype=np.int32),
            "poses": np.concatenate([t.poses for t in trajectories]),
            "actions": np.concatenate([t.actions for t in trajectories]),
            "rewards": np.concatenate([t.rewards for t in trajectories]),
            "observations": np.concatenate(observations).astype(np.float16),
        }

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> QuerySet:
        ends = np.cumsum(arrays["steps"])
        trajectories: list[Trajectory] = []
        scenes = header.get("scenes") or [one["scene"] for one in header["queries"] for _ in range(2)]
        recorded = header.get("recorded") or [None] * len(scenes)
        for k, (end, steps) in enumerate(zip(ends, arrays["steps"], strict=True)):
            first = int(end - steps)
            rows, rows_with_end = slice(first, end), slice(first + k, end + k + 1)
            observations = arrays["observations"][rows_with_end].astype(np.float32)
            dones = np.zeros(steps, dtype=np.bool_)
            dones[-1] = arrays["outcomes"][k] != Outcome.RUNNING
            trajectories.append(
                Trajectory(
                    scene=Scene.from_dict(scenes[k]),
                    outcome=Outcome(int(arrays["outcomes"][k])),
                    poses=arrays["poses"][rows_with_end],
                    observations=observations[:-1],
                    actions=arrays["actions"][rows],
                    rewards=arrays["rewards"][rows],
                    next_observations=observations[1:],
                    dones=dones,
                    self_intersections=int(arrays["self_intersections"][k]),
                    recorded=Recorded.from_dict(recorded[k]) if recorded[k] else None,
                )
            )
        queries = tuple(
            Query(a.scene, a, b, (entry["members"][0], entry["members"][1]))
            for entry, a, b in zip(header["queries"], trajectories[0::2], trajectories[1::2], strict=True)
        )
        return cls(header["setup"], queries, header["filtered"])


def resample_path(poses: Floats) -> Floats:
    """PATH_SAMPLES points (m) evenly spaced along a path of poses (T + 1, 3)."""
    points = poses[:, :2]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], PATH_SAMPLES)
    return np.stack([np.interp(at, along, points[:, k]) for k in (0, 1)], axis=1).astype(np.float32)


def path_gap_m(a: Trajectory, b: Trajectory) -> float:
    """Largest distance (m) between the two paths at equal shares of their lengths: what an eye sees as different."""
    return float(np.linalg.norm(resample_path(a.poses) - resample_path(b.poses), axis=1).max())


def flaw(trajectory: Trajectory, config: QueryConfig) -> str | None:
    """Why this trajectory may not be shown, or None."""
    if trajectory.outcome == Outcome.COLLISION:
        return "collision"
    if trajectory.outcome != Outcome.SUCCESS:
        return "timeout"
    if trajectory.self_intersections:
        return "self_intersection"
    if trajectory.duration_s > config.max_duration_s:
        return "too_long"
    if trajectory.duration_s < config.min_duration_s:
        return "too_short"
    return None


def look_alike(a: Trajectory, b: Trajectory, config: QueryConfig) -> bool:
    """True if a person could hardly tell the two trajectories apart."""
    ratio = max(a.duration_s, b.duration_s) / min(a.duration_s, b.duration_s)
    return path_gap_m(a, b) < config.min_gap_m and ratio < config.min_duration_ratio


def round_observations(trajectory: Trajectory) -> Trajectory:
    """The trajectory with its observations as a stored query set keeps them (float16 precision)."""
    return replace(
        trajectory,
        observations=trajectory.observations.astype(np.float16).astype(np.float32),
        next_observations=trajectory.next_observations.astype(np.float16).astype(np.float32),
    )


def generate_queries(
    members: Sequence[DrivingPolicy],
    config: QueryConfig | None = None,
    on_progress: Callable[[float, dict[str, float]], None] | None = None,
) -> QuerySet:
    """Queries of `config.count` scenes: in each every pair of `config.trajectories` random members' trajectories
    without a flaw.

    Raises LearningError if `config.max_scenes` scenes do not give that many, with what the filters dropped.
    """
    config = config or QueryConfig()
    if len(members) < config.trajectories:
        raise LearningError(
            f"members = {len(members)}: {config.trajectories} trajectories need as many ensemble members"
        )
    setup = get_setup(require_same(**{f"member {k}": member.setup for k, member in enumerate(members)}))
    roll_outs = [partial(rollout, setup, member.rollout_policy) for member in members]
    return queries_of(setup.name, roll_outs, scene_rounds(setup.name, config), config, on_progress)


def scene_rounds(setup: str, config: QueryConfig) -> Iterator[list[Scene]]:
    """The scenes that queries may be made in, a round at a time: in a building each takes milliseconds to draw."""
    for first in range(0, config.max_scenes, config.scenes_per_round):
        number = min(config.scenes_per_round, config.max_scenes - first)
        yield scene_set(setup, number, purpose=Purpose.QUERIES, seed=config.seed, first=first)


def queries_of(
    setup: str,
    roll_outs: Sequence[Callable[[Sequence[Scene]], list[Trajectory]]],
    rounds: Iterable[Sequence[Scene]],
    config: QueryConfig,
    on_progress: Callable[[float, dict[str, float]], None] | None = None,
) -> QuerySet:
    """`generate_queries` of whatever rolls out in scenes of that setup, in these scenes, so many at a time."""
    random = np.random.default_rng([config.seed, 6])
    reasons = ("collision", "timeout", "self_intersection", "too_long", "too_short", "look_alike", "one_drive_left")
    filtered = dict.fromkeys(reasons, 0) | {"drives": 0, "scenes": 0}
    of_scenes: list[list[Query]] = []
    for round_scenes in rounds:
        trajectories = [roll_out(round_scenes) for roll_out in roll_outs]
        for row in range(len(round_scenes)):
            filtered["scenes"] += 1
            found = _queries_in_scene([trajectory[row] for trajectory in trajectories], config, random, filtered)
            if not found:
                continue
            of_scenes.append(found)
            if len(of_scenes) == config.count:
                return QuerySet(setup, tuple(query for of_one in of_scenes for query in of_one), filtered)
        if on_progress:
            on_progress(len(of_scenes) / config.count, {"queries": len(of_scenes), "scenes": filtered["scenes"]})
    raise LearningError(
        f"count = {config.count}: {filtered['scenes']} scenes gave queries in only {len(of_scenes)}; dropped: "
        f"{filtered}. Ask for fewer, allow longer trajectories (max_duration_s) or train a better ensemble."
    )


def _queries_in_scene(
    trajectories: Sequence[Trajectory], config: QueryConfig, random: np.random.Generator, filtered: dict[str, int]
) -> list[Query]:
    """Every pair of the first drawn trajectories that all look different; none where there are not so many."""
    good: list[int] = []
    for k, trajectory in enumerate(trajectories):
        filtered["drives"] += 1
        reason = flaw(trajectory, config)
        if reason is None:
            good.append(k)
        else:
            filtered[reason] += 1
    if len(good) < config.trajectories:
        filtered["one_drive_left"] += 1
        return []
    choices = list(permutations(good, config.trajectories))
    for k in random.permutation(len(choices)):
        pairs = list(combinations(choices[k], 2))
        if not any(look_alike(trajectories[i], trajectories[j], config) for i, j in pairs):
            return [
                Query(
                    trajectories[i].scene,
                    round_observations(trajectories[i]),
                    round_observations(trajectories[j]),
                    (i, j),
                )
                for i, j in pairs
            ]
    filtered["look_alike"] += 1
    return []

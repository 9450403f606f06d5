"""Queries of converted recordings: pairs that somebody names, or those of one scene that differ most."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.metrics import TrajectoryMetrics, measure
from desirepath.learning.queries.queries import Query, QueryConfig, look_alike
from desirepath.recordings.conversion import Converted
from desirepath.recordings.recording import RecordingError
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
SAME_PLACE_M = 1.0  # so far apart two runs of one scene may begin, and their goals be
MOST_IN_SCENE = 300  # runs of one scene that are proposed from: 45,000 pairs
BY_POSES = ("time", "path_length", "accumulated_angle", "min_human_distance", "min_obstacle_distance", "path_area")
"""What pairs are proposed by, of `TrajectoryMetrics`."""
ALIKE = QueryConfig()


@dataclass(frozen=True)
class Proposed:
    """queries: those that differ most first, scenes in turn. filtered: how many pairs were not proposed, and why."""

    queries: tuple[Query, ...]
    filtered: dict[str, int]


def given_pairs(file: str, converted: Sequence[Converted], pairs: Sequence[tuple[str, str]]) -> tuple[Query, ...]:
    """Queries of the named runs, A first. Raises RecordingError for a name that is unknown, or of several runs."""
    named: dict[str, list[int]] = defaultdict(list)
    for k, one in enumerate(converted):
        named[_run(one)].append(k)
    queries = []
    for number, pair in enumerate(pairs, start=1):
        places = []
        for side, name in zip("ab", pair, strict=True):
            found = named.get(name, [])
            if len(found) != 1:
                known = ", ".join(list(named)[:20])
                problem = (
                    f"no run of that name; there are {known}" if not found else f"{len(found)} runs have that name"
                )
                raise RecordingError(file, f"pair {number}, {side}", name, problem)
            places.append(found[0])
        if places[0] == places[1]:
            raise RecordingError(file, f"pair {number}", list(pair), "names one run twice; a pair needs two")
        queries.append(_query(converted, places[0], places[1]))
    return tuple(queries)


def propose_pairs(converted: Sequence[Converted], most: int) -> Proposed:
    """At most `most` pairs of runs of one scene that begin and end alike and do not look alike."""
    filtered = {"other_begin_or_goal": 0, "look_alike": 0}
    of_scene: dict[str, list[int]] = defaultdict(list)
    for k, one in enumerate(converted):
        of_scene[one.scene].append(k)
    scaled = _scaled(measure([one.trajectory for one in converted]))
    ranked: list[list[tuple[int, int]]] = []
    for places in of_scene.values():
        kept = places[:MOST_IN_SCENE]
        first, second = (np.array(kept)[side] for side in np.triu_indices(len(kept), 1))
        apart = np.linalg.norm(scaled[first] - scaled[second], axis=1)
        good: list[tuple[int, int]] = []
        for row in np.argsort(-apart, kind="stable"):
            a, b = int(first[row]), int(second[row])
            if not _same_place(converted[a].trajectory, converted[b].trajectory):
                filtered["other_begin_or_goal"] += 1
            elif look_alike(converted[a].trajectory, converted[b].trajectory, ALIKE):
                filtered["look_alike"] += 1
            else:
                good.append((a, b))
                if len(good) == most:
                    break
        ranked.append(good)
    chosen = [
        pair for turn in range(max(map(len, ranked), default=0)) for good in ranked for pair in good[turn : turn + 1]
    ]
    return Proposed(tuple(_query(converted, a, b) for a, b in chosen[:most]), filtered)


def _run(one: Converted) -> str:
    return one.trajectory.recorded.run if one.trajectory.recorded else ""


def _query(converted: Sequence[Converted], a: int, b: int) -> Query:
    first, second = converted[a].trajectory, converted[b].trajectory
    return Query(first.scene, first, second, (a, b))


def _same_place(a: Trajectory, b: Trajectory) -> bool:
    if a.scene.obstacles != b.scene.obstacles:
        return False
    ends = ((a.scene.start, b.scene.start), (a.scene.goal, b.scene.goal))
    return all(math.dist((one.x, one.y), (other.x, other.y)) <= SAME_PLACE_M for one, other in ends)


def _scaled(found: TrajectoryMetrics) -> Doubles:
    """(n, measures) in standard deviations; 0 where a measure is not known of all."""
    columns = np.stack([np.asarray(getattr(found, name), dtype=np.float64) for name in BY_POSES], axis=1)
    known = np.isfinite(columns).all(axis=0)
    columns = np.where(known, columns, 0.0)
    spread = columns.std(axis=0)
    scaled: Doubles = (columns - columns.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    return scaled

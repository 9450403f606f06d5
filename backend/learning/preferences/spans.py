"""How much of a drive somebody looks at before answering: the whole, or only its beginning, and what that measures.

Which of these it was is a hypothesis of `posterior.py`; programmed participants who look at a beginning only live in
`oracles.py`. All ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backend.learning.preferences.vocabulary import measures
from backend.learning.queries.queries import Query
from backend.simulation.trajectory import Outcome, Trajectory

Doubles = NDArray[np.float64]
SPANS_S: tuple[float | None, ...] = (None, 4.0, 2.0)
"""Seconds of a drive that are judged, from the start on; None: all. Coarse, since drives last 3 to 12 s. Ours."""


def beginning(drive: Trajectory, seconds: float) -> Trajectory:
    """The first `seconds` of a drive, at least one step; the whole drive where it is shorter."""
    steps = max(1, round(seconds / drive.dt))
    if steps >= len(drive.actions):
        return drive
    return replace(
        drive,
        outcome=Outcome.RUNNING,
        poses=drive.poses[: steps + 1],
        observations=drive.observations[:steps],
        actions=drive.actions[:steps],
        rewards=drive.rewards[:steps],
        next_observations=drive.next_observations[:steps],
        dones=drive.dones[:steps],
    )


def seen_differences(pairs: Sequence[tuple[Trajectory, Trajectory]]) -> Doubles:
    """(n, spans, 7) measures of each pair's first drive minus its second's, of as much as each of SPANS_S looks at."""
    drives = [drive for pair in pairs for drive in pair]
    judged = [measures(drives if s is None else [beginning(drive, s) for drive in drives]) for s in SPANS_S]
    differences: Doubles = np.stack([one[0::2] - one[1::2] for one in judged], axis=1)
    return differences


def seen_in(queries: Sequence[Query]) -> Doubles:
    """(n, spans, 7) `seen_differences` of queries, A minus B."""
    return seen_differences([(query.trajectory_a, query.trajectory_b) for query in queries])

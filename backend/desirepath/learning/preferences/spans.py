"""How much of a trajectory somebody looks at before answering: the whole, or only its beginning, and what that
measures.

Which of these it was is a hypothesis of `posterior.py`; programmed participants who look at a beginning only live in
`oracles.py`. All ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.preferences.marked_steps import MOMENT_S, marked_steps
from desirepath.learning.preferences.measures import measures, table_of
from desirepath.learning.queries.queries import Query
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory

Doubles = NDArray[np.float64]
SPANS_S: tuple[float | None, ...] = (None, 4.0, 2.0)
"""Seconds of a trajectory that are judged, from the start on; None: all. Coarse, since trajectories last 3 to 12 s.
Ours.
"""
PEAK_S = 1.0
"""How long a moment is, for whoever remembers the most extreme one and the last. Ours."""


def beginning(trajectory: Trajectory, seconds: float) -> Trajectory:
    """The first `seconds` of a trajectory, at least one step; the whole trajectory where it is shorter."""
    steps = max(1, round(seconds / trajectory.dt))
    return trajectory if steps >= len(trajectory.actions) else _part(trajectory, 0, steps)


def moments(trajectory: Trajectory, seconds: float) -> list[Trajectory]:
    """A trajectory in spans of so many seconds one after another, the last one what is left."""
    steps, n = max(1, round(seconds / trajectory.dt)), len(trajectory.actions)
    return [_part(trajectory, first, min(first + steps, n)) for first in range(0, n, steps)]


def marked_parts(trajectory: Trajectory, taps_s: Sequence[float]) -> tuple[list[Trajectory], list[Trajectory]]:
    """What taps at those times are about, and the trajectory's other parts, each about `MOMENT_S` long, in its order.

    A tap about a moment that one before it is about already says nothing more. What is shorter than half a moment is no
    part.
    """
    marked, others = marked_steps(len(trajectory.actions), trajectory.dt, taps_s)
    return [_part(trajectory, *one) for one in marked], [_part(trajectory, *one) for one in others]


def part_measures(parts: Sequence[Trajectory]) -> Doubles:
    """(n, spans, 7) measures of parts of trajectories, the same for whichever beginning is looked at.

    What adds up over a trajectory is that of MOMENT_S, so that a long part is no detour: of its way what brought the
    robot no nearer to its goal, of its time what driving straight there at full speed would have saved. Over whole
    trajectories of one scene these sum to path_length_m and time_s but for a constant.
    """
    measured = measures(parts)
    setup = get_setup(parts[0].scene.setup)
    names = [one.name for one in table_of(setup.name)]
    ends = np.array([part.poses[[0, -1], :2] for part in parts])
    goals = np.array([(part.scene.goal.x, part.scene.goal.y) for part in parts])
    nearer = -np.diff(np.linalg.norm(ends - goals[:, None], axis=2), axis=1)[:, 0]
    for name, reached in (("path_length_m", nearer), ("time_s", nearer / setup.robot.limits.v_max)):
        if name in names:
            measured[:, names.index(name)] -= reached
    lasting = np.array([part.duration_s for part in parts])
    for name in ("path_length_m", "time_s", "accumulated_angle_rad"):
        if name in names:
            measured[:, names.index(name)] *= MOMENT_S / lasting
    return np.repeat(measured[:, None], len(SPANS_S), axis=1)


def equally_long(one: Trajectory, other: Trajectory) -> tuple[Trajectory, Trajectory]:
    """As many steps of both, from their beginnings."""
    steps = min(len(one.actions), len(other.actions))
    return _part(one, 0, steps), _part(other, 0, steps)


def _part(trajectory: Trajectory, first: int, end: int) -> Trajectory:
    return replace(
        trajectory,
        outcome=Outcome.RUNNING,
        poses=trajectory.poses[first : end + 1],
        observations=trajectory.observations[first:end],
        actions=trajectory.actions[first:end],
        rewards=trajectory.rewards[first:end],
        next_observations=trajectory.next_observations[first:end],
        dones=trajectory.dones[first:end],
    )


def seen_differences(pairs: Sequence[tuple[Trajectory, Trajectory]]) -> Doubles:
    """(n, spans, 7) measures of each pair's first trajectory minus its second's, of as much as each of SPANS_S looks
    at.
    """
    seen = seen_measures([trajectory for pair in pairs for trajectory in pair])
    return np.asarray(seen[0::2] - seen[1::2])


def seen_measures(trajectories: Sequence[Trajectory]) -> Doubles:
    """(n, spans, 7) measures of each, of as much as each of SPANS_S looks at."""
    judged = [
        measures(trajectories if s is None else [beginning(trajectory, s) for trajectory in trajectories])
        for s in SPANS_S
    ]
    return np.stack(judged, axis=1)


def seen_in(queries: Sequence[Query]) -> Doubles:
    """(n, spans, 7) `seen_differences` of queries, A minus B."""
    return seen_differences([(query.trajectory_a, query.trajectory_b) for query in queries])

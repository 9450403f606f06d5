"""The trajectories of one scene that somebody puts in order: a query's two, others of the query set in that scene, and
where these are too few what the setup's conditioned policy does there at different preference weights.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import load_trajectory, save_trajectories
from desirepath.store.models import TrajectoryRow
from desirepath.store.query_sets import queries_of
from desirepath.study.personalising.live_rollouts import load_shipped_conditioned
from desirepath.study.protocol_rows import row_of

if TYPE_CHECKING:
    from desirepath.simulation.trajectory import Trajectory
    from desirepath.study.kind import Acting

LONGEST_S = 12.0  # as of queries (`learning/queries/queries.py`), where the protocol's sample says nothing


KEPT = 256  # ours: queries of which this process remembers the rollouts


class Known(OrderedDict[tuple[str, str, int, float | None], "Found"]):
    """What this process has found already, by query set and query: the same for everybody, and a fifth of a second of
    rollouts; the one that was asked for last is the last."""


@dataclass(frozen=True)
class Found:
    """stored: of the query set, by their ids. rolled_out: beside them; whether their rows are there is for the database
    to say each time, as a transaction may be rolled back and a participant erased."""

    stored: tuple[str, ...]
    rolled_out: tuple[Trajectory, ...]


def choose_drives(acting: Acting, query: str, trajectories: Sequence[str], of: int) -> list[str]:
    """Ids in the order of their numbers, which is the participant's own."""
    found = _find(acting, query, trajectories, of)
    rows = save_trajectories(acting.s, acting.files, found.rolled_out)
    of_scene = [*found.stored, *(row.id for row in rows)]
    random = np.random.default_rng([acting.session.seed, 53, acting.session.position])
    return [of_scene[i] for i in random.permutation(len(of_scene))]


def _find(acting: Acting, query: str, trajectories: Sequence[str], of: int) -> Found:
    known = acting.files.derive(Known)
    set_id = row_of(acting.s, acting.session).protocol["materials"]["query_set"]
    key = set_id, query, of, acting.frozen.protocol.sample.longest_s
    found = known.pop(key, None)
    if found is None:
        queries = queries_of(acting.s, acting.files, set_id, whole=False)
        scene = next(one.scene_hash for one in queries if one.id == query)
        beside = [id for q in queries if q.scene_hash == scene for id in (q.trajectory_a, q.trajectory_b)]
        stored = tuple(dict.fromkeys([*trajectories, *beside]))[:of]
        several = fill_up([load_trajectory(acting.files, one) for one in stored], of, key[3])
        found = Found(stored, tuple(several[len(stored) :]))
    known[key] = found
    while len(known) > KEPT:
        known.popitem(last=False)
    return found


def fill_up(given: Sequence[Trajectory], of: int, longest_s: float | None = None) -> list[Trajectory]:
    """Those and, in the same scene, what is missing of the conditioned policy's."""
    from desirepath.learning.queries.queries import QueryConfig  # numba comes with it
    from desirepath.learning.queries.varied_queries import several_in_scene

    if len(given) >= of:
        return list(given)[:of]
    conditioned = load_shipped_conditioned(given[0].scene.setup)
    return several_in_scene(conditioned, given, of, QueryConfig(max_duration_s=longest_s or LONGEST_S))


def durations_s(s: DatabaseSession, trajectories: Sequence[str]) -> list[float]:
    """How long each takes."""
    rows = select(TrajectoryRow.id, TrajectoryRow.duration_s).where(TrajectoryRow.id.in_(trajectories))
    known: dict[str, float] = {row.id: row.duration_s for row in s.execute(rows)}
    return [known[one] for one in trajectories]

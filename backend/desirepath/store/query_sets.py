"""Query sets in the store: brought in once, then looked up by artefact. How queries are made lives in `learning`.

A study protocol names a set by a shipped name, the path of a file, or the id of one that a job made here.
"""
# torch comes with `learning` and takes seconds to import, so it is imported where a set is read, not with the server.

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import and_, or_, select
from sqlalchemy.orm import Session, defer

from desirepath.simulation.recorded import PARTS
from desirepath.store.artefact_upkeep import is_offered
from desirepath.store.artefacts import (
    SHA256,
    ArtefactError,
    ArtefactStore,
    load_artefact,
    query_entry,
    save_artefact,
    save_trajectories,
)
from desirepath.store.models import Artefact
from desirepath.store.shipped_policies import register, register_parents

if TYPE_CHECKING:
    from desirepath.learning.queries.queries import QuerySet
    from desirepath.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class StoredQuery:
    """A query whose two trajectories are in the store. `id` is the query's digest, the same wherever it is asked."""

    id: str
    setup: str
    scene_hash: str
    trajectory_a: str
    trajectory_b: str
    duration_a_s: float
    duration_b_s: float
    practice: bool = False  # of a ranking set (`ranking_sets.py`): for practice alone


KINDS = ("query_set", "ranking_set")
"""Artefacts that a protocol's `query_set` may name. What is ranked is one trajectory, both sides of its query."""


def query_sets_here(s: Session, *, also: str | None = None) -> dict[str, str]:
    """id -> "name (setup, how many queries)" of every query set of the store that may be used, newest first.

    also: the one that a study shows already, which goes on with it though it was archived meanwhile.
    """
    usable = or_(is_offered(), and_(Artefact.id == also, Artefact.quarantined_at.is_(None))) if also else is_offered()
    rows = select(Artefact).where(Artefact.kind.in_(KINDS), usable)
    return {
        artefact.id: f"{artefact.name} ({artefact.setup}, {len(artefact.card['stored_queries'])} queries)"
        for artefact in s.scalars(rows.order_by(Artefact.created_at.desc(), Artefact.id))
    }


def import_query_set(s: Session, files: ArtefactStore, reference: str) -> Artefact:
    """The query set that a protocol names: by an id, a shipped name (`study_room/queries_500`) or the path of
    a `.npz` file, which is brought into the store; idempotent and then fast.

    Raises LearningError if there is none or it is damaged, ArtefactError if it is empty, quarantined or no query set.
    """
    if SHA256.fullmatch(reference):
        named = s.get(Artefact, reference)
        kind = "ranking_set" if named is not None and named.kind == "ranking_set" else "query_set"
        return load_artefact(s, files, reference, kind=kind)[0]
    from desirepath.explain.ranking_sets import RankingSet, is_ranking_set
    from desirepath.learning.cards import Card, card_path
    from desirepath.learning.queries.queries import QuerySet
    from desirepath.learning.shipped_files import resolve
    from desirepath.store.ranking_sets import save_ranking_set

    path = resolve(reference)
    content = path.read_bytes()
    stored = s.get(Artefact, hashlib.sha256(content).hexdigest())
    if stored is not None:
        return stored
    card = Card.load(card_path(path)) if card_path(path).exists() else None
    described: dict[str, Any] = {
        "name": card.name if card else path.stem,
        "card": asdict(card) if card else {},
        "parents": register_parents(s, files, card) if card else [],
        "content": content,
    }
    if is_ranking_set(content):
        return save_ranking_set(s, files, RankingSet.from_bytes(content), **described)
    return save_query_set(s, files, QuerySet.from_bytes(content), **described)


def register_made(s: Session, files: ArtefactStore, name: str, job_id: str | None = None) -> Artefact:
    """Store the policy or query set of that name in a setup's folder, unless it is stored. Raises LearningError."""
    from desirepath.learning.shipped_files import load_card

    if load_card(name).kind == "query_set":
        return import_query_set(s, files, name)
    return register(s, files, name, job_id=job_id)


def save_query_set(
    s: Session,
    files: ArtefactStore,
    query_set: QuerySet,
    *,
    name: str,
    card: dict[str, Any],
    parents: list[tuple[str, str]] | None = None,
    job_id: str | None = None,
    content: bytes | None = None,
    videos: Iterable[Path] = (),
    study_id: str | None = None,
) -> Artefact:
    """Store a query set and each of its trajectories once; idempotent.

    videos: files of those that its trajectories name; each becomes an artefact of its own, of which the set is made.

    content: the set's bytes where they came from a file, so that the artefact's id is the file's sha256. The stored
    card gets `stored_queries`: where each query's trajectories lie; and `recorded` where they are of recordings. Raises
    ArtefactError for an empty set, or a video that is neither given nor here.
    """
    if not query_set.queries:
        raise ArtefactError(f"query set {name!r} holds no queries; a study needs at least one")
    content = query_set.to_bytes() if content is None else content
    trajectories = [t for query in query_set.queries for t in (query.trajectory_a, query.trajectory_b)]
    filmed = _save_videos(s, files, trajectories, query_set.setup, videos, study_id)
    rows = save_trajectories(s, files, trajectories)
    stored = [query_entry(a, b) for a, b in zip(rows[0::2], rows[1::2], strict=True)]
    return save_artefact(
        s,
        files,
        kind="query_set",
        name=name,
        setup=query_set.setup,
        content=content,
        card={**card, **_describe_recordings(trajectories), "stored_queries": stored},
        parents=[*(parents or ()), *((video, "video") for video in filmed)],
        study_id=study_id,
        job_id=job_id,
    )


def _save_videos(
    s: Session,
    files: ArtefactStore,
    trajectories: Sequence[Trajectory],
    setup: str,
    given: Iterable[Path],
    study_id: str | None,
) -> list[str]:
    """The videos that trajectories name, stored; their ids."""
    wanted = {one.recorded.video.sha256: one.recorded for one in trajectories if one.recorded and one.recorded.video}
    for file in given if wanted else ():
        content = file.read_bytes()
        recorded = wanted.get(hashlib.sha256(content).hexdigest())
        if recorded is not None and recorded.video is not None:
            card = {"video": asdict(recorded.video), "imported": {"file": file.name}}
            described: dict[str, Any] = {"name": file.name, "setup": setup, "card": card, "study_id": study_id}
            save_artefact(s, files, kind="video", content=content, **described)
    for sha, recorded in wanted.items():
        found = s.get(Artefact, sha)
        if found is None or found.kind != "video" or not files.exists(sha):
            raise ArtefactError(f"video {recorded.run} is not here; import the folder that has it, or the data set")
    return sorted(wanted)


def _describe_recordings(trajectories: Sequence[Trajectory]) -> dict[str, Any]:
    """What a card says of recordings: `has`, of what all trajectories have; files, with the sha256 of each. Nothing of
    trajectories that engines made."""
    recorded = [each.recorded for each in trajectories if each.recorded is not None]
    if not recorded:
        return {}
    has = [part for part in PARTS if len(recorded) == len(trajectories) and all(part in each.has for each in recorded)]
    return {"recorded": {"has": has, "files": {each.file: each.sha256 for each in recorded}}}


def queries_of(s: Session, files: ArtefactStore, artefact_id: str, *, whole: bool = True) -> list[StoredQuery]:
    """The queries of a stored set, in its order. Raises ArtefactError if it is none or a trajectory's file is gone.

    whole=False: whoever asks looks after the files of those that are used (`require_files`).
    """
    artefact = s.get(Artefact, artefact_id, options=[defer(Artefact.card)])
    if artefact is None or artefact.kind not in KINDS:
        raise ArtefactError(f"{artefact_id!r} is not a query set in this store")
    row = (artefact.id, artefact.created_at)
    queries = _listed.get(row)
    if queries is None:
        queries = _listed[row] = tuple(
            StoredQuery(**{name: entry[name] for name in _FIELDS if name in entry})
            for entry in artefact.card["stored_queries"]
        )
    if whole:
        require_files(files, (t for query in queries for t in (query.trajectory_a, query.trajectory_b)))
    return list(queries)


_FIELDS = tuple(field.name for field in fields(StoredQuery))
# By the artefact's row, which never changes: a card holds hundreds of queries, and everybody who joins needs them.
_listed: dict[tuple[str, datetime], tuple[StoredQuery, ...]] = {}


def require_files(files: ArtefactStore, trajectories: Iterable[str]) -> None:
    """Raises ArtefactError if the file of one of these trajectories is gone."""
    for trajectory_id in trajectories:
        if not files.exists(trajectory_id):
            raise ArtefactError(f"the file of trajectory {trajectory_id} is missing; restore a backup")

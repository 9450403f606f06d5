"""Packs the example study's installation into one small file; `store/example_study.py` reads it."""

from __future__ import annotations

import base64
import io
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.learning.queries.queries import Query, QuerySet, round_observations
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.database import Database
from desirepath.store.example_study import FORMAT, MODELS, ROWS, SHOWN, TEXT_BEGINS, Rows, renamed
from desirepath.store.models import (
    Artefact,
    ArtefactAnswer,
    ArtefactParent,
    Base,
    Event,
    Job,
    JobAttempt,
    JobMetric,
    Participant,
    Response,
    Session,
    Study,
    TrajectoryRow,
    Trial,
)
from desirepath.store.query_sets import StoredQuery, queries_of

SAME_BYTES = 64  # shorter agreements with the shipped policy are not looked for


@dataclass(frozen=True)
class Packed:
    """The file, and how many rows of each table it holds."""

    content: bytes
    counts: dict[str, int]


def pack_example(db: Database, files: ArtefactStore, study_id: str) -> Packed:
    """Everything of the study, as the installation's only one."""
    with db.session() as s:
        whole = _whole(study_id)
        rows = {model.__tablename__: [_as_data(row) for row in s.scalars(whole[model])] for model in MODELS}
        query_set = s.get_one(Artefact, rows["study"][0]["protocol"]["materials"]["query_set"])
        local = _places(queries_of(s, files, query_set.id))
        contents = {row["id"]: files.get(row["id"]) for row in rows["artefact"]}
        sources = {of: source for of, source in _sources(s, files, rows) if source}
    brought = [row for row in rows["trajectory"] if row["id"] not in local]
    ids: dict[str, str] = {}
    queries, shown = [], []
    for first, second in _by_scene(brought):
        a, b = (round_observations(load_trajectory(files, name)) for name in (first, second))
        ids |= {first: a.digest(), second: b.digest()}
        queries.append(Query(a.scene, a, b, (0, 0)))
        shown.append([ids[first], ids[second]])
    rows["trajectory"] = brought
    rows, contents = renamed(rows, contents, ids)
    about = {
        "format": FORMAT,
        "query_set": query_set.name,
        "local": {name: place for name, place in local.items() if name in json.dumps(rows)},
        "shown": shown,
        "rows": rows,
        "files": {sha: _difference(content, *sources.get(sha, ("", b""))) for sha, content in contents.items()},
    }
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as packed:
        for name, content in (
            (ROWS, json.dumps(about, sort_keys=True, separators=(",", ":")).encode()),
            (SHOWN, QuerySet(query_set.setup, tuple(queries), {}).to_bytes()),
        ):
            packed.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_LZMA)  # ids stand far apart, many times
    return Packed(out.getvalue(), {name: len(of) for name, of in rows.items()})


def _whole(study_id: str) -> dict[type[Base], Select[Any]]:
    """What of each table is the study's."""
    # What a study has measured by itself holds thousands of scenes; `example_study.py` asks for smaller ones.
    large = select(Job.id).where(Job.kind == "evaluate", Job.created_by == "study")
    ours = (Job.study_id == study_id, Job.id.not_in(large))
    made = (Artefact.study_id == study_id, func.coalesce(Artefact.job_id, "").not_in(large))
    artefacts, jobs = select(Artefact.id).where(*made), select(Job.id).where(*ours)
    return {
        Study: select(Study),
        Participant: select(Participant).order_by(Participant.code),
        Session: select(Session).order_by(Session.created_at),
        TrajectoryRow: select(TrajectoryRow).order_by(TrajectoryRow.scene_hash, TrajectoryRow.id),
        Trial: select(Trial).order_by(Trial.session_id, Trial.index),
        Response: select(Response).order_by(Response.created_at),
        Event: select(Event).where(Event.study_id == study_id).order_by(Event.id),
        Job: select(Job).where(*ours).order_by(Job.created_at),
        JobAttempt: select(JobAttempt).where(JobAttempt.job_id.in_(jobs)).order_by(JobAttempt.began_at),
        JobMetric: select(JobMetric).where(JobMetric.job_id.in_(jobs)).order_by(JobMetric.id),
        Artefact: select(Artefact).where(*made).order_by(Artefact.created_at),
        ArtefactParent: select(ArtefactParent).where(ArtefactParent.artefact_id.in_(artefacts)),
        ArtefactAnswer: select(ArtefactAnswer).where(ArtefactAnswer.artefact_id.in_(artefacts)),
    }


def _as_data(row: Base) -> dict[str, Any]:
    """A row as JSON; numbers that only give an order are left out, as are what opens links and sessions."""
    left_out = {"recruiting_token", "token_hash"} | ({"id"} if isinstance(row, Event | JobMetric) else set())
    values = {column.name: getattr(row, column.name) for column in row.__table__.columns}
    return {
        name: value.isoformat() if isinstance(value, datetime) else value
        for name, value in values.items()
        if name not in left_out and value is not None
    }


def _places(queries: Sequence[StoredQuery]) -> dict[str, list[Any]]:
    """What a query set names -> [which query, which of its ids]."""
    names = ("id", "trajectory_a", "trajectory_b")
    return {getattr(query, name): [k, name] for k, query in enumerate(queries) for name in names}


def _by_scene(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Ids two by two, each pair of one scene; who is left over stands with itself."""
    waiting: dict[str, str] = {}
    for row in rows:
        other = waiting.pop(row["scene_hash"], None)
        if other is None:
            waiting[row["scene_hash"]] = row["id"]
        else:
            yield other, row["id"]
    yield from ((alone, alone) for alone in waiting.values())


def _sources(s: DatabaseSession, files: ArtefactStore, rows: Rows) -> Iterator[tuple[str, tuple[str, bytes]]]:
    """Of what was conditioned: the shipped policy's name and bytes."""
    for row in rows["artefact_parent"]:
        if row["role"] == "conditioned":
            yield row["artefact_id"], (s.get_one(Artefact, row["parent_id"]).name, files.get(row["parent_id"]))


def _difference(content: bytes, name: str, source: bytes) -> dict[str, Any]:
    """The content as pieces: base64 and [begin, end] of the source's bytes; a text as it is. name: the source's."""
    if content[:1] == TEXT_BEGINS:
        return {"text": content.decode()}
    known = {source[k : k + SAME_BYTES]: k for k in range(0, len(source) - SAME_BYTES, SAME_BYTES)}
    pieces: list[Any] = []
    own = at = 0
    while at < len(content):
        there = known.get(content[at : at + SAME_BYTES])
        if there is None:
            at += 1
            continue
        end, there_end = at, there
        while end < len(content) and there_end < len(source) and content[end] == source[there_end]:
            end, there_end = end + 1, there_end + 1
        pieces += [base64.b64encode(content[own:at]).decode(), [there, there_end]]
        own = at = end
    return {"of": name, "pieces": [*pieces, base64.b64encode(content[own:]).decode()]}

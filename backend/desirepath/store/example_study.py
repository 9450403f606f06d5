"""The example study: simulated people's, with everything that was learned from them. Packed by `desirepath ship
example-study`, brought into an installation once, removed whole.

Unlike a data set (`dataset`) it holds jobs and policies, too, and only what is shipped is read: rows go in as they are.
What an installation has already is not packed: trajectories of the study's shipped query set are named by their place
in it, and of a policy only those bytes are kept that the shipped policy it was made from does not have. Trajectories
are written anew where they arrive, and another machine's compressor gives them other names: all rows follow.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import secrets
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy import Select, Table, delete, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.installed import DATASETS
from desirepath.learning.shipped_files import resolve
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.database import COMPACT_PENDING, Database
from desirepath.store.erasure import delete_job_files
from desirepath.store.models import (
    Artefact,
    ArtefactAnswer,
    ArtefactParent,
    Audit,
    Base,
    Erasing,
    Event,
    Job,
    JobAttempt,
    JobMetric,
    Participant,
    Response,
    Session,
    Setting,
    Study,
    TrajectoryRow,
    Trial,
)
from desirepath.store.models.base import UtcDateTime
from desirepath.store.query_sets import StoredQuery, import_query_set, queries_of

FILE = DATASETS / "example_study" / "example_study.zip"
FORMAT = "desirepath-example-1"
SETTING = "example_study"
"""Its row: {"study": id}; {"study": null} once it was removed, so that it does not come back."""
ROWS, SHOWN = "rows.json", "shown.npz"
SAME_BYTES = 64  # shorter agreements with the shipped policy are not looked for
HASHES = re.compile(r"[0-9a-f]{64}")
Rows = dict[str, list[dict[str, Any]]]


class ExampleError(ValueError):
    """The example study cannot be packed, brought or removed as asked; nothing was changed."""


@dataclass(frozen=True)
class Packed:
    """The file, and how many rows of each table it holds."""

    content: bytes
    counts: dict[str, int]


# ---- packing: on an installation that was made for it and holds nothing else -----------------------------------------


def pack_example(db: Database, files: ArtefactStore, study_id: str) -> Packed:
    """Everything of the study, as the installation's only one. Raises ExampleError for what names something else."""
    from desirepath.learning.queries.queries import Query, QuerySet, round_observations

    with db.session() as s:
        rows = {model.__tablename__: [_as_data(row) for row in s.scalars(query)] for model, query in _whole(study_id)}
        query_set = s.get_one(Artefact, rows["study"][0]["protocol"]["materials"]["query_set"])
        local = _places(queries_of(s, files, query_set.id))
        contents = {row["id"]: files.get(row["id"]) for row in rows["artefact"]}
        sources = {of: source for of, source in _sources(s, files, rows) if source}
    brought = [row for row in rows["trajectory"] if row["id"] not in local]
    ids, queries, shown = {}, [], []
    for first, second in _by_scene(brought):
        a, b = (round_observations(load_trajectory(files, name)) for name in (first, second))
        ids |= {first: a.digest(), second: b.digest()}
        queries.append(Query(a.scene, a, b, (0, 0)))
        shown.append([ids[first], ids[second]])
    rows["trajectory"] = brought
    rows, contents = _renamed(rows, contents, ids)
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
            packed.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, 9)
    return Packed(out.getvalue(), {name: len(of) for name, of in rows.items()})


def _whole(study_id: str) -> Iterator[tuple[type[Base], Select[Any]]]:
    """The tables in the order in which their rows refer to each other, and what of each is the study's."""
    artefacts = select(Artefact.id).where(Artefact.study_id == study_id)
    jobs = select(Job.id).where(Job.study_id == study_id)
    yield Study, select(Study)
    yield Participant, select(Participant).order_by(Participant.code)
    yield Session, select(Session).order_by(Session.created_at)
    yield TrajectoryRow, select(TrajectoryRow).order_by(TrajectoryRow.scene_hash, TrajectoryRow.id)
    yield Trial, select(Trial).order_by(Trial.session_id, Trial.index)
    yield Response, select(Response).order_by(Response.created_at)
    yield Event, select(Event).where(Event.study_id == study_id).order_by(Event.id)
    yield Job, select(Job).where(Job.study_id == study_id).order_by(Job.created_at)
    yield JobAttempt, select(JobAttempt).where(JobAttempt.job_id.in_(jobs)).order_by(JobAttempt.began_at)
    yield JobMetric, select(JobMetric).where(JobMetric.job_id.in_(jobs)).order_by(JobMetric.id)
    yield Artefact, select(Artefact).where(Artefact.study_id == study_id).order_by(Artefact.created_at)
    yield ArtefactParent, select(ArtefactParent).where(ArtefactParent.artefact_id.in_(artefacts))
    yield ArtefactAnswer, select(ArtefactAnswer).where(ArtefactAnswer.artefact_id.in_(artefacts))


MODELS = tuple(model for model, _ in _whole(""))


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


def _renamed(rows: Rows, contents: Mapping[str, bytes], ids: Mapping[str, str]) -> tuple[Rows, dict[str, bytes]]:
    """Rows and artefacts in which every id is written as `ids` has it. Texts among the artefacts that name some get
    names of their own; they stand in the order in which they were made of each other."""
    ids, kept = dict(ids), {}
    for name, content in contents.items():
        new = _written(content.decode(), ids).encode() if content[:1] == b"{" else content
        ids[name] = hashlib.sha256(new).hexdigest()
        kept[ids[name]] = new
    return json.loads(_written(json.dumps(rows), ids)), kept


def _written(text: str, ids: Mapping[str, str]) -> str:
    return HASHES.sub(lambda found: ids.get(found[0], found[0]), text)


def _difference(content: bytes, name: str, source: bytes) -> dict[str, Any]:
    """The content as pieces: texts (base64) and [begin, end] of the source's bytes. name: the source's."""
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


# ---- bringing it -----------------------------------------------------------------------------------------------------


def add_example(db: Database, files: ArtefactStore, source: Path = FILE) -> str | None:
    """Bring the example study, once in an installation's life; returns its id, None where it was here before.

    Everything that takes time is done before the one transaction that writes. Raises ExampleError for another file.
    """
    with db.session() as s:
        if s.get(Setting, SETTING) is not None:
            return None
    about, trajectories = _read(source)
    with db.transaction() as s:
        query_set = import_query_set(s, files, about["query_set"])
        queries = queries_of(s, files, query_set.id, whole=False)
    local = {name: str(getattr(queries[k], field)) for name, (k, field) in about["local"].items()}
    new = dict(zip(trajectories, files.put_all(trajectories.values()), strict=True))
    contents = {sha: _rebuilt(sha, described) for sha, described in about["files"].items()}
    rows, contents = _renamed(about["rows"], contents, local | new)
    files.put_all(contents.values())
    with db.transaction() as s:
        if s.get(Setting, SETTING) is not None:
            return None
        for model in MODELS:
            s.add_all(model(**_as_columns(model, row)) for row in rows[model.__tablename__])
            s.flush()
        study_id = str(rows["study"][0]["id"])
        s.add(Setting(key=SETTING, value={"study": study_id}))
    return study_id


def _read(source: Path) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What stands in the file; trajectories by the names that its rows call them, written as this machine does."""
    from desirepath.learning.queries.queries import QuerySet

    try:
        with zipfile.ZipFile(source) as packed:
            about, shown = json.loads(packed.read(ROWS)), QuerySet.from_bytes(packed.read(SHOWN)).queries
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as problem:
        raise ExampleError(f"{source}: is no example study ({problem})") from problem
    if about.get("format") != FORMAT:
        raise ExampleError(f"{source}: format {about.get('format')!r} is unknown; this version reads {FORMAT}")
    trajectories = {}
    for (a, b), query in zip(about["shown"], shown, strict=True):
        trajectories |= {a: query.trajectory_a.to_bytes(), b: query.trajectory_b.to_bytes()}
    return about, trajectories


def _rebuilt(sha: str, described: Mapping[str, Any]) -> bytes:
    """The artefact that was packed by `_difference`. Raises ExampleError where the shipped policy is another one."""
    source = resolve(described["of"]).read_bytes() if described["of"] else b""
    parts = (base64.b64decode(one) if isinstance(one, str) else source[slice(*one)] for one in described["pieces"])
    content = b"".join(parts)
    if hashlib.sha256(content).hexdigest() != sha:
        raise ExampleError(
            f"artefact {sha} cannot be made from {described['of']} any more; `desirepath ship example-study` anew"
        )
    return content


def _as_columns(model: type[Base], row: Mapping[str, Any]) -> dict[str, Any]:
    """A row's values as its columns hold them; what opens a link or a session is a secret that nobody knows."""
    times = {column.name for column in model.__table__.columns if isinstance(column.type, UtcDateTime)}
    values = {name: datetime.fromisoformat(value) if name in times else value for name, value in row.items()}
    secret = {Study: "recruiting_token", Session: "token_hash"}.get(model)
    return values | ({secret: secrets.token_hex(32)} if secret else {})


# ---- removing it -----------------------------------------------------------------------------------------------------


def example_id(s: DatabaseSession) -> str | None:
    """The study's id, where it is here."""
    row = s.get(Setting, SETTING)
    return None if row is None else row.value["study"]


def remove_example(db: Database, files: ArtefactStore, data: Path) -> None:
    """Remove the example study with everything that came with it or was made of it since; it does not come back.

    data: the data folder, where logs of jobs lie. Raises ExampleError where it is not here, or where somebody who is no
    program takes part in it by now.
    """
    with db.transaction() as s:
        study_id = example_id(s)
        if study_id is None:
            raise ExampleError("the example study is not here")
        people = s.scalars(select(Participant).where(Participant.study_id == study_id)).all()
        if not all(person.simulated for person in people):
            raise ExampleError("people take part in the example study by now; erase them first")
        s.add_all(Erasing(participant_id=person.id) for person in people)
        s.flush()
        doomed = _find_doomed(s, study_id)
        named = _named(s, doomed)
        for table in reversed(Base.metadata.sorted_tables):
            _delete_rows(s, table, doomed)
        gone = (named & set(s.scalars(select(TrajectoryRow.id)))) - _named(s)
        s.execute(delete(TrajectoryRow).where(TrajectoryRow.id.in_(gone)))
        s.merge(Setting(key=SETTING, value={"study": None}))
        s.merge(Setting(key=COMPACT_PENDING, value={}))
    for sha in sorted(gone | doomed["artefact_id"]):
        files.delete(sha)
    delete_job_files(data, doomed["job_id"])
    db.compact()


def _find_doomed(s: DatabaseSession, study_id: str) -> dict[str, set[str]]:
    """Column that refers to a row -> ids of the study's rows of that kind."""
    doomed = {"study_id": {study_id}}
    for name, model in (
        ("participant_id", Participant),
        ("session_id", Session),
        ("job_id", Job),
        ("artefact_id", Artefact),
    ):
        doomed[name] = set(s.scalars(select(model.id).where(model.study_id == study_id)))
    in_sessions = Response.session_id.in_(doomed["session_id"])
    doomed["response_id"] = set(s.scalars(select(Response.id).where(in_sessions)))
    doomed["artefact_id"] |= set(s.scalars(select(Artefact.id).where(Artefact.job_id.in_(doomed["job_id"]))))
    doomed["parent_id"] = doomed["artefact_id"]
    return doomed


def _delete_rows(s: DatabaseSession, table: Table, doomed: Mapping[str, set[str]]) -> None:
    """The table's rows that are the study's or refer to some of it. Who did what stays in the audit log."""
    if table.name == Audit.__tablename__:
        return
    own = {
        Study: "study_id",
        Participant: "participant_id",
        Session: "session_id",
        Job: "job_id",
        Artefact: "artefact_id",
    }
    for model, name in own.items():
        if table is model.__table__:
            s.execute(delete(table).where(table.c.id.in_(doomed[name])))
    for name, ids in doomed.items():
        if name in table.c and not (table is Job.__table__ and name == "job_id"):
            s.execute(delete(table).where(table.c[name].in_(ids)))


def _named(s: DatabaseSession, doomed: Mapping[str, set[str]] | None = None) -> set[str]:
    """Every hash that trials, jobs and cards name: those of the doomed, by default all that there are."""
    of = (
        (select(Trial.trajectory_a, Trial.trajectory_b), Trial.session_id, "session_id"),
        (select(Job.params, Job.result), Job.id, "job_id"),
        (select(Artefact.card), Artefact.id, "artefact_id"),
    )
    rows = [s.execute(q.where(key.in_(doomed[name])) if doomed else q).all() for q, key, name in of]
    return set(HASHES.findall(json.dumps([list(row) for found in rows for row in found], default=str)))

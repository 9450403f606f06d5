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
import json
import re
import secrets
import zipfile
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy import Table, delete, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.installed import DATASETS
from desirepath.learning.shipped_files import resolve
from desirepath.store.artefacts import ArtefactStore
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
from desirepath.store.query_sets import import_query_set, queries_of

FILE = DATASETS / "example_study" / "example_study.zip"
FORMAT = "desirepath-example-1"
SETTING = "example_study"
"""Its row: {"study": id}; {"study": null} once it was removed, so that it does not come back."""
ROWS, SHOWN = "rows.json", "shown.npz"
TEXT_BEGINS = b"{"  # snapshots and evaluations are JSON, which may name trajectories
HASHES = re.compile(r"[0-9a-f]{64}")
Rows = dict[str, list[dict[str, Any]]]
MODELS: tuple[type[Base], ...] = (
    Study, Participant, Session, TrajectoryRow, Trial, Response, Event, Job, JobAttempt, JobMetric, Artefact,
    ArtefactParent, ArtefactAnswer,
)  # fmt: skip
"""Its tables in the order in which their rows refer to each other."""


class ExampleError(ValueError):
    """The example study cannot be packed, brought or removed as asked; nothing was changed."""


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
    rows, contents = renamed(about["rows"], contents, local | new)
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
    trajectories: dict[str, bytes] = {}
    for (a, b), query in zip(about["shown"], shown, strict=True):
        trajectories |= {a: query.trajectory_a.to_bytes(), b: query.trajectory_b.to_bytes()}
    return about, trajectories


def packed_policies() -> dict[str, bytes]:
    """The policies in the file by their ids, which are the same wherever they arrive."""
    about, _ = _read(FILE)
    ids = [row["id"] for row in about["rows"]["artefact"] if row["kind"] == "policy"]
    return {sha: _rebuilt(sha, about["files"][sha]) for sha in ids}


def renamed(rows: Rows, contents: Mapping[str, bytes], ids: Mapping[str, str]) -> tuple[Rows, dict[str, bytes]]:
    """Rows and artefacts in which every id is written as `ids` has it. Texts among the artefacts that name some get
    names of their own; they stand in the order in which they were made of each other."""
    ids, kept = dict(ids), {}
    for name, content in contents.items():
        new = _written(content.decode(), ids).encode() if content[:1] == TEXT_BEGINS else content
        ids[name] = hashlib.sha256(new).hexdigest()
        kept[ids[name]] = new
    return json.loads(_written(json.dumps(rows), ids)), kept


def _written(text: str, ids: Mapping[str, str]) -> str:
    return HASHES.sub(lambda found: ids.get(found[0], found[0]), text)


def _rebuilt(sha: str, described: Mapping[str, Any]) -> bytes:
    """The artefact that was packed by its difference. Raises ExampleError where the shipped policy is another one."""
    if "text" in described:
        return str(described["text"]).encode()
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
    found: str | None = row.value["study"] if row is not None else None
    return found


def was_brought(s: DatabaseSession) -> bool:
    """Whether it is here, or was and has been removed."""
    return s.get(Setting, SETTING) is not None


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
        texts = (files.get(sha) for sha in doomed["artefact_id"] if files.exists(sha))
        named = _named(s, doomed) | {
            sha for text in texts if text[:1] == TEXT_BEGINS for sha in HASHES.findall(text.decode())
        }
        s.execute(delete(Event).where(Event.study_id == study_id))
        for table in reversed(Base.metadata.sorted_tables):
            if table is Participant.__table__:  # nothing is left that needed the key
                s.execute(delete(Erasing))
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
    made = doomed["artefact_id"]
    while (
        children := set(s.scalars(select(ArtefactParent.artefact_id).where(ArtefactParent.parent_id.in_(made)))) - made
    ):
        made |= children
    of_jobs = select(Artefact.job_id).where(Artefact.id.in_(made), Artefact.job_id.is_not(None))
    doomed["job_id"] |= {str(job) for job in s.scalars(of_jobs)}
    doomed["parent_id"] = made
    return doomed


def _delete_rows(s: DatabaseSession, table: Table, doomed: Mapping[str, set[str]]) -> None:
    """The table's rows that are the study's or refer to some of it. Who did what stays in the audit log."""
    if table.name in (Audit.__tablename__, Erasing.__tablename__):
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
        (select(Trial.trajectory_a, Trial.trajectory_b, Trial.arms), Trial.session_id, "session_id"),
        (select(Job.params, Job.result), Job.id, "job_id"),
        (select(Artefact.card), Artefact.id, "artefact_id"),
    )
    rows = [s.execute(q.where(key.in_(doomed[name])) if doomed else q).all() for q, key, name in of]
    return set(HASHES.findall(json.dumps([list(row) for found in rows for row in found], default=str)))

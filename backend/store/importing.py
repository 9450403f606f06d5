"""Loads an exported data set into this database, to the same answers. Writing one lives in `export.py`.

An imported study is closed and its sessions have no link: it is there to be analysed. Recruiting ids, completion codes,
problem reports and whatever withdrawn participants left were never exported, so they are not there.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import pyarrow as pa
import pyarrow.parquet as pq
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from backend.simulation.trajectory import Trajectory
from backend.store.artefacts import ArtefactStore
from backend.store.database import Database
from backend.store.dataset import (
    CHECKSUMS_FILE,
    EVENTS,
    PARTICIPANTS,
    PROTOCOL_FOLDER,
    READABLE,
    RESPONSES,
    SESSIONS,
    STROKES,
    STUDY_FILE,
    TRAJECTORIES,
    TRAJECTORY_FOLDER,
    TRIALS,
    Table,
)
from backend.store.demonstration_snapshots import StrokeError
from backend.store.models import (
    Event,
    Participant,
    ProtocolVersion,
    Response,
    Study,
    Tombstone,
    TrajectoryRow,
    Trial,
    new_id,
    protocol_digest,
)
from backend.store.models import Session as SessionRow
from backend.store.stroke_rows import add_strokes
from backend.store.who_counts import role_of

Row = dict[str, Any]
# Columns that are called as in the database.
PARTICIPANT_FIELDS = ("simulated", "pilot", "oracle", "created_at", "withdrawn_at", "excluded_at", "excluded_reason")
SESSION_FIELDS = (
    *("state", "language", "simulated", "seed", "plan", "position", "device", "personalisation"),
    *("created_at", "opens_at", "started_at", "finished_at", "last_seen_at", "expires_at"),
    *("ended_because", "appointment", "protocol_number", "assignment"),
)
TRIAL_FIELDS = (
    *("index", "block", "kind", "role", "view", "trajectory_a", "trajectory_b", "arms", "phase"),
    *("phase_since", "a_seen_at", "b_seen_at", "restarts", "replays", "probe_of", "sides_swapped"),
)


class DatasetError(ValueError):
    """A folder that is no whole, unchanged data set of this format; nothing was imported."""


@dataclass(frozen=True)
class ReadDataset:
    """A data set as it lies in a folder. about: study.json; protocol, files: the study's frozen copy; tables: by name,
    JSON columns as plain data; later: {"protocol", "files"} of its later versions, in order."""

    folder: Path
    about: Row
    protocol: Row
    files: dict[str, str]
    tables: dict[str, list[Row]]
    later: list[Row]

    def trajectory(self, trajectory_id: str) -> Trajectory:
        return Trajectory.from_bytes((self.folder / TRAJECTORY_FOLDER / f"{trajectory_id}.npz").read_bytes())


def read_dataset(folder: Path) -> ReadDataset:
    """Participants, sessions, trials and responses of the data set in `folder`; nothing is imported.

    Raises DatasetError as `import_dataset` does.
    """
    _check_files(folder)
    about = _about(folder)
    frozen = _read_json(folder / PROTOCOL_FOLDER / "frozen.json")
    tables = {table.name: _read(folder, table) for table in (PARTICIPANTS, SESSIONS, TRIALS, RESPONSES)}
    later = [_read_json(folder / PROTOCOL_FOLDER / f"{one['number']}.json") for one in about["protocol_versions"]]
    return ReadDataset(folder, about, frozen["protocol"], frozen["files"], tables, later)


def import_dataset(db: Database, files: ArtefactStore, folder: Path) -> dict[str, Any]:
    """Load the data set in `folder`; returns {"study", "participants", "sessions", "responses", "trajectories"}.

    Checks every checksum first. Raises DatasetError naming the file if one is missing, changed, added or unreadable, if
    the protocol is not the one whose hash the study carries, or if the study is here already.
    """
    _check_files(folder)
    about = _about(folder)
    tables = {table.name: _read(folder, table) for table in (PARTICIPANTS, SESSIONS, TRIALS, RESPONSES, EVENTS)}
    drives = _read(folder, TRAJECTORIES)
    strokes = _read(folder, STROKES)
    try:
        with db.transaction() as s:
            if s.get(Study, about["study"]) is not None:
                raise DatasetError(f"study {about['study']} ({about['name']}) is in this database already")
            _add_study(s, folder, about)
            _add_trajectories(s, files, folder, drives)
            _add_rows(s, about["study"], tables)
            add_strokes(s, files, folder, strokes)
    except KeyError as missing:
        raise DatasetError(f"{folder}: {missing} is missing or names nothing in the data set") from missing
    except StrokeError as problem:
        raise DatasetError(str(problem)) from None
    except IntegrityError as problem:
        raise DatasetError(f"{folder}: its rows do not fit together or are here already ({problem.orig})") from problem
    return {
        "study": about["study"],
        "participants": len(tables[PARTICIPANTS.name]),
        "sessions": len(tables[SESSIONS.name]),
        "responses": len(tables[RESPONSES.name]),
        "trajectories": len(drives),
    }


def _about(folder: Path) -> Row:
    about: Row = _read_json(folder / STUDY_FILE)
    if about.get("format") not in READABLE:
        raise DatasetError(
            f"{STUDY_FILE}: format {about.get('format')!r} is unknown; this version reads {', '.join(READABLE)}"
        )
    return about


def _check_files(folder: Path) -> None:
    """Every file must be listed with its sha256 and every listed one must be there."""
    try:
        lines = (folder / CHECKSUMS_FILE).read_text(encoding="utf-8").splitlines()
    except OSError as problem:
        raise DatasetError(
            f"{folder} is no exported data set: cannot read {CHECKSUMS_FILE} ({problem.strerror})"
        ) from None
    listed = {name: sha for sha, _, name in (line.partition("  ") for line in lines)}
    present = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - {CHECKSUMS_FILE}
    for name in sorted(set(listed) ^ present):
        raise DatasetError(f"{name}: " + ("is missing" if name in listed else f"is not listed in {CHECKSUMS_FILE}"))
    for name, sha in listed.items():
        if hashlib.sha256((folder / name).read_bytes()).hexdigest() != sha:
            raise DatasetError(f"{name}: was changed after the export (its sha256 differs); use an untouched copy")


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        raise DatasetError(f"{path.name}: cannot be read ({problem})") from None


def _read(folder: Path, table: Table) -> list[Row]:
    name = f"{table.name}.parquet"
    try:
        found = pq.read_table(folder / name)
    except (OSError, pa.ArrowException) as problem:
        raise DatasetError(f"{name}: cannot be read ({problem})") from None
    found = found.rename_columns(_todays_names(table, found.column_names))
    for column in table.columns:
        if column.newer and column.name not in found.column_names:
            found = found.append_column(column.name, pa.nulls(len(found), column.type))
        if column.name not in found.column_names or found.schema.field(column.name).type != column.type:
            raise DatasetError(f"{name}: column {column.name!r} ({column.type_name()}) is missing or of another type")
    try:
        rows = [table.unpacked(row) for row in found.to_pylist()]
    except ValueError as problem:
        raise DatasetError(f"{name}: {problem}") from None
    for row in rows:
        if row.get("role") is not None:
            row["role"] = role_of(row["role"])
    return rows


def _todays_names(table: Table, names: list[str]) -> list[str]:
    """Columns of an older data set by the names that they have now."""
    today = {column.former: column.name for column in table.columns if column.former and column.name not in names}
    return [today.get(name, name) for name in names]


def _add_study(s: Session, folder: Path, about: Row) -> None:
    frozen = _read_json(folder / PROTOCOL_FOLDER / "frozen.json")
    protocol_yaml = (folder / PROTOCOL_FOLDER / "protocol.yaml").read_bytes().decode()
    found = protocol_digest(protocol_yaml, frozen["files"])
    expected = _written(about["protocol"])
    if found != expected:
        raise DatasetError(
            f"{PROTOCOL_FOLDER}: protocol.yaml and the files in frozen.json have sha256 {found}, but {STUDY_FILE} says "
            f"{expected}: this is not the protocol that the answers were collected with; use an "
            "untouched copy"
        )
    s.add(
        Study(
            id=about["study"],
            name=about["name"],
            protocol_name=about["protocol"]["name"],
            protocol_version=about["protocol"]["version"],
            protocol_yaml=protocol_yaml,
            protocol=frozen["protocol"],
            files=frozen["files"],
            protocol_hash=about["protocol"]["sha256"],
            state="closed",
            recruiting_token=secrets.token_urlsafe(32),
            seed=about["seed"],
            created_at=datetime.fromisoformat(about["created_at"]),
        )
    )
    s.flush()
    for version in about["protocol_versions"]:
        s.add(_version(folder, about["study"], version))
    for tombstone in about["erased_participants"]:
        at = datetime.fromisoformat(tombstone["erased_at"])
        s.add(
            Tombstone(id=tombstone["tombstone"], study_id=about["study"], erased_at=at, erased_by="imported", counts={})
        )


def _written(about: Row) -> str:
    """sha256 of a protocol as it lies in the data set: without completion codes (formats before 5 had them)."""
    return str(about.get("written_sha256") or about["sha256"])


def _version(folder: Path, study_id: str, about: Row) -> ProtocolVersion:
    name = f"{PROTOCOL_FOLDER}/{about['number']}.json"
    frozen = _read_json(folder / name)
    if protocol_digest(frozen["yaml"], frozen["files"]) != _written(about):
        raise DatasetError(f"{name}: is not the protocol whose sha256 {STUDY_FILE} names; use an untouched copy")
    return ProtocolVersion(
        study_id=study_id,
        number=about["number"],
        protocol_version=about["version"],
        protocol_yaml=frozen["yaml"],
        protocol=frozen["protocol"],
        files=frozen["files"],
        protocol_hash=about["sha256"],
        changes=about["changes"],
        created_at=datetime.fromisoformat(about["created_at"]),
    )


def _add_trajectories(s: Session, files: ArtefactStore, folder: Path, rows: list[Row]) -> None:
    contents: list[bytes] = []
    for row in rows:
        name = f"{TRAJECTORY_FOLDER}/{row['trajectory']}.npz"
        try:
            # The bytes as they came: another machine's compressor may write the same arrays differently.
            content = (folder / name).read_bytes()
            trajectory = Trajectory.from_bytes(content)
        except (OSError, ValueError, KeyError, TypeError, BadZipFile) as problem:
            raise DatasetError(f"{name}: is no trajectory ({problem})") from None
        if hashlib.sha256(content).hexdigest() != row["trajectory"]:
            raise DatasetError(f"{name}: holds another trajectory than its name says")
        contents.append(content)
        if s.get(TrajectoryRow, row["trajectory"]) is None:
            s.add(
                TrajectoryRow(
                    id=row["trajectory"],
                    setup=trajectory.scene.setup,
                    scene_hash=trajectory.scene.digest(),
                    steps=len(trajectory.actions),
                    duration_s=trajectory.duration_s,
                    outcome=int(trajectory.outcome),
                    made_by=row["made_by"],
                    created_at=row["created_at"],
                )
            )
    files.put_all(contents)


def _add_rows(s: Session, study_id: str, tables: dict[str, list[Row]]) -> None:
    people: dict[str, Participant] = {}
    for row in tables[PARTICIPANTS.name]:
        people[row["participant"]] = Participant(
            id=new_id(),
            study_id=study_id,
            code=row["participant"],
            consents=_consents(row),
            **_kept(row, PARTICIPANT_FIELDS),
        )
    s.add_all(people.values())
    s.flush()
    for row in tables[SESSIONS.name]:
        s.add(
            SessionRow(
                id=row["session"],
                participant_id=people[row["participant"]].id,
                study_id=study_id,
                token_hash=secrets.token_hex(32),  # the hash of no token: nobody can enter
                **_kept(row, SESSION_FIELDS),
            )
        )
    s.flush()
    for row in tables[TRIALS.name]:
        s.add(
            Trial(
                id=row["trial"],
                session_id=row["session"],
                step_key=row["step"],
                query_id=row["query"],
                **_kept(row, TRIAL_FIELDS),
            )
        )
    s.flush()
    for row in tables[RESPONSES.name]:
        s.add(
            Response(
                id=row["response"],
                session_id=row["session"],
                trial_id=row["trial"],
                step_key=row["step"],
                kind=row["kind"],
                value=row["value"],
                request_id=f"imported-{row['response']}",
                client_time=row["client_time"],
                decision_s=row["decision_s"],
                consent_id=row["consent"],
                created_at=row["created_at"],
            )
        )
    for row in tables[EVENTS.name]:
        s.add(
            Event(
                at=row["at"],
                study_id=study_id,
                session_id=row["session"],
                trial_id=row["trial"],
                kind=row["kind"],
                client_time=row["client_time"],
                data=row["data"],
            )
        )
        s.flush()  # one by one: their order is their id


def _consents(row: Row) -> Row | None:
    asked = {purpose: row[purpose] for purpose in ("training", "open_data") if row[purpose] is not None}
    return asked or None


def _kept(row: Row, fields: tuple[str, ...]) -> Row:
    return {name: row[name] for name in fields}

"""Brings a data set that lies in a folder into this database, to the same answers. Reading its files is `reading.py`'s.

An imported study is closed and its sessions have no link: it is there to be analysed. Recruiting ids, completion codes,
problem reports and whatever withdrawn participants left were never exported, so they are not there.
"""

from __future__ import annotations

import hashlib
import secrets
from dataclasses import asdict
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session

from desirepath.simulation.recorded import Video
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore, save_artefact
from desirepath.store.database import Database
from desirepath.store.dataset.coding_rows import add_codings
from desirepath.store.dataset.columns import (
    PROTOCOL_FOLDER,
    STUDY_FILE,
    TRAJECTORY_FOLDER,
    VIDEO_ENDINGS,
    VIDEO_FOLDER,
    Table,
    video_name,
)
from desirepath.store.dataset.reading import (
    About,
    AboutProtocol,
    AboutVersion,
    DatasetError,
    Row,
    check_files,
    frozen_in,
    read_about,
    read_tables,
    version_in,
)
from desirepath.store.dataset.stroke_rows import add_strokes
from desirepath.store.dataset.tables import (
    CODEBOOK,
    CODINGS,
    EVENTS,
    HEAD_POSES,
    PARTICIPANTS,
    RESPONSES,
    SESSIONS,
    STROKES,
    TRAJECTORIES,
    TRIALS,
)
from desirepath.store.demonstration_snapshots import StrokeError
from desirepath.store.head_poses import HeadPoseError, add_head_poses
from desirepath.store.models import (
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
from desirepath.store.models import Session as SessionRow
from desirepath.store.plain_data import Unstorable
from desirepath.store.robot_recordings import add_recordings


def import_dataset(db: Database, files: ArtefactStore, folder: Path) -> dict[str, Any]:
    """Load the data set in `folder`; returns {"study", "participants", "sessions", "responses", "trajectories"}.

    Checks every checksum first. Raises DatasetError naming the file if one is missing, changed, added or unreadable, if
    the protocol is not the one whose hash the study carries, or if the study is here already.
    """
    check_files(folder)
    about = read_about(folder)
    read = (PARTICIPANTS, SESSIONS, TRIALS, RESPONSES, EVENTS, TRAJECTORIES, STROKES, HEAD_POSES, CODEBOOK, CODINGS)
    tables = read_tables(folder, read)
    try:
        with db.transaction() as s:
            if s.get(Study, about.study) is not None:
                raise DatasetError(f"study {about.study} ({about.name}) is in this database already")
            _add_study(s, folder, about)
            _add_trajectories(s, files, folder, tables[TRAJECTORIES.name])
            _add_rows(s, about.study, tables)
            add_strokes(s, files, folder, tables[STROKES.name])
            add_head_poses(s, tables[HEAD_POSES.name])
            add_recordings(files, folder, tables[RESPONSES.name])
            add_codings(s, about.study, tables[CODEBOOK.name], tables[CODINGS.name])
    except KeyError as missing:
        raise DatasetError(f"{folder}: {missing} is missing or names nothing in the data set") from missing
    except (StrokeError, HeadPoseError) as problem:
        raise DatasetError(str(problem)) from None
    except Unstorable as problem:
        raise DatasetError(f"{folder}: a value {problem}") from None
    except DBAPIError as problem:  # not StorageError: that is the disk's or the lock's
        raise DatasetError(f"{folder}: its rows do not fit together or are here already ({problem.orig})") from problem
    return {
        "study": about.study,
        "participants": len(tables[PARTICIPANTS.name]),
        "sessions": len(tables[SESSIONS.name]),
        "responses": len(tables[RESPONSES.name]),
        "trajectories": len(tables[TRAJECTORIES.name]),
    }


def _add_study(s: Session, folder: Path, about: About) -> None:
    protocol_yaml, frozen = frozen_in(folder)
    _check_protocol(protocol_yaml, frozen["files"], about.protocol, f"{PROTOCOL_FOLDER}: protocol.yaml and frozen.json")
    s.add(
        Study(
            id=about.study,
            name=about.name,
            protocol_name=about.protocol.name,
            protocol_version=about.protocol.version,
            protocol_yaml=protocol_yaml,
            protocol=frozen["protocol"],
            files=frozen["files"],
            protocol_hash=about.protocol.sha256,
            state="closed",
            recruiting_token=secrets.token_urlsafe(32),
            seed=about.seed,
            created_at=about.created_at,
        )
    )
    s.flush()
    for version in about.protocol_versions:
        s.add(_version(folder, about.study, version))
    for erased in about.erased_participants:
        s.add(
            Tombstone(
                id=erased.tombstone, study_id=about.study, erased_at=erased.erased_at, erased_by="imported", counts={}
            )
        )


def _check_protocol(written: str, files: dict[str, str], about: AboutProtocol, what: str) -> None:
    """What the data set holds must be the protocol whose hash it tells. Raises DatasetError."""
    actual, expected = protocol_digest(written, files), about.written_sha256
    if actual != expected:
        raise DatasetError(
            f"{what} have sha256 {actual}, but {STUDY_FILE} says {expected}: this is not the protocol that the answers "
            "were collected with; use an untouched copy"
        )


def _version(folder: Path, study_id: str, about: AboutVersion) -> ProtocolVersion:
    frozen = version_in(folder, about.number)
    _check_protocol(frozen["yaml"], frozen["files"], about, f"{PROTOCOL_FOLDER}/{about.number}.json: its protocol")
    return ProtocolVersion(
        study_id=study_id,
        number=about.number,
        protocol_version=about.version,
        protocol_yaml=frozen["yaml"],
        protocol=frozen["protocol"],
        files=frozen["files"],
        protocol_hash=about.sha256,
        changes=about.changes,
        created_at=about.created_at,
    )


def _add_trajectories(s: Session, files: ArtefactStore, folder: Path, rows: list[Row]) -> None:
    contents: list[bytes] = []
    for row in rows:
        name = f"{TRAJECTORY_FOLDER}/{row['trajectory']}.npz"
        try:
            # The bytes as they came: another machine's compressor may write the same arrays differently.
            content = (folder / name).read_bytes()
        except OSError as problem:
            raise DatasetError(f"{name}: cannot be read ({problem.strerror})") from None
        if hashlib.sha256(content).hexdigest() != row["trajectory"]:  # before anything of it is unpacked
            raise DatasetError(f"{name}: holds another trajectory than its name says")
        try:
            trajectory = Trajectory.from_bytes(content)
        except (ValueError, KeyError, TypeError, BadZipFile) as problem:
            raise DatasetError(f"{name}: is no trajectory ({problem})") from None
        contents.append(content)
        if (shown := trajectory.recorded.video if trajectory.recorded else None) is not None:
            _add_video(s, files, folder, trajectory.scene.setup, shown)
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


def _add_video(s: Session, files: ArtefactStore, folder: Path, setup: str, shown: Video) -> None:
    name = f"{VIDEO_FOLDER}/{video_name(shown)}"
    try:
        content = (folder / name).read_bytes()
    except OSError as problem:
        raise DatasetError(f"{name}: cannot be read ({problem.strerror})") from None
    if hashlib.sha256(content).hexdigest() != shown.sha256 or shown.media not in VIDEO_ENDINGS:
        raise DatasetError(f"{name}: is another video than its trajectory says")
    card = {"video": asdict(shown), "imported": {"file": name}}
    save_artefact(s, files, kind="video", name=name, setup=setup, content=content, card=card)


def _add_rows(s: Session, study_id: str, tables: dict[str, list[Row]]) -> None:
    people: dict[str, Participant] = {}
    for row in tables[PARTICIPANTS.name]:
        people[row["participant"]] = Participant(
            id=new_id(),
            study_id=study_id,
            code=row["participant"],
            consents=_consents(row),
            **_columns_in(row, PARTICIPANTS, Participant),
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
                plan=row["plan"],
                **_columns_in(row, SESSIONS, SessionRow),
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
                **_columns_in(row, TRIALS, Trial),
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
                request_id=f"imported-{row['response']}",
                consent_id=row["consent"],
                **_columns_in(row, RESPONSES, Response),
            )
        )
    for row in tables[EVENTS.name]:
        s.add(
            Event(
                study_id=study_id, session_id=row["session"], trial_id=row["trial"], **_columns_in(row, EVENTS, Event)
            )
        )
        s.flush()  # one by one: their order is their id


def _consents(row: Row) -> Row | None:
    answered = {purpose: row[purpose] for purpose in ("training", "open_data") if row[purpose] is not None}
    return answered or None


def _columns_in(row: Row, table: Table, model: type[Any]) -> Row:
    return {name: row[name] for name in table.kept_in(model)}

"""Recordings of robots' runs: which there are, whose, into a data set and back. What one holds is
`deploy/recorder.py`'s."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.dataset.columns import IS_SHA
from desirepath.store.demonstration_snapshots import StrokeError
from desirepath.store.models import Response, RobotRun, StudyRobot

KIND = "robot_drive"
FOLDER = "recordings"


def recordings_of(s: Session, sessions: Collection[str] | None = None) -> set[str]:
    """sha256 of every recording, of those sessions alone where they are given. An imported data set has answers that
    name them and no runs."""
    runs = select(RobotRun.recording).where(RobotRun.recording.is_not(None))
    answers = select(Response.value).where(Response.kind == KIND)
    if sessions is not None:
        runs, answers = runs.where(RobotRun.session_id.in_(sessions)), answers.where(Response.session_id.in_(sessions))
    named = {value.get("recording") for value in s.scalars(answers)}
    return {str(sha) for sha in {*s.scalars(runs), *named} if sha}


def write_recordings(s: Session, files: ArtefactStore, sessions: Collection[str], out: Path) -> None:
    """Every recording of those sessions, named by its sha256, into the data set's folder `out`."""
    for sha in sorted(recordings_of(s, sessions)):
        (out / FOLDER).mkdir(exist_ok=True)
        (out / FOLDER / f"{sha}.mcap").write_bytes(files.get(sha))


def add_recordings(files: ArtefactStore, folder: Path, answers: Iterable[dict[str, Any]]) -> None:
    """Take in the recordings that imported answers name. Raises StrokeError for a file of another name or none."""
    for row in answers:
        sha = row["value"].get("recording") if row["kind"] == KIND else None
        if sha is None:
            continue
        if not isinstance(sha, str) or not IS_SHA.fullmatch(sha):
            raise StrokeError(f"responses.parquet: value: recording = {str(sha)[:80]!r} is no sha256")
        name = f"{FOLDER}/{sha}.mcap"
        try:
            content = (folder / name).read_bytes()
        except OSError as problem:
            raise StrokeError(f"{name}: cannot be read ({problem.strerror})") from None
        if hashlib.sha256(content).hexdigest() != sha:
            raise StrokeError(f"{name}: holds another recording than its name says")
        files.put(content)


def delete_runs(s: Session, sessions: Collection[str]) -> None:
    """Erase the runs of those sessions; robots that stood ready hear that there is none."""
    theirs = select(RobotRun.robot_id).where(RobotRun.session_id.in_(sessions), RobotRun.robot_id.is_not(None))
    s.execute(update(StudyRobot).where(StudyRobot.id.in_(theirs)).values(number=StudyRobot.number + 1, person=None))
    s.execute(delete(RobotRun).where(RobotRun.session_id.in_(sessions)))

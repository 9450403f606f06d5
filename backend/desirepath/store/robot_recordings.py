"""Recordings of robots' runs and of voices: which there are, whose, into a data set and back. What a robot's holds is
`deploy/recorder.py`'s, how a voice comes in `study/voices.py`'s."""

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
from desirepath.store.models import Event, Response, RobotRun, StudyRobot

VOICE, VOICE_EVENT = "think_aloud", "voice_recorded"
ENDINGS = {"robot_drive": "mcap", VOICE: "webm"}
"""Kind of answer that names a recording -> the ending of its file."""
FOLDER = "recordings"


def recordings_of(s: Session, sessions: Collection[str] | None = None) -> set[str]:
    """sha256 of every recording, of those sessions alone where they are given. An imported data set has answers that
    name them and no runs; a voice is there before it is answered."""
    runs = select(RobotRun.recording).where(RobotRun.recording.is_not(None))
    answers = select(Response.value).where(Response.kind.in_(ENDINGS))
    spoken = select(Event.session_id, Event.data).where(Event.kind == VOICE_EVENT).order_by(Event.id)
    if sessions is not None:
        runs, answers = runs.where(RobotRun.session_id.in_(sessions)), answers.where(Response.session_id.in_(sessions))
        spoken = spoken.where(Event.session_id.in_(sessions))
    newest = {(whose, told.get("step")): told.get("recording") for whose, told in s.execute(spoken)}
    named = {value.get("recording") for value in s.scalars(answers)}
    return {str(sha) for sha in {*s.scalars(runs), *named, *newest.values()} if sha}


def write_recordings(
    s: Session, files: ArtefactStore, sessions: Collection[str], out: Path, *, voices: bool = True
) -> None:
    """Every recording of those sessions that answers or runs name, by its sha256, into the data set's folder `out`.
    voices: those, too, by which people can be known."""
    rows = select(Response.value).where(Response.kind == VOICE, Response.session_id.in_(sessions))
    spoken = {value.get("recording") for value in s.scalars(rows)}
    began = select(Event.data).where(Event.kind == VOICE_EVENT, Event.session_id.in_(sessions))
    unkept = {told.get("recording") for told in s.scalars(began)} - spoken  # never answered
    for sha in sorted(recordings_of(s, sessions) - unkept):
        if sha in spoken and not voices:
            continue
        (out / FOLDER).mkdir(exist_ok=True)
        (out / FOLDER / f"{sha}.{'webm' if sha in spoken else 'mcap'}").write_bytes(files.get(sha))


def add_recordings(files: ArtefactStore, folder: Path, answers: Iterable[dict[str, Any]]) -> None:
    """Take in the recordings that imported answers name; voices may have been left out. Raises StrokeError for a file
    of another name or none."""
    for row in answers:
        sha = row["value"].get("recording") if row["kind"] in ENDINGS else None
        if sha is None:
            continue
        if not isinstance(sha, str) or not IS_SHA.fullmatch(sha):
            raise StrokeError(f"responses.parquet: value: recording = {str(sha)[:80]!r} is no sha256")
        name = f"{FOLDER}/{sha}.{ENDINGS[row['kind']]}"
        if row["kind"] == VOICE and not (folder / name).is_file():
            continue
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

"""A voice as a browser records it: parts come in one after the other and make one file in the artefact store.

What is there of which step is the newest event `voice_recorded`; what the store does with it (export, erasure, backup)
is `store/robot_recordings.py`'s.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.events import log_event
from desirepath.store.models import Artefact, Event, Session, TrajectoryRow
from desirepath.store.robot_recordings import VOICE_EVENT
from desirepath.study.refusals import Refused

LARGEST_PART = 192 * 1024  # bytes (ours); five seconds have some 20 kB
BYTES_PER_MINUTE = 960 * 1024  # ours: 128 kbit/s, four times what pages ask the browser for
LATE_S = 60.0  # ours: how long after the protocol's minutes a last part is taken
EBML = b"\x1a\x45\xdf\xa3"
PICTURES = (b"V_VP8", b"V_VP9", b"V_AV1", b"V_MPEG", b"V_MJPEG", b"V_THEORA")


@dataclass(frozen=True)
class Voice:
    """What there is of one step. part: the number of the last one; seconds: from the first part to it."""

    sha: str | None
    bytes: int
    part: int
    began: datetime
    seconds: float


def voice_of(s: DatabaseSession, session: Session, step_key: str) -> Voice | None:
    """What was recorded at that step; None: nothing ever."""
    rows = select(Event).where(Event.session_id == session.id, Event.kind == VOICE_EVENT).order_by(Event.id.desc())
    newest = next((event for event in s.scalars(rows) if event.data.get("step") == step_key), None)
    if newest is None:
        return None
    told = newest.data
    began = datetime.fromisoformat(told["began"])
    return Voice(told["recording"], told["bytes"], told["part"], began, told["seconds"])


def add_part(
    s: DatabaseSession,
    files: ArtefactStore,
    session: Session,
    step_key: str,
    minutes: int,
    part: int,
    content: bytes,
    now: datetime,
) -> tuple[Voice, str | None]:
    """Add a part; the first begins a new recording. Returns what there is then, and the file that it replaces, to be
    deleted once this is committed. A part that came before changes nothing. Raises Refused."""

    def refuse(code: str, message: str, status: int = 422) -> Refused:
        return Refused(status, code, message, session_id=session.id, study_id=session.study_id)

    if not 0 < len(content) <= LARGEST_PART:
        raise refuse("bad_value", f"a part must have 1 to {LARGEST_PART} bytes, has {len(content)}")
    before = voice_of(s, session, step_key)
    there = before if before is not None and before.sha else None
    if part == 0:
        if not is_webm_opus(content):
            raise refuse("bad_value", "the first part must begin a WebM file with Opus audio and no picture")
        whole, began = content, now
    else:
        if there is None or part > there.part + 1:
            expected = 0 if there is None else there.part + 1
            raise refuse("out_of_order", f"part {part} came, part {expected} was expected", 409)
        if part <= there.part:
            return there, None
        began = there.began
        if (now - began).total_seconds() > 60.0 * minutes + LATE_S:
            raise refuse("too_long", f"a recording here is at most {minutes} minutes long", 409)
        if there.bytes + len(content) > minutes * BYTES_PER_MINUTE:
            raise refuse("too_large", f"a recording here has at most {minutes * BYTES_PER_MINUTE} bytes", 413)
        whole = files.get(there.sha or "") + content
    sha = files.put(whole)
    seconds = round((now - began).total_seconds(), 1)
    voice = Voice(sha, len(whole), part, began, seconds)
    _note(s, session, step_key, voice)
    replaced = there.sha if there is not None and there.sha != sha else None
    return voice, None if replaced is None or _is_used(s, session, replaced) else replaced


def forget(s: DatabaseSession, files: ArtefactStore, session: Session, step_key: str) -> None:
    """Delete what was recorded at that step."""
    voice = voice_of(s, session, step_key)
    if voice is not None and voice.sha:
        if not _is_used(s, session, voice.sha):
            files.delete(voice.sha)
        _note(s, session, step_key, Voice(None, 0, voice.part, voice.began, 0.0))


def _is_used(s: DatabaseSession, session: Session, sha: str) -> bool:
    """Whether a file of these bytes is anybody else's, too."""
    kept = s.get(Artefact, sha) is not None or s.get(TrajectoryRow, sha) is not None
    others = select(Event.id).where(Event.kind == VOICE_EVENT, Event.session_id != session.id)
    return kept or s.scalar(others.where(Event.data["recording"].as_string() == sha).limit(1)) is not None


def is_webm_opus(content: bytes) -> bool:
    """Whether these bytes begin a WebM file whose one track is Opus audio."""
    head = content[:512]  # tracks are named before the first sound
    pictures = any(codec in head for codec in PICTURES)
    return head.startswith(EBML) and b"webm" in head[:64] and b"A_OPUS" in head and not pictures


def _note(s: DatabaseSession, session: Session, step_key: str, voice: Voice) -> None:
    log_event(
        s,
        VOICE_EVENT,
        session_id=session.id,
        step=step_key,
        recording=voice.sha,
        bytes=voice.bytes,
        part=voice.part,
        began=voice.began.isoformat(),
        seconds=voice.seconds,
    )
    s.flush()

"""Drawing: what becomes of the paths that a participant draws at a step of kind `demonstration`.

Every stroke is stored, whatever comes of it. One that can be driven is driven on the stage, watched by the server's
clock, and then kept (the step's answer) or drawn again. How a stroke becomes a drive is `backend.demonstrations`'s;
which step comes next is `machine.py`'s, which calls `keep` when the answer is stored.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.artefacts import ArtefactStore, save_trajectory
from backend.store.events import log_event
from backend.store.models import Session, StrokeRow, TrajectoryRow
from backend.study.refusals import Refused
from backend.study.words import DRAWN_KINDS, TOLERANCE_S

if TYPE_CHECKING:
    from backend.demonstrations.demonstration import Demonstration
    from backend.simulation.scene import Scene

Step = dict[str, Any]
MOST_POINTS = 4_000  # as client/draw.js
MOST_ATTEMPTS = 60  # ours, per step: who needs more is better served by a pause
POINTERS = frozenset({"mouse", "touch", "pen", "keys", "bot"})


@dataclass(frozen=True)
class Showing:
    """A drive that has to be shown now."""

    trajectory: str
    view: str
    playback_id: str


@dataclass(frozen=True)
class Attempt:
    """A stroke as it came, and what can be made of it: either a demonstration or the problem with it."""

    drawn: dict[str, Any]
    pointer: str
    demonstration: Demonstration | None
    problem: dict[str, Any] | None


# ---- reading ---------------------------------------------------------------------------------------------------------


def scene_of(step: Step) -> Scene:
    """The scene that a step's path is drawn in."""
    from backend.simulation.demonstration_scenes import demonstration_scene  # numba comes with it

    return demonstration_scene(step["environment"], step["pair"])


def latest_stroke(s: DatabaseSession, session_id: str, step_key: str) -> StrokeRow | None:
    """The newest stroke of a step."""
    mine = select(StrokeRow).where(StrokeRow.session_id == session_id, StrokeRow.step_key == step_key)
    return s.scalars(mine.order_by(StrokeRow.attempt.desc()).limit(1)).first()


def kept_strokes(s: DatabaseSession, session_id: str, step: Step) -> Sequence[StrokeRow]:
    """What the participant kept in the situation of that step, in order."""
    mine = select(StrokeRow).where(
        StrokeRow.session_id == session_id,
        StrokeRow.environment == step["environment"],
        StrokeRow.pair == step["pair"],
        StrokeRow.state == "kept",
    )
    return s.scalars(mine.order_by(StrokeRow.created_at)).all()


def playback_id(stroke: StrokeRow) -> str:
    """Names one showing of a stroke's drive; another one whenever it begins again."""
    return hashlib.sha256(f"{stroke.id}:{stroke.shown_since}".encode()).hexdigest()[:24]


def showing(stroke: StrokeRow | None) -> Showing | None:
    """What the stage drives now, None if nothing."""
    if stroke is None or stroke.shown_since is None or stroke.trajectory is None:
        return None
    return Showing(stroke.trajectory, stroke.view, playback_id(stroke))


def state_of(s: DatabaseSession, session: Session, step: Step) -> dict[str, Any]:
    """What a page is told of a drawing: `phase` drawing, ready (drawn, waits to be driven), driving or watched."""
    stroke = latest_stroke(s, session.id, step["key"])
    phase = "drawing"
    if stroke is not None and stroke.state in ("drawn", "watched"):
        phase = "driving" if stroke.shown_since is not None else "ready" if stroke.state == "drawn" else "watched"
    going = stroke is not None and phase != "drawing"
    drive = s.get(TrajectoryRow, stroke.trajectory) if going and stroke is not None and stroke.trajectory else None
    shown = showing(stroke)
    return {
        "phase": phase,
        "stroke": stroke.id if going and stroke is not None else None,
        "duration_s": drive.duration_s if drive is not None else None,
        "playback_id": shown.playback_id if shown else None,
        "may_skip": bool(step.get("optional")),
        "attempts": stroke.attempt if stroke is not None else 0,
    }


# ---- a stroke comes in -----------------------------------------------------------------------------------------------


def attempt_of(step: Step, given: Mapping[str, Any], *, simulated: bool) -> Attempt:
    """Turn what was sent into a demonstration, or say kindly why not; touches no table (about 0.1 s).

    Raises Refused for what is no stroke at all.
    """
    from backend.demonstrations.demonstration import demonstration_from  # numba comes with it
    from backend.demonstrations.stroke import Stroke, StrokeProblem

    drawn = {name: given.get(name) for name in ("points", "speeds", "times_s")}
    pointer = str(given.get("pointer", "mouse"))
    if not set(pointer.split("+")) <= POINTERS or ("bot" in pointer.split("+") and not simulated):
        raise Refused(422, "bad_value", "must be mouse, touch, pen or keys, or several with +", field="pointer")
    if not isinstance(drawn["points"], list) or not len(drawn["points"]) <= MOST_POINTS:
        raise Refused(422, "bad_value", f"must be a list of at most {MOST_POINTS} points", field="points")
    try:
        stroke = Stroke.of(**drawn)
        made = demonstration_from(stroke, scene_of(step))
    except StrokeProblem as problem:
        if problem.code == "unreadable":
            raise Refused(422, "bad_value", str(problem), field="points") from None
        told = {"code": problem.code, "message": str(problem), "thing": problem.thing, **problem.numbers}
        return Attempt(stroke.as_dict(), pointer, None, told | {"at": list(problem.at) if problem.at else None})
    return Attempt(stroke.as_dict(), pointer, made, None)


def add_stroke(
    s: DatabaseSession,
    files: ArtefactStore,
    session: Session,
    step: Step,
    attempt: Attempt,
    *,
    request_id: str,
    client_time: datetime | None,
    now: datetime,
) -> StrokeRow:
    """Store a stroke; one that can be driven begins to be. The same request again gives the same row."""
    known = s.scalars(select(StrokeRow).where(StrokeRow.request_id == request_id)).first()
    if known is not None:
        if known.session_id != session.id or known.step_key != step["key"]:
            raise _refused(session, "request_id_used", "This request id belongs to another stroke.")
        return known
    before = latest_stroke(s, session.id, step["key"])
    if before is not None and before.state in ("drawn", "watched"):
        raise _refused(session, "drawn_already", "Keep the path that you drew, or take it back first.")
    number = before.attempt + 1 if before is not None else 1
    if number > MOST_ATTEMPTS:
        raise _refused(session, "too_many_strokes", f"At most {MOST_ATTEMPTS} paths can be tried here.")
    made = attempt.demonstration
    stroke = StrokeRow(
        session_id=session.id,
        step_key=step["key"],
        attempt=number,
        environment=step["environment"],
        pair=step["pair"],
        view=step["view"],
        pointer=attempt.pointer,
        drawn=attempt.drawn,
        state="refused" if made is None else "drawn",
        problem=attempt.problem,
        request_id=request_id,
        client_time=client_time,
        created_at=now,
    )
    if made is not None:
        stroke.trajectory = save_trajectory(s, files, made.trajectory).id
        stroke.demonstration = files.put(made.to_bytes())
        stroke.shown_since = now
    s.add(stroke)
    s.flush()
    _log(s, session, stroke, "stroke_drawn", client_time=client_time, code=(attempt.problem or {}).get("code"))
    return stroke


# ---- watched, taken back, kept ---------------------------------------------------------------------------------------


def drive(s: DatabaseSession, session: Session, step: Step, *, now: datetime) -> StrokeRow:
    """Let the robot drive the drawn path (again)."""
    stroke = _current(s, session, step)
    if stroke.shown_since is None:
        stroke.shown_since = now
        _log(s, session, stroke, "stroke_shown")
    return stroke


def driven(s: DatabaseSession, session: Session, step: Step, playback: str | None, *, now: datetime) -> StrokeRow:
    """The drive was watched to its end, by the server's clock too; simulated sessions need not watch."""
    stroke = _current(s, session, step)
    if stroke.shown_since is None:
        return stroke  # told twice
    if not session.simulated:
        if playback != playback_id(stroke):
            raise _refused(session, "other_playback", "This is not the drive that is being shown.")
        elapsed = (now - stroke.shown_since).total_seconds()
        needed = s.get_one(TrajectoryRow, stroke.trajectory).duration_s
        if elapsed < needed - TOLERANCE_S:
            told = f"The drive takes {needed:.1f} s and began {elapsed:.1f} s ago."
            raise _refused(session, "too_early", told, elapsed_s=round(elapsed, 2), needed_s=round(needed, 2))
    stroke.state, stroke.shown_since, stroke.watched_at = "watched", None, stroke.watched_at or now
    _log(s, session, stroke, "stroke_watched")
    return stroke


def interrupted(s: DatabaseSession, session: Session, step: Step, *, reason: str) -> bool:
    """A drive was not seen to its end (reload, hidden tab, lost picture): it can be begun again, nothing is lost.

    Returns whether anything was being driven.
    """
    stroke = latest_stroke(s, session.id, step["key"])
    if stroke is None or stroke.shown_since is None:
        return False
    stroke.shown_since = None
    _log(s, session, stroke, "stroke_interrupted", reason=reason)
    return True


def redraw(s: DatabaseSession, session: Session, step: Step) -> StrokeRow:
    """Take the drawn path back; it stays stored, marked."""
    stroke = _current(s, session, step)
    stroke.state, stroke.shown_since = "redone", None
    _log(s, session, stroke, "stroke_redone")
    return stroke


def keep(s: DatabaseSession, session: Session, step: Step, value: Mapping[str, Any]) -> None:
    """The answer to the step is being stored: mark its stroke as kept. Raises Refused for one that was not watched."""
    if value.get("skipped"):
        stroke = latest_stroke(s, session.id, step["key"])
        if stroke is not None and stroke.state in ("drawn", "watched"):
            stroke.state, stroke.shown_since = "redone", None
        return
    stroke = _current(s, session, step)
    if stroke.id != value["stroke"]:
        raise _refused(session, "other_stroke", "This is not the path that was drawn last.")
    if stroke.state != "watched" and not session.simulated:
        raise _refused(session, "too_early", "Please watch the robot drive it first.")
    stroke.state, stroke.shown_since = "kept", None
    _log(s, session, stroke, "stroke_kept")


def wanted(s: DatabaseSession, session: Session, step: Step) -> bool:
    """Whether a step still asks for a path: further ones of a situation only until one of them was skipped."""
    if not step.get("optional"):
        return True
    missing: int = step["number"] - 1 - kept_count(s, session.id, step)
    return missing <= 0


def kept_count(s: DatabaseSession, session_id: str, step: Step) -> int:
    """How many paths were kept in the situation of that step."""
    counted = select(func.count(StrokeRow.id)).where(
        StrokeRow.session_id == session_id,
        StrokeRow.environment == step["environment"],
        StrokeRow.pair == step["pair"],
        StrokeRow.state == "kept",
    )
    return s.scalar(counted) or 0


def _current(s: DatabaseSession, session: Session, step: Step) -> StrokeRow:
    """The stroke of the step that can be driven."""
    if step["kind"] not in DRAWN_KINDS:
        raise _refused(session, "not_current_step", "The session is at another step.")
    stroke = latest_stroke(s, session.id, step["key"])
    if stroke is None or stroke.state not in ("drawn", "watched"):
        raise _refused(session, "nothing_drawn", "There is no path here yet.")
    return stroke


def _log(
    s: DatabaseSession,
    session: Session,
    stroke: StrokeRow,
    kind: str,
    *,
    client_time: datetime | None = None,
    **data: Any,
) -> None:
    told = {name: value for name, value in data.items() if value is not None}
    log_event(
        s,
        kind,
        session_id=session.id,
        client_time=client_time,
        step=stroke.step_key,
        stroke=stroke.id,
        attempt=stroke.attempt,
        **told,
    )


def _refused(session: Session, code: str, message: str, **details: Any) -> Refused:
    return Refused(409, code, message, session_id=session.id, study_id=session.study_id, **details)

"""Drawing: what becomes of the paths that a participant draws at a step of kind `demonstration`.

Every stroke is stored, whatever comes of it. One that can be driven is rolled out on the stage, watched by the server's
clock, and then kept (the step's answer) or drawn again. How a stroke becomes a trajectory is
`demonstrations`'s; how the person walks meanwhile `walks.py`'s; how all that is read again `paths.py`'s; which
step comes next is `machine.py`'s, which calls `keep` when the answer is stored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.words import TOLERANCE_S
from desirepath.store.artefacts import ArtefactStore, save_trajectory
from desirepath.store.events import log_event
from desirepath.store.models import Session, StrokeRow, TrajectoryRow
from desirepath.study.clock import elapsed_s
from desirepath.study.drawing import walks
from desirepath.study.drawing.paths import has_met_person, is_walked, latest_stroke, playback_id, scene_of
from desirepath.study.drawing.walks import PathStep, Walked
from desirepath.study.refusals import Refused

if TYPE_CHECKING:
    from desirepath.demonstrations.demonstration import Demonstration

MOST_POINTS = 4_000  # ours; the stage is told
MOST_ATTEMPTS = 60  # ours, per step: who needs more is better served by a pause
HANDS = frozenset({"controller", "hand", "gaze"})  # with a headset
POINTERS = HANDS | {"mouse", "touch", "pen", "keys", "bot"}


@dataclass(frozen=True)
class Attempt:
    """A stroke as it came, and what can be made of it: either a demonstration or the problem with it.

    walk: that it was drawn for, as it is stored. headset: with what it was drawn, None: in the window.
    """

    drawn: dict[str, Any]
    pointer: str
    walk: dict[str, Any] | None
    demonstration: Demonstration | None
    problem: dict[str, Any] | None
    headset: dict[str, Any] | None = None


# ---- a stroke comes in -----------------------------------------------------------------------------------------------


def attempt_of(step: PathStep, sent: Mapping[str, Any], *, simulated: bool) -> Attempt:
    """Turn what was sent into a demonstration, or say kindly why not; touches no table (about 0.1 s).

    Raises Refused for what is no stroke at all.
    """
    from desirepath.demonstrations.demonstration import demonstration_from  # numba comes with it
    from desirepath.demonstrations.stroke import Stroke, StrokeProblem

    walk = walks.choose_walk(step, sent)
    drawn = {name: sent.get(name) for name in ("points", "speeds", "times_s")}
    pointer = str(sent.get("pointer", "mouse"))
    if not set(pointer.split("+")) <= POINTERS or ("bot" in pointer.split("+") and not simulated):
        message = "must be mouse, touch, pen, keys, controller, hand or gaze, or several with +"
        raise Refused(422, "bad_value", message, field="pointer")
    inside = step.view == "immersive" and set(pointer.split("+")) <= HANDS
    headset = sent.get("headset") if inside else None
    if not isinstance(drawn["points"], list) or not len(drawn["points"]) <= MOST_POINTS:
        raise Refused(422, "bad_value", f"must be a list of at most {MOST_POINTS} points", field="points")
    try:
        stroke = Stroke.of(**drawn)
        demonstration = demonstration_from(stroke, walks.scene_with(scene_of(step), walk))
    except StrokeProblem as problem:
        if problem.code == "unreadable":
            raise Refused(422, "bad_value", str(problem), field="points") from None
        return Attempt(stroke.as_dict(), pointer, walk, None, walks.problem_of(problem), headset)
    return Attempt(stroke.as_dict(), pointer, walk, demonstration, None, headset)


def add_stroke(
    s: DatabaseSession,
    files: ArtefactStore,
    session: Session,
    step: PathStep,
    attempt: Attempt,
    *,
    request_id: str,
    client_time: datetime | None,
    now: datetime,
    must_wear: bool = False,
) -> StrokeRow:
    """Store a stroke; one that can be driven begins to be. The same request again gives the same row.

    must_wear: one that was drawn without a headset does not count.
    """
    known = _find_known(s, session, step, request_id)
    if known is not None:
        return known
    before = latest_stroke(s, session.id, step.key)
    if before is not None and before.state in ("drawn", "watched"):
        raise _refused(session, "drawn_already", "Keep the path that you drew, or take it back first.")
    if must_wear and step.view == "immersive" and attempt.headset is None:
        raise _refused(session, "headset_required", "This is to be drawn with a headset.")
    stroke = _new(session, step, before, attempt.drawn, attempt.pointer, request_id, now)
    stroke.walk, stroke.problem, stroke.client_time = attempt.walk, attempt.problem, client_time
    _note_headset(stroke, "drawn", attempt.headset)
    demonstration = attempt.demonstration
    if demonstration is None:
        stroke.state, stroke.shown_since = "refused", None
    else:
        stroke.trajectory = save_trajectory(s, files, demonstration.trajectory).id
        if not is_walked(step, stroke):
            stroke.demonstration = files.put(demonstration.to_bytes())
    s.add(stroke)
    s.flush()
    _log(s, session, stroke, "stroke_drawn", client_time=client_time, code=(attempt.problem or {}).get("code"))
    return stroke


def _note_headset(stroke: StrokeRow, what: str, headset: dict[str, Any] | None) -> None:
    stroke.headset = {**(stroke.headset or {}), what: headset}
    stroke.hmd = all(stroke.headset.values())


def _find_known(s: DatabaseSession, session: Session, step: PathStep, request_id: str) -> StrokeRow | None:
    """The stroke that the same request made before."""
    known = s.scalars(select(StrokeRow).where(StrokeRow.request_id == request_id)).first()
    if known is not None and (known.session_id != session.id or known.step_key != step.key):
        raise _refused(session, "request_id_used", "This request id belongs to another stroke.")
    return known


def _new(
    session: Session,
    step: PathStep,
    before: StrokeRow | None,
    drawn: dict[str, Any],
    pointer: str,
    request_id: str,
    now: datetime,
) -> StrokeRow:
    """A stroke after the one `before` that is driven from now on."""
    number = before.attempt + 1 if before is not None else 1
    if number > MOST_ATTEMPTS:
        raise _refused(session, "too_many_strokes", f"At most {MOST_ATTEMPTS} paths can be tried here.")
    return StrokeRow(
        session_id=session.id,
        step_key=step.key,
        attempt=number,
        environment=step.environment,
        pair=step.pair,
        view=step.view,
        pointer=pointer,
        drawn=drawn,
        state="drawn",
        shown_since=now,
        request_id=request_id,
        created_at=now,
    )


# ---- watched, taken back, kept ---------------------------------------------------------------------------------------


def roll_out(s: DatabaseSession, session: Session, step: PathStep, *, now: datetime) -> StrokeRow:
    """Let the robot drive the drawn path (again)."""
    stroke = _current(s, session, step)
    if stroke.shown_since is None:
        stroke.shown_since = now
        _log(s, session, stroke, "stroke_shown")
    return stroke


def mark_watched(
    s: DatabaseSession,
    files: ArtefactStore,
    session: Session,
    step: PathStep,
    playback: str | None,
    walked: Walked | None = None,
    *,
    now: datetime,
    headset: dict[str, Any] | None = None,
    must_wear: bool = False,
) -> StrokeRow:
    """The trajectory was watched to its end, by the server's clock too; simulated sessions need not watch.

    headset: with what, None: in the window. must_wear: the first time without one does not count.

    walked: what the participant walked beside it, where they do; a trajectory that met them is refused, and its walk
    kept.
    """
    stroke = latest_stroke(s, session.id, step.key)
    if stroke is not None and has_met_person(stroke):
        return stroke  # reported twice
    stroke = _current(s, session, step)
    if stroke.shown_since is None:
        return stroke  # reported twice
    if not session.simulated and playback != playback_id(stroke):
        raise _refused(session, "other_playback", "This is not the trajectory that is being shown.")
    needed = s.get_one(TrajectoryRow, stroke.trajectory).duration_s
    if is_walked(step, stroke):
        if walked is None:
            raise _refused(session, "not_walked", "Walk beside the robot first.")
        if walked.demonstration is not None and walked.duration_s < needed - TOLERANCE_S:
            message = f"The trajectory takes {needed:.1f} s, the walk ends after {walked.duration_s:.1f} s."
            raise _refused(session, "not_walked", message, walked_s=round(walked.duration_s, 2))
        needed = min(needed, walked.duration_s)
    if not session.simulated:
        elapsed = elapsed_s(stroke.shown_since, now)
        if elapsed is not None and elapsed < needed - TOLERANCE_S:
            message = f"The trajectory takes {needed:.1f} s and began {elapsed:.1f} s ago."
            raise _refused(session, "too_early", message, elapsed_s=round(elapsed, 2), needed_s=round(needed, 2))
    if stroke.watched_at is None:
        worn = headset if step.view == "immersive" else None
        if must_wear and worn is None and step.view == "immersive":
            raise _refused(session, "headset_required", "This is to be watched with a headset.")
        _note_headset(stroke, "watched", worn)
    if walked is not None and is_walked(step, stroke):
        _add_walk(s, files, session, stroke, walked)
    stroke.shown_since, stroke.watched_at = None, stroke.watched_at or now
    if stroke.state != "refused":
        stroke.state = "watched"
        _log(s, session, stroke, "stroke_watched")
    return stroke


def _add_walk(s: DatabaseSession, files: ArtefactStore, session: Session, stroke: StrokeRow, walked: Walked) -> None:
    """The walk stays with its stroke; what both make together takes the place of the trajectory alone."""
    stroke.walk, stroke.problem = walked.stored, walked.problem
    demonstration = walked.demonstration
    if demonstration is None:
        stroke.state = "refused"
    else:
        stroke.trajectory = save_trajectory(s, files, demonstration.trajectory).id
        stroke.demonstration = files.put(demonstration.to_bytes())
    _log(s, session, stroke, "stroke_walked", code=(walked.problem or {}).get("code"))


def walk_again(s: DatabaseSession, session: Session, step: PathStep, *, request_id: str, now: datetime) -> StrokeRow:
    """The same path once more, walked beside anew: a stroke of its own, so that the walk before stays stored."""
    known = _find_known(s, session, step, request_id)
    if known is not None:
        return known
    before = latest_stroke(s, session.id, step.key)
    if before is None or not (has_met_person(before) or (before.state == "watched" and step.person == "walks")):
        raise _refused(session, "nothing_walked", "There is no walk here yet.")
    if before.state == "watched":
        before.state, before.shown_since = "redone", None
        _log(s, session, before, "stroke_redone")
    stroke = _new(session, step, before, before.drawn, before.pointer, request_id, now)
    stroke.trajectory = (before.walk or {}).get("beside")
    _note_headset(stroke, "drawn", (before.headset or {}).get("drawn"))
    s.add(stroke)
    s.flush()
    _log(s, session, stroke, "stroke_drawn")
    return stroke


def interrupt(s: DatabaseSession, session: Session, step: PathStep, *, reason: str) -> bool:
    """A trajectory was not seen to its end (reload, hidden tab, lost picture): it can be begun again, nothing is lost.

    Returns whether anything was being driven.
    """
    stroke = latest_stroke(s, session.id, step.key)
    if stroke is None or stroke.shown_since is None:
        return False
    stroke.shown_since = None
    _log(s, session, stroke, "stroke_interrupted", reason=reason)
    return True


def redraw(s: DatabaseSession, session: Session, step: PathStep) -> StrokeRow:
    """Take the drawn path back; it stays stored, marked."""
    stroke = _current(s, session, step)
    stroke.state, stroke.shown_since = "redone", None
    _log(s, session, stroke, "stroke_redone")
    return stroke


def keep(s: DatabaseSession, session: Session, step: PathStep, value: Mapping[str, Any]) -> None:
    """The answer to the step is being stored: mark its stroke as kept. Raises Refused for one that was not watched."""
    if value.get("skipped"):
        stroke = latest_stroke(s, session.id, step.key)
        if stroke is not None and stroke.state in ("drawn", "watched"):
            stroke.state, stroke.shown_since = "redone", None
        return
    stroke = _current(s, session, step)
    if stroke.id != value["stroke"]:
        raise _refused(session, "other_stroke", "This is not the path that was drawn last.")
    if stroke.state != "watched" and (not session.simulated or is_walked(step, stroke)):
        raise _refused(session, "too_early", "Please watch the robot drive it first.")
    stroke.state, stroke.shown_since = "kept", None
    _log(s, session, stroke, "stroke_kept")


def _current(s: DatabaseSession, session: Session, step: PathStep) -> StrokeRow:
    """The stroke of the step that can be driven."""
    stroke = latest_stroke(s, session.id, step.key)
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
    logged = {name: value for name, value in data.items() if value is not None}
    log_event(
        s,
        kind,
        session_id=session.id,
        client_time=client_time,
        step=stroke.step_key,
        stroke=stroke.id,
        attempt=stroke.attempt,
        **logged,
    )


def _refused(session: Session, code: str, message: str, **details: Any) -> Refused:
    return Refused(409, code, message, session_id=session.id, study_id=session.study_id, **details)

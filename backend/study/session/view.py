"""What a session shows now: its step, its trial, which drive plays; and the checks that all changes share.

Every change runs inside a writing transaction with the session locked (`sessions.acting`) and checks what it changes
with a compare-and-set, so that two servers cannot both advance a session.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, cast

from sqlalchemy import CursorResult, func, select, update
from sqlalchemy.orm import Session as DatabaseSession
from sqlalchemy.orm.attributes import set_committed_value

from backend.store.models import Response, Session, TrajectoryRow, Trial
from backend.store.sides import Side, shown_on
from backend.study.drawing import paths
from backend.study.grammar.words import DRAWN_KINDS, LABEL_S, PLAYING, SINGLE_KINDS, TRIAL_KINDS
from backend.study.plan.planning import Step
from backend.study.refusals import Refused
from backend.study.session import appointments, routing
from backend.study.session.pages import drawing_payload, ending_payload, payload_of, trial_payload
from backend.study.session.versions import protocol_of


@dataclass(frozen=True)
class StepView:
    """What a page shows now. `index` counts from 0 over the steps that this person meets in this appointment, `total`
    is how many these will be as far as it is known; `trial`: phase, durations, playback, None where there is none.
    """

    kind: str
    key: str
    index: int
    total: int
    payload: dict[str, Any] = field(default_factory=dict)
    trial: dict[str, Any] | None = None

    def as_dict(self) -> dict[str, Any]:
        """The step as the API tells it: without texts."""
        return {"key": self.key, "kind": self.kind, "index": self.index, "total": self.total, "trial": self.trial}


@dataclass(frozen=True)
class Playback:
    """A drive that has to be played now."""

    trajectory: str
    label: str
    view: str
    playback_id: str


def step_of(session: Session) -> Step:
    """The plan's current step."""
    step: Step = session.plan[session.position]
    return step


def trial_of(s: DatabaseSession, session: Session, step_key: str | None = None) -> Trial | None:
    """The trial of a step, of the current one unless told. Asked for once in a transaction: its session is locked."""
    known: dict[tuple[str, str], Trial] = s.info.setdefault("trials", {})
    key = (session.id, step_key or step_of(session)["key"])
    if key not in known:
        found = s.scalars(select(Trial).where(Trial.session_id == key[0], Trial.step_key == key[1])).first()
        if found is None:
            return None
        known[key] = found
    return known[key]


def playback_id(trial: Trial, side: Side) -> str:
    """Names one showing of one drive; another one after every restart. Says nothing about who watches what."""
    shown = f"{trial.id}:{trial.restarts}:{side}" + (f":{trial.replays}" if trial.replays else "")
    return hashlib.sha256(shown.encode()).hexdigest()[:24]


def playing(trial: Trial | None) -> Playback | None:
    """What the stage plays in this trial now, None if nothing."""
    if trial is None or trial.phase not in PLAYING:
        return None
    side: Side = "a" if trial.phase == "playing_a" else "b"
    trajectory = shown_on(side, trial.trajectory_a, trial.trajectory_b)
    return Playback(trajectory, side.upper() if label_s(trial) else "", trial.view, playback_id(trial, side))


def current(s: DatabaseSession, session: Session, *, now: datetime | None = None) -> StepView:
    """Where the session stands, with the texts of its language. Changes nothing. now: tells whether it is too soon."""
    index, total = _progress(s, session)
    if session.state in ("paused", "withdrawn", "expired"):
        return StepView(session.state, session.state, index, total)
    if session.state == "screened_out":
        payload = ending_payload(protocol_of(s, session), session.language, session.completion_code)
        return StepView("screened_out", "screened_out", index, total, payload)
    if not appointments.is_open(session, now):
        return StepView("too_soon", "too_soon", index, total, appointments.window_of(session))
    step = step_of(session)
    if step["kind"] in DRAWN_KINDS:
        shown = paths.state_of(s, session, step)
        return StepView(step["kind"], step["key"], index, total, drawing_payload(step), shown)
    if step["kind"] in TRIAL_KINDS:
        trial, payload = trial_of(s, session), trial_payload(step)
    else:
        frozen = protocol_of(s, session)
        trial, payload = (
            None,
            payload_of(
                frozen,
                step,
                session.language,
                completion_code=session.completion_code,
                earlier=lambda name: routing.answer_to(s, session, name),
            ),
        )
        if step["kind"] == "appointment":
            payload |= appointments.next_of(s, session)
    return StepView(
        kind=step["kind"],
        key=step["key"],
        index=index,
        total=total,
        payload=payload,
        trial=_trial_state(s, trial) if trial is not None else None,
    )


def _progress(s: DatabaseSession, session: Session) -> tuple[int, int]:
    """How many steps of this appointment lie behind, and how many there will be as far as the answers tell."""
    answered = s.scalar(select(func.count(Response.id)).where(Response.session_id == session.id)) or 0
    end = appointments.end_of(session)
    left = [step for step in session.plan[session.position + 1 : end] if routing.may_come(s, session, step)]
    waits = session.state == "active" and step_of(session)["kind"] == "wait"  # no step of its own to be counted
    return answered, answered + (not waits) + len(left)


def _trial_state(s: DatabaseSession, trial: Trial) -> dict[str, Any]:
    shown = playing(trial)
    return {
        "phase": trial.phase,
        "duration_a_s": duration_s(s, trial, "a"),
        "duration_b_s": duration_s(s, trial, "b"),
        "label_s": label_s(trial),
        "restarts": trial.restarts,
        "replays": trial.replays,
        "next_side": "b" if trial.a_seen_at is not None else "a",
        "playback_id": shown.playback_id if shown else None,
    }


def label_s(trial: Trial) -> float:
    """How long the letter stands before a drive of the trial: one that is shown alone has none."""
    return 0.0 if trial.kind in SINGLE_KINDS else LABEL_S


def duration_s(s: DatabaseSession, trial: Trial, side: Side) -> float:
    """How long a drive of the trial takes."""
    trajectory = shown_on(side, trial.trajectory_a, trial.trajectory_b)
    if trajectory not in _durations_s:
        _durations_s[trajectory] = s.get_one(TrajectoryRow, trajectory).duration_s
    return _durations_s[trajectory]


_durations_s: dict[str, float] = {}  # by the trajectory's sha256, so never stale; one number per trajectory shown


# ---- checks and changes that everything shares -----------------------------------------------------------------------


def require_active(session: Session, now: datetime) -> None:
    """Raise Refused if nothing can be done in the session now."""
    if session.state == "active":
        if appointments.is_open(session, now):
            return
        raise refused(session, 409, "too_soon", "This appointment has not begun yet.", opens_at=str(session.opens_at))
    told = {
        "paused": "The session is paused; go on first.",
        "completed": "This session is finished.",
        "withdrawn": "You have left this study.",
        "expired": "The time in which this session could be continued is over.",
        "screened_out": "This session is finished.",
    }[session.state]
    raise refused(session, 409 if session.state == "paused" else 410, session.state, told)


def current_trial(s: DatabaseSession, session: Session, step_key: str, now: datetime) -> Trial:
    """The trial of the current step, which must be that one."""
    require_active(session, now)
    step = step_of(session)
    if step["key"] != step_key or step["kind"] not in TRIAL_KINDS:
        raise not_current(s, session, step_key)
    trial = trial_of(s, session)
    assert trial is not None  # noqa: S101  made when the step was entered
    return trial


def not_current(s: DatabaseSession, session: Session, step_key: str) -> Refused:
    """Why a step that is not the current one cannot be answered."""
    answered = s.scalars(
        select(Response.id).where(Response.session_id == session.id, Response.step_key == step_key)
    ).first()
    if answered is not None:
        return refused(session, 409, "already_answered", "This step was answered already.", step=step_key)
    if not any(step["key"] == step_key for step in session.plan):
        return refused(session, 404, "unknown_step", "This session has no such step.", asked=step_key[:80])
    return refused(session, 409, "not_current_step", "The session is at another step.", step=step_key)


def set_phase(s: DatabaseSession, trial: Trial, before: str, after: str, now: datetime) -> None:
    """Change a trial's phase if nobody else has."""
    s.flush()
    _compare_and_set(
        s,
        trial,
        update(Trial).where(Trial.id == trial.id, Trial.phase == before).values(phase=after, phase_since=now),
    )
    set_committed_value(trial, "phase", after)
    set_committed_value(trial, "phase_since", now)


def set_position(s: DatabaseSession, session: Session, to: int) -> Sequence[Step]:
    """Advance to step `to` if nobody else has moved the session. Returns the steps that were left."""
    passed = session.plan[session.position : to]
    _compare_and_set(
        s,
        session,
        update(Session).where(Session.id == session.id, Session.position == session.position).values(position=to),
    )
    set_committed_value(session, "position", to)
    return passed


def _compare_and_set(s: DatabaseSession, row: Session | Trial, statement: Any) -> None:
    changed = cast("CursorResult[Any]", s.execute(statement.execution_options(synchronize_session=False)))
    if changed.rowcount != 1:
        session_id = row.id if isinstance(row, Session) else row.session_id
        raise Refused(409, "moved", "The session went on in the meantime.", session_id=session_id)


def refused(
    session: Session, status: int, code: str, message: str, trial: Trial | None = None, **details: Any
) -> Refused:
    """A refusal that names its session."""
    return Refused(
        status,
        code,
        message,
        session_id=session.id,
        study_id=session.study_id,
        trial_id=trial.id if trial is not None else None,
        **details,
    )

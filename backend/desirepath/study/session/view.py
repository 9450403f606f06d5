"""What a session shows now: its step, its trial, which trajectory plays; and the checks that all changes share.

Every change runs inside a writing transaction with the session locked (`finding.acting`); what may change into what is
`states.py`'s.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.words import LABEL_S, PLAYING
from desirepath.store.models import Response, Session, TrajectoryRow, Trial, utc_now
from desirepath.store.sides import Side, shown_on
from desirepath.study.kind import KINDS, Moment, Page, kind_of, read_step
from desirepath.study.links import code_and_way_back, window_of
from desirepath.study.protocol.freezing import FrozenProtocol
from desirepath.study.protocol.outline import minutes_left
from desirepath.study.protocol.schema import Protocol
from desirepath.study.refusals import Refused
from desirepath.study.session import appointments
from desirepath.study.session.versions import protocol_of
from desirepath.study.steps import Step


@dataclass(frozen=True)
class StepView:
    """What a page shows now. `index` counts from 0 over the steps that this person meets in this appointment, `total`
    is how many these will be as far as it is known; `trial`: phase, durations, playback, None where there is none.
    minutes_left: of this appointment; further: all further pairs that may still come counted, since this is one of them
    (`Step.further`); done: the share of its time that lies behind, 0 to 1.
    """

    kind: str
    key: str
    index: int
    total: int
    payload: dict[str, Any] = field(default_factory=dict)
    trial: dict[str, Any] | None = None
    minutes_left: float = 0.0
    further: bool = False
    done: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """The step as the API tells it: without texts."""
        return {"key": self.key, "kind": self.kind, "index": self.index, "total": self.total, "trial": self.trial}


@dataclass(frozen=True)
class Playback:
    """A trajectory that has to be played now; its letter stands for `label_s` before it moves."""

    trajectory: str
    label: str
    label_s: float
    view: str
    playback_id: str


def step_of(session: Session) -> Step:
    """The plan's current step."""
    return read_step(session.plan[session.position])


def trial_of(s: DatabaseSession, session: Session) -> Trial | None:
    """The trial of the current step. Asked for once in a transaction: its session is locked."""
    known: dict[tuple[str, str], Trial] = s.info.setdefault("trials", {})
    key = (session.id, step_of(session).key)
    if key not in known:
        trial = s.scalars(select(Trial).where(Trial.session_id == key[0], Trial.step_key == key[1])).first()
        if trial is None:
            return None
        known[key] = trial
    return known[key]


def playback_id(trial: Trial, side: Side, *, restarts: int | None = None, replays: int | None = None) -> str:
    """Names one showing of one trajectory; another one after every restart. Says nothing about who watches what.
    restarts, replays: of an earlier showing; default as the trial is now."""
    again = trial.replays if replays is None else replays
    shown = f"{trial.id}:{trial.restarts if restarts is None else restarts}:{side}" + (f":{again}" if again else "")
    return hashlib.sha256(shown.encode()).hexdigest()[:24]


def playing(trial: Trial | None) -> Playback | None:
    """What the stage plays in this trial now, None if nothing."""
    if trial is None or trial.phase not in PLAYING:
        return None
    side: Side = "a" if trial.phase == "playing_a" else "b"
    trajectory = shown_on(side, trial.trajectory_a, trial.trajectory_b)
    stands_s = label_s(trial)
    return Playback(trajectory, side.upper() if stands_s else "", stands_s, trial.view, playback_id(trial, side))


def current(s: DatabaseSession, session: Session, *, now: datetime | None = None) -> StepView:
    """Where the session stands, with the texts of its language. Changes nothing. now: tells whether it is too soon."""
    frozen = protocol_of(s, session)
    moment = Moment(s, session, frozen, now or utc_now())
    behind = _progress(moment, frozen.protocol)
    if session.state == "withdrawn":
        return StepView("withdrawn", "withdrawn", payload={"declined": has_declined(s, session)}, **behind)
    if session.state in ("paused", "expired"):
        return StepView(session.state, session.state, **behind)
    if session.state == "screened_out":
        payload = ending_payload(frozen, session.language, session.completion_code)
        return StepView("screened_out", "screened_out", payload=payload, **behind)
    if not appointments.is_open(session, now):
        return StepView("too_soon", "too_soon", payload=window_of(session), **behind)
    step, kind = moment.step, kind_of(moment.step)
    page = Page(frozen, session.language, session.completion_code, moment.answer_to)
    payload = kind.payload(step, page) | kind.payload_now(step, moment)
    trial = trial_of(s, session) if kind.shows == "trajectories" else None
    state = _trial_state(s, trial, step) if trial is not None else kind.state(step, moment)
    return StepView(step.kind, step.key, payload=payload, trial=state, **behind)


def ending_payload(frozen: FrozenProtocol, language: str, completion_code: str | None) -> dict[str, Any]:
    """The payload of the page for somebody whom the study cannot go on with; no title where its words are the
    catalogue's."""
    ending = frozen.protocol.screen_out
    if ending is None:
        return {"title": None, "text": None} | code_and_way_back(completion_code, None)
    return Page(frozen, language).show_text(ending.text) | code_and_way_back(completion_code, ending.return_url)


CONSENTING = [kind.response_kind for kind in KINDS.values() if kind.consents]


def consent_in_force(s: DatabaseSession, session: Session) -> str | None:
    """The id of the participant's newest consent, of whichever appointment."""
    consents = (
        select(Response.id)
        .join(Session, Session.id == Response.session_id)
        .where(Session.participant_id == session.participant_id, Response.kind.in_(CONSENTING))
        .order_by(Response.created_at.desc())
    )
    return s.scalars(consents).first()


def has_declined(s: DatabaseSession, session: Session) -> bool:
    """Whether somebody left before they had consented, so that they answered nothing."""
    return session.state == "withdrawn" and consent_in_force(s, session) is None


def _progress(moment: Moment, protocol: Protocol) -> dict[str, Any]:
    """How much of this appointment lies behind, and how much there will be as far as the answers tell."""
    session, plan = moment.session, moment.plan
    answered = set(moment.s.scalars(select(Response.step_key).where(Response.session_id == session.id)))
    end = appointments.end_of(plan, session.appointment)
    later, further = plan[session.position + 1 : end], moment.step.further
    left = [step for step in later if moment.may_come(step)]
    uncounted = session.state == "active" and kind_of(moment.step).goes_on
    counted = {"index": len(answered), "total": len(answered) + (not uncounted) + len(left)}
    if session.state in ("completed", "screened_out"):
        return counted | {"minutes_left": 0.0, "done": 1.0}
    timed = [step for step in later if step.further or moment.may_come(step)] if further else left
    ahead = minutes_left(protocol, plan, timed if uncounted else [moment.step, *timed])
    behind = minutes_left(protocol, plan, [step for step in plan if step.key in answered])
    return counted | {"minutes_left": ahead, "further": further, "done": behind / max(behind + ahead, 0.01)}


def _trial_state(s: DatabaseSession, trial: Trial, step: Step) -> dict[str, Any]:
    shown = playing(trial)
    return {
        "phase": trial.phase,
        "duration_a_s": duration_s(s, trial, "a"),
        "duration_b_s": duration_s(s, trial, "b"),
        "label_s": label_s(trial),
        "restarts": trial.restarts,
        "replays": trial.replays,
        "worn": step.worn,
        "next_side": "b" if trial.a_seen_at is not None else "a",
        "playback_id": shown.playback_id if shown else None,
    }


def label_s(trial: Trial) -> float:
    """How long the letter stands before a trajectory of the trial: one that is shown alone has none."""
    return 0.0 if shows_one(trial) else LABEL_S


def shows_one(trial: Trial) -> bool:
    """Whether the trial shows one trajectory, not two."""
    return any(kind.trajectories == 1 and kind.name == trial.kind for kind in KINDS.values())


def duration_s(s: DatabaseSession, trial: Trial, side: Side) -> float:
    """How long a trajectory of the trial takes."""
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
        raise refusal(session, 409, "too_soon", "This appointment has not begun yet.", opens_at=str(session.opens_at))
    message = {
        "paused": "The session is paused; go on first.",
        "completed": "This session is finished.",
        "withdrawn": "You have left this study.",
        "expired": "The time in which this session could be continued is over.",
        "screened_out": "This session is finished.",
    }[session.state]
    raise refusal(session, 409 if session.state == "paused" else 410, session.state, message)


def current_trial(s: DatabaseSession, session: Session, step_key: str, now: datetime) -> Trial:
    """The trial of the current step, which must be that one."""
    require_active(session, now)
    step = step_of(session)
    if step.key != step_key or kind_of(step).shows != "trajectories":
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
        return refusal(session, 409, "already_answered", "This step was answered already.", step=step_key)
    if not any(step["key"] == step_key for step in session.plan):
        return refusal(session, 404, "unknown_step", "This session has no such step.", asked=step_key[:80])
    return refusal(session, 409, "not_current_step", "The session is at another step.", step=step_key)


def refusal(
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

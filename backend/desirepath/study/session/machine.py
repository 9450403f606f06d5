"""The state machine of a session: the only writer of its position and of answers. Knows no kind of step by name.

Every function runs inside a writing transaction with the session locked (`finding.acting`). What is shown is
`view.py`'s, how trajectories are watched `watching.py`'s, pausing and leaving `leaving.py`'s, what each step is and
means its kind's (`kinds/`); they are reached from here, the one door for pages, stage and HTTP, which live above.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.words import TOLERANCE_S
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.events import log_event
from desirepath.store.models import Response, Session, Trial
from desirepath.store.sides import Side
from desirepath.study.clock import elapsed_s
from desirepath.study.kind import Acting, Moment, Page, begin, has_timed_out, kind_of
from desirepath.study.personalising import alignment_jobs
from desirepath.study.personalising.waiting import Waiting, waiting_of
from desirepath.study.refusals import Refused
from desirepath.study.session import states
from desirepath.study.session.finding import find_session
from desirepath.study.session.leaving import change_language, pause, report_problem, resume, withdraw
from desirepath.study.session.versions import protocol_of
from desirepath.study.session.view import (
    Playback,
    StepView,
    consent_in_force,
    current,
    has_declined,
    not_current,
    playing,
    refusal,
    require_active,
    step_of,
    trial_of,
)
from desirepath.study.session.watching import (
    answered_in_room,
    chosen_early,
    interrupt,
    restart_trajectory,
    start_trial,
    trajectory_seen,
    viewing_of,
    watch_again,
)
from desirepath.study.steps import Step
from desirepath.study.wire import BadValue, InRoomAnswer

__all__ = [
    "Playback",
    "Refused",
    "Side",
    "StepView",
    "Submitted",
    "change_language",
    "current",
    "find_session",
    "has_declined",
    "interrupt",
    "pause",
    "playing",
    "report_problem",
    "restart_trajectory",
    "resume",
    "settle",
    "start_trial",
    "step_of",
    "submit",
    "trajectory_seen",
    "trial_of",
    "waiting",
    "waits",
    "watch_again",
    "withdraw",
]


@dataclass(frozen=True)
class Submitted:
    """What became of an answer. `duplicate`: it was stored before, by the same request."""

    response_id: str
    duplicate: bool


def submit(
    s: DatabaseSession,
    files: ArtefactStore,
    session: Session,
    step_key: str,
    value: Mapping[str, Any],
    *,
    request_id: str,
    client_time: datetime | None,
    now: datetime,
    named: str | None = None,
) -> Submitted:
    """Store the answer to the current step and move on, in one transaction.

    named: the kind that the request says it answers. The same request again is answered the same and counts once.
    Raises Refused for an answer that is too early or too late, not to the current step, given already, or no answer to
    this step.
    """
    known = s.scalars(select(Response).where(Response.request_id == request_id)).first()
    if known is not None:
        if known.session_id != session.id or known.step_key != step_key:
            raise refusal(session, 409, "request_id_used", "This request id belongs to another answer.")
        log_event(s, "duplicate_request", session_id=session.id, trial_id=known.trial_id, step=step_key)
        return Submitted(known.id, duplicate=True)
    require_active(session, now)
    frozen = protocol_of(s, session)
    acting = Acting(s, session, frozen, now, files)
    step = acting.step
    if step.key != step_key:
        raise not_current(s, session, step_key)
    kind = kind_of(step)
    trial = trial_of(s, session) if kind.shows == "trajectories" else None
    if trial is not None:
        decision_s = _decision_s(session, trial, value, now)
    else:
        decision_s = None
        _check_can_be_answered(acting, step, value)
    if step.most_s and not session.simulated and (acting.stood_s or 0.0) > step.most_s + TOLERANCE_S:
        value = {**value, "timed_out": True}  # whatever the page's clock said
    stored = _check(acting, step, value, named)
    if trial is not None and trial.phase == "playing_b":
        chosen_early(s, session, trial, hmd=value.get("hmd") is True)
    stored |= kind.keep(step, acting, stored)
    response = Response(
        session_id=session.id,
        trial_id=trial.id if trial is not None else None,
        step_key=step_key,
        kind=kind.response_kind,
        value=stored,
        request_id=request_id,
        client_time=client_time,
        decision_s=decision_s,
        consent_id=consent_in_force(s, session),
        created_at=now,
    )
    s.add(response)
    if trial is not None:
        states.set_phase(s, trial, "answer", "participant", now)
    s.flush()
    log_event(
        s,
        "answered",
        session_id=session.id,
        trial_id=response.trial_id,
        client_time=client_time,
        step=step_key,
        response=response.id,
    )
    session.started_at = session.started_at or now
    reason = kind.ends(step, acting, stored)
    if reason is not None:
        ending = frozen.protocol.screen_out
        states.end(acting, "screen_out", completion_code=ending.completion_code if ending else "random", because=reason)
        alignment_jobs.end_what_nobody_waits_for(s, session)
    else:
        _move(acting, _next_position(acting))
    return Submitted(response.id, duplicate=False)


def _check(acting: Acting, step: Step, value: Any, named: str | None) -> dict[str, Any]:
    """The answer as it is stored. Raises BadValue, which names the session."""
    session = acting.session
    page = Page(acting.frozen, session.language, session.completion_code, acting.answer_to)
    try:
        kind = kind_of(step)
        if named not in (None, kind.name):
            raise BadValue("kind", named, f"must be {kind.name}, the kind of this step, or left out")
        answer = kind.answers.read(value)
        stored = kind.check(step, answer, page)
        if isinstance(answer, InRoomAnswer) and step.view == "immersive":
            worn = answer.headset.model_dump(exclude_unset=True) if answer.headset is not None else None
            stored |= answered_in_room(acting.s, session, worn)
        return stored
    except Refused as wrong:
        wrong.session_id, wrong.study_id = session.id, session.study_id
        wrong.details["step"] = step.key
        raise


def _decision_s(session: Session, trial: Trial, value: Mapping[str, Any], now: datetime) -> float | None:
    """Seconds since the choice was possible, None where the server's clock was set back. Raises Refused where it is not
    possible yet, or not any more."""
    rules = viewing_of(session)
    if trial.phase != "choosing" and not (rules.early_choice and trial.phase == "playing_b"):
        message = "Please watch both trajectories first."
        raise refusal(session, 409, "too_early", message, trial, phase=trial.phase, step=trial.step_key)
    assert trial.phase_since is not None  # noqa: S101  set with every phase
    elapsed = elapsed_s(trial.phase_since, now)
    if elapsed is None:
        return None
    if rules.choice_limit_s is not None and not session.simulated:
        over = elapsed > rules.choice_limit_s + TOLERANCE_S
        if over and not has_timed_out(value):
            raise refusal(session, 409, "too_late", "The time for this choice is over.", trial, elapsed_s=elapsed)
        if has_timed_out(value) and elapsed < rules.choice_limit_s - TOLERANCE_S:
            raise refusal(session, 409, "too_early", "There is still time to choose.", trial, elapsed_s=elapsed)
    return round(elapsed, 3)


def _check_can_be_answered(acting: Acting, step: Step, value: Mapping[str, Any]) -> None:
    """Raise Refused for steps that nobody answers, breaks that are not over, and half-filled pages before time."""
    session = acting.session
    kind_of(step).check_time(step, acting, value)
    least = step.least_s(timed_out=has_timed_out(value))
    if not least or session.simulated:
        return
    elapsed = acting.stood_s
    if elapsed is not None and elapsed < least - TOLERANCE_S:
        message = f"This takes {least} s and began {elapsed:.0f} s ago."
        raise refusal(session, 409, "too_early", message, elapsed_s=round(elapsed, 2), needed_s=least)


def _next_position(acting: Acting) -> int:
    """The index of the step after the current one; passed over is what its kind passes over, then what is not asked."""
    to = acting.session.position + 1
    step = acting.plan[to]
    return acting.first_asked(kind_of(step).pass_over(step, to, acting))


def _move(acting: Acting, to: int) -> None:
    """Advance to step `to` if nobody else has moved the session, and do what arriving there means."""
    left = acting.plan[acting.session.position : to]
    states.set_position(acting.s, acting.session, to, acting.now)
    log_event(acting.s, "step_entered", session_id=acting.session.id, step=acting.step.key)
    begun = dict.fromkeys(step.then for step in left if step.then is not None)
    for what in begun:
        begin(what, acting)
    ending = acting.arrive()
    if ending is not None:
        states.end(acting, ending.event, completion_code=ending.completion_code, **ending.logged)
        if ending.event == "complete":  # after an appointment others may follow, which show it
            alignment_jobs.end_what_nobody_waits_for(acting.s, acting.session)
    _settle(acting)


def settle(s: DatabaseSession, files: ArtefactStore, session: Session, *, now: datetime) -> bool:
    """Let a session go on that stands at a step which goes on by itself. Returns whether it moved.

    Call it whenever somebody looks at a waiting session; between two such looks nothing needs to happen.
    """
    return session.state == "active" and _settle(Acting(s, session, protocol_of(s, session), now, files))


def _settle(acting: Acting) -> bool:
    if acting.session.state != "active":
        return False
    to = kind_of(acting.step).settle(acting.step, acting)
    if to is None:
        return False
    _move(acting, acting.first_asked(to))
    return True


def waiting(s: DatabaseSession, session: Session, *, now: datetime) -> Waiting | None:
    """How long the session will wait where it stands; None where there is nothing to say of that."""
    return waiting_of(Moment(s, session, protocol_of(s, session), now))


def waits(s: DatabaseSession, session: Session, *, now: datetime) -> bool:
    """Whether the session would stay where it is if it were let go on now: `settle`, without changing anything."""
    if session.state != "active" or not kind_of(step_of(session)).goes_on:
        return True
    moment = Moment(s, session, protocol_of(s, session), now)
    return kind_of(moment.step).waits(moment.step, moment)

"""The state machine of a session: the only writer of its position and of answers.

Every function runs inside a writing transaction with the session locked (`sessions.acting`). What is shown is
`steps.py`'s, how drives are watched `watching.py`'s, which step comes next `routing.py`'s, pausing and leaving
`leaving.py`'s; they are reached from here, the one door for pages, stage and HTTP, which live above.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.artefacts import ArtefactStore
from backend.store.events import log_event
from backend.store.models import Participant, Response, Session, Study, Trial
from backend.store.sides import Side
from backend.store.who_counts import role_of
from backend.study.drawing import strokes
from backend.study.grammar.words import DRAWN_KINDS, TOLERANCE_S, TRIAL_KINDS
from backend.study.personalising import next_query, training
from backend.study.plan.planning import Step
from backend.study.protocol.freezing import FrozenProtocol
from backend.study.refusals import Refused
from backend.study.session import appointments, evaluating, routing
from backend.study.session.answers import checked_value, timed_out
from backend.study.session.finding import find_session
from backend.study.session.leaving import change_language, pause, report_problem, resume, withdraw
from backend.study.session.versions import protocol_of
from backend.study.session.view import (
    Playback,
    StepView,
    current,
    not_current,
    playing,
    refused,
    require_active,
    set_phase,
    set_position,
    step_of,
    trial_of,
)
from backend.study.session.watching import (
    interrupted,
    restart_trajectory,
    start_trial,
    trajectory_seen,
    viewing_of,
    watch_again,
)

__all__ = [
    "Playback",
    "Refused",
    "Side",
    "StepView",
    "Submitted",
    "change_language",
    "current",
    "find_session",
    "interrupted",
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
) -> Submitted:
    """Store the answer to the current step and move on, in one transaction.

    The same request again is answered the same and counts once. Raises Refused for an answer that is too early or too
    late, not to the current step, given already, or no answer to this step.
    """
    known = s.scalars(select(Response).where(Response.request_id == request_id)).first()
    if known is not None:
        if known.session_id != session.id or known.step_key != step_key:
            raise refused(session, 409, "request_id_used", "This request id belongs to another answer.")
        log_event(s, "duplicate_request", session_id=session.id, trial_id=known.trial_id, step=step_key)
        return Submitted(known.id, duplicate=True)
    require_active(session, now)
    step = step_of(session)
    if step["key"] != step_key:
        raise not_current(s, session, step_key)
    frozen = protocol_of(s, session)
    trial = trial_of(s, session) if step["kind"] in TRIAL_KINDS else None
    decision_s = _decision_s(session, trial, value, now) if trial is not None else None
    if trial is None:
        _check_can_be_answered(s, session, step, value, now)
    try:
        stored = checked_value(frozen, step, value, lambda name: routing.answer_to(s, session, name))
    except Refused as wrong:
        wrong.session_id, wrong.study_id = session.id, session.study_id
        wrong.details["step"] = step_key
        raise
    if step["kind"] == "consent":
        stored["text_hash"] = frozen.consent_hash(session.language)
        s.get_one(Participant, session.participant_id).consents = stored.get("purposes", {})
    elif step["kind"] in DRAWN_KINDS:
        strokes.keep(s, session, step, stored)
    elif step["kind"] == "guess":
        stored |= _about_last_comparison(s, session, stored["choice"])
    kinds = {"trial": "preference"}
    response = Response(
        session_id=session.id,
        trial_id=trial.id if trial is not None else None,
        step_key=step_key,
        kind=kinds.get(step["kind"], step["kind"]),
        value=stored,
        request_id=request_id,
        client_time=client_time,
        decision_s=decision_s,
        consent_id=_consent_in_force(s, session),
        created_at=now,
    )
    s.add(response)
    if trial is not None:
        set_phase(s, trial, trial.phase, "answered", now)
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
    study = s.get_one(Study, session.study_id)
    reason = routing.ends_here(s, session, study, frozen.protocol, step, stored)
    if reason is not None:
        _screen_out(s, session, frozen, reason, now)
    else:
        _move(s, files, session, routing.next_position(s, files, session), now)
    return Submitted(response.id, duplicate=False)


def _decision_s(session: Session, trial: Trial, value: Mapping[str, Any], now: datetime) -> float:
    """Seconds since the choice was possible. Raises Refused where it is not yet, or not any more."""
    rules = viewing_of(session)
    if trial.phase != "choosing" and not (rules.early_choice and trial.phase == "playing_b"):
        told = "Please watch both drives first."
        raise refused(session, 409, "too_early", told, trial, phase=trial.phase, step=trial.step_key)
    assert trial.phase_since is not None  # noqa: S101  set with every phase
    elapsed = (now - trial.phase_since).total_seconds()
    if rules.choice_limit_s is not None and not session.simulated:
        over = elapsed > rules.choice_limit_s + TOLERANCE_S
        if over and not timed_out(value):
            raise refused(session, 409, "too_late", "The time for this choice is over.", trial, elapsed_s=elapsed)
        if timed_out(value) and elapsed < rules.choice_limit_s - TOLERANCE_S:
            raise refused(session, 409, "too_early", "There is still time to choose.", trial, elapsed_s=elapsed)
    return round(elapsed, 3)


def _check_can_be_answered(
    s: DatabaseSession, session: Session, step: Step, value: Mapping[str, Any], now: datetime
) -> None:
    """Raise Refused for steps that go on by themselves, breaks that are not over, and half-filled pages before time."""
    if step["kind"] == "wait":
        raise refused(session, 409, "still_waiting", "This step goes on by itself.")
    if step["kind"] in ("debriefing", "appointment"):
        raise refused(session, 409, "finished", "This session is finished.")
    least = step.get("at_least_s", 0)
    if timed_out(value) and step.get("time_limit_s") is not None:
        least = step["time_limit_s"]
    if not least or session.simulated:
        return
    before = select(Response.created_at).where(Response.session_id == session.id)
    since = s.scalars(before.order_by(Response.created_at.desc()).limit(1)).first() or session.created_at
    elapsed = (now - since).total_seconds()
    if elapsed < least - TOLERANCE_S:
        told = f"This takes {least} s and began {elapsed:.0f} s ago."
        raise refused(session, 409, "too_early", told, elapsed_s=round(elapsed, 2), needed_s=least)


def _consent_in_force(s: DatabaseSession, session: Session) -> str | None:
    """The id of the participant's newest consent, of whichever appointment."""
    given = (
        select(Response.id)
        .join(Session, Session.id == Response.session_id)
        .where(Session.participant_id == session.participant_id, Response.kind == "consent")
        .order_by(Response.created_at.desc())
    )
    return s.scalars(given).first()


def _about_last_comparison(s: DatabaseSession, session: Session, choice: str) -> dict[str, Any]:
    """What a guess is about: the pair just seen, and whether the drive named came from the participant's answers."""
    last = s.scalars(
        select(Trial)
        .where(Trial.session_id == session.id, Trial.kind == "comparison")
        .order_by(Trial.index.desc())
        .limit(1)
    ).first()
    return {"about": last.step_key, "right": (last.arms or {})["own"] == choice} if last is not None else {}


def _screen_out(s: DatabaseSession, session: Session, frozen: FrozenProtocol, reason: str, now: datetime) -> None:
    """End the session kindly for somebody whom the study cannot go on with."""
    page = frozen.protocol.screen_out
    session.completion_code = _code(page.completion_code if page else "random", session)
    session.state, session.finished_at, session.ended_because = "screened_out", now, reason
    log_event(s, "screened_out", session_id=session.id, outcome=reason, step=step_of(session)["key"])


def _code(wanted: str, session: Session) -> str:
    """The completion code. One for everybody is worth money: a session that need not watch never gets it."""
    return secrets.token_hex(4).upper() if wanted == "random" or session.simulated else wanted


def _move(s: DatabaseSession, files: ArtefactStore, session: Session, to: int, now: datetime) -> None:
    """Advance to step `to` if nobody else has moved the session, and do what arriving there means."""
    passed = set_position(s, session, to)
    step = step_of(session)
    log_event(s, "step_entered", session_id=session.id, step=step["key"])
    protocol = protocol_of(s, session).protocol
    if step["kind"] == "trial":
        _make_trial(s, files, session, step, now)
    elif step["kind"] == "evaluation":
        evaluating.make_trial(s, session, step, now)
    if any(one.get("then") == "train" for one in passed):
        training.start_training(s, files, session, s.get_one(Study, session.study_id), protocol)
    if step["kind"] == "wait":
        settle(s, files, session, now=now)
    elif step["kind"] == "appointment":
        begins = routing.first_asked(s, session, session.position + 1)
        following = appointments.make_next(s, session, step, begins, now)
        if step_of(following)["kind"] == "trial":
            _make_trial(s, files, following, step_of(following), now)
    elif step["kind"] == "debriefing":
        wanted = next(entry.debriefing.completion_code for entry in protocol.stages if entry.debriefing)
        session.completion_code = _code(wanted, session)
        session.state, session.finished_at = "completed", now
        log_event(s, "session_completed", session_id=session.id)


def _make_trial(s: DatabaseSession, files: ArtefactStore, session: Session, step: Step, now: datetime) -> None:
    asked = next_query.asked_in(s, files, session, step)
    trial = Trial(
        session_id=session.id,
        step_key=step["key"],
        index=session.position,
        block=step["block"],
        kind="query",
        role=role_of(step["role"]),
        view=step["view"],
        query_id=asked.query,
        probe_of=asked.probe_of,
        sides_swapped=asked.turned,
        trajectory_a=asked.trajectory_a,
        trajectory_b=asked.trajectory_b,
        phase_since=now,
    )
    s.add(trial)
    s.flush()
    if asked.why is not None:
        log_event(s, "query_chosen", session_id=session.id, trial_id=trial.id, query=asked.query, **asked.why)


def settle(s: DatabaseSession, files: ArtefactStore, session: Session, *, now: datetime) -> bool:
    """Let a waiting session go on once its job has ended or is late. Returns whether it moved.

    Call it whenever somebody looks at a waiting session; between two such looks nothing needs to happen.
    """
    if session.state != "active" or step_of(session)["kind"] != "wait":
        return False
    protocol = protocol_of(s, session).protocol
    outcome = training.outcome_of(s, session, protocol, now)
    if outcome is None:
        return False
    shown = training.make_comparisons(s, session, now) if outcome == "shown" else 0
    session.personalisation = outcome
    log_event(s, "personalisation", session_id=session.id, outcome=outcome, comparisons=shown)
    _move(s, files, session, _after_wait(s, session, shown), now)
    return True


def _after_wait(s: DatabaseSession, session: Session, shown: int) -> int:
    """Where a waiting session goes: to the first comparison or drive to be rated, past all of them and the guess if
    there is none."""
    past = ("comparison", "guess") if not shown else ()
    after = (i for i in range(session.position + 1, len(session.plan)) if session.plan[i]["kind"] not in past)
    return routing.first_asked(s, session, next(after))

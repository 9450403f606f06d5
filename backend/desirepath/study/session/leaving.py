"""Pausing, going on, leaving for good, another language, a problem report: what is possible at any step."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.events import log_event
from desirepath.store.models import Participant, ProblemReport, Session
from desirepath.store.snapshots import set_aside_snapshots
from desirepath.study import robots
from desirepath.study.kind import kind_of
from desirepath.study.personalising import alignment_jobs
from desirepath.study.session import states
from desirepath.study.session.versions import protocol_of
from desirepath.study.session.view import refusal, require_active, step_of
from desirepath.study.session.watching import interrupt

LONGEST_PROBLEM = 4000  # characters of a problem report; ours


def pause(s: DatabaseSession, session: Session, *, now: datetime) -> None:
    """Stop for now; an unfinished trial starts over afterwards. Pausing twice is pausing once."""
    if session.state == "paused":
        return
    require_active(session, now)
    interrupt(s, session, reason="paused", now=now)
    states.change(session, "pause", "participant")
    log_event(s, "paused", session_id=session.id)


def resume(s: DatabaseSession, session: Session, *, now: datetime) -> None:
    """Go on after a pause."""
    if session.state == "active":
        return
    if session.state != "paused":
        require_active(session, now)
    states.change(session, "resume", "participant")
    log_event(s, "resumed", session_id=session.id)


def withdraw(s: DatabaseSession, session: Session, *, now: datetime) -> None:
    """Leave the study: the answers count nowhere from now on, a running alignment is cancelled, and nothing more is
    learned from snapshots that hold them.

    Possible also after the last step. Erasing what is stored is `store.erasure`'s.
    """
    if session.state == "withdrawn":
        return
    participant = s.get_one(Participant, session.participant_id)
    participant.withdrawn_at = now
    others = select(Session).where(Session.participant_id == participant.id, Session.state.in_(("active", "paused")))
    for later in s.scalars(others):
        states.change(later, "withdraw", "participant")  # a later appointment, too
    if session.state != "withdrawn":
        states.change(session, "withdraw", "participant")
    alignment_jobs.end_trainings(s, session, by="withdrawal")
    robots.end_runs_of(s, participant.id, now, "withdrawn")
    set_aside_snapshots(s, participant.id)
    log_event(s, "withdrawn", session_id=session.id, step=step_of(session).key)


def change_language(s: DatabaseSession, session: Session, language: str) -> None:
    """Show the pages in another of the protocol's languages from now on; answers stay as they are.

    Not while a pair is on the stage: its page must not be loaded anew.
    """
    languages = protocol_of(s, session).protocol.languages
    if language not in languages:
        allowed = ", ".join(languages)
        raise refusal(session, 422, "bad_value", f"must be one of {allowed}", field="language", value=language[:20])
    step = step_of(session)
    if session.state == "active" and kind_of(step).shows == "trajectories":
        raise refusal(session, 409, "in_trial", "The language can be changed after this pair.", step=step.key)
    if language == session.language:
        return
    log_event(s, "language_changed", session_id=session.id, step=step.key, before=session.language, after=language)
    session.language = language


def report_problem(s: DatabaseSession, session: Session, text: str) -> None:
    """Keep what a participant wrote by `report a problem`."""
    text = text.strip()
    if not text or len(text) > LONGEST_PROBLEM:
        raise refusal(session, 422, "bad_value", f"Please write 1 to {LONGEST_PROBLEM} characters.", field="text")
    s.add(ProblemReport(session_id=session.id, text=text))
    log_event(s, "problem_reported", session_id=session.id, step=step_of(session).key)

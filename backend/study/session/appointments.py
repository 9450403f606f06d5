"""Several appointments of one participant: when one is open, how the next is found, on any device, days later.

All appointments share one plan; each session begins where the one before ended. The next link is made from the link of
now, so that nothing is stored but its hash, and the page can show it again.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.events import log_event
from backend.store.models import Session, utc_now
from backend.study.links import next_token, token_hash
from backend.study.plan.planning import Step


def end_of(session: Session) -> int:
    """Index after the last step of the session's own appointment."""
    ends = [i + 1 for i, step in enumerate(session.plan) if step["kind"] == "appointment"]
    own = session.appointment or 1
    return ends[own - 1] if own <= len(ends) else len(session.plan)


def is_open(session: Session, now: datetime | None = None) -> bool:
    """Whether the appointment has begun; bots need not wait."""
    return session.opens_at is None or session.simulated or (now or utc_now()) >= session.opens_at


def window_of(session: Session) -> dict[str, Any]:
    """From when until when the appointment can be entered."""
    return {"opens_at": session.opens_at, "expires_at": session.expires_at}


def next_of(s: DatabaseSession, session: Session) -> dict[str, Any]:
    """What the last page of an appointment tells: the next one's window, code and way. The code needs the session's own
    link, by which it was found (`sessions.find_session`).
    """
    following = s.scalars(
        select(Session).where(
            Session.participant_id == session.participant_id, Session.appointment == session.appointment + 1
        )
    ).first()
    token = s.info.get("token")
    if following is None or token is None:
        return {}
    code = next_token(token)
    return {**window_of(following), "return_code": code, "return_path": f"/p/{code}"}


def make_next(s: DatabaseSession, session: Session, step: Step, begins: int, now: datetime) -> Session:
    """End this appointment and make the next one, in the same transaction; `begins`: index of its first step."""
    following = Session(
        participant_id=session.participant_id,
        study_id=session.study_id,
        token_hash=token_hash(next_token(s.info["token"])),
        language=session.language,
        simulated=session.simulated,
        seed=session.seed,
        plan=session.plan,
        position=begins,
        assignment=session.assignment,
        appointment=session.appointment + 1,
        personalisation=session.personalisation,  # why nothing is learned, where that is known already
        protocol_number=session.protocol_number,
        opens_at=now + timedelta(days=step["after_days"]),
        created_at=now,
        expires_at=now + timedelta(days=step["within_days"]),
    )
    s.add(following)
    session.state, session.finished_at = "completed", now
    s.flush()
    log_event(s, "session_completed", session_id=session.id, appointment=session.appointment)
    log_event(s, "step_entered", session_id=following.id, step=following.plan[following.position]["key"])
    return following

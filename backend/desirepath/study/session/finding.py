"""Finds a session by its token and locks it for one change. What changes is decided in `machine.py`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.database import Database
from desirepath.store.events import log_event
from desirepath.store.models import Session
from desirepath.store.worker_signals import Signal, signal_workers
from desirepath.study.links import normalise_token, token_hash
from desirepath.study.personalising import alignment_jobs
from desirepath.study.refusals import Refused, log_refusal
from desirepath.study.session import states

PRESENCE_TOLD_EVERY_S = 15.0  # ours: an open page is noted every 20 s


def find_session(s: DatabaseSession, token: str, *, now: datetime, lock: bool = True) -> Session:
    """The session of a link. Raises Refused: 404 `unknown` for a forged or erased one, 410 `expired`.

    One that expired while the server's clock was set forward goes on again; where nothing is locked, that is left to
    the next request that may write. The transaction remembers the link (`s.info["token"]`), from which the next
    appointment's is made.
    """
    s.info["token"] = normalise_token(token)
    session = s.scalars(
        select(Session)
        .where(Session.token_hash == token_hash(token))
        .with_for_update(of=Session)
        .execution_options(populate_existing=True)
        if lock
        else select(Session).where(Session.token_hash == token_hash(token))
    ).first()
    if session is None:
        raise Refused(404, "unknown", "This link does not lead to a session.", link=token_hash(token))
    if session.state in ("active", "paused", "expired") and now > session.expires_at:
        raise Refused(
            410,
            "expired",
            "The time in which this session could be continued is over.",
            session_id=session.id,
            study_id=session.study_id,
            link=session.token_hash,
        )
    if session.state == "expired" and lock:
        # Its time is not over: the server's clock had been set forward when somebody looked.
        states.change(session, "reopen", "clock")
        log_event(s, "session_reopened", session_id=session.id)
    return session


@contextmanager
def acting(
    db: Database, token: str, *, request: str, now: datetime, durable: bool = True
) -> Iterator[tuple[DatabaseSession, Session]]:
    """A writing transaction with the token's session locked; `durable` as in `Database.transaction`.

    A refusal rolls everything back, is logged by itself as an event (`request` says what was asked), and goes on up.
    """
    try:
        with db.transaction(durable=durable) as s:
            session = find_session(s, token, now=now)
            if db.is_due("presence", every_s=PRESENCE_TOLD_EVERY_S):
                signal_workers(s, Signal.PARTICIPANT_PRESENT)
            session.last_seen_at = now
            if session.step_since is None and (session.opens_at is None or now >= session.opens_at):
                session.step_since = now
            yield s, session
    except Refused as refused:
        if refused.code == "expired" and refused.session_id is not None:
            _expire(db, refused.session_id)
        log_refusal(db, refused, request=request)
        raise


def _expire(db: Database, session_id: str) -> None:
    with db.transaction() as s:
        session = s.get(Session, session_id, with_for_update=True)
        if session is not None and session.state in ("active", "paused"):
            states.change(session, "expire", "clock")
            log_event(s, "session_expired", session_id=session_id)
            alignment_jobs.end_what_nobody_waits_for(s, session)

"""Writes to the append-only log: what happened, when, in which session. Reading it is a plain select."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session

from desirepath.store.models import Event
from desirepath.store.models import Session as SessionRow

# What identifies a person or opens a door never enters the log, so that it cannot leave with it either.
FORBIDDEN_KEYS = frozenset(
    {
        *("token", "cookie", "password", "csrf", "completion_code"),
        *("ip", "ip_address", "remote_addr", "client_ip", "user_agent", "useragent", "email"),
        *("external_id", "prolific_pid"),
    }
)


def check_keys(kind: str, data: Mapping[str, Any]) -> None:
    """Raises ValueError if a key of a log entry names something that must not be logged (FORBIDDEN_KEYS)."""
    forbidden = sorted(FORBIDDEN_KEYS & {key.lower() for key in data})
    if forbidden:
        raise ValueError(
            f"event {kind!r}: {', '.join(forbidden)} must not be logged; leave it out or log a neutral word"
        )


def log_event(
    s: Session,
    kind: str,
    *,
    study_id: str | None = None,
    session_id: str | None = None,
    trial_id: str | None = None,
    client_time: datetime | None = None,
    **data: Any,
) -> Event:
    """Add one event to the transaction; the study is filled in from the session.

    data: plain JSON values. Raises ValueError if a key names something that must not be logged (FORBIDDEN_KEYS).
    """
    check_keys(kind, data)
    if session_id is not None and study_id is None:
        session = s.get(SessionRow, session_id)
        study_id = session.study_id if session else None
    event = Event(
        kind=kind, study_id=study_id, session_id=session_id, trial_id=trial_id, client_time=client_time, data=data
    )
    s.add(event)
    return event

"""Every change of state there is, of a session and of a trial, in two tables: from, event, to, who may.

All writes go through `change` and `set_phase`; the picture in docs/architecture.md is `python -m
desirepath.study.session.states`. When something happens is decided by the rooms that call.
"""

from __future__ import annotations

import secrets
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

from sqlalchemy import CursorResult, update
from sqlalchemy.orm import Session as DatabaseSession
from sqlalchemy.orm.attributes import set_committed_value

from desirepath.store.events import log_event
from desirepath.store.models import Session, Trial
from desirepath.study.refusals import Refused

if TYPE_CHECKING:
    from desirepath.study.kind import Acting

Who = Literal["participant", "study", "clock"]
"""Who may: the participant, the study itself (what its protocol says happens), the clock."""


class Change(NamedTuple):
    """One arrow."""

    before: str
    event: str
    after: str
    who: Who


SESSION = (
    Change("active", "pause", "paused", "participant"),
    Change("paused", "resume", "active", "participant"),
    Change("active", "complete", "completed", "study"),
    Change("active", "end_appointment", "completed", "study"),
    Change("active", "screen_out", "screened_out", "study"),
    Change("active", "withdraw", "withdrawn", "participant"),
    Change("paused", "withdraw", "withdrawn", "participant"),
    Change("completed", "withdraw", "withdrawn", "participant"),
    Change("screened_out", "withdraw", "withdrawn", "participant"),
    Change("expired", "withdraw", "withdrawn", "participant"),
    Change("active", "expire", "expired", "clock"),
    Change("paused", "expire", "expired", "clock"),
    Change("expired", "reopen", "active", "clock"),  # it had been set forward, and is right again
)
"""A session's states. Erasure takes the row away, an import brings it in as it was; neither changes a state."""

TRIAL = (
    Change("ready", "start", "playing_a", "participant"),
    Change("ready", "go_on", "playing_b", "participant"),  # A was seen before B was interrupted
    Change("playing_a", "seen", "playing_b", "participant"),
    Change("playing_a", "seen_alone", "choosing", "participant"),  # of a trial that shows one trajectory
    Change("playing_b", "seen", "choosing", "participant"),
    Change("playing_a", "interrupt", "ready", "study"),
    Change("playing_b", "interrupt", "ready", "study"),
    Change("ready", "interrupt", "ready", "study"),  # A was seen, but starts over as well
    Change("choosing", "interrupt", "ready", "study"),  # what was marked in it is lost
    Change("choosing", "watch_again", "playing_a", "participant"),
    Change("choosing", "answer", "answered", "participant"),
    Change("playing_b", "answer", "answered", "participant"),  # where the protocol allows an early choice
)
"""A trial's phases."""

STATES = tuple(dict.fromkeys(state for change in SESSION for state in (change.before, change.after)))
_STILL_POSSIBLE = ("withdraw", "reopen")
FINAL = tuple(
    s for s in STATES if not any(change.before == s and change.event not in _STILL_POSSIBLE for change in SESSION)
)
"""A session in one of these goes on no more."""


class NoSuchChange(RuntimeError):
    """A change that the table does not have: a fault of ours, never of the participant."""


def after(table: tuple[Change, ...], before: str, event: str, who: Who) -> str:
    """The state that the event leads to. Raises NoSuchChange."""
    for row in table:
        if (row.before, row.event, row.who) == (before, event, who):
            return row.after
    raise NoSuchChange(f"{who} may not {event} what is {before!r}")


def change(session: Session, event: str, who: Who) -> None:
    """Change a session's state; it is locked. Raises NoSuchChange."""
    session.state = after(SESSION, session.state, event, who)


def end(
    acting: Acting, event: str, *, completion_code: str | None = None, because: str | None = None, **logged: Any
) -> None:
    """End a session by what its protocol says: completed, screened out, or an appointment's end.

    completion_code: the protocol's, `random` for one of the session's own; None: there is none. because: why, where
    the study could not go on.
    """
    session = acting.session
    change(session, event, "study")
    session.finished_at, session.ended_because = acting.now, because
    if completion_code is not None:
        session.completion_code = _code(completion_code, session)
    if because is not None:
        logged |= {"outcome": because, "step": acting.step.key}
    kind = "screened_out" if event == "screen_out" else "session_completed"
    log_event(acting.s, kind, session_id=session.id, **logged)


def _code(wanted: str, session: Session) -> str:
    """The completion code. One for everybody is worth money: a session that need not watch never gets it."""
    return secrets.token_hex(4).upper() if wanted == "random" or session.simulated else wanted


def set_phase(s: DatabaseSession, trial: Trial, event: str, who: Who, now: datetime) -> None:
    """Change a trial's phase if nobody else has. Raises NoSuchChange, Refused 409 `moved`."""
    before, to = trial.phase, after(TRIAL, trial.phase, event, who)
    s.flush()
    compare_and_set(
        s, trial, update(Trial).where(Trial.id == trial.id, Trial.phase == before).values(phase=to, phase_since=now)
    )
    set_committed_value(trial, "phase", to)
    set_committed_value(trial, "phase_since", now)


def set_position(s: DatabaseSession, session: Session, to: int, now: datetime) -> None:
    """Advance to step `to` if nobody else has moved the session. Raises Refused 409 `moved`."""
    compare_and_set(
        s,
        session,
        update(Session)
        .where(Session.id == session.id, Session.position == session.position)
        .values(position=to, step_since=now),
    )
    set_committed_value(session, "position", to)
    set_committed_value(session, "step_since", now)


def compare_and_set(s: DatabaseSession, row: Session | Trial, statement: Any) -> None:
    """Run an update that must change exactly one row."""
    changed = cast("CursorResult[Any]", s.execute(statement.execution_options(synchronize_session=False)))
    if changed.rowcount != 1:
        session_id = row.id if isinstance(row, Session) else row.session_id
        raise Refused(409, "moved", "The session went on in the meantime.", session_id=session_id)


def draw_diagrams() -> str:
    """Both tables as the diagrams of docs/architecture.md (Mermaid)."""
    lines = []
    for title, table, first in (("session", SESSION, "active"), ("trial", TRIAL, "ready")):
        lines += [f"%% {title}", "stateDiagram-v2", f"  [*] --> {first}"]
        lines += [f"  {change.before} --> {change.after}: {change.event} ({change.who})" for change in table] + [""]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    print(draw_diagrams(), end="")

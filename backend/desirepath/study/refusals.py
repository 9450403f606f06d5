"""What the study says no to; every no is written to the log. Which requests are refused is decided elsewhere."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any
from weakref import WeakKeyDictionary

from desirepath.store.database import Database
from desirepath.store.events import log_event
from desirepath.store.models import Session

LOGGED_AGAIN_AFTER_S = 3600.0  # ours: a robot that goes on with a dead link fills no log
MOST_LOGGED = 1_000  # links refused within that time; what comes on top is not written down at all
MOST_OF_A_SESSION = 100  # ours: refusals of one session written down within that time; a person meets a few

_logged: WeakKeyDictionary[Database, dict[tuple[str, ...], float]] = WeakKeyDictionary()  # each in the order of time
_of_sessions: WeakKeyDictionary[Database, dict[str, deque[float]]] = WeakKeyDictionary()  # when each was refused
_logged_lock = threading.Lock()


def first_this_hour(db: Database, *what: str) -> bool:
    """Whether this was not refused in the last hour, so that it belongs into the log. In memory: a restart forgets."""
    now = time.monotonic()
    with _logged_lock:
        logged = _logged.setdefault(db, {})
        for old in list(logged):
            if now - logged[old] < LOGGED_AGAIN_AFTER_S:
                break
            del logged[old]
        if what in logged or len(logged) >= MOST_LOGGED:
            return False
        logged[what] = now
        return True


def _few_of(db: Database, session_id: str) -> bool:
    """Whether the session's log may take one refusal more. In memory: a restart forgets."""
    now = time.monotonic()
    with _logged_lock:
        of_all = _of_sessions.setdefault(db, {})
        for other in [key for key, times in of_all.items() if now - times[-1] >= LOGGED_AGAIN_AFTER_S]:
            del of_all[other]
        times = of_all.setdefault(session_id, deque())
        while times and now - times[0] >= LOGGED_AGAIN_AFTER_S:
            times.popleft()
        if len(times) >= MOST_OF_A_SESSION:
            return False
        times.append(now)
        return True


class Refused(Exception):
    """A request that is not let through. `status`: HTTP; `code`: one stable word; `message`: for the person.

    `link`: what names a link that opens nothing (any more), a hash of its token; is never written down.
    """

    def __init__(
        self,
        status: int,
        code: str,
        message: str,
        *,
        field: str | None = None,
        value: Any = None,
        session_id: str | None = None,
        study_id: str | None = None,
        trial_id: str | None = None,
        link: str | None = None,
        **details: Any,
    ) -> None:
        super().__init__(message)
        self.link = link
        self.status, self.code, self.message, self.field, self.value = status, code, message, field, value
        self.session_id, self.study_id, self.trial_id, self.details = session_id, study_id, trial_id, details

    def as_dict(self) -> dict[str, Any]:
        """What the page is answered."""
        shown = self.value if isinstance(self.value, str | int | float | bool | None) else None
        return {"error": {"code": self.code, "field": self.field, "value": shown, "message": self.message}}


def log_refusal(db: Database, refused: Refused, *, request: str) -> None:
    """Write the refusal as an event of its own, after the refused transaction was rolled back; a dead link's once."""
    if refused.link is not None and not first_this_hour(db, refused.link, refused.code):
        return
    if refused.session_id is not None and not _few_of(db, refused.session_id):
        return
    with db.transaction() as s:
        known = refused.session_id is not None and s.get(Session, refused.session_id) is not None
        log_event(
            s,
            "refused",
            study_id=refused.study_id,
            session_id=refused.session_id if known else None,
            trial_id=refused.trial_id,
            code=refused.code,
            request=request,
            field=refused.field,
            **refused.details,
        )

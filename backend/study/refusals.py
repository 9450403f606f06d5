"""What the study says no to; every no is written to the log. Which requests are refused is decided elsewhere."""

from __future__ import annotations

from typing import Any

from backend.store.database import Database
from backend.store.events import log_event
from backend.store.models import Session


class Refused(Exception):
    """A request that is not let through. `status`: HTTP; `code`: one stable word; `message`: for the person."""

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
        **details: Any,
    ) -> None:
        super().__init__(message)
        self.status, self.code, self.message, self.field, self.value = status, code, message, field, value
        self.session_id, self.study_id, self.trial_id, self.details = session_id, study_id, trial_id, details

    def as_dict(self) -> dict[str, Any]:
        """What the page is answered."""
        shown = self.value if isinstance(self.value, str | int | float | bool | None) else None
        return {"error": {"code": self.code, "field": self.field, "value": shown, "message": self.message}}


def log_refusal(db: Database, refused: Refused, *, request: str) -> None:
    """Write the refusal as an event of its own, after the refused transaction was rolled back."""
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

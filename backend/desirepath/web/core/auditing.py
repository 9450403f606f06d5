"""Notes what a signed-in request does and writes it to the audit log once it is done. The log is `store/audit.py`.

One place for all routes: `auth.check_csrf` notes the action that `roles.py` names, a route may add details with
`audit_details`, the guard writes the entry after the change is committed and before the browser hears of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import structlog
from fastapi import Request
from starlette.concurrency import run_in_threadpool

from desirepath.store.audit import record
from desirepath.store.database import StorageError
from desirepath.web.core.dependencies import services_of

OWN_COLUMNS = ("study_id", "code", "job_id")  # path parameters that `record` takes as such; others become data
LONGEST_ID = 32  # characters of our own ids
LONGEST_NAME = 200  # of whatever else an address holds
log = structlog.get_logger("desirepath.web")


@dataclass
class _Noted:
    """An entry that is written if the request ends well, or was refused by its role."""

    action: str
    by: str
    role: str | None
    outcome: str
    data: dict[str, Any] = field(default_factory=dict)


def note_in_audit(request: Request, action: str, *, by: str, role: str | None = None, outcome: str = "done") -> None:
    """Note what this request is about to do; the path's parameters are written with it."""
    request.state.audit = _Noted(action, by, role, outcome)


def audit_details(request: Request, **data: Any) -> None:
    """Add what the path does not say, e.g. the new state; `study_id` says in which study, where the path does not."""
    request.state.audit.data |= data


async def write(request: Request, status: int) -> None:
    """Write what was noted, unless the request failed for another reason than the role. Never fails the request."""
    noted: _Noted | None = getattr(request.state, "audit", None)
    if noted is None or (noted.outcome == "done" and status >= 400):
        return
    try:
        await run_in_threadpool(_write, request, noted)
    except StorageError:
        log.exception("an entry of the audit log could not be written", action=noted.action, by=noted.by)


def _write(request: Request, noted: _Noted) -> None:
    addressed = {name: str(value)[:LONGEST_NAME] for name, value in request.path_params.items()}
    given = {**addressed, **noted.data}
    for name in OWN_COLUMNS:
        if len(given.get(name) or "") > LONGEST_ID:  # a refused post: what it names is nothing of ours
            del given[name]
    own = {key: given.pop(key) for key in OWN_COLUMNS if key in given}
    with services_of(request).database.transaction() as s:
        record(s, noted.action, by=noted.by, role=noted.role, outcome=noted.outcome, **own, **given)

"""How the server is: what is wrong, by name, for load balancers, monitoring and people. The route is elsewhere.

Reads as little as may be: it has to answer when the database, the disk or the artefact store does not.
"""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Literal
from urllib.parse import unquote, urlsplit

import structlog
from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session as DatabaseSession

from backend.api.core.contract import Reply
from backend.api.core.dependencies import Services
from backend.api.core.disk import room_left
from backend.jobs.heartbeat import SILENT_S, silent_s
from backend.store.database import StorageError
from backend.store.models import Job, utc_now

Problem = Literal["database_away", "disk_full", "disk_low", "store_away", "no_worker"]
WAITS_TOO_LONG = timedelta(minutes=2)  # ours: a job that is queued so long while none runs has no worker
NOWHERE = "0" * 64  # a content address that nothing has
CODES: dict[str, int] = {"disk_full": 507, "no_database": 503}
log = structlog.get_logger("desirepath.web")


class Health(Reply):
    """How the server is. `status`: the worst of what concerns answers; `problems`: everything that is wrong, by name;
    `free_mb`: on the fullest disk of those that it writes on; `worker_silent_s`: since a worker of this data folder
    said that it lives, null where none ever did."""

    status: Literal["ok", "disk_low", "disk_full", "no_database"]
    problems: list[Problem]
    free_mb: int
    worker_silent_s: float | None


def health_of(services: Services) -> Health:
    """Look at everything that the server needs."""
    room, silent = room_left(services.settings), silent_s(services.settings.data)
    problems: list[Problem] = []
    waiting = False
    try:
        with services.database.session() as s:
            s.connection().exec_driver_sql("SELECT 1")
            waiting = _nobody_works(s)
    except (SQLAlchemyError, StorageError) as problem:
        log.error("the database does not answer", problem=str(problem)[:300])
        problems.append("database_away")
    if room.state != "ok":
        problems.append(room.state)
    if not _store_answers(services):
        problems.append("store_away")
    if waiting or (silent is not None and silent > SILENT_S):
        problems.append("no_worker")
    away = "database_away" in problems and room.state != "disk_full"
    return Health(
        status="no_database" if away else room.state, problems=problems, free_mb=room.free_mb, worker_silent_s=silent
    )


def _nobody_works(s: DatabaseSession) -> bool:
    """Whether a job has waited for too long while none runs."""
    if s.scalar(select(func.count()).where(Job.state == "running")):
        return False
    oldest = s.scalar(select(func.min(Job.created_at)).where(Job.state == "queued"))
    return oldest is not None and utc_now() - oldest > WAITS_TOO_LONG


def _store_answers(services: Services) -> bool:
    """Whether the artefact store can be asked."""
    parts = urlsplit(services.files.url)
    try:
        if parts.scheme in ("", "file"):
            return Path(unquote(parts.path)).is_dir() or Path(unquote(parts.path)).parent.is_dir()
        services.files.exists(NOWHERE)
    except Exception as problem:  # whatever a store's library raises
        log.error("the artefact store does not answer", problem=f"{type(problem).__name__}: {problem}"[:300])
        return False
    return True

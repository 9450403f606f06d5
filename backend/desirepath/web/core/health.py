"""How the server is: what is wrong, by name, for load balancers, monitoring and people. The route is elsewhere.

Reads as little as may be: it has to answer when the database, the disk or the artefact store does not.
"""

from __future__ import annotations

import math
import threading
import time
from datetime import timedelta
from pathlib import Path
from typing import Literal
from urllib.parse import unquote, urlsplit
from weakref import WeakKeyDictionary

import structlog
from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.jobs.heartbeat import SILENT_S, silent_s
from desirepath.jobs.leases import workers_silent_s
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import StorageError
from desirepath.store.models import Job, utc_now
from desirepath.web.core.contract import Reply
from desirepath.web.core.dependencies import Services
from desirepath.web.core.disk import room_left

Problem = Literal["database_away", "disk_full", "disk_low", "store_away", "no_worker", "loading"]
WAITS_TOO_LONG = timedelta(minutes=2)  # ours: a job that is queued so long while none runs has no worker
LOOKS_EVERY_S = 10.0  # ours: at a store that is no folder of this machine
WAITS_FOR_STORE_S = 1.0  # ours: balancers give up after a few seconds
NOWHERE = "0" * 64  # a content address that nothing has
Status = Literal["ok", "disk_low", "disk_full", "no_database", "loading"]
CODES: dict[str, int] = {"disk_full": 507, "no_database": 503, "loading": 503}
log = structlog.get_logger("desirepath.web")


class Health(Reply):
    """How the server is. `status`: the worst of what concerns answers; `problems`: everything that is wrong, by name;
    `free_mb`: on the fullest disk of those that it writes on; `worker_silent_s`: since any worker, on any machine, said
    that it lives, null where none ever did."""

    status: Status
    problems: list[Problem]
    free_mb: int
    worker_silent_s: float | None


def health_of(services: Services, *, prepared: bool = False) -> Health:
    """Look at everything that the server needs. prepared: a server that is still loading what its first visitors would
    wait for is not well either."""
    room, silent = room_left(services.settings), silent_s(services.settings.data)
    problems: list[Problem] = []
    waiting = False
    try:
        with services.database.session() as s:
            s.connection().exec_driver_sql("SELECT 1")
            waiting = _nobody_works(s)
            silent = workers_silent_s(services.settings.data, s)
    except (SQLAlchemyError, StorageError) as problem:
        log.error("the database does not answer", problem=str(problem)[:300])
        problems.append("database_away")
    if room.state != "ok":
        problems.append(room.state)
    if not _store_answers(services):
        problems.append("store_away")
    if waiting or (silent is not None and silent > SILENT_S):
        problems.append("no_worker")
    status: Status = room.state
    if "database_away" in problems and room.state != "disk_full":
        status = "no_database"
    elif prepared and not services.prepared.is_set():
        problems.append("loading")
        status = "loading"
    return Health(status=status, problems=problems, free_mb=room.free_mb, worker_silent_s=silent)


def _nobody_works(s: DatabaseSession) -> bool:
    """Whether a job has waited for too long while none runs."""
    if s.scalar(select(func.count()).where(Job.state == "running")):
        return False
    oldest = s.scalar(select(func.min(Job.created_at)).where(Job.state == "queued"))
    return oldest is not None and utc_now() - oldest > WAITS_TOO_LONG


def _store_answers(services: Services) -> bool:
    """Whether the artefact store can be asked. One elsewhere is asked now and then, beside: a balancer that waits for
    the answer must not take a server for dead because a store is slow."""
    parts = urlsplit(services.files.url)
    if parts.scheme in ("", "file"):
        return Path(unquote(parts.path)).is_dir() or Path(unquote(parts.path)).parent.is_dir()
    return _LOOKS.setdefault(services.files, _Look()).answers(services.files)


class _Look:
    """What a store elsewhere said last; never more than one asks it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._looking: threading.Thread | None = None
        self._said, self._since = True, -math.inf

    def answers(self, files: ArtefactStore) -> bool:
        with self._lock:
            if self._looking is None and time.monotonic() - self._since > LOOKS_EVERY_S:
                self._looking = threading.Thread(target=self._look, args=(files,), daemon=True)
                self._looking.start()
            looking = self._looking
        if looking is not None:
            looking.join(WAITS_FOR_STORE_S)
        return self._said and (looking is None or not looking.is_alive())

    def _look(self, files: ArtefactStore) -> None:
        try:
            files.exists(NOWHERE)
            said = True
        except Exception as problem:  # whatever a store's library raises
            log.error("the artefact store does not answer", problem=f"{type(problem).__name__}: {problem}"[:300])
            said = False
        with self._lock:
            self._said, self._since, self._looking = said, time.monotonic(), None


_LOOKS: WeakKeyDictionary[ArtefactStore, _Look] = WeakKeyDictionary()

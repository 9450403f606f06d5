"""The server processes that live, and the door at which each can be reached by the others.

A replay stands in the memory of the process that was asked for it; its stage may be asked of any. What such a door lets
through is `stage/stage_proxy.py`'s.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta

import structlog
from sqlalchemy import delete, select
from sqlalchemy.exc import SQLAlchemyError

from desirepath.store.database import Database, StorageError, shared_now
from desirepath.store.models import ServerProcess
from desirepath.web.replicas.notices import Notices
from desirepath.web.replicas.shared_limits import SharedCounts

BEAT_S = 5.0  # ours
SILENT = timedelta(seconds=30)  # ours: a process that was not heard of for so long is gone
MARK = "~"  # between a process's id and the rest of a token; `token_urlsafe` has none
log = structlog.get_logger("desirepath.replicas")


@dataclass(frozen=True)
class Peer:
    """One process. address: host and port of its inner door."""

    process_id: str
    address: str


class Peers:
    """This process among the others. Where there can be none, nothing is written down."""

    def __init__(self, database: Database, notices: Notices, counts: SharedCounts | None) -> None:
        self._database, self._notices, self._counts = database, notices, counts
        self._ending = threading.Event()
        self._address = ""
        self._thread: threading.Thread | None = None

    def begin(self, address: str) -> None:
        """Say where this process is reached, and go on saying that it lives."""
        if not self._notices.shared:
            return
        self._address = address
        self._beat()
        self._thread = threading.Thread(target=self._keep_beating, daemon=True, name="replicas-beating")
        self._thread.start()

    def end(self) -> None:
        """This process goes, in order."""
        self._ending.set()
        if self._thread is None:
            return
        self._thread.join(BEAT_S)
        with suppress(SQLAlchemyError, StorageError), self._database.transaction(durable=False) as s:
            s.execute(delete(ServerProcess).where(ServerProcess.id == self._notices.process_id))
        if self._counts is not None:
            self._counts.close()

    def living(self, *, since: datetime | None = None) -> list[Peer]:
        """All of them, this one among them. since: those that began later, by `now`."""
        with self._database.session() as s:
            asked = select(ServerProcess).where(ServerProcess.seen_at > shared_now(s) - SILENT)
            if since is not None:
                asked = asked.where(ServerProcess.started_at >= since)
            return [
                Peer(process.id, process.address) for process in s.scalars(asked.order_by(ServerProcess.started_at))
            ]

    def now(self) -> datetime:
        """By the clock of `living`."""
        with self._database.session() as s:
            return shared_now(s)

    def mark(self, token: str) -> str:
        """The token with this process's name, where others might be asked for what it opens."""
        return f"{self._notices.process_id}{MARK}{token}" if self._notices.shared else token

    def keeper_of(self, token: str) -> Peer | None:
        """The other process that keeps what the token opens; None: this one, or none that lives."""
        process_id, marked, _ = token.partition(MARK)
        if not marked or process_id == self._notices.process_id:
            return None
        return next((peer for peer in self.living() if peer.process_id == process_id), None)

    def _keep_beating(self) -> None:
        while not self._ending.wait(BEAT_S):
            try:
                self._beat()
            except (SQLAlchemyError, StorageError) as problem:
                log.warning("this process could not say that it lives", problem=str(problem)[:200])

    def _beat(self) -> None:
        with self._database.transaction(durable=False) as s:
            now = shared_now(s)
            here = s.get(ServerProcess, self._notices.process_id)
            if here is None:
                s.add(ServerProcess(id=self._notices.process_id, address=self._address, started_at=now, seen_at=now))
            else:
                here.seen_at = now
            s.execute(delete(ServerProcess).where(ServerProcess.seen_at < now - SILENT))
        if self._counts is not None:
            self._counts.remove_old()

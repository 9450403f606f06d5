"""What the server processes of one installation tell each other, and which of them holds what. No meaning lives here.

On PostgreSQL notices go through LISTEN and NOTIFY, and what a process holds is an advisory lock of its connection, so
that it is let go of however the process ends. On SQLite there is one process and nobody to tell.
"""

from __future__ import annotations

import hashlib
import json
import os
import queue
import secrets
import select
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import structlog
from sqlalchemy import text
from sqlalchemy.exc import SQLAlchemyError

from desirepath.store.database import Database, StorageError

CHANNEL = "desirepath"
LARGEST_NOTICE = 7_000  # bytes; PostgreSQL takes 7,999
CHECK_CONNECTION_S = 60.0  # of silence, then a question shows whether the connection lives
CLOSE_PATIENCE_S = 2.0
AGAIN_AFTER_S = 1.0  # a lost connection is asked for again
HOLD_PATIENCE_S = 5.0
log = structlog.get_logger("desirepath.replicas")


@dataclass(frozen=True)
class Notice:
    """One thing told. own: by this process itself; data: JSON's own types."""

    topic: str
    key: str
    data: dict[str, Any]
    own: bool


Heard = Callable[[Notice], None]


class Notices:
    """Of a process that is alone. Methods may be called from any thread; handlers are to be quick."""

    def __init__(self) -> None:
        self.process_id = secrets.token_hex(8)
        self._handlers: dict[str, list[Heard]] = {}
        self._missed: list[Callable[[], None]] = []

    @property
    def shared(self) -> bool:
        """Whether there can be other processes."""
        return False

    def hear(self, topic: str, handler: Heard) -> None:
        """Call `handler` with every notice of that topic, in the order in which all processes hear them."""
        self._handlers.setdefault(topic, []).append(handler)

    def when_missed(self, handler: Callable[[], None]) -> None:
        """Call `handler` when notices may have been missed."""
        self._missed.append(handler)

    def tell_missed(self) -> None:
        """Notices may have been missed: tell whoever asked for that."""
        for handler in self._missed:
            handler()

    def tell(self, topic: str, key: str, **data: Any) -> None:
        """Tell all processes, this one among them. Nobody waits for it."""
        self._hear(Notice(topic, key, data, own=True))

    def hold(self, key: str) -> None:
        """This process has what the key stands for. Once it returns, the others see it."""

    def let_go(self, key: str) -> None:
        """It has it no more."""

    def is_held(self, key: str) -> bool:
        """Whether any process has it."""
        return False

    def start(self) -> None:
        """Begin to listen."""

    def close(self) -> None:
        """Stop listening and let go of everything."""

    def _hear(self, notice: Notice) -> None:
        for handler in self._handlers.get(notice.topic, []):
            try:
                handler(notice)
            except Exception:
                log.exception("a notice could not be heeded", topic=notice.topic)


class PostgresNotices(Notices):
    """Through the PostgreSQL server that the processes share. A connection that is lost is made again."""

    def __init__(self, database: Database) -> None:
        super().__init__()
        import psycopg  # a quarter of a second that a start on SQLite need not wait

        self._psycopg = psycopg
        self._database = database
        self._address = database.url.set(drivername="postgresql").render_as_string(hide_password=False)
        self._orders: queue.SimpleQueue[tuple[str, str, Future[None] | None] | None] = queue.SimpleQueue()
        self._held: set[str] = set()
        self._ending = threading.Event()
        self._ended, self._end = os.pipe()  # the first is read when the second is written: it ends a sleep
        self._listening = threading.Event()
        self._threads = [
            threading.Thread(target=one, daemon=True, name=f"replicas-{name}")
            for name, one in (("listening", self._listen), ("telling", self._work_off))
        ]

    @property
    def shared(self) -> bool:
        return True

    def start(self) -> None:
        for thread in self._threads:
            thread.start()
        self._listening.wait(HOLD_PATIENCE_S)

    def close(self) -> None:
        if self._ending.is_set():
            return
        self._ending.set()
        os.write(self._end, b".")
        self._orders.put(None)
        for thread in self._threads:
            if thread.is_alive():
                thread.join(CLOSE_PATIENCE_S)
        if not self._threads[0].is_alive():
            os.close(self._end)
            os.close(self._ended)

    def tell(self, topic: str, key: str, **data: Any) -> None:
        payload = json.dumps({"from": self.process_id, "topic": topic, "key": key, "data": data})
        if len(payload) > LARGEST_NOTICE:
            raise ValueError(f"a notice of {len(payload)} bytes: at most {LARGEST_NOTICE}")
        self._orders.put(("tell", payload, None))

    def hold(self, key: str) -> None:
        done: Future[None] = Future()
        self._orders.put(("hold", key, done))
        with suppress(TimeoutError):  # it will be held as soon as there is a connection
            done.result(HOLD_PATIENCE_S)

    def let_go(self, key: str) -> None:
        self._orders.put(("let_go", key, None))

    def is_held(self, key: str) -> bool:
        high, low = _lock_of(key)
        asked = text(
            "SELECT EXISTS (SELECT 1 FROM pg_locks WHERE locktype = 'advisory' AND granted AND objsubid = 2 "
            "AND database = (SELECT oid FROM pg_database WHERE datname = current_database()) "
            "AND classid::bigint = :high AND objid::bigint = :low)"
        )
        try:
            with self._database.session() as s:
                return bool(s.scalar(asked, {"high": high % 2**32, "low": low % 2**32}))
        except (SQLAlchemyError, StorageError):
            return False

    def _listen(self) -> None:
        before = False
        while not self._ending.is_set():
            try:
                with self._psycopg.connect(self._address, autocommit=True) as connection:
                    connection.execute(f"LISTEN {CHANNEL}")
                    self._listening.set()
                    if before:
                        self._orders.put(("look", "", None))
                        self.tell_missed()
                    before = True
                    waking = select.poll()  # psycopg's own waiting wakes up ten times a second
                    for descriptor in (connection.fileno(), self._ended):
                        waking.register(descriptor, select.POLLIN)
                    while not self._ending.is_set():
                        for notify in connection.notifies(timeout=0):  # also what came with the last reply
                            self._take(notify.payload)
                        if not waking.poll(CHECK_CONNECTION_S * 1000):
                            connection.execute("SELECT 1")
            except self._psycopg.Error as problem:
                log.warning("the connection for notices was lost and is made again", problem=str(problem)[:200])
                self._ending.wait(AGAIN_AFTER_S)

    def _take(self, payload: str) -> None:
        try:
            sent = json.loads(payload)
            notice = Notice(sent["topic"], sent["key"], sent["data"], own=sent["from"] == self.process_id)
        except (ValueError, KeyError, TypeError):
            log.warning("something on our channel was no notice of ours", bytes=len(payload))
            return
        self._hear(notice)

    def _work_off(self) -> None:
        while not self._ending.is_set():
            try:
                with self._psycopg.connect(self._address, autocommit=True) as connection:
                    for key in self._held:
                        connection.execute("SELECT pg_advisory_lock_shared(%s, %s)", _lock_of(key))
                    while (order := self._orders.get()) is not None:
                        self._carry_out(connection, *order)
                    return
            except self._psycopg.Error as problem:
                log.warning("the connection for notices was lost and is made again", problem=str(problem)[:200])
                self._ending.wait(AGAIN_AFTER_S)

    def _carry_out(self, connection: Any, what: str, value: str, done: Future[None] | None) -> None:
        try:
            if what == "look":  # the other connection may be lost as well, and with it what is held
                connection.execute("SELECT 1")
            elif what == "tell":
                connection.execute("SELECT pg_notify(%s, %s)", (CHANNEL, value))
            elif what == "hold" and value not in self._held:
                self._held.add(value)
                connection.execute("SELECT pg_advisory_lock_shared(%s, %s)", _lock_of(value))
            elif what == "let_go" and value in self._held:
                self._held.remove(value)
                connection.execute("SELECT pg_advisory_unlock_shared(%s, %s)", _lock_of(value))
        except self._psycopg.Error:
            if what == "tell":
                self._orders.put((what, value, None))  # said again on the next connection
            raise
        finally:
            if done is not None:
                done.set_result(None)


def _lock_of(key: str) -> tuple[int, int]:
    """Two signed numbers of 32 bits, as advisory locks have them."""
    digest = hashlib.sha256(f"desirepath {key}".encode()).digest()
    return int.from_bytes(digest[:4], signed=True), int.from_bytes(digest[4:8], signed=True)


def notices_for(database: Database) -> Notices:
    """As the database allows."""
    return Notices() if database.is_sqlite else PostgresNotices(database)

"""Tells workers at once that a job was committed or that a participant is there, so that they need not poll.

On SQLite through one named pipe per worker beside the database file, on PostgreSQL through LISTEN and NOTIFY. A signal
may be lost (a worker that is just starting, a lost connection), so workers look for themselves now and then as well.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import os
import select
import threading
from collections.abc import Callable, Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import event, func
from sqlalchemy import select as select_rows
from sqlalchemy.orm import Session

from desirepath.store.database import Database

CHANNEL = "desirepath_workers"
CHECK_CONNECTION_S = 60.0  # of silence on PostgreSQL, then a question shows whether the connection lives
RECONNECT_AFTER_S = 1.0
READ_BYTES = 4_096
_PENDING = "worker_signals"
log = structlog.get_logger("desirepath.worker")


class Signal(StrEnum):
    """What workers are told: one byte in the pipe, the payload of a NOTIFY."""

    JOB_QUEUED = "j"
    PARTICIPANT_PRESENT = "p"


def signal_workers(s: Session, signal: Signal) -> None:
    """Tell every worker of this database, once, when the transaction of `s` commits."""
    pending = s.info.setdefault(_PENDING, set())
    if signal in pending:
        return
    pending.add(signal)
    engine: Any = s.get_bind().engine

    def notify(s: Session) -> None:
        s.execute(select_rows(func.pg_notify(CHANNEL, signal.value)))  # PostgreSQL delivers it with the commit

    def write(s: Session) -> None:
        pending.discard(signal)
        _write_to_pipes(Path(engine.url.database), signal)

    if engine.dialect.name == "postgresql":
        event.listen(s, "before_commit", notify, once=True)
    else:
        event.listen(s, "after_commit", write, once=True)


def _write_to_pipes(database: Path, signal: Signal) -> None:
    with contextlib.suppress(OSError):  # what is committed stays so, whether or not the folder can be listed
        for pipe in _pipes_beside(database):
            with contextlib.suppress(OSError):  # its worker is gone, or has more to read than it needs to wake up
                descriptor = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
                try:
                    os.write(descriptor, signal.value.encode())
                finally:
                    os.close(descriptor)


def remove_silent_pipes(database: Database) -> None:
    """Take away the pipes that no worker reads: of workers that were killed."""
    if database.file is None:
        return
    for pipe in _pipes_beside(database.file):
        try:
            os.close(os.open(pipe, os.O_WRONLY | os.O_NONBLOCK | os.O_NOFOLLOW))
        except OSError as problem:
            if problem.errno == errno.ENXIO:
                pipe.unlink(missing_ok=True)


def _pipes_beside(database: Path) -> Iterator[Path]:
    return database.parent.glob(f"{glob.escape(database.name)}.worker-*")


class SignalListener:
    """Calls `on_signal` for every signal, on a thread of its own that sleeps between them.

    Args:
        database: whose committed transactions are told.
        name: the worker's, the same after a restart, letters and digits.
        on_signal: has to be quick.
    """

    def __init__(self, database: Database, name: str, on_signal: Callable[[Signal], None]) -> None:
        self._database, self._on_signal = database, on_signal
        file = database.file
        self._pipe = None if file is None else file.absolute().with_name(f"{file.name}.worker-{name}")
        self._closed = threading.Event()
        self.hears = False  # whether a signal sent now would arrive; else the worker has to poll

    def start(self) -> None:
        """Begin to listen."""
        if self._pipe is None:
            threading.Thread(target=self._listen_to_postgres, daemon=True, name="worker-signals").start()
            return
        try:
            opened = _open_pipe(self._pipe)
        except OSError as problem:  # a file system without named pipes
            log.warning("the worker polls for jobs, as it can make no pipe", pipe=str(self._pipe), problem=str(problem))
            return
        self.hears = True
        threading.Thread(target=self._read, args=(opened,), daemon=True, name="worker-signals").start()

    def close(self) -> None:
        """Leave no pipe behind; the thread sleeps on and ends with the process."""
        self._closed.set()
        if self._pipe is not None:
            self._pipe.unlink(missing_ok=True)

    def _read(self, opened: int) -> None:
        while True:
            for signal in set(os.read(opened, READ_BYTES).decode("ascii", errors="replace")):
                self._tell(signal)

    def _tell(self, value: str) -> None:
        try:
            self._on_signal(Signal(value))
        except ValueError:  # of another version
            return
        except Exception:  # such as a process that cannot be started just now: the next signal must still be heard
            log.exception("a signal could not be heeded", signal=value)

    def _listen_to_postgres(self) -> None:
        import psycopg

        address = self._database.url.set(drivername="postgresql").render_as_string(hide_password=False)
        while True:
            try:
                with psycopg.connect(address, autocommit=True) as connection:
                    connection.execute(f"LISTEN {CHANNEL}")
                    self.hears = True
                    self._on_signal(Signal.JOB_QUEUED)  # it may have been told before
                    waking = select.poll()  # psycopg's own waiting wakes up ten times a second
                    waking.register(connection.fileno(), select.POLLIN)
                    while True:
                        for notice in connection.notifies(timeout=0):  # also what came with the last reply
                            self._tell(notice.payload)
                        if not waking.poll(CHECK_CONNECTION_S * 1000):
                            connection.execute("SELECT 1")
            except psycopg.Error as problem:
                self.hears = False
                log.warning("the connection for signals was lost and is made again", problem=str(problem)[:200])
                if self._closed.wait(RECONNECT_AFTER_S):
                    return


def _open_pipe(path: Path) -> int:
    """The named pipe, made where it is missing, opened so that it never comes to an end. Raises OSError."""
    if path.exists() and not path.is_fifo():
        path.unlink()
    with contextlib.suppress(FileExistsError):
        os.mkfifo(path, 0o600)
    return os.open(path, os.O_RDWR | os.O_NOFOLLOW)

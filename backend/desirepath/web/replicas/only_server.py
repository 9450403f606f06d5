"""One server process for a SQLite file: a lock of the operating system's beside it, gone with whoever held it.

What wakes pages, counts attempts and keeps writers in line stands in a server's memory there; of two each would know
half. Several processes on PostgreSQL are `supervisor.py`'s.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from desirepath.settings import Settings
from desirepath.store.database import Database, StorageError, check_writable

TRIES, TRY_S = 5, 0.1


class AlreadyServed(StorageError):
    """Another server process has this installation; names it."""


@contextlib.contextmanager
def only_server(settings: Settings) -> Iterator[None]:
    """Be the only server of this installation, where that is on SQLite. Raises AlreadyServed, StorageError."""
    lock = _lock_file(settings)
    if lock is None:
        yield
        return
    check_writable(settings.data)
    check_writable(lock.parent)
    with os.fdopen(os.open(lock, os.O_RDWR | os.O_CREAT, 0o600), "r+") as held:
        tries = 0
        while not _taken(held):
            tries += 1
            if tries < TRIES:  # somebody may only have asked who serves
                time.sleep(TRY_S)
                continue
            other = _written(held)
            who = f"process {other['pid']} at {other['url']}" if other else "by a process that is starting"
            raise AlreadyServed(
                f"{lock.parent} is served already ({who}), and SQLite serves one process; stop that one, name another "
                "folder with --data, or set DESIREPATH_DATABASE_URL to a PostgreSQL server"
            )
        held.truncate(0)
        held.seek(0)
        held.write(json.dumps({"pid": os.getpid(), "url": settings.local_url}))
        held.flush()
        yield  # closing the file lets go of it


def running_server(settings: Settings) -> str | None:
    """Address of the server that has this installation, where that is on SQLite and one runs."""
    lock = _lock_file(settings)
    if lock is None or not lock.is_file():
        return None
    with lock.open("r+") as asked:
        if _taken(asked, shared=True):
            return None
        return str(_written(asked).get("url", "")) or None


def _lock_file(settings: Settings) -> Path | None:
    file = Database(settings.database).file
    return None if file is None else file.resolve().with_name(f"{file.resolve().name}.serving")


def _taken(file: IO[str], *, shared: bool = False) -> bool:
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _written(file: IO[str]) -> dict[str, Any]:
    try:
        return dict(json.loads(file.read()))
    except (ValueError, TypeError):  # it writes just now
        return {}

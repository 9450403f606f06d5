"""Counts for `limits` in PostgreSQL, so that all server processes count together. What is limited stands in
`core/throttle.py`."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Iterator
from typing import Any

from limits.storage import Storage
from limits.storage.base import SlidingWindowCounterSupport
from sqlalchemy import Connection, create_engine, text
from sqlalchemy.exc import SQLAlchemyError

from desirepath.store.database import Database

# One statement, so that two processes that count at once both count. window: number of the current window since 1970.
_COUNT = text("""
INSERT INTO rate_window AS kept (key_hash, window_number, current, previous, expires_at)
VALUES (:key, :window, :amount, 0, :expires)
ON CONFLICT (key_hash) DO UPDATE SET
  previous = CASE kept.window_number WHEN :window THEN kept.previous WHEN :window - 1 THEN kept.current ELSE 0 END,
  current = CASE kept.window_number WHEN :window THEN kept.current ELSE 0 END + :amount,
  window_number = :window,
  expires_at = :expires
WHERE CASE kept.window_number WHEN :window THEN kept.previous WHEN :window - 1 THEN kept.current ELSE 0 END * :share
  + CASE kept.window_number WHEN :window THEN kept.current ELSE 0 END + :amount < :most + 1
RETURNING current
""")
_READ = text("SELECT window_number, current, previous FROM rate_window WHERE key_hash = :key")


class SharedCounts(Storage, SlidingWindowCounterSupport):
    """Sliding window counters: of each key how many came in this window of time and in the one before.

    Keys hold addresses and tokens; the table has their hashes, for two windows at most.
    """

    STORAGE_SCHEME = ["desirepath"]

    def __init__(self, database: Database) -> None:
        super().__init__()
        self._database = database
        # Connections of their own: a count may be lost with the machine's power, what others commit must not.
        self._engine = create_engine(
            database.url,
            isolation_level="AUTOCOMMIT",
            pool_pre_ping=True,
            connect_args={"options": "-c synchronous_commit=off"},
        )

    @property
    def base_exceptions(self) -> type[Exception]:
        return SQLAlchemyError

    def acquire_sliding_window_entry(self, key: str, limit: int, expiry: int, amount: int = 1) -> bool:
        if amount > limit:
            return False
        window, into = divmod(time.time(), expiry)
        values = {
            "key": _hashed(key),
            "window": int(window),
            "amount": amount,
            "most": limit,
            "share": 1 - into / expiry,
            "expires": (int(window) + 2) * expiry,
        }
        with self._connected() as connection:
            return connection.execute(_COUNT, values).first() is not None

    def get_sliding_window(self, key: str, expiry: int) -> tuple[int, float, int, float]:
        number, into = divmod(time.time(), expiry)
        left = expiry - into
        with self._connected() as connection:
            row = connection.execute(_READ, {"key": _hashed(key)}).first()
        window, current, previous = row or (0, 0, 0)
        if window == int(number):
            return previous, left, current, left + expiry
        return (current, left, 0, left + expiry) if window == int(number) - 1 else (0, 0.0, 0, 0.0)

    def clear_sliding_window(self, key: str, expiry: int) -> None:
        self.clear(key)

    def clear(self, key: str) -> None:
        self._change("DELETE FROM rate_window WHERE key_hash = :key", key=_hashed(key))

    def reset(self) -> int | None:
        return self._change("DELETE FROM rate_window")

    def remove_old(self) -> None:
        """Whatever counts no more."""
        self._change("DELETE FROM rate_window WHERE expires_at < :now", now=time.time())

    def check(self) -> bool:
        with self._connected() as connection:
            return connection.execute(text("SELECT 1")).scalar() == 1

    # The fixed window of `limits`, which nothing here uses.

    def incr(self, key: str, expiry: int, amount: int = 1) -> int:
        raise NotImplementedError("counts are of sliding windows")

    def get(self, key: str) -> int:
        raise NotImplementedError("counts are of sliding windows")

    def get_expiry(self, key: str) -> float:
        raise NotImplementedError("counts are of sliding windows")

    def _change(self, statement: str, **values: Any) -> int:
        with self._connected() as connection:
            return connection.execute(text(statement), values).rowcount

    def close(self) -> None:
        """Give the connections back."""
        self._engine.dispose()

    @contextlib.contextmanager
    def _connected(self) -> Iterator[Connection]:
        with self._database.explain_errors(), self._engine.connect() as connection:
            yield connection


def _hashed(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()

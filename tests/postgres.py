"""PostgreSQL for tests: a server of our own or the one that DESIREPATH_TEST_DATABASE_URL names, databases on it.

Tests that ask for `postgres_server` use it wherever its programs are installed. With DESIREPATH_TEST_DATABASE_URL set
(`own`, or the URL of a server on which databases may be made) all tests with a database of their own run on it instead
of SQLite, but for those about SQLite itself.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest
from sqlalchemy import create_engine, func, insert, select, text
from sqlalchemy.engine import make_url

from desirepath.store.database import Database
from desirepath.store.models import Base
from desirepath_experiments.own_postgres import NoPostgres, own_postgres

ASKED = os.environ.get("DESIREPATH_TEST_DATABASE_URL", "")
OWN = "own"
EMPTY = "desirepath_test_empty"
_numbers = count(1)


@contextmanager
def server() -> Iterator[str]:
    """URL of the server; skips the test where there is none."""
    if ASKED not in ("", OWN):
        yield ASKED
        return
    try:
        with own_postgres(waits_for_the_disk=False) as url:
            yield url
    except NoPostgres as problem:
        pytest.skip(str(problem))


@contextmanager
def holding(server_url: str, sqlite: Path, *, empty: bool = False) -> Iterator[str]:
    """URL of a new database that holds what the SQLite file holds, a migrated empty one where there is no such file;
    empty: one without any table."""
    _make_empty(server_url)
    name = f"desirepath_test_{os.getpid()}_{next(_numbers)}"
    _say(server_url, f"CREATE DATABASE {name}" + ("" if empty else f" TEMPLATE {EMPTY}"))
    url = _url(server_url, name)
    if sqlite.is_file():
        _copy(Database(f"sqlite:///{sqlite}"), Database(url))
    yield url
    _say(server_url, f"DROP DATABASE {name} WITH (FORCE)")


def _make_empty(server_url: str) -> None:
    with create_engine(_psycopg(server_url)).connect() as connection:
        known = connection.execute(text("SELECT 1 FROM pg_database WHERE datname = :name"), {"name": EMPTY}).first()
    if known is None:
        _say(server_url, f"CREATE DATABASE {EMPTY}")
        empty = Database(_url(server_url, EMPTY))
        empty.migrate()
        empty.close()


def _copy(before: Database, after: Database) -> None:
    with before.engine.connect() as reading, after.engine.begin() as writing:
        for table in Base.metadata.sorted_tables:
            rows = [dict(row) for row in reading.execute(select(table)).mappings()]
            if rows:
                writing.execute(insert(table), rows)
            numbered = table.autoincrement_column
            if rows and numbered is not None:
                last = select(func.setval(func.pg_get_serial_sequence(table.name, numbered.name), func.max(numbered)))
                writing.execute(last)
    before.close()
    after.close()


def _say(server_url: str, statement: str) -> None:
    with create_engine(_psycopg(server_url), isolation_level="AUTOCOMMIT").connect() as connection:
        connection.execute(text(statement))


def _url(server_url: str, name: str) -> str:
    return make_url(server_url).set(database=name).render_as_string(hide_password=False)


def _psycopg(url: str) -> str:
    return make_url(url).set(drivername="postgresql+psycopg").render_as_string(hide_password=False)

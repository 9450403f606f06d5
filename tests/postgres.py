"""PostgreSQL for tests: a server of our own or the one that DESIREPATH_TEST_DATABASE_URL names, databases on it.

Tests that ask for `postgres_server` use it wherever its programs are installed. With DESIREPATH_TEST_DATABASE_URL set
(`own`, or the URL of a server on which databases may be made) all tests with a database of their own run on it instead
of SQLite, but for those about SQLite itself.
"""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest
from sqlalchemy import create_engine, func, insert, select, text
from sqlalchemy.engine import make_url

from backend.store.database import Database
from backend.store.models import Base

ASKED = os.environ.get("DESIREPATH_TEST_DATABASE_URL", "")
OWN = "own"
EMPTY = "desirepath_test_empty"
# Keeps a server until its own standard input closes, which it does however the tests end, also by a kill.
KEEPER = """
if told=$("$0" -D "$2/data" -A trust -U desirepath -N -E UTF8 2>&1) &&
    told=$("$1" -D "$2/data" -o "$3" -l "$2/log" -w start 2>&1); then
  echo up
  cat > /dev/null
  "$1" -D "$2/data" -m immediate stop > /dev/null
else
  echo "$told"
  cat "$2/log"
fi
cd /
rm -rf "$2"
"""
_numbers = count(1)


@contextmanager
def server() -> Iterator[str]:
    """URL of the server; skips the test where there is none."""
    if ASKED not in ("", OWN):
        yield ASKED
        return
    initdb, pg_ctl = (_program(name) for name in ("initdb", "pg_ctl"))
    if initdb is None or pg_ctl is None:
        pytest.skip("no PostgreSQL server program (initdb, pg_ctl) is installed")
    as_whom: list[str] = []
    user = None
    if os.geteuid() == 0:  # the server refuses to run as root
        user = next((u.pw_name for u in pwd.getpwall() if u.pw_name in ("postgres", "nobody")), None)
        if user is None or shutil.which("runuser") is None:
            pytest.skip("running as root and there is no user to run PostgreSQL as")
        as_whom = ["runuser", "-u", user, "--"]
    # Not below tmp_path: the server's user may not enter that, and the socket's path must be short.
    folder = Path(tempfile.mkdtemp(prefix="desirepath-pg-"))
    if user is not None:
        shutil.chown(folder, user)
    options = f"-k {folder} -c listen_addresses='' -c fsync=off -c max_connections=200"
    keeper = subprocess.Popen(
        [*as_whom, "sh", "-c", KEEPER, initdb, pg_ctl, str(folder), options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=folder,
        start_new_session=True,
    )
    assert keeper.stdin is not None
    assert keeper.stdout is not None
    try:
        told = keeper.stdout.readline()
        assert told == "up\n", told + keeper.communicate()[0]
        yield f"postgresql://desirepath@/postgres?host={folder}"
    finally:
        keeper.stdin.close()
        keeper.wait(60)


def _program(name: str) -> str | None:
    """On the PATH, or where Debian puts it."""
    debian = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return shutil.which(name) or (str(debian[-1]) if debian else None)


@contextmanager
def holding(server_url: str, sqlite: Path) -> Iterator[str]:
    """URL of a new database that holds what the SQLite file holds, a migrated empty one where there is no such file."""
    _make_empty(server_url)
    name = f"desirepath_test_{os.getpid()}_{next(_numbers)}"
    _say(server_url, f"CREATE DATABASE {name} TEMPLATE {EMPTY}")
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

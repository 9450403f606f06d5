"""What the store's tests share."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from backend.store.artefacts import ArtefactStore
from backend.store.database import Database
from tests.store.small_study import SmallStudy


@pytest.fixture
def study(database: Database, files: ArtefactStore) -> SmallStudy:
    """An open study without participants."""
    return SmallStudy(database, files)


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """URL of a PostgreSQL server of our own on a Unix socket; skipped where no server program is installed."""
    initdb, pg_ctl = (_postgres_program(name) for name in ("initdb", "pg_ctl"))
    if initdb is None or pg_ctl is None:
        pytest.skip("no PostgreSQL server program (initdb, pg_ctl) is installed")
    as_whom: list[str] = []
    # Not below tmp_path: the server's user may not enter that, and the socket's path must be short.
    folder = Path(tempfile.mkdtemp(prefix="desirepath-pg-"))
    if os.geteuid() == 0:  # the server refuses to run as root
        user = next((u.pw_name for u in pwd.getpwall() if u.pw_name in ("postgres", "nobody")), None)
        if user is None or shutil.which("runuser") is None:
            pytest.skip("running as root and there is no user to run PostgreSQL as")
        as_whom = ["runuser", "-u", user, "--"]
        shutil.chown(folder, user)

    def run(*words: str) -> None:
        done = subprocess.run([*as_whom, *words], capture_output=True, text=True)
        assert done.returncode == 0, f"{words[0]}: {done.stdout}{done.stderr}"

    data = str(folder / "data")
    run(initdb, "-D", data, "-A", "trust", "-U", "desirepath", "-N", "-E", "UTF8")
    options = f"-k {folder} -c listen_addresses='' -c fsync=off"
    run(pg_ctl, "-D", data, "-o", options, "-l", str(folder / "log"), "-w", "start")
    yield f"postgresql://desirepath@/postgres?host={folder}"
    run(pg_ctl, "-D", data, "-m", "immediate", "stop")
    shutil.rmtree(folder)


def _postgres_program(name: str) -> str | None:
    """On the PATH, or where Debian puts it."""
    debian = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return shutil.which(name) or (str(debian[-1]) if debian else None)


@pytest.fixture(params=["sqlite", "postgresql"])
def either(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """An empty database of each kind, not migrated."""
    if request.param == "sqlite":
        yield Database(f"sqlite:///{tmp_path / 'either.sqlite'}")
        return
    url = request.getfixturevalue("postgres_server")
    found = Database(url)
    with found.engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    yield found
    found.close()

"""What the store's tests share."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_study import SmallStudy
from sqlalchemy import text

from backend.store.artefacts import ArtefactStore
from backend.store.database import Database


@pytest.fixture
def study(database: Database, files: ArtefactStore) -> SmallStudy:
    """An open study without participants."""
    return SmallStudy(database, files)


@pytest.fixture(scope="session")
def postgres_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """URL of a PostgreSQL server of our own on a Unix socket; skipped where no server program is installed."""
    programs = {name: shutil.which(name) for name in ("initdb", "pg_ctl")}
    if None in programs.values():
        pytest.skip("no PostgreSQL server program (initdb, pg_ctl) on the PATH")
    folder = Path(tmp_path_factory.mktemp("pg"))
    as_whom: list[str] = []
    if os.geteuid() == 0:  # the server refuses to run as root
        user = next((u.pw_name for u in pwd.getpwall() if u.pw_name in ("postgres", "nobody")), None)
        if user is None or shutil.which("runuser") is None:
            pytest.skip("running as root and there is no user to run PostgreSQL as")
        as_whom = ["runuser", "-u", user, "--"]
        for parent in (folder, *folder.parents[:3]):
            if str(parent).startswith(str(tmp_path_factory.getbasetemp().parent.parent)):
                parent.chmod(parent.stat().st_mode | 0o011)
        shutil.chown(folder, user)
    data, run = folder / "data", lambda *words: subprocess.run([*as_whom, *words], check=True, capture_output=True)
    run(programs["initdb"], "-D", str(data), "-A", "trust", "-U", "desirepath", "-N", "-E", "UTF8")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = f"-k {folder} -p {port} -c listen_addresses='' -c fsync=off"
    run(programs["pg_ctl"], "-D", str(data), "-o", options, "-l", str(folder / "log"), "-w", "start")
    yield f"postgresql://desirepath@/postgres?host={folder}&port={port}"
    run(programs["pg_ctl"], "-D", str(data), "-m", "immediate", "stop")


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

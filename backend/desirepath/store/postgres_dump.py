"""PostgreSQL's part of a backup, by its own programs (`pg_dump`, `pg_restore`): our tables as they are at one moment.

What a backup is made of besides lives in `backup.py`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from sqlalchemy import inspect, text
from sqlalchemy.engine import URL

from desirepath.store.database import Database

NAMED_FILES = (
    "SELECT id, FALSE FROM trajectory",
    "SELECT id, quarantined_at IS NOT NULL FROM artefact",
    "SELECT demonstration, FALSE FROM stroke WHERE demonstration IS NOT NULL",
    "SELECT sha256, FALSE FROM task_file",
)
"""Of any database: the files that rows name, and whether an erasure may have removed the file itself."""


class BackupError(ValueError):
    """The backup cannot be made or brought back; nothing was changed."""


def dump(db: Database, out: Path) -> dict[str, bool]:
    """Write our tables (not the jobs' own) to `out`, in pg_dump's own format; others may write meanwhile.

    Returns the files that rows in it name -> whether an erasure may have removed the file itself. Raises BackupError.
    """
    # What is dumped and what is asked here is one and the same moment.
    with db.explain_errors(), db.engine.connect().execution_options(isolation_level="REPEATABLE READ") as connection:
        moment = connection.execute(text("SELECT pg_export_snapshot()")).scalar_one()
        options = ["--format=custom", "--no-owner", "--no-privileges", f"--snapshot={moment}", f"--file={out}"]
        _run("pg_dump", db.url, [*options, "--schema=public"])
        rows = [row for query in NAMED_FILES for row in connection.execute(text(query))]
    return dict(sorted((str(name), bool(gone)) for name, gone in rows))


def check_empty(url: str) -> None:
    """Raises BackupError where a database has tables already."""
    database = Database(url)
    try:
        tables = inspect(database.engine).get_table_names()
    finally:
        database.close()
    if tables:
        name = database.url.database
        raise BackupError(
            f"database {name!r} has tables already ({min(tables)}); bring a backup back into an empty one"
        )


def bring_back(url: str, dumped: Path) -> None:
    """Load what `dump` wrote, all of it or nothing. Raises BackupError."""
    database = Database(url)
    try:
        # The dump makes the schema itself, with what stands in it; an empty database has an empty one.
        with database.engine.begin() as connection:
            connection.execute(text("DROP SCHEMA IF EXISTS public"))
        try:
            _run("pg_restore", database.url, ["--no-owner", "--single-transaction", "--exit-on-error", str(dumped)])
        finally:
            with database.engine.begin() as connection:
                connection.execute(text("CREATE SCHEMA IF NOT EXISTS public"))
    finally:
        database.close()


def _run(program: str, url: URL, options: list[str]) -> None:
    path = shutil.which(program) or _debians(program)
    if path is None:
        raise BackupError(f"{program} is not installed here; Debian's package is `postgresql-client`")
    plain = url.set(drivername="postgresql", password=None).render_as_string(hide_password=False)
    # Not on the command line, where everybody on the machine could read it.
    known = os.environ | ({"PGPASSWORD": url.password} if url.password else {})
    ended = subprocess.run(
        [path, f"--dbname={plain}", *options], env=known, capture_output=True, text=True, check=False
    )
    if ended.returncode != 0:
        raise BackupError(f"{program}: {ended.stderr.strip()[-800:]}")


def _debians(program: str) -> str | None:
    installed = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{program}"))
    return str(installed[-1]) if installed else None

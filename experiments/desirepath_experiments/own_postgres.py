"""A PostgreSQL server of the command's own, for benchmarks and tests: a socket in its own folder, gone afterwards."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Keeps a server until its own standard input closes, which it does however the caller ends, also by a kill.
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


class NoPostgres(RuntimeError):
    """No PostgreSQL server can be started here; says what is missing."""


@contextmanager
def own_postgres(*, waits_for_the_disk: bool = True) -> Iterator[str]:
    """URL of a fresh server's database `postgres`. waits_for_the_disk: False only where nothing has to survive.

    Raises NoPostgres.
    """
    initdb, pg_ctl = (_program(name) for name in ("initdb", "pg_ctl"))
    if initdb is None or pg_ctl is None:
        raise NoPostgres("no PostgreSQL server program (initdb, pg_ctl) is installed; Debian's package is `postgresql`")
    as_whom: list[str] = []
    user = None
    if os.geteuid() == 0:  # the server refuses to run as root
        user = next((u.pw_name for u in pwd.getpwall() if u.pw_name in ("postgres", "nobody")), None)
        if user is None or shutil.which("runuser") is None:
            raise NoPostgres("this runs as root, and there is no user to run PostgreSQL as (postgres, nobody; runuser)")
        as_whom = ["runuser", "-u", user, "--"]
    # Its user may not enter a folder of root's, and the socket's path must be short.
    folder = Path(tempfile.mkdtemp(prefix="desirepath-pg-"))
    if user is not None:
        shutil.chown(folder, user)
    options = f"-k {folder} -c listen_addresses='' -c max_connections=200"
    if not waits_for_the_disk:
        options += " -c fsync=off"
    keeper = subprocess.Popen(
        [*as_whom, "sh", "-c", KEEPER, initdb, pg_ctl, str(folder), options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=folder,
        start_new_session=True,
    )
    assert keeper.stdin is not None  # noqa: S101  pipes were asked for
    assert keeper.stdout is not None  # noqa: S101
    try:
        answer = keeper.stdout.readline()
        if answer != "up\n":
            raise NoPostgres(f"PostgreSQL did not start: {answer}{keeper.communicate()[0]}")
        yield f"postgresql://desirepath@/postgres?host={folder}"
    finally:
        keeper.stdin.close()
        keeper.wait(60)


def own_postgres_pid(folder: str) -> int:
    """The process of a server of `own_postgres`, whose URL names the folder as its host."""
    return int((Path(folder) / "data" / "postmaster.pid").read_text(encoding="utf-8").splitlines()[0])


def _program(name: str) -> str | None:
    """On the PATH, or where Debian puts it."""
    debian = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return shutil.which(name) or (str(debian[-1]) if debian else None)

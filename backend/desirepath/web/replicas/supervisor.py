"""`desirepath serve --processes N`: several server processes behind the same two ports, and one worker beside them.

The kernel gives each new connection to one of them. One that dies is started again; what somebody was in the middle of
goes on in another. Every process is a `desirepath serve` of its own, which ends with this one, however it ends.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import structlog

from desirepath.jobs.process import environment_of, start_worker
from desirepath.settings import Settings
from desirepath.store.database import Database
from desirepath.web.core.dependencies import Services
from desirepath.web.core.monitoring import COUNTED_TOGETHER
from desirepath.web.replicas.peers import Peers
from desirepath.web.server import ServerError, check_ports, run

AGAIN_AFTER_S = 2.0  # a process that dies at once is not started faster than this
START_PATIENCE_S = 60.0
STOP_PATIENCE_S = 15.0
LOOK_S = 0.2
MOST_PROCESSES = 64  # ours
COUNTS = "desirepath-counts-"
UNHELD_S = 60.0  # between making a folder and locking it lies next to nothing
log = structlog.get_logger("desirepath.server")


def check_can_share(database: Database, processes: int) -> None:
    """Raise ServerError where several processes cannot serve this installation."""
    if not 1 <= processes <= MOST_PROCESSES:
        raise ServerError(f"processes = {processes}: 1 to {MOST_PROCESSES}")
    if processes > 1 and database.is_sqlite:
        raise ServerError(
            f"processes = {processes}: {database.file} is SQLite, which cannot tell another process that something has "
            "changed, and lets one writer in at a time; set DESIREPATH_DATABASE_URL to a PostgreSQL server, or "
            "serve with one process"
        )


def serve_many(settings: Settings, peers: Peers, processes: int, *, on_ready: Callable[[], None]) -> None:
    """Serve until SIGINT or SIGTERM. on_ready: called once when all processes are listening."""
    check_ports(settings)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    began, begun_at, ready = time.monotonic(), peers.now(), False
    counts, held = _counts_folder()
    servers = [_start(settings, str(counts)) for _ in range(processes)]
    worker = None
    started_at = [began] * processes
    try:
        while not stopping.wait(LOOK_S):
            now = time.monotonic()
            for place, process in enumerate(servers):
                if process.poll() is not None and now - started_at[place] > AGAIN_AFTER_S:
                    if not ready:
                        raise ServerError(f"a server process ended with {process.returncode}; its log says why")
                    log.warning("a server process ended and is started again", exit_code=process.returncode)
                    servers[place], started_at[place] = _start(settings, str(counts)), now
            if not ready and len(peers.living(since=begun_at)) >= processes:
                ready = True
                on_ready()
            if not ready and now - began > START_PATIENCE_S:
                raise ServerError(f"the server processes were not listening within {START_PATIENCE_S:.0f} s")
            if ready and settings.worker and (worker is None or worker.poll() is not None):
                worker = start_worker(settings)
    finally:
        _stop([*servers, *([worker] if worker is not None else [])])
        shutil.rmtree(counts, ignore_errors=True)
        os.close(held)


def serve_one(services: Services) -> None:
    """Serve as one of several; take the folder of counts away where the supervisor was killed and could not."""
    supervisor, counts = os.getppid(), Path(os.environ.get(COUNTED_TOGETHER, ""))
    try:
        run(services)
    finally:
        if os.getppid() != supervisor and counts.name.startswith(COUNTS):
            shutil.rmtree(counts, ignore_errors=True)


def _counts_folder() -> tuple[Path, int]:
    """A new folder for what the processes count, and the lock that is held on it; those of supervisors that were killed
    go. Not in the data folder: what is counted is written through memory, and a full disk would kill who writes there.
    """
    for left in Path(tempfile.gettempdir()).glob(f"{COUNTS}*"):
        with contextlib.suppress(OSError):  # somebody else's, no folder, or still held
            if time.time() - left.lstat().st_mtime > UNHELD_S and left.lstat().st_uid == os.getuid():
                lock = _locked(left)
                shutil.rmtree(left)
                os.close(lock)
    made = Path(tempfile.mkdtemp(prefix=COUNTS))
    return made, _locked(made)


def _locked(folder: Path) -> int:
    opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(opened)
        raise
    return opened


def _start(settings: Settings, counts: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "desirepath.cli.ends_with_parent", "serve"],
        env=environment_of(settings)
        | {
            "DESIREPATH_WORKER": "false",
            COUNTED_TOGETHER: counts,
            "DESIREPATH_SHARES_PORTS": "true",
            "DESIREPATH_HOST": settings.host,
            "DESIREPATH_PORT": str(settings.port),
        },
        stdin=subprocess.PIPE,  # closes when this process ends, and ends the other
        start_new_session=True,
    )


def _stop(processes: list[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
    deadline = time.monotonic() + STOP_PATIENCE_S
    for process in processes:
        try:
            process.wait(max(0.1, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()

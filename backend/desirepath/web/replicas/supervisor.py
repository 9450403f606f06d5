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
import time
from collections.abc import Callable
from pathlib import Path

import structlog

from desirepath.collecting import wake_on_signals
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
LOOK_S = 0.2  # until all processes are listening
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
    began, begun_at, ready = time.monotonic(), peers.now(), False
    counts, held = _counts_folder()

    def start_server() -> subprocess.Popen[bytes]:
        return _start(settings, str(counts))

    children: list[_Child] = []
    try:
        with wake_on_signals() as sleep:
            children += [_Child(start_server) for _ in range(processes)]
            wait_s: float | None = LOOK_S
            while not sleep(wait_s):
                ended = [child for child in children if child.process.poll() is not None]
                if ended and not ready:
                    raise ServerError(f"a server process ended with {ended[0].process.returncode}; its log says why")
                if not ready and len(peers.living(since=begun_at)) >= processes:
                    ready = True
                    on_ready()
                    children += [_Child(lambda: start_worker(settings))] if settings.worker else []
                if not ready and time.monotonic() - began > START_PATIENCE_S:
                    raise ServerError(f"the server processes were not listening within {START_PATIENCE_S:.0f} s")
                waits = [child.start_again() for child in ended]
                wait_s = min((left for left in waits if left > 0), default=None) if ready else LOOK_S
    finally:
        _stop([child.process for child in children])
        shutil.rmtree(counts, ignore_errors=True)
        os.close(held)


class _Child:
    """A process that is to run as long as this one does."""

    def __init__(self, start: Callable[[], subprocess.Popen[bytes]]) -> None:
        self._start = start
        self.process, self._started_at = start(), time.monotonic()

    def start_again(self) -> float:
        """Start it once more, after it has ended. Returns how many seconds that has to wait yet; then nothing is
        done."""
        left = self._started_at + AGAIN_AFTER_S - time.monotonic()
        if left <= 0:
            log.warning("a process ended and is started again", exit_code=self.process.returncode)
            self.process, self._started_at = self._start(), time.monotonic()
        return left


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

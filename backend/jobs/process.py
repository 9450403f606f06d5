"""One attempt at a job: a training process of its own, watched, and killed with all its children on cancel.

The worker must stay able to answer while a training runs, and a training that dies must take nothing with it, so no
job runs inside the worker. What the process does lives in `run.py`.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from datetime import datetime
from enum import IntEnum, StrEnum
from pathlib import Path

import structlog

from backend.settings import Settings
from backend.store.database import Database
from backend.store.models import Job, utc_now

POLL_S = 0.2
HEARTBEAT_S = 2.0
KILL_AFTER_S = 3.0  # from asking the group to end to killing it
FINAL_STATES = ("succeeded", "failed", "cancelled")
LOG_TAIL_BYTES = 2_000
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS", "NUMBA")}

log = structlog.get_logger("desirepath.jobs")


class Outcome(StrEnum):
    """How an attempt ended. `crashed`: killed by a signal, so another attempt may work."""

    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"
    CRASHED = "crashed"


class ExitCode(IntEnum):
    """What the training process says by its exit code."""

    DONE = 0  # the row says succeeded or cancelled
    FAILED = 3  # the row says why
    ORPHANED = 4  # its worker is gone


def log_file(settings: Settings, job_id: str) -> Path:
    """Where a job's processes write; all attempts in one file."""
    return settings.data / "logs" / "jobs" / f"{job_id}.log"


def read_log(settings: Settings, job_id: str, last_bytes: int = LOG_TAIL_BYTES) -> str:
    """The end of a job's log, whole lines only; empty where there is none."""
    try:
        with log_file(settings, job_id).open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - last_bytes))
            text = file.read().decode("utf-8", errors="replace")
    except FileNotFoundError:
        return ""
    return text.partition("\n")[2] if size > last_bytes else text


def environment_of(settings: Settings) -> dict[str, str]:
    """The environment in which a process of ours sees the same installation, one thread per library."""
    return {
        **os.environ,
        **ONE_THREAD,
        "DESIREPATH_DATA": str(settings.data.resolve()),
        "DESIREPATH_DATABASE_URL": settings.database,
        "DESIREPATH_ARTEFACTS_URL": settings.artefacts,
    }


def start_process(settings: Settings, job_id: str | None = None) -> subprocess.Popen[bytes]:
    """A training process for that job, or one that gets everything ready and waits to be told (`assign`)."""
    command = [sys.executable, "-m", "backend.jobs.run", str(os.getpid())]
    return subprocess.Popen(
        command if job_id is None else [*command, job_id],
        env=environment_of(settings),
        stdin=subprocess.PIPE,
        start_new_session=True,
    )


def assign(process: subprocess.Popen[bytes], job_id: str) -> None:
    """Tell a waiting process its job. One that died meanwhile is found dead by `_watch`."""
    assert process.stdin is not None  # noqa: S101  opened by start_process
    with contextlib.suppress(BrokenPipeError), process.stdin:
        process.stdin.write(f"{job_id}\n".encode())


class Spare:
    """One training process that waits with torch and the simulator loaded: whoever sits in front of a page gets it,
    and saves the seconds that starting takes. None is kept where `wanted` is false."""

    def __init__(self, settings: Settings, *, wanted: bool) -> None:
        self._settings, self._wanted = settings, wanted
        self._lock = threading.Lock()
        self._waiting = start_process(settings) if wanted else None

    def take(self, job_id: str) -> subprocess.Popen[bytes]:
        """The waiting process if it lives, else a fresh one, with that job; the next spare starts at once."""
        with self._lock:
            process, self._waiting = self._waiting, start_process(self._settings) if self._wanted else None
        if process is None or process.poll() is not None:
            return start_process(self._settings, job_id)
        assign(process, job_id)
        return process

    def end(self) -> None:
        """Let go of the waiting process."""
        with self._lock:
            process, self._waiting, self._wanted = self._waiting, None, False
        if process is not None:
            end_group(process)


def run_attempt(
    database: Database,
    settings: Settings,
    job_id: str,
    number: int,
    running: dict[str, subprocess.Popen[bytes]],
    spare: Spare,
) -> Outcome:
    """Run attempt `number` (from 1) in a process of its own until it ends, is cancelled or dies.

    The process stands in `running` under the job's id for as long as it lives. Jobs of a session get the spare one.
    """
    of_a_session = _begin(database, job_id, number)
    if isinstance(of_a_session, Outcome):
        return of_a_session
    process = spare.take(job_id) if of_a_session else start_process(settings, job_id)
    log.info("job started", job=job_id, attempt=number, pid=process.pid)
    running[job_id] = process
    try:
        _watch(database, job_id, process)
    finally:
        end_group(process)
        del running[job_id]
    return _outcome(database, settings, job_id, process.returncode)


def _begin(database: Database, job_id: str, number: int) -> Outcome | bool:
    """Mark the job as running. Returns whether it is a session's; an outcome if it has ended or must not start."""
    with database.transaction() as s:
        job = s.get(Job, job_id)
        if job is None:  # erased while it was queued
            return Outcome.CANCELLED
        if job.state in FINAL_STATES:
            return Outcome(job.state)
        if job.state == "cancelling":
            finish(job, "cancelled")
            return Outcome.CANCELLED
        now = utc_now()
        job.state, job.started_at, job.heartbeat_at, job.progress = "running", job.started_at or now, now, 0.0
        job.message = "" if number == 1 else f"attempt {number}"
        return job.session_id is not None


def _watch(database: Database, job_id: str, process: subprocess.Popen[bytes]) -> None:
    """Wait for the process; look for a cancel twice a second, tell that we are alive every two seconds."""
    beat: datetime = utc_now()
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(POLL_S)
            return
        with database.session() as s:
            job = s.get(Job, job_id)
            state = job.state if job else "cancelling"
        if state == "cancelling":
            return
        if (utc_now() - beat).total_seconds() >= HEARTBEAT_S:
            beat = utc_now()
            with database.transaction() as s:
                job = s.get(Job, job_id)
                if job is not None:
                    job.heartbeat_at = beat


def end_group(process: subprocess.Popen[bytes]) -> None:
    """End the process and everything it started: ask, wait, kill."""
    with contextlib.suppress(ProcessLookupError):
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            deadline = time.monotonic() + KILL_AFTER_S
            while process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.05)
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _outcome(database: Database, settings: Settings, job_id: str, code: int) -> Outcome:
    with database.transaction() as s:
        job = s.get(Job, job_id)
        if job is None:
            return Outcome.CANCELLED
        if job.state in FINAL_STATES:
            return Outcome(job.state)
        if job.state == "cancelling":
            finish(job, "cancelled")
            return Outcome.CANCELLED
        if code < 0:
            name = signal.Signals(-code).name
            job.error = f"The training process was killed by {name}. Out of memory is the usual cause; see the log."
            log.warning("job's process was killed", job=job_id, signal=name)
            return Outcome.CRASHED
        job.error = f"The training process ended with exit code {code}:\n{read_log(settings, job_id)}".strip()
        finish(job, "failed")
        return Outcome.FAILED


def conclude(database: Database, job_id: str, outcome: str) -> None:
    """Write the final state of a job whose attempts are used up."""
    if outcome != Outcome.CRASHED:
        return
    with database.transaction() as s:
        job = s.get(Job, job_id)
        if job is not None and job.state not in FINAL_STATES:
            job.error = f"{job.error or ''} It was tried again once and died again.".strip()
            finish(job, "failed")


def finish(job: Job, state: str) -> None:
    """Put a job into one of its final states."""
    job.state, job.finished_at = state, utc_now()
    if state == "succeeded":
        job.progress = 1.0
        job.error = None

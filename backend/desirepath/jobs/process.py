"""One attempt at a job: a training process of its own, watched, and killed with all its children on cancel.

The worker must stay able to answer while a training runs, and a training that dies must take nothing with it, so no
job runs inside the worker. What the process does lives in `run.py`.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import IO, Any, NoReturn, TypeVar

import structlog

from desirepath.jobs.leases import (
    KEPT_LOG_BYTES,
    WorkerName,
    begin_attempt,
    end_attempt,
    holds,
    say_under_way,
    this_process,
)
from desirepath.settings import Settings
from desirepath.store.database import Database, StorageError
from desirepath.store.models import Job, utc_now
from desirepath.store.outbox import ENDED, is_instant

POLL_S = 0.2
PARENT_POLL_S = 0.5  # where the system cannot tell
HEARTBEAT_S = 2.0
WRITE_TRIES = 10  # at the start and the end of a job, each with the database's own patience
WAIT_S = (0.2, 5.0)  # before the second of these tries, and the longest; each waits twice as long as the one before
ATTEMPT_TRIES = 5  # of an attempt whose process found the database away or the disk full, with the same waits
STANDS_S = 600.0  # ours: how long the standing process outlasts the last sign of a participant
KILL_AFTER_S = 3.0  # from asking the group to end to killing it
FINAL_STATES = ENDED
LOG_TAIL_BYTES = 2_000
ASKED_TO_END = (-signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP)
STOPPING_SEEN_S = 5.0  # a service manager asks the worker and its trainings to end at the same moment
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS", "NUMBA")}

T = TypeVar("T")

log = structlog.get_logger("desirepath.jobs")


class Outcome(StrEnum):
    """How an attempt ended. `crashed`: killed by a signal, so another attempt may work; `again`: it could not work
    just now, which is no attempt; `lost`: another worker has taken the job up; `stopped`: its worker was stopped in
    order, which is no attempt either."""

    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"
    CRASHED = "crashed"
    AGAIN = "again"
    LOST = "lost"
    STOPPED = "stopped"


class ExitCode(IntEnum):
    """What the training process says by its exit code."""

    DONE = 0  # the row says succeeded or cancelled
    AGAIN = 2  # the database was away or the disk full: the same once more may work
    FAILED = 3  # the row says why
    ORPHANED = 4  # its worker is gone


def log_folder(settings: Settings) -> Path:
    """Where this machine's training processes write."""
    return settings.data / "logs" / "jobs"


def log_file(settings: Settings, job_id: str) -> Path:
    """Where a job's processes write; all attempts in one file."""
    return log_folder(settings) / f"{job_id}.log"


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
    """The environment in which a process of ours sees the same installation."""
    return {
        **os.environ,
        "DESIREPATH_DATA": str(settings.data.resolve()),
        "DESIREPATH_DATABASE_URL": settings.database,
        "DESIREPATH_ARTEFACTS_URL": settings.artefacts,
    }


def start_worker(settings: Settings, output: IO[Any] | None = None, *, quiet: bool = False) -> subprocess.Popen[bytes]:
    """The background worker as its own process with the same settings; it ends with us, even if we are killed.

    What it prints goes to `output`, by default where ours goes. quiet: it prints only what goes wrong.
    """
    command = [sys.executable, "-m", "desirepath", "worker", "--parent", str(os.getpid()), *["--quiet"] * quiet]
    return subprocess.Popen(
        command, env=environment_of(settings), stdout=output, stderr=None if output is None else subprocess.STDOUT
    )


def start_process(settings: Settings, job_id: str | None = None, attempt: str = "") -> subprocess.Popen[bytes]:
    """A training process for that attempt at a job; without one, a standing process: it gets everything ready, is told
    jobs one after another on its standard input (`Standing.take`), and says on its standard output how each ended."""
    command = [sys.executable, "-m", "desirepath.jobs.run", str(os.getpid())]
    return subprocess.Popen(
        command if job_id is None else [*command, job_id, attempt],
        env=environment_of(settings) | ONE_THREAD,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE if job_id is None else None,
        start_new_session=True,
    )


class Standing:
    """One process that stands ready with torch and the simulator loaded, for jobs that take less time than that.

    It is started by `want` and ended by `rest`. While it works, further jobs get processes of their own. None is kept
    where `allowed` is false.
    """

    def __init__(self, settings: Settings, *, allowed: bool) -> None:
        self._settings, self._allowed = settings, allowed
        self._lock = threading.Lock()
        self._wanted_at: float | None = None
        self._at_work: subprocess.Popen[bytes] | None = None
        self.ready: subprocess.Popen[bytes] | None = None  # stands by, for the next instant job

    def want(self) -> None:
        """Somebody is there who may need it: start it, unless it runs."""
        if not self._allowed:
            return
        with self._lock:
            self._wanted_at = time.monotonic()
            died = self.ready is not None and self.ready.poll() is not None
            if self._at_work is None and (self.ready is None or died):
                self.ready = start_process(self._settings)

    def rest(self) -> None:
        """End it if nobody has wanted it for `STANDS_S`."""
        with self._lock:
            if self._wanted_at is None or time.monotonic() - self._wanted_at < STANDS_S:
                return
            self._wanted_at = None
            process, self.ready = self.ready, None
        if process is not None:
            end_group(process)

    def take(self, job_id: str, attempt: str = "") -> subprocess.Popen[bytes]:
        """The standing process if it is free and lives, else a fresh one, with that job."""
        with self._lock:
            process, self.ready = self.ready, None
            if self._allowed:
                self._wanted_at = time.monotonic()  # where none stood ready, the next job shall find one
            if process is not None and process.poll() is None:
                self._at_work = process
            else:
                process = None
        if process is None:
            return start_process(self._settings, job_id, attempt)
        assert process.stdin is not None  # noqa: S101  opened by start_process
        with contextlib.suppress(BrokenPipeError):  # it died just now, which `watch` finds
            process.stdin.write(f"{job_id} {attempt}\n".encode())
            process.stdin.flush()
        return process

    def give_back(self, process: subprocess.Popen[bytes]) -> None:
        """Take a process that has done its job; one that cannot stand, or has died, is replaced while one is wanted."""
        stands = process.stdout is not None and process.poll() is None
        with self._lock:
            if process is self._at_work:
                self._at_work = None
            if stands and self._wanted_at is not None and self.ready is None:
                self.ready = process
                return
        end_group(process)
        with self._lock:
            if self._wanted_at is not None and self._at_work is None and self.ready is None:
                self.ready = start_process(self._settings)

    def end(self) -> None:
        """Let go of the process that stands ready."""
        with self._lock:
            process, self.ready, self._wanted_at, self._allowed = self.ready, None, None, False
        if process is not None:
            end_group(process)


def patiently(write: Callable[[], T]) -> T:
    """What `write` returns, called again where others write for long, the database is away or the disk is full: a
    training must not be lost for a line about it.

    Raises StorageError when it was tried `WRITE_TRIES` times in vain, half a minute later.
    """
    for wait_s in _waits(WRITE_TRIES):
        try:
            return write()
        except StorageError as problem:
            log.warning("the database is waited for", problem=str(problem)[:200])
            time.sleep(wait_s)
    return write()


def _waits(tries: int) -> list[float]:
    return [min(WAIT_S[0] * 2**number, WAIT_S[1]) for number in range(tries - 1)]


def run_attempt(
    database: Database,
    settings: Settings,
    job_id: str,
    number: int,
    running: dict[str, subprocess.Popen[bytes]],
    standing: Standing,
    stopping: threading.Event,
    worker: WorkerName | None = None,
) -> Outcome:
    """Run attempt `number` (from 1) in a process until the job ends, is cancelled or the process dies.

    The process stands in `running` under the job's id for as long as it works. Instant jobs get the standing one. One
    that found the database away or the disk full is followed by another, some times. Never returns once the worker is
    `stopping`: the queue must not hear of an end, so that the next worker runs this very attempt.
    """
    for wait_s in [*_waits(ATTEMPT_TRIES), None]:
        outcome = _run_process(
            database, settings, job_id, number, running, standing, stopping, worker or this_process()
        )
        if outcome != Outcome.AGAIN:
            return outcome
        if wait_s is not None:
            time.sleep(wait_s)
    return patiently(lambda: _give_up_waiting(database, settings, job_id))


def _run_process(
    database: Database,
    settings: Settings,
    job_id: str,
    number: int,
    running: dict[str, subprocess.Popen[bytes]],
    standing: Standing,
    stopping: threading.Event,
    worker: WorkerName,
) -> Outcome:
    if stopping.is_set():
        _wait_for_the_end()
    begun = patiently(lambda: _begin(database, job_id, number, worker))
    if isinstance(begun, Outcome):
        return begun
    instant, attempt = begun
    process = standing.take(job_id, attempt) if instant else start_process(settings, job_id, attempt)
    log.info("job started", job=job_id, attempt=number, pid=process.pid)
    running[job_id] = process
    code = None
    try:
        code = watch(database, job_id, process, attempt)
        if code is not None and _was_stopped(code, stopping):
            _wait_for_the_end()
    finally:
        del running[job_id]
        if code is None or not instant:
            end_group(process)
        if instant:
            standing.give_back(process)
    code = process.returncode if code is None else code
    return patiently(lambda: _outcome(database, settings, job_id, code, attempt))


def _was_stopped(code: int, stopping: threading.Event) -> bool:
    """Whether the process was ended because the worker is."""
    return code < 0 and (stopping.is_set() or (code in ASKED_TO_END and stopping.wait(STOPPING_SEEN_S)))


def _wait_for_the_end() -> NoReturn:
    """The worker ends within seconds, and this thread with it."""
    while True:
        time.sleep(60)


def leave_to_the_next(database: Database, settings: Settings, job_id: str) -> None:
    """Write down that a job's attempt was cut short because its worker was stopped in order."""
    with database.transaction() as s:
        job = s.get(Job, job_id, with_for_update=True)
        if job is not None and job.state not in FINAL_STATES and job.held_by is not None:
            end_attempt(s, job.held_by, Outcome.STOPPED, read_log(settings, job_id, KEPT_LOG_BYTES))


def _begin(database: Database, job_id: str, number: int, worker: WorkerName) -> Outcome | tuple[bool, str]:
    """Mark the job as running, by us. Returns whether it is an instant one and the attempt's id; an outcome if it has
    ended or must not start."""
    with database.transaction() as s:
        job = s.get(Job, job_id, with_for_update=True)
        if job is None:  # erased while it was queued
            return Outcome.CANCELLED
        if job.state in FINAL_STATES:
            return Outcome(job.state)
        if job.state == "cancelling":
            finish(job, "cancelled")
            return Outcome.CANCELLED
        attempt = begin_attempt(s, job, worker)
        job.state, job.started_at, job.progress = "running", job.started_at or utc_now(), 0.0
        job.message = "" if number == 1 else f"attempt {number}"
        return is_instant(job), attempt


def watch(database: Database, job_id: str, process: subprocess.Popen[bytes], attempt: str | None = None) -> int | None:
    """Wait for the job's exit code, telling every two seconds that we are alive. None: the job is to be cancelled, or
    another worker has it."""
    beat = time.monotonic()
    while True:
        code = exit_code(process, POLL_S)
        if code is not None:
            return code
        if patiently(lambda: _must_end(database, job_id, attempt)):
            return None
        if time.monotonic() - beat >= HEARTBEAT_S:
            beat = time.monotonic()
            # Where others write for long, the next sign of life will do; a training must not be lost for it.
            with contextlib.suppress(StorageError), database.transaction() as s:
                job = s.get(Job, job_id)
                if job is not None and job.held_by == attempt:
                    say_under_way(s, job)


def _must_end(database: Database, job_id: str, attempt: str | None) -> bool:
    with database.session() as s:
        job = s.get(Job, job_id)
        return job is None or job.state == "cancelling" or not holds(job, attempt)


def exit_code(process: subprocess.Popen[bytes], wait_s: float) -> int | None:
    """The job's exit code: what a standing process tells, else the process's own. None: not yet."""
    if process.stdout is None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(wait_s)
        return None
    if not select.select([process.stdout], [], [], wait_s)[0]:
        return None
    line = process.stdout.readline()
    return int(line) if line else process.wait()  # an end of output: it died


def wait_for_end_of(parent: int) -> None:
    """Return once `parent`, the process that started this one, has ended, however it did."""
    with contextlib.suppress(OSError, AttributeError):  # not on Linux, or it has ended already
        handle = os.pidfd_open(parent)
        try:
            if os.getppid() == parent:
                select.select([handle], [], [])
            return
        finally:
            os.close(handle)
    while os.getppid() == parent:
        time.sleep(PARENT_POLL_S)


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


def _outcome(database: Database, settings: Settings, job_id: str, code: int, attempt: str) -> Outcome:
    with database.transaction() as s:
        job = s.get(Job, job_id, with_for_update=True)
        if job is None:
            return Outcome.CANCELLED
        outcome = _outcome_of(job, settings, code, attempt)
        end_attempt(s, attempt, outcome, read_log(settings, job_id, KEPT_LOG_BYTES))
        return outcome


def _outcome_of(job: Job, settings: Settings, code: int, attempt: str) -> Outcome:
    if job.state in FINAL_STATES:
        return Outcome(job.state)
    if not holds(job, attempt):
        log.warning("another worker has taken the job up", job=job.id)
        return Outcome.LOST
    if job.state == "cancelling":
        finish(job, "cancelled")
        return Outcome.CANCELLED
    if code < 0:
        name = signal.Signals(-code).name
        cause = "Out of memory is the usual cause; see the log." if code == -signal.SIGKILL else "The log may say why."
        job.error = f"The training process was ended by {name}. {cause}"
        log.warning("job's process was killed", job=job.id, signal=name)
        return Outcome.CRASHED
    if code == ExitCode.AGAIN:
        log.warning("job's process found the database away or the disk full", job=job.id)
        return Outcome.AGAIN
    job.error = f"The training process ended with exit code {code}:\n{read_log(settings, job.id)}".strip()
    finish(job, "failed")
    return Outcome.FAILED


def _give_up_waiting(database: Database, settings: Settings, job_id: str) -> Outcome:
    with database.transaction() as s:
        job = s.get(Job, job_id)
        if job is not None and job.state not in FINAL_STATES:
            reason = "Database or artefact store was away, or the disk full, several times in a row; start it again."
            job.error = f"{reason}\n{read_log(settings, job_id)}".strip()
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

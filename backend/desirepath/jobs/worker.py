"""The background worker: hands rows of the job table to the engine, and looks after jobs whose worker is gone.

What one job does lives in `runners.py`, how its process is watched in `process.py`.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import platform
import queue
import signal
import subprocess
import threading
import time
import uuid
from io import BufferedRandom

import structlog
from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from desirepath.jobs.engine import Engine, EngineState
from desirepath.jobs.heartbeat import beat
from desirepath.jobs.leases import WorkerName, claim_silent, is_silent, say_alive
from desirepath.jobs.process import (
    FINAL_STATES,
    Standing,
    conclude,
    end_group,
    finish,
    leave_to_the_next,
    log_folder,
    patiently,
    run_attempt,
    wait_for_end_of,
)
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database, StorageError, check_writable, shared_now
from desirepath.store.models import Job
from desirepath.store.outbox import queue_of
from desirepath.store.shipped_policies import register_shipped
from desirepath.store.worker_signals import Signal, SignalListener

LOOK_S = 5.0  # between two looks where no signal comes
DEAF_LOOK_S = 0.25  # where none can come: a participant is waiting
ALIVE_S = 15.0
DATABASE_AWAY_S = 1.0
TIDY_S = 600.0
LEFT_OVER_S = 3_600.0  # since a log was written last; a row is written before its log
TOKEN_CHARACTERS = 8

log = structlog.get_logger("desirepath.worker")


class Worker:
    """One worker process: an engine, and the loop that feeds it until `stopping` is set; `woken` ends its sleep."""

    def __init__(self, settings: Settings, stopping: threading.Event, woken: threading.Event) -> None:
        self._stopping, self._woken = stopping, woken
        check_writable(settings.data)
        self._settings = settings
        self._database = Database(settings.database)
        self._database.migrate()
        with self._database.one_starts(), self._database.transaction() as s:
            register_shipped(s, ArtefactStore(settings.artefacts))
        self._slot, self.name = _take_slot(settings)
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._submitted: set[str] = set()
        self._signals = SignalListener(self._database, self.name.id.rpartition("-")[2], self._on_signal)
        self._standing = Standing(settings, allowed=settings.standing_process)
        self._engine = Engine(
            settings.jobs_database,
            executor_id=self.name.id,
            processes=settings.training_processes,
            attempt=lambda job_id, number: run_attempt(
                self._database, settings, job_id, number, self._running, self._standing, stopping, self.name
            ),
            conclude=lambda job_id, outcome: patiently(lambda: conclude(self._database, job_id, outcome)),
        )

    def run(self) -> None:
        """Work until stopped, then end all training processes; the next worker takes their jobs up."""
        stopping = self._stopping
        self._engine.start()
        self._signals.start()
        due = dict.fromkeys(("revive", "alive", "tidy"), 0.0)
        while not stopping.is_set():
            try:
                self.submit_queued()
                now = time.monotonic()
                if now >= due["revive"]:
                    self.revive_stale()
                    self._standing.rest()
                    due["revive"] = now + LOOK_S
                if now >= due["alive"]:
                    beat(self._settings.data)
                    with self._database.transaction() as s:
                        say_alive(s, self.name, self._settings.training_processes)
                    due["alive"] = now + ALIVE_S
                if now >= due["tidy"]:
                    self.tidy_logs()
                    due["tidy"] = now + TIDY_S
            except (StorageError, SQLAlchemyError) as problem:  # trainings go on meanwhile
                log.warning("the worker waits for the database", problem=str(problem)[:200])
                stopping.wait(DATABASE_AWAY_S)
                continue
            self._woken.wait(LOOK_S if self._signals.hears else DEAF_LOOK_S)
            self._woken.clear()
        self._standing.end()
        for job_id, process in list(self._running.items()):
            end_group(process)
            with contextlib.suppress(StorageError, SQLAlchemyError):
                leave_to_the_next(self._database, self._settings, job_id)

    def _on_signal(self, signal: Signal) -> None:
        if signal is Signal.PARTICIPANT_PRESENT:
            self._standing.want()
        else:
            self._woken.set()

    def close(self) -> None:
        """Leave nothing in the databases' logs that could stand in their files."""
        self._signals.close()
        for database in (self._database, Database(self._settings.jobs_database)):
            database.close()

    def submit_queued(self) -> None:
        """Give every queued row to the engine, once."""
        with self._database.session() as s:
            waiting = list(s.scalars(select(Job).where(Job.state == "queued").order_by(Job.priority, Job.created_at)))
        for job in waiting:
            if job.id not in self._submitted:
                self._engine.submit(job.id, queue=queue_of(job), priority=job.priority)
                self._submitted.add(job.id)

    def revive_stale(self) -> None:
        """Take up jobs whose worker has been silent for long; end those that the engine has given up."""
        with self._database.session() as s:
            unfinished = list(s.scalars(select(Job).where(Job.state.not_in(FINAL_STATES))))
            now = shared_now(s)
        for job in unfinished:
            if job.id in self._running or not is_silent(job, now):
                continue
            standing = self._engine.state(job.id)
            if standing is EngineState.WAITING:
                continue
            with self._database.transaction() as s:
                mine = claim_silent(s, job.id)
            if not mine:
                continue
            match standing:
                case EngineState.UNKNOWN:
                    self._engine.submit(job.id, queue=queue_of(job), priority=job.priority)
                case EngineState.RUNNING:
                    log.warning("job is taken up from a worker that is gone", job=job.id)
                    self._engine.resume(job.id, queue=queue_of(job))
                case EngineState.ENDED:
                    self._give_up(job)

    def tidy_logs(self) -> None:
        """Delete logs of jobs that were erased on another machine; an erasure reaches its own data folder only."""
        before = time.time() - LEFT_OVER_S
        old = [path for path in log_folder(self._settings).glob("*.log") if path.stat().st_mtime < before]
        with self._database.session() as s:
            gone = [path for path in old if s.get(Job, path.stem) is None]
        for path in gone:
            path.unlink(missing_ok=True)

    def _give_up(self, waiting: Job) -> None:
        job_id = waiting.id
        if self._engine.submit_again(job_id, queue=queue_of(waiting), priority=waiting.priority):
            log.warning("a job that the queue ended without a result is queued again", job=job_id)
            return
        with self._database.transaction() as s:
            job = s.get(Job, job_id)
            if job is not None and job.state not in FINAL_STATES:
                job.error = job.error or "The queue ended this job without a result; start it again with retry."
                finish(job, "failed")


def run_worker(settings: Settings, *, parent: int | None = None) -> None:
    """Work until SIGTERM or SIGINT, or until `parent`, the process that started us, is gone (a killed server)."""
    stopping, woken = threading.Event(), threading.Event()

    def stop() -> None:
        stopping.set()
        woken.set()

    def stop_with_parent(parent: int) -> None:
        # A restarted server brings its own worker; one left over from before would train beside it, and on old code.
        wait_for_end_of(parent)
        stop()

    if parent is not None:
        threading.Thread(target=stop_with_parent, args=(parent,), daemon=True).start()
    # A handler that sets an event itself waits for ever where it interrupts this thread's waiting for that event.
    stop_asked: queue.SimpleQueue[None] = queue.SimpleQueue()

    def stop_when_asked() -> None:
        stop_asked.get()
        stop()

    threading.Thread(target=stop_when_asked, daemon=True).start()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop_asked.put(None))
    worker = Worker(settings, stopping, woken)
    if parent is None:  # one that another command started says nothing unasked
        log.info("worker started", worker=worker.name.id, processes=settings.training_processes)
    worker.run()
    worker.close()
    # No orderly end of the engine: it would wait for the interrupted steps and record them as failed. Left as they
    # are, they are taken up by the next worker, exactly as after a kill.
    os._exit(0)


def _take_slot(settings: Settings) -> tuple[BufferedRandom, WorkerName]:
    """The first free worker's place in this data folder, held until the process ends, and the name that goes with it:
    the same after a restart, and no other's on any machine, whatever these call themselves."""
    number = 0
    while True:
        held = (settings.data / f"worker-{number}.lock").open("a+b")
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            held.close()
            number += 1
            continue
        held.seek(0)
        token = held.read(TOKEN_CHARACTERS).decode("ascii", errors="replace")
        if len(token) < TOKEN_CHARACTERS:
            token = uuid.uuid4().hex[:TOKEN_CHARACTERS]
            held.truncate(0)
            held.write(token.encode())
            held.flush()
        machine = (settings.machine or platform.node())[:80]
        return held, WorkerName(f"{machine}-{number}-{token}", machine)

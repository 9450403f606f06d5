"""`desirepath benchmark faults`: kill what a study runs on, at random moments under load, and count what was lost.

On a PostgreSQL server of its own. Who answers meanwhile is `persistent.py`'s.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from pydantic import Field
from sqlalchemy import func, select, text

from desirepath.cli.loopback import loopback_server
from desirepath.jobs.heartbeat import FILE as HEARTBEAT
from desirepath.store.database import Database
from desirepath.store.models import Job, Response, ServerProcess, Session, Trial, utc_now
from desirepath.store.outbox import enqueue_job
from desirepath_experiments.benchmarks.open_browser import ServeBenchmarkError
from desirepath_experiments.benchmarks.persistent import Persistent
from desirepath_experiments.benchmarks.processes import children_of, command_of
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.benchmarks.serving import await_processes, open_installation
from desirepath_experiments.own_postgres import own_postgres_pid

Fault = Literal["server", "worker", "connections", "database", "disk"]
PAUSE_S = (0.5, 3.0)  # between two faults; a process is there again before the next one
RECOVERY_PATIENCE_S = 120.0
JOBS_PATIENCE_S = 600.0
JOB_SCENES = 400  # of the evaluations that run meanwhile; some seconds each
DISK_MB, FULL_S = 512, 1.5  # of the data folder's own small disk, where one may be mounted; how long it is full
LOOK_S = 0.02


@dataclass
class Outcome:
    """Faults of one sort: seconds until the next answer was acknowledged, and until what was killed was there again."""

    answer_after_s: list[float] = field(default_factory=list)
    there_after_s: list[float] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        def spread(seconds: list[float]) -> dict[str, float] | None:
            if not seconds:
                return None
            return {"median": round(float(np.median(seconds)), 2), "worst": round(max(seconds), 2)}

        return {
            "times": len(self.answer_after_s),
            "next_answer_after_s": spread(self.answer_after_s),
            "there_again_after_s": spread(self.there_after_s),
        }


@pydantic.dataclasses.dataclass(frozen=True)
class FaultsConfig:
    """How often what is killed, under which load."""

    kills: Annotated[int, Field(ge=1, description="How often something is killed.")] = 20
    participants: Annotated[int, Field(ge=1, description="Who answer all the while.")] = 6
    processes: Annotated[int, Field(ge=1, description="Server processes.")] = 2
    seed: Annotated[int, Field(ge=0, description="Of the moments and of what is killed.")] = 0


def benchmark_faults(config: FaultsConfig, progress: Progress) -> dict[str, Any]:
    """Kill so often, in turn and at random moments: a server process or the worker (kill -9), connections to the
    database (half of them, ended by it), the database (one of its own processes: it ends all connections and recovers),
    and fill the disk for a moment (where a small one may be mounted).

    Participants answer pairs all the while, as pages do: what is not acknowledged is sent again under the same request
    id. Jobs run beside them.

    Returns kills, answers_acknowledged, answers_lost (acknowledged, and not stored once with the same choice),
    half_trials (answered without an answer or the other way round), jobs, jobs_lost (that did not succeed in the end),
    faults (by sort: times, next_answer_after_s and there_again_after_s with median and worst), sent_again,
    watched_again (pairs that started over, seen though they were: a database that crashed forgot it), not_tried and
    why, lost_because (what jobs that were lost say), seconds.
    Raises ServeBenchmarkError where nobody gets on any more, NoPostgres.
    """
    began, random = time.monotonic(), np.random.default_rng(config.seed)
    with contextlib.ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="desirepath-faults-")))
        data, mounted = folder / "data", held.enter_context(_mount_small_disk(folder / "data"))
        installation = held.enter_context(open_installation(data, postgresql=True))
        database = installation.database
        sorts: list[Fault] = ["server", "worker", "connections", "database"]
        if mounted:
            sorts.append("disk")
        arguments, log = ("--processes", str(config.processes)), folder / "server.log"
        with loopback_server(installation.settings, worker=True, log=log, arguments=arguments) as (address, supervisor):
            await_processes(database, config.processes)
            stopping = threading.Event()
            first, link = config.seed * 1000, installation.study.recruiting_token
            people = [Persistent(address, link, first + n, stopping) for n in range(config.participants)]
            threads = [threading.Thread(target=person.walk, daemon=True) for person in people]
            for thread in threads:
                thread.start()
            outcomes: dict[Fault, Outcome] = {sort: Outcome() for sort in sorts}
            jobs = [_start_job(database, 0)]
            scene = _Scene(database, data, supervisor.pid, people)
            scene.await_answer(since=0)
            for number in range(config.kills):
                sort = sorts[number % len(sorts)]
                time.sleep(float(random.uniform(*PAUSE_S)))
                progress.tell(f"{number + 1} of {config.kills}: {sort}")
                scene.strike(sort, random, outcomes[sort])
                jobs.append(_start_job(database, number + 1))
            stopping.set()
            for thread in threads:
                thread.join(RECOVERY_PATIENCE_S)
            stuck = sum(thread.is_alive() for thread in threads)
            broken = [person.problem for person in people if person.problem]
            if stuck or broken:
                raise ServeBenchmarkError(f"{stuck} of {config.participants} participants do not get on; {broken[:1]}")
            unfinished = _await_jobs(database, jobs)
        acknowledged = {key: value for person in people for key, value in person.acknowledged.items()}
        lost, halves = lost_answers(database, acknowledged), half_trials(database)
    return {
        "kills": config.kills,
        "participants": config.participants,
        "processes": config.processes,
        "answers_acknowledged": len(acknowledged),
        "answers_lost": lost,
        "half_trials": halves,
        "jobs": len(jobs),
        "jobs_lost": len(unfinished),
        "lost_because": unfinished,
        "sent_again": sum(person.sent_again for person in people),
        "watched_again": sum(person.watched_again for person in people),
        "faults": {sort: outcome.as_dict() for sort, outcome in outcomes.items()},
        "not_tried": [] if mounted else ["disk: no small file system may be mounted here"],
        "seed": config.seed,
        "seconds": round(time.monotonic() - began, 1),
    }


class _Scene:
    """What can be struck, and how one sees that it is there again."""

    def __init__(self, database: Database, data: Path, supervisor: int, people: list[Persistent]) -> None:
        self._database, self._data, self._supervisor, self._people = database, data, supervisor, people

    def strike(self, sort: Fault, random: np.random.Generator, outcome: Outcome) -> None:
        answered, at, began = self._answers(), time.monotonic(), utc_now()
        match sort:
            case "server":
                killed = int(random.choice(self._servers()))
                os.kill(killed, signal.SIGKILL)
                self._until(lambda: killed not in self._servers() and self._begun_since(began) >= 1)
                outcome.there_after_s.append(time.monotonic() - at)
            case "worker":
                beaten, worker = time.time(), self._worker()
                if worker is not None:
                    os.kill(worker, signal.SIGKILL)
                    self._until(lambda: self._worker() not in (None, worker) and self._beaten_at() > beaten)
                    outcome.there_after_s.append(time.monotonic() - at)
            case "connections":
                with self._database.session() as s:
                    s.execute(
                        text(
                            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database() "
                            "AND pid <> pg_backend_pid() AND random() < 0.5"
                        )
                    )
            case "database":
                # PostgreSQL ends all connections where one of its processes is killed, and recovers from its log.
                serving = own_postgres_pid(str(self._database.url.query["host"]))
                clients = [client for client in children_of(serving) if "postgres: desirepath" in command_of(client)]
                os.kill(int(random.choice(clients)), signal.SIGKILL)
            case "disk":
                with _fill(self._data):
                    time.sleep(FULL_S)
        self.await_answer(since=answered)
        outcome.answer_after_s.append(
            min(when for person in self._people for when in person.acknowledged_at if when > at) - at
        )

    def await_answer(self, *, since: int) -> None:
        self._until(lambda: self._answers() > since)

    def _answers(self) -> int:
        return sum(len(person.acknowledged) for person in self._people)

    def _servers(self) -> list[int]:
        return [pid for pid in children_of(self._supervisor) if "ends_with_parent serve" in command_of(pid)]

    def _begun_since(self, moment: datetime) -> int:
        """Server processes that listen, of those that began later."""
        with self._database.session() as s:
            rows = select(func.count()).select_from(ServerProcess).where(ServerProcess.started_at > moment)
            return s.scalar(rows) or 0

    def _worker(self) -> int | None:
        pids = [pid for pid in children_of(self._supervisor) if "desirepath worker" in command_of(pid)]
        return pids[0] if pids else None

    def _beaten_at(self) -> float:
        try:
            return (self._data / HEARTBEAT).stat().st_mtime
        except OSError:
            return 0.0

    def _until(self, holds: Callable[[], bool]) -> None:
        deadline = time.monotonic() + RECOVERY_PATIENCE_S
        while not holds():
            if time.monotonic() > deadline:
                problems = [person.problem or person.last for person in self._people]
                raise ServeBenchmarkError(f"nothing recovered within {RECOVERY_PATIENCE_S:.0f} s; people: {problems}")
            time.sleep(LOOK_S)


def _start_job(database: Database, number: int) -> str:
    while True:
        try:
            with database.transaction() as s:
                params = {"policy": "study_room/base", "scenes": JOB_SCENES, "seed": number}
                return enqueue_job(s, "evaluate", params, created_by="benchmark").id
        except OSError:  # our own connection was ended, too
            time.sleep(LOOK_S)


def _await_jobs(database: Database, jobs: list[str]) -> list[str]:
    """What the jobs that did not succeed say."""
    deadline = time.monotonic() + JOBS_PATIENCE_S
    while True:
        with database.session() as s:
            rows = list(s.scalars(select(Job).where(Job.id.in_(jobs))))
        left = [row for row in rows if row.state != "succeeded"]
        if all(row.state == "failed" for row in left) or time.monotonic() > deadline:
            return [f"{row.state}: {row.error}"[:300] for row in left]
        time.sleep(0.5)


def lost_answers(database: Database, acknowledged: dict[str, tuple[str, str, str]]) -> int:
    """Acknowledged answers that are not stored where they belong with the choice that was sent."""
    rows_asked = select(Response.request_id, Session.token_hash, Response.step_key, Response.value)
    with database.session() as s:
        rows = s.execute(rows_asked.join(Session, Session.id == Response.session_id)).all()
    stored = {row[0]: (row[1], row[2], row[3].get("choice")) for row in rows}
    return sum(stored.get(request_id) != sent for request_id, sent in acknowledged.items())


def half_trials(database: Database) -> int:
    """Trials that are answered without an answer, or have one and are not."""
    rows = (
        select(func.count())
        .select_from(Trial)
        .outerjoin(Response, Response.trial_id == Trial.id)
        .where((Trial.phase == "answered") != Response.id.is_not(None))
    )
    with database.session() as s:
        return s.scalar(rows) or 0


@contextlib.contextmanager
def _mount_small_disk(folder: Path) -> Iterator[bool]:
    """The folder as a small file system of its own; False where none may be mounted."""
    folder.mkdir()
    libc = ctypes.CDLL(None, use_errno=True)
    mounted = libc.mount(b"tmpfs", bytes(folder), b"tmpfs", 0, f"size={DISK_MB}m".encode()) == 0
    try:
        yield mounted
    finally:
        if mounted:
            libc.umount2(bytes(folder), 2)  # MNT_DETACH: whatever still looks at it


@contextlib.contextmanager
def _fill(folder: Path) -> Iterator[None]:
    """No room on the folder's disk within the block."""
    filler = folder / "filler"
    try:
        with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(b"\0" * 2**20)
        yield
    finally:
        filler.unlink(missing_ok=True)

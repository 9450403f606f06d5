"""`desirepath benchmark serve`: many participants at once against a server of our own, and every answer counted after.

What one participant does lives in `open_browser.py`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import ssl
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import httpx
import numpy as np
import pydantic
from pydantic import Field
from sqlalchemy import func, select, text

from desirepath.cli.loopback import loopback_server
from desirepath.installed import PROTOCOLS
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Base, Job, Response, ServerProcess, Session, Study
from desirepath.store.outbox import PARTICIPANT_WAITS, enqueue_job
from desirepath.store.shipped_policies import register_shipped
from desirepath.store.snapshots import take_snapshot
from desirepath.study.protocol.freezing import freeze
from desirepath.study.studies import create_study
from desirepath_experiments.benchmarks.open_browser import OpenBrowser, ServeBenchmarkError, Tally, beside
from desirepath_experiments.benchmarks.processes import family_mb, family_s
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.own_postgres import own_postgres, own_postgres_pid

QUICK_STUDY = PROTOCOLS / "quick_preference_study.yaml"
MOST_ANSWERS = 15  # the quick protocol's practice pair and 14 more; the next one would start each session's alignment
LEAST_ALIGNED = 3  # one is a learning trial
# Ours: a person's pair. The shipped trajectories take 11 to 14 s a pair, starting, changing over and choosing the rest.
PACE_S = 20.0
AT_LEAST = 50  # ours: fewer participants than this answer so much faster that they are as much work as so many people
ALIGNMENTS = 3  # queued one behind the other, so that one runs for as long as the participants answer
ALIGNMENT_BEGUN = 0.04  # progress past loading and fitting the reward model: the policy's training runs
ALIGNMENT_PATIENCE_S = 180.0
LOOK_S = 0.5
PROCESSES_PATIENCE_S = 60.0
LOG_LINES = 12  # of the server's log, in an error


@pydantic.dataclasses.dataclass(frozen=True)
class ServeConfig:
    """How many answer how often against how many processes on which database."""

    sessions: Annotated[int, Field(ge=1, description="Participants at once.")] = 20
    answers: Annotated[
        int, Field(ge=1, le=MOST_ANSWERS, description="Of each; with one more every session would start an alignment.")
    ] = 2
    pace: Annotated[
        float | None,
        Field(
            ge=0.1,
            le=120,
            description="Seconds between two answers of one participant; default 20 as people take, and as much less "
            "with fewer than 50 participants.",
        ),
    ] = None
    during_alignment: Annotated[bool, Field(description="Let alignments run meanwhile.")] = False
    processes: Annotated[
        int, Field(ge=1, description="Of the server; more than one on a PostgreSQL server of the benchmark's own.")
    ] = 1
    postgresql: Annotated[bool, Field(description="On PostgreSQL with one process, too.")] = False

    @property
    def pace_s(self) -> float:
        return usual_pace_s(self.sessions) if self.pace is None else self.pace


def usual_pace_s(sessions: int) -> float:
    """Seconds between two answers of one participant, where none are asked for: a person's, or less where there are few
    participants, so that the server has as much to do as with AT_LEAST people."""
    return PACE_S * min(1.0, sessions / AT_LEAST)


def benchmark_serve(config: ServeConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Let participants answer pairs, all at once, and compare what was stored.

    Returns sessions, answers_sent, answers_acknowledged, answers_stored, p50_ack_ms and p95_ack_ms (from sending an
    answer to its acknowledgement, as the client measures it), p95_stage_ms (from asking for a trajectory to the stage's
    websocket hearing of it), rss_mb of the server's processes with everybody connected, rss_per_session_mb,
    server_ms_per_answer (processor time of everything that belongs to one, joining included), what came through the
    stages, and errors: what had to be tried again, connections that broke and requests that a busy server put off.
    during_alignment: the same again with fresh participants while alignments of one core run, under that key; only then
    does a worker run beside the server.
    server_s_per_session: the same processor time, of one session from joining to its last answer.
    On PostgreSQL also database_ms_per_answer and database_s_per_session (processor time of its processes), what one
    session left in it, its answers and everything else: database_kb_per_session, rows_per_session; and what it made
    the database write: commits_per_session, log_kb_per_session (the write-ahead log).
    Raises ServeBenchmarkError if an acknowledged answer is not stored exactly once or a participant could not go on,
    ValueError for fewer answers than an alignment learns from.
    """
    if config.during_alignment and config.answers < LEAST_ALIGNED:
        raise ValueError(
            f"answers = {config.answers}: alignments learn from these answers and need at least {LEAST_ALIGNED}"
        )
    began = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="desirepath-benchmark-") as folder,
        open_installation(Path(folder), postgresql=config.postgresql or config.processes > 1) as installation,
    ):
        log, arguments = Path(folder) / "server.log", ("--processes", str(config.processes))
        try:
            with loopback_server(
                installation.settings, worker=config.during_alignment, log=log, arguments=arguments
            ) as (
                url,
                server,
            ):
                await_processes(installation.database, config.processes)
                result = {"sessions": config.sessions, **_walk_everybody(installation, url, server.pid, config)}
                if config.during_alignment:
                    with _run_alignments(installation) as running:
                        result["during_alignment"] = _walk_everybody(installation, url, server.pid, config, running)
        except ServeBenchmarkError as problem:
            raise ServeBenchmarkError(f"{problem}\nThe server's log ends with:\n{_end_of_errors(log)}") from None
    return {
        **result,
        "processes": config.processes,
        "pace_s": config.pace_s,
        "cores": os.cpu_count(),
        "seconds": round(time.monotonic() - began, 1),
    }


@dataclass(frozen=True)
class Installation:
    """An installation of a benchmark's own with one open study of the quick protocol."""

    settings: Settings
    database: Database
    files: ArtefactStore
    study: Study


@contextlib.contextmanager
def open_installation(folder: Path, *, postgresql: bool) -> Iterator[Installation]:
    """An installation in this folder, on a PostgreSQL server of its own where that is asked for. Raises NoPostgres."""
    with own_postgres() if postgresql else contextlib.nullcontext() as server_url:
        # Named here, so that no setting of the surroundings leads to an installation that is in use.
        settings = Settings(data=folder, database_url=server_url, artefacts_url=None)
        database, files = Database(settings.database), ArtefactStore(settings.artefacts)
        database.migrate()
        with database.transaction() as s:
            register_shipped(s, files)
            study = create_study(s, files, freeze(QUICK_STUDY), name="benchmark", created_by=None)
        try:
            yield Installation(settings, database, files, study)
        finally:
            database.close()


def _walk_everybody(
    installation: Installation,
    url: str,
    server_pid: int,
    config: ServeConfig,
    aligning: Callable[[], bool] | None = None,
) -> dict[str, Any]:
    """One walk of everybody, checked against the database. Returns what `benchmark_serve` says of it."""
    tally, database, sessions = Tally(), installation.database, config.sessions
    memory_before = family_mb(server_pid)
    processor_before = family_s(server_pid)
    database_before = _database_state(database)
    memory, looks, failed = asyncio.run(_walk_all(tally, url, server_pid, installation.study, config, aligning))
    if failed:
        raise ServeBenchmarkError(f"{len(failed)} of {sessions} participants could not go on; the first: {failed[0]}")
    processor = family_s(server_pid) - processor_before
    stored = count_stored(database, tally)
    p50, p95 = np.percentile(tally.ack_ms, [50, 95])
    result: dict[str, Any] = {
        "answers_sent": tally.sent,
        "answers_acknowledged": len(tally.ack_ms),
        "answers_stored": stored,
        "p50_ack_ms": round(float(p50), 1),
        "p95_ack_ms": round(float(p95), 1),
        "max_ack_ms": round(max(tally.ack_ms), 1),
        "p95_stage_ms": round(float(np.percentile(tally.stage_ms, 95)), 1),
        "rss_mb": round(memory, 1),
        "rss_per_session_mb": round((memory - memory_before) / sessions, 2),
        "server_ms_per_answer": round(processor * 1000 / tally.sent, 1),
        "server_s_per_session": round(processor / sessions, 3),
        "stage_messages": tally.stage_messages,
        "stage_mb": round(tally.stage_bytes / 2**20, 2),
        "stream_events": tally.stream_events,
        "errors": tally.errors,
    }
    after = _database_state(database)
    if database_before is not None and after is not None:
        result |= {
            "database_ms_per_answer": round((after.processor_s - database_before.processor_s) * 1000 / tally.sent, 1),
            "database_s_per_session": round((after.processor_s - database_before.processor_s) / sessions, 3),
            "database_kb_per_session": round((after.size - database_before.size) / 1024 / sessions, 1),
            "rows_per_session": round((after.rows - database_before.rows) / sessions, 1),
            "commits_per_session": round((after.commits - database_before.commits) / sessions, 1),
            "log_kb_per_session": round((after.log_bytes - database_before.log_bytes) / 1024 / sessions, 1),
        }
    if aligning is not None:
        share = sum(looks) / len(looks)
        if not share:
            raise ServeBenchmarkError("no alignment was running while the participants answered; see the jobs' logs")
        result["alignment_ran_share"] = round(share, 2)
    return result


async def _walk_all(
    tally: Tally,
    url: str,
    server_pid: int,
    study: Study,
    config: ServeConfig,
    aligning: Callable[[], bool] | None,
) -> tuple[float, list[bool], list[str]]:
    """Returns the server's memory with everybody connected (MB), looks at the alignments, and what went wrong."""
    sessions, pace_s = config.sessions, config.pace_s
    ready = asyncio.Barrier(sessions)
    looks: list[bool] = []
    memory = 0.0
    trust = ssl.create_default_context()  # loading certificates once is enough; nothing here speaks TLS

    async def one(number: int) -> None:
        async with httpx.AsyncClient(base_url=url, timeout=60.0, verify=trust) as client:
            participant = OpenBrowser(client, number, tally)
            try:
                await participant.walk(
                    study.recruiting_token, config.answers, ready, pace_s * number / sessions, pace_s
                )
            except BaseException:
                await ready.abort()  # nobody waits for one who will not come
                raise

    async def look() -> None:
        nonlocal memory
        while True:
            if ready.n_waiting == 0 and tally.sent:
                memory = max(memory, family_mb(server_pid))
                if aligning is not None:
                    looks.append(await asyncio.to_thread(aligning))
            await asyncio.sleep(LOOK_S)

    async with beside(look()):
        ended = await asyncio.gather(*(one(number) for number in range(sessions)), return_exceptions=True)
    problems = [problem for problem in ended if isinstance(problem, BaseException)]
    causes = [problem for problem in problems if not isinstance(problem, asyncio.BrokenBarrierError)] or problems
    return memory, looks, [f"{type(problem).__name__}: {problem}" for problem in causes]


def await_processes(database: Database, processes: int) -> None:
    """Until so many server processes have said that they live. Raises ServeBenchmarkError if they do not."""
    if database.is_sqlite:
        return
    deadline = time.monotonic() + PROCESSES_PATIENCE_S
    while True:
        with database.session() as s:
            living = s.scalar(select(func.count()).select_from(ServerProcess)) or 0
        if living >= processes:
            return
        if time.monotonic() > deadline:
            raise ServeBenchmarkError(f"of {processes} server processes {living} live after a minute")
        time.sleep(LOOK_S)


@dataclass(frozen=True)
class _DatabaseState:
    """Of the benchmark's own PostgreSQL: seconds of processor, bytes, rows, commits and bytes of write-ahead log so
    far. commits: of every transaction, those that only read among them, as the server counts them (a second late)."""

    processor_s: float
    size: int
    rows: int
    commits: int
    log_bytes: int


def _database_state(database: Database) -> _DatabaseState | None:
    """None on SQLite."""
    if database.is_sqlite:
        return None
    with database.session() as s:
        size, commits, written = s.execute(
            text(
                "SELECT pg_database_size(current_database()), xact_commit, pg_current_wal_lsn() - '0/0'::pg_lsn "
                "FROM pg_stat_database WHERE datname = current_database()"
            )
        ).one()
        rows = sum(s.scalar(select(func.count()).select_from(table)) or 0 for table in Base.metadata.sorted_tables)
    return _DatabaseState(
        family_s(own_postgres_pid(str(database.url.query["host"]))), size, rows, int(commits), int(written)
    )


def count_stored(database: Database, tally: Tally) -> int:
    """How many answers to pairs are stored. Raises ServeBenchmarkError for a lost, doubled or misplaced one."""
    hashes = {session for session, _ in tally.acknowledged.values()}
    wanted = (
        select(Response.request_id, Session.token_hash, Response.step_key)
        .join(Session, Session.id == Response.session_id)
        .where(Session.token_hash.in_(hashes))
    )
    with database.session() as s:
        rows = [(request_id, (session, step)) for request_id, session, step in s.execute(wanted)]
    stored = dict(rows)
    lost = sum(stored.get(request_id) != place for request_id, place in tally.acknowledged.items())
    doubled = len(rows) - len({place for _, place in rows})
    foreign = sum(request_id not in tally.acknowledged for request_id in stored)
    if lost or doubled or foreign:
        raise ServeBenchmarkError(
            f"of {len(tally.acknowledged)} acknowledged answers {lost} are not stored where they belong, "
            f"{doubled} are stored twice, {foreign} were stored without being acknowledged"
        )
    return sum(request_id in tally.pairs for request_id in stored)


@contextlib.contextmanager
def _run_alignments(installation: Installation) -> Iterator[Callable[[], bool]]:
    """Alignments on one session's answers, one after another; begins when the first one trains.

    Yields a function that says whether one is running. They end with the server.
    """
    database = installation.database
    with database.transaction() as s:
        session_id = s.scalars(select(Response.session_id).order_by(Response.created_at)).first()
        snapshot = take_snapshot(s, installation.files, session_id=session_id)
        jobs = [
            enqueue_job(
                s,
                "align",
                {"snapshot": snapshot.id, "setup": snapshot.setup, "recipe": "fine_tuning", "seed": seed},
                priority=PARTICIPANT_WAITS,
                study_id=installation.study.id,
                session_id=session_id,  # its process gets the priority of one that somebody waits for
                created_by="benchmark",
            ).id
            for seed in range(ALIGNMENTS)
        ]

    def rows() -> list[Job]:
        with database.session() as s:
            return list(s.scalars(select(Job).where(Job.id.in_(jobs))))

    deadline = time.monotonic() + ALIGNMENT_PATIENCE_S
    while not any(job.state == "running" and job.progress > ALIGNMENT_BEGUN for job in rows()):
        failed = [job.error for job in rows() if job.state == "failed"]
        if failed or time.monotonic() > deadline:
            raise ServeBenchmarkError(f"no alignment got going: {failed or 'none began in time'}")
        time.sleep(LOOK_S)
    yield lambda: any(job.state == "running" for job in rows())


def _end_of_errors(log: Path) -> str:
    """The last lines of a server's log that are not about a request that went well."""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return "\n".join([line for line in lines if "event='request'" not in line][-LOG_LINES:])

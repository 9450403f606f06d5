"""`desirepath benchmark rest`: what an installation uses while nobody is there, and how soon a job starts then.

What a process has used is read in `processes.py`.
"""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import httpx
import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from desirepath.cli.loopback import loopback_server
from desirepath.jobs.leases import attempts_at
from desirepath.settings import Settings
from desirepath.store.database import Database
from desirepath.store.outbox import enqueue_job
from desirepath_experiments.benchmarks.processes import Usage, family, processor_s, usage_of
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.own_postgres import own_postgres, own_postgres_pid

SETTLE_S = 60.0  # after the start: DBOS looks more often at first, what the first visitors need is loaded
JOB_PATIENCE_S = 60.0
BETWEEN_JOBS_S = 3.0  # a queue has room again a moment after the row says that a job is done
JOB = ("evaluate", {"policy": "study_room/base", "scenes": 1})


class RestBenchmarkError(RuntimeError):
    """A job was not taken up."""


@dataclass(frozen=True)
class RestConfig:
    """For how long nobody is there, and what is tried beside it."""

    minutes: Annotated[float, Field(ge=0.1, description="How long nobody is there.")] = 3.0
    restarts: Annotated[int, Field(ge=1, description="Starts on a folder that is there.")] = 3
    jobs: Annotated[int, Field(ge=0, description="Jobs that are queued one after another then.")] = 10
    processes: Annotated[
        int, Field(ge=1, description="Server processes; more than one on a PostgreSQL server of the benchmark's own.")
    ] = 1
    postgresql: Annotated[bool, Field(description="On PostgreSQL with one process, too.")] = False


def benchmark_rest(config: RestConfig, progress: Progress) -> dict[str, Any]:
    """Start `desirepath serve --demo` on a new folder, then again on the same one, and look at it while nobody comes.

    On PostgreSQL its server is told beside (`database`) and counts in no total.

    Returns seconds of the wall clock and of the server's processor until the sign-in page was read: `new_folder`, and
    `restart` (median of `restarts`); per minute at rest, of all processes: `processor_s`, `written_kb` (what they gave
    to the system), `disk_kb` (what went to the disk), `wakeups`; `memory_mb`: proportional (PSS), at the end;
    `processes`: the same of each; `job_start_ms`: from a job's row to its begin, median and slowest of `jobs`.
    Raises RestBenchmarkError.
    """
    minutes, load = config.minutes, os.getloadavg()[0]
    arguments = ("--demo", "--processes", str(config.processes))
    with (
        tempfile.TemporaryDirectory(prefix="desirepath-rest-") as folder,
        own_postgres() if config.postgresql or config.processes > 1 else nullcontext() as url,
    ):
        settings = Settings(data=Path(folder) / "data", database_url=url, artefacts_url=None)
        new_folder = _time_start(settings, arguments)
        again = [_time_start(settings, arguments) for _ in range(config.restarts)]
        with loopback_server(settings, arguments=arguments) as (_, server):
            progress.tell(f"at rest for {minutes:g} minutes, after {SETTLE_S:.0f} s")
            time.sleep(SETTLE_S)
            roots = [server.pid, *([own_postgres_pid(url.partition("host=")[2])] if url else [])]
            before = [{pid: usage_of(pid) for pid in family(root)} for root in roots]
            time.sleep(minutes * 60)
            used, *beside = [
                [usage_of(pid) - known[pid] for pid in family(root) if pid in known]
                for root, known in zip(roots, before, strict=True)
            ]
            progress.tell(f"{config.jobs} jobs")
            waits = [_time_job(settings) for _ in range(config.jobs)]
    rows = [_per_minute(usage, minutes) for usage in used]
    return {
        "minutes": minutes,
        "new_folder": new_folder,
        "restart": {name: round(float(np.median([restart[name] for restart in again])), 2) for name in again[0]},
        **_total(rows),
        "processes": rows,
        "database": _total([_per_minute(usage, minutes) for usage in beside[0]]) if beside else None,
        "job_start_ms": {"median": round(float(np.median(waits))), "slowest": round(max(waits))} if waits else None,
        "load_average": round(load, 1),
    }


def _total(rows: list[dict[str, Any]]) -> dict[str, float]:
    return {name: round(sum(row[name] for row in rows), 2) for name in rows[0] if name != "process"}


def _time_start(settings: Settings, arguments: tuple[str, ...]) -> dict[str, float]:
    began = time.perf_counter()
    with loopback_server(settings, arguments=arguments) as (url, server):
        httpx.get(f"{url}/lab/sign-in", trust_env=False).raise_for_status()
        return {"seconds": round(time.perf_counter() - began, 2), "processor_s": round(processor_s(server.pid), 2)}


def _per_minute(used: Usage, minutes: float) -> dict[str, Any]:
    return {
        "process": used.command,
        "processor_s": round(used.processor_s / minutes, 3),
        "written_kb": round(used.written_bytes / 1e3 / minutes, 1),
        "disk_kb": round(used.disk_bytes / 1e3 / minutes, 1),
        "wakeups": round(used.wakeups / minutes, 1),
        "memory_mb": round(used.memory_mb, 1),
    }


def _time_job(settings: Settings) -> float:
    """Milliseconds from a job's row to the begin of its attempt. Raises RestBenchmarkError."""
    database = Database(settings.database)
    try:
        time.sleep(BETWEEN_JOBS_S)
        with database.transaction() as s:
            job = enqueue_job(s, JOB[0], JOB[1], created_by="benchmark")
        deadline = time.monotonic() + JOB_PATIENCE_S
        while time.monotonic() < deadline:
            time.sleep(0.2)
            with database.session() as s:
                begun, ended = attempts_at(s, job.id)[:1], s.get_one(type(job), job.id).finished_at
            if begun and ended:
                return (begun[0].began_at - job.created_at).total_seconds() * 1e3
        raise RestBenchmarkError(f"job {job.id} was not done within {JOB_PATIENCE_S:.0f} s")
    finally:
        database.close()

"""Benchmark: many participants give their last answer at the same moment. When is each one's policy ready to show?

Sessions are walked in this process, jobs run in a real worker beside it, as in an installation.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.jobs.process import FINAL_STATES, start_worker
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.queries.queries import Query
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.database import Database
from desirepath.store.job_results import Learned
from desirepath.store.models import Job, Session, Study, utc_now
from desirepath.store.outbox import cancel_job
from desirepath.store.shipped_policies import register_shipped
from desirepath.store.sides import SIDES
from desirepath.study.protocol.freezing import freeze
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.study.session.joining import join_study
from desirepath.study.simulated.participant import any_answer
from desirepath.study.studies import create_study
from desirepath_experiments.benchmarks.serving import QUICK_STUDY

POLL_S = 0.1
PATIENCE_S = 1800.0  # for all searches, one behind the other


class FinishBenchmarkError(RuntimeError):
    """The worker did not end all jobs."""


def benchmark_finish(*, participants: int = 10, oracle: str = "min-human-distance", seed: int = 0) -> dict[str, Any]:
    """Seconds from everybody's last answer, given at once, to each one's policies; one worker, searches behind.

    instant_s and search_s: median and slowest over the participants, from the last answer to the end of the job.
    shown_at_once: for how many the instant policy passed its gate; takes_over: for how many it found a better one.
    errors: what those say that failed.
    no_comparison_rate: share for whom nothing could be shown within the protocol's patience, the minutes of the
    questionnaire not counted. Raises FinishBenchmarkError.
    """
    if participants < 1:
        raise ValueError(f"participants = {participants}: at least 1")
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="desirepath-benchmark-") as folder:
        settings = Settings(data=Path(folder), database_url=None, artefacts_url=None)
        database, files = Database(settings.database), ArtefactStore(settings.artefacts)
        database.migrate()
        frozen = freeze(QUICK_STUDY)
        with database.transaction() as s:
            register_shipped(s, files)
            study = create_study(s, files, frozen, name="benchmark finish", created_by=None)
        first, *others = [_Walker(database, files, study, oracle, seed * 1000 + n) for n in range(participants + 1)]
        for walker in (first, *others):
            walker.walk_to_last_answer()
        with _worker(settings, Path(folder) / "worker.log"):
            first.answer()  # not measured: the worker starts, loads and compiles with this one
            _wait(database, first.session_id, "instant")
            _cancel_rest(database, first.session_id)
            for walker in others:
                walker.answer()
            ended = [_wait(database, walker.session_id) for walker in others]
        database.close()
    patience_s = frozen.training.give_up_after_s if frozen.training else 0
    return {
        "participants": participants,
        "cores": os.cpu_count(),
        **_summary(ended, patience_s),
        "seconds": round(time.monotonic() - began, 1),
    }


class _Walker:
    """One simulated session; answers by an oracle."""

    def __init__(self, database: Database, files: ArtefactStore, study: Study, oracle: str, seed: int) -> None:
        self._database, self._files = database, files
        self._oracle = make_oracle(oracle, seed=seed)
        self._random = np.random.default_rng([seed, 19])
        with database.transaction() as s:
            session, self._token = join_study(s, study, language="en", simulated=True, files=files)
            self.session_id = session.id
            self._last = next(step["key"] for step in session.plan if step.get("then") == "train")

    def walk_to_last_answer(self) -> None:
        """Answer everything but the step that starts the training."""
        while self._key() != self._last:
            self.answer()

    def answer(self) -> None:
        """Answer the current step."""
        with acting(self._database, self._token, request="benchmark", now=utc_now()) as (s, session):
            view = machine.current(s, session)
            value = (
                self._choice(s, session, view.key) if view.kind == "trial" else any_answer(_shown(view), self._random)
            )
            machine.submit(
                s,
                self._files,
                session,
                view.key,
                value,
                request_id=uuid4().hex,
                client_time=None,
                now=utc_now(),
            )

    def _key(self) -> str:
        with self._database.session() as s:
            return machine.current(s, s.get_one(Session, self.session_id)).key

    def _choice(self, s: DatabaseSession, session: Session, key: str) -> dict[str, str]:
        machine.start_trial(s, session, key, request_id=None, now=utc_now())
        for side in SIDES:
            machine.trajectory_seen(s, session, key, side, None, now=utc_now())
        trial = machine.trial_of(s, session, key)
        assert trial is not None  # noqa: S101  it was started just now
        a, b = (load_trajectory(self._files, t) for t in (trial.trajectory_a, trial.trajectory_b))
        return {"choice": "ab"[self._oracle.choose(Query(a.scene, a, b, (0, 1)))]}


def _shown(view: machine.StepView) -> dict[str, Any]:
    """The step as the API tells it to bots."""
    items = [item for block in view.payload.get("blocks", []) for item in block["items"]]
    return {"kind": view.kind, "items": items}


@contextmanager
def _worker(settings: Settings, log: Path) -> Iterator[None]:
    with log.open("wb") as out:
        process = start_worker(settings, out)
        try:
            yield
        finally:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(20)
            process.kill()


def _jobs(database: Database, session_id: str) -> list[Job]:
    with database.session() as s:
        return list(s.scalars(select(Job).where(Job.session_id == session_id, Job.kind == "align")))


def _wait(database: Database, session_id: str, recipe: str | None = None) -> list[Job]:
    """The session's alignments (of one recipe) once they have ended."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        jobs = [job for job in _jobs(database, session_id) if recipe in (None, job.params["recipe"])]
        if all(job.state in FINAL_STATES for job in jobs):
            return jobs
        if time.monotonic() > deadline:
            raise FinishBenchmarkError(f"jobs were not done after {PATIENCE_S:.0f} s: {[job.state for job in jobs]}")
        time.sleep(POLL_S)


def _cancel_rest(database: Database, session_id: str) -> None:
    for job in _jobs(database, session_id):
        if job.state not in FINAL_STATES:
            with database.transaction() as s:
                cancel_job(s, job.id, by="benchmark")
    _wait(database, session_id)


def _summary(ended: list[list[Job]], patience_s: float) -> dict[str, Any]:
    instant = [job for jobs in ended for job in jobs if job.params["recipe"] == "instant"]
    searches = [job for jobs in ended for job in jobs if job.params["recipe"] != "instant"]
    in_time = [any(_shows(job) and _seconds(job) <= patience_s for job in jobs) for jobs in ended]
    return {
        "instant_s": _spread([_seconds(job) for job in instant]),
        "search_s": _spread([_seconds(job) for job in searches]),
        "shown_at_once": sum(_shows(job) for job in instant),
        "takes_over": sum(_shows(job) for job in searches),
        "failed": sum(job.state != "succeeded" for job in (*instant, *searches)),
        "errors": sorted({job.error for job in (*instant, *searches) if job.error}),
        "no_comparison_rate": 1 - sum(in_time) / len(in_time),
        "patience_s": patience_s,
    }


def _shows(job: Job) -> bool:
    return job.state == "succeeded" and bool((learned := job.result_as(Learned)) and learned.comparisons)


def _seconds(job: Job) -> float:
    assert job.finished_at is not None  # noqa: S101  it has ended
    return (job.finished_at - job.created_at).total_seconds()


def _spread(seconds: list[float]) -> dict[str, float] | None:
    if not seconds:
        return None
    return {"median": round(statistics.median(seconds), 2), "slowest": round(max(seconds), 2)}

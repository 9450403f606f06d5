"""Workers that share nothing but a database and an artefact store: one is killed, another goes on; who did what."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from desirepath.jobs import leases, process
from desirepath.jobs.leases import STALE_AFTER, WorkerName, attempts_at, begin_attempt, claim_silent, end_attempt, holds
from desirepath.jobs.process import FINAL_STATES, Outcome
from desirepath.settings import Settings
from desirepath.store import database as database_module
from desirepath.store import models, outbox
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Artefact, Job, JobAttempt, TaskFile, WorkerProcess, base, utc_now
from desirepath.store.outbox import enqueue_job
from desirepath_experiments.reproduction.on_workers import Queue, SweepError
from desirepath_experiments.reproduction.tasks import Task, Work
from tests import postgres
from tests.running import until

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 200.0
HERE, THERE = WorkerName("here-0-aaaaaaaa", "here"), WorkerName("there-0-bbbbbbbb", "there")


@contextmanager
def worker_on(machine: str, folder: Path, database_url: str, artefacts_url: str) -> Iterator[subprocess.Popen[bytes]]:
    """`desirepath worker` in an empty folder, told nothing but the two URLs (and what to call the machine)."""
    folder.mkdir()
    told = {
        "DESIREPATH_DATABASE_URL": database_url,
        "DESIREPATH_ARTEFACTS_URL": artefacts_url,
        "DESIREPATH_MACHINE": machine,
    }
    plain = {name: value for name, value in os.environ.items() if not name.startswith("DESIREPATH_")}
    worker = subprocess.Popen(
        [sys.executable, "-m", "desirepath", "worker"], cwd=folder, env=plain | {"PYTHONPATH": str(ROOT)} | told
    )
    try:
        yield worker
    finally:
        worker.kill()
        worker.wait()


def test_a_killed_workers_job_is_done_by_another_machine(postgres_server: str, tmp_path: Path) -> None:
    artefacts = (tmp_path / "artefacts").as_uri()
    with postgres.holding(postgres_server, tmp_path / "none") as url:
        database = Database(url)

        def job(job_id: str) -> Job:
            with database.session() as s:
                return s.get_one(Job, job_id)

        def log_of(one: Job) -> str:
            with database.session() as s:
                return s.get_one(JobAttempt, one.held_by).log

        def machines(job_id: str) -> list[tuple[str, str | None]]:
            with database.session() as s:
                return [(one.machine, one.outcome) for one in attempts_at(s, job_id)]

        with (
            worker_on("alpha", tmp_path / "a", url, artefacts) as alpha,
            worker_on("beta", tmp_path / "b", url, artefacts) as beta,
        ):
            until(lambda: living(database) == {"alpha", "beta"}, "they did not start")
            with database.transaction() as s:
                params = {"policy": "study_room/base", "scenes": 2_000}
                asked = enqueue_job(s, "evaluate", params, created_by="tests").id
            until(lambda: machines(asked), "nobody took the job up")
            first = machines(asked)[0][0]
            {"alpha": alpha, "beta": beta}[first].send_signal(signal.SIGKILL)
            killed = time.monotonic()
            until(lambda: len(machines(asked)) == 2, "nobody took the job over")
            taken_over_s = time.monotonic() - killed
            until(lambda: job(asked).state in FINAL_STATES, "the job did not end")
            until(lambda: "worked for" in log_of(job(asked)), "its log is not to be read where no file of it lies")
        done = job(asked)
        assert done.state == "succeeded", done.error
        assert machines(asked) == [(first, "lost"), ({"alpha": "beta", "beta": "alpha"}[first], "succeeded")]
        assert taken_over_s < 25, "twelve seconds of silence, five between two looks, and the queue's own"
        with database.session() as s:
            assert s.get_one(Artefact, done.result["evaluation"]).card["results"]["n"] == 2_000
        print(f"taken over {taken_over_s:.1f} s after the kill")
        ArtefactStore(artefacts).get(done.result["evaluation"])
        database.close()


def living(database: Database) -> set[str]:
    with database.session() as s:
        return {one.machine for one in s.query(WorkerProcess)}


@pytest.fixture
def held(database: Database) -> tuple[Database, str, str]:
    """A job that a worker here has begun: its id and the attempt's."""
    with database.transaction() as s:
        job = enqueue_job(s, "evaluate", {})
        job.state = "running"
        return database, job.id, begin_attempt(s, job, HERE)


def test_a_sweep_is_spread_over_machines_and_goes_on_where_it_was(postgres_server: str, tmp_path: Path) -> None:
    """Four tasks and one that needs them, on the queue; ended in the middle, and started again on another folder."""
    numbers = [{"number": one, "seconds": 0.5} for one in range(4)]
    parts = [Task("waiting", one, seconds=0.5) for one in numbers]
    whole = Task("summed", {}, needs=tuple(parts))
    artefacts = (tmp_path / "artefacts").as_uri()
    with (
        postgres.holding(postgres_server, tmp_path / "none") as url,
        worker_on("alpha", tmp_path / "a", url, artefacts),
        worker_on("beta", tmp_path / "b", url, artefacts),
    ):
        database = Database(url)
        until(lambda: living(database) == {"alpha", "beta"}, "they did not start")
        told: list[str] = []

        def sweep(folder: str, tasks: list[Task]) -> int:
            queue = Queue("trial", database, ArtefactStore(artefacts), created_by="tests")
            work = Work(tmp_path / folder)
            with work.claimed():
                done = queue.finish(tasks, work, on_task=lambda task, *_: told.append(task.kind))
                assert all(work.has(task) for task in tasks)
            return done

        assert sweep("first", parts[:3]) == 3
        with database.session() as s:
            assert len(s.query(Job).all()) == 3
            assert {one.machine for one in s.query(JobAttempt)} == {"alpha", "beta"}
        assert sweep("second", [whole]) == 5  # of which three were computed before, and are only fetched
        assert told[3:].count("summed") == 1
        with database.session() as s:
            assert len(s.query(Job).all()) == 5
        assert Work(tmp_path / "second").load(whole).meta["sum"] == 6
        assert sweep("second", [whole]) == 0
        with database.session() as s:
            ArtefactStore(artefacts).delete(s.get_one(TaskFile, parts[0].key).sha256)
        assert sweep("third", parts[:2]) == 2  # what is gone is computed again
        with database.session() as s:
            assert len(s.query(Job).all()) == 6
        broken = Task("waiting", {"number": 0, "seconds": "long"})
        with pytest.raises(SweepError, match="could not convert string to float: 'long'"):
            sweep("fourth", [broken])
        database.close()


def test_of_several_that_look_one_takes_a_silent_job_up(held: tuple[Database, str, str]) -> None:
    database, job_id, _ = held
    with database.transaction() as s:
        assert not claim_silent(s, job_id), "it was heard of just now"
        s.get_one(Job, job_id).heartbeat_at = utc_now() - STALE_AFTER
    with database.transaction() as s:
        assert claim_silent(s, job_id)
    with database.transaction() as s:
        assert not claim_silent(s, job_id)


@pytest.mark.parametrize("wrong_by", [timedelta(hours=-1), timedelta(hours=1)], ids=["behind", "ahead"])
def test_a_machine_with_a_wrong_clock_keeps_its_jobs_and_loses_them_when_it_is_gone(
    wrong_by: timedelta, postgres_server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who is silent is told by the database's clock, which all have, not by that of whoever looks."""
    with postgres.holding(postgres_server, tmp_path / "none") as url:
        database = Database(url)
        with monkeypatch.context() as on_the_other_machine:
            for module in (base, database_module, leases, models, outbox):
                on_the_other_machine.setattr(module, "utc_now", lambda: datetime.now(UTC) + wrong_by, raising=False)
            with database.transaction() as s:
                job_id = enqueue_job(s, "evaluate", {}).id
                assert not claim_silent(s, job_id), "it was put there just now"
                job = s.get_one(Job, job_id)
                job.state = "running"
                begin_attempt(s, job, THERE)
                leases.say_under_way(s, job)
                leases.say_alive(s, THERE, 1)
                assert leases.newest_sign_s(s) < 1
        with database.transaction() as s:
            assert leases.newest_sign_s(s) < 5
            assert not claim_silent(s, job_id), "it was heard of just now"
            s.get_one(Job, job_id).heartbeat_at -= STALE_AFTER
        with database.transaction() as s:
            assert claim_silent(s, job_id)
        database.close()


def test_who_was_thought_dead_and_comes_back_writes_nothing_any_more(
    held: tuple[Database, str, str], tmp_path: Path
) -> None:
    """Its process is ended, and how that ended is not the job's end."""
    database, job_id, first = held
    with database.transaction() as s:
        second = begin_attempt(s, s.get_one(Job, job_id), THERE)
    training = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        assert process.watch(database, job_id, training, first) is None
    finally:
        training.kill()
        training.wait()
    settings = Settings(data=tmp_path, _env_file=None)
    assert process._outcome(database, settings, job_id, 3, first) == Outcome.LOST
    with database.transaction() as s:
        job = s.get_one(Job, job_id)
        assert (job.state, job.error, holds(job, second)) == ("running", None, True)
        end_attempt(s, second, "succeeded", "all well")
        assert [(one.machine, one.outcome) for one in attempts_at(s, job_id)] == [
            ("here", "lost"),
            ("there", "succeeded"),
        ]

"""A worker that sleeps: what wakes it, and that a job is found where nothing did."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

from desirepath.jobs import engine as engine_module
from desirepath.jobs import worker as worker_module
from desirepath.jobs.process import FINAL_STATES
from desirepath.jobs.worker import Worker
from desirepath.settings import Settings
from desirepath.store.database import Database
from desirepath.store.models import Job
from desirepath.store.outbox import enqueue_job
from desirepath.store.worker_signals import Signal, signal_workers
from tests.running import until

PATIENCE_S = 60.0
NEVER_S = 3_600.0


@pytest.fixture
def start(database: Database, tmp_path, monkeypatch) -> Iterator[Callable[..., Worker]]:
    """Start a worker in this process that looks for itself every `look_s`."""
    stopping, woken, threads = threading.Event(), threading.Event(), []
    started = []

    def begin(*, look_s: float, standing: bool = False) -> Worker:
        monkeypatch.setattr(worker_module, "LOOK_S", look_s)
        monkeypatch.setattr(engine_module, "IDLE_POLL_S", NEVER_S)
        url = database.url.render_as_string(hide_password=False)
        settings = Settings(data=tmp_path, database_url=url, standing_process=standing, _env_file=None)
        started.append(Worker(settings, stopping, woken))
        threads.append(threading.Thread(target=started[0].run))
        threads[0].start()
        until(lambda: started[0]._signals.hears)
        return started[0]

    yield begin
    stopping.set()
    woken.set()
    threads[0].join(PATIENCE_S)
    started[0]._engine.stop()
    started[0].close()


def has_ended(database: Database, job: str) -> bool:
    with database.session() as s:
        return s.get_one(Job, job).state in FINAL_STATES


def test_a_committed_job_wakes_the_worker_and_its_queue(database, start):
    start(look_s=NEVER_S)
    for _ in range(2):
        with database.transaction() as s:
            job = enqueue_job(s, "evaluate", {"policy": "study_room/none"}).id
        until(lambda job=job: has_ended(database, job))


def test_a_job_whose_signal_was_lost_is_found(database, start):
    start(look_s=0.5)
    for pipe in database.file.parent.glob("*.worker-*"):
        pipe.unlink()
    with database.transaction() as s:
        job = enqueue_job(s, "evaluate", {"policy": "study_room/none"}).id
    until(lambda: has_ended(database, job))


def test_the_standing_process_starts_when_a_participant_is_there(database, start):
    worker = start(look_s=NEVER_S, standing=True)
    assert worker._standing.ready is None
    with database.transaction() as s:
        signal_workers(s, Signal.PARTICIPANT_PRESENT)
    until(lambda: worker._standing.ready is not None)

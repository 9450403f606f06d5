"""The durable queue: order, once only, a second attempt after a crash, and taking up what a killed worker left."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from desirepath.jobs import engine as engine_module
from desirepath.jobs.engine import Engine, EngineState
from desirepath.store.outbox import Queue

PATIENCE_S = 60


class Recorder:
    """Attempts that are written down; `gate` holds every attempt back until it is set."""

    def __init__(self) -> None:
        self.attempts: list[tuple[str, int]] = []
        self.concluded: dict[str, str] = {}
        self.ended = threading.Condition()
        self.gate = threading.Event()
        self.gate.set()
        self.outcomes: dict[str, str] = {}

    def attempt(self, job_id: str, number: int) -> str:
        self.attempts.append((job_id, number))
        self.gate.wait(PATIENCE_S)
        return self.outcomes.get(job_id, "succeeded")

    def conclude(self, job_id: str, outcome: str) -> None:
        with self.ended:
            self.concluded[job_id] = outcome
            self.ended.notify_all()

    def wait_for(self, *jobs: str) -> None:
        with self.ended:
            assert self.ended.wait_for(lambda: self.concluded.keys() >= set(jobs), PATIENCE_S), self.attempts


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def engine(recorder: Recorder, tmp_path: Path) -> Iterator[Engine]:
    made = Engine(
        f"sqlite:///{tmp_path / 'jobs.sqlite'}",
        executor_id="tests",
        processes=1,
        attempt=recorder.attempt,
        conclude=recorder.conclude,
    )
    made.start()
    yield made
    recorder.gate.set()
    made.stop()


def test_smaller_priorities_go_first(engine, recorder):
    recorder.gate.clear()
    engine.submit("first", queue=Queue.ANALYSTS, priority=10)
    while not recorder.attempts:
        threading.Event().wait(0.05)
    engine.submit("patient", queue=Queue.ANALYSTS, priority=20)
    engine.submit("urgent", queue=Queue.ANALYSTS, priority=1)
    assert engine.state("urgent") == EngineState.WAITING
    recorder.gate.set()
    recorder.wait_for("first", "patient", "urgent")
    assert [job for job, _ in recorder.attempts] == ["first", "urgent", "patient"]


def test_participants_do_not_queue_behind_analysts_nor_instant_policies_behind_trainings(engine, recorder):
    recorder.gate.clear()
    engine.submit("long-training", queue=Queue.ANALYSTS, priority=1)
    while not recorder.attempts:
        threading.Event().wait(0.05)
    waiting = {"search": Queue.BEHIND, "own-policy": Queue.PARTICIPANTS, "at-once": Queue.INSTANT}
    for number, (job, queue) in enumerate(waiting.items(), start=2):
        engine.submit(job, queue=queue, priority=5)
        while len(recorder.attempts) < number:
            threading.Event().wait(0.05)
    assert recorder.attempts == [("long-training", 1), ("search", 1), ("own-policy", 1), ("at-once", 1)]
    assert {engine.state(job) for job in ("long-training", *waiting)} == {EngineState.RUNNING}


def test_submitting_twice_runs_once(engine, recorder):
    for _ in range(3):
        engine.submit("job", queue=Queue.ANALYSTS, priority=1)
    recorder.wait_for("job")
    engine.submit("job", queue=Queue.ANALYSTS, priority=1)
    engine.submit("other", queue=Queue.ANALYSTS, priority=1)
    recorder.wait_for("other")
    assert recorder.attempts == [("job", 1), ("other", 1)]
    assert engine.state("job") == EngineState.ENDED
    assert engine.state("never-heard-of") == EngineState.UNKNOWN


def test_what_is_submitted_starts_at_once_though_idle_queues_hardly_look(engine, recorder, monkeypatch):
    monkeypatch.setattr(engine_module, "IDLE_POLL_S", 3_600.0)
    monkeypatch.setattr(engine_module, "STILL_BUSY_S", 1.0)
    engine.submit("first", queue=Queue.ANALYSTS, priority=1)
    recorder.wait_for("first")
    threading.Event().wait(1.0 + 2 * engine_module.TRAINING_POLL_S)  # all queues have fallen asleep
    for number in range(3):
        engine.submit(f"later-{number}", queue=Queue.ANALYSTS, priority=1)
    recorder.wait_for("later-0", "later-1", "later-2")


def test_crash_gets_one_more_attempt_and_failure_none(engine, recorder):
    recorder.outcomes = {"crashing": "crashed", "failing": "failed"}
    for job in recorder.outcomes:
        engine.submit(job, queue=Queue.ANALYSTS, priority=1)
    recorder.wait_for("crashing", "failing")
    assert sorted(recorder.attempts) == [("crashing", 1), ("crashing", 2), ("failing", 1)]
    assert recorder.concluded == {"crashing": "crashed", "failing": "failed"}


KILLED = """
import os, signal, sys, time
from desirepath.jobs import engine as engine_module
from desirepath.jobs.engine import Engine, Queue
def attempt(job_id, number):
    if number == 1:
        return "crashed"
    os.kill(os.getpid(), signal.SIGKILL)
engine = Engine(sys.argv[1], executor_id="tests", processes=1, attempt=attempt, conclude=lambda job, outcome: None)
engine.start()
engine.submit("job", queue=Queue.ANALYSTS, priority=1)
time.sleep(60)
"""


@pytest.fixture
def left_behind(tmp_path: Path) -> str:
    """The queue of a worker that was killed in its second attempt."""
    url = f"sqlite:///{tmp_path / 'jobs.sqlite'}"
    killed = subprocess.run([sys.executable, "-c", KILLED, url], cwd=Path(__file__).resolve().parents[2])
    assert killed.returncode == -9
    return url


def test_next_worker_of_the_same_name_repeats_only_the_interrupted_step(recorder, left_behind):
    engine = Engine(left_behind, executor_id="tests", processes=1, attempt=recorder.attempt, conclude=recorder.conclude)
    engine.start()
    try:
        recorder.wait_for("job")
        assert recorder.attempts == [("job", 2)]
    finally:
        engine.stop()


def test_another_worker_takes_the_job_up_when_it_is_told_to(recorder, left_behind):
    engine = Engine(left_behind, executor_id="other", processes=1, attempt=recorder.attempt, conclude=recorder.conclude)
    engine.start()
    try:
        assert engine.state("job") == EngineState.RUNNING
        engine.resume("job", queue=Queue.ANALYSTS)
        recorder.wait_for("job")
        assert recorder.attempts == [("job", 2)]
    finally:
        engine.stop()

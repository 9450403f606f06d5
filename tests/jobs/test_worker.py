"""A real worker with real training processes: success, cancel, bad input, a killed process, a killed worker."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sqlalchemy import select

from desirepath.jobs.context import PAUSED
from desirepath.jobs.leases import attempts_at
from desirepath.jobs.process import FINAL_STATES, environment_of, read_log
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore, lineage
from desirepath.store.database import Database
from desirepath.store.models import Artefact, Job, JobMetric, Participant, Session
from desirepath.store.outbox import PARTICIPANT_WAITS, REFINES, cancel_job, enqueue_job
from desirepath.store.snapshots import take_snapshot
from tests.answered_study import add_answered_study

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 150
ENDLESS = {"setup": "study_room", "updates": 2_000_000, "n_envs": 8}


class WorkerRig:
    """A data folder with a worker on it."""

    def __init__(self, data: Path) -> None:
        self.settings = Settings(data=data, _env_file=None)
        self.database = Database(self.settings.database)
        self.database.migrate()
        self.files = ArtefactStore(self.settings.artefacts)
        self.worker: subprocess.Popen[bytes] | None = None

    def start_worker(self) -> None:
        self.worker = subprocess.Popen(
            [sys.executable, "-m", "desirepath", "worker"], cwd=ROOT, env=environment_of(self.settings)
        )

    def stop_worker(self, number: signal.Signals = signal.SIGTERM) -> int:
        assert self.worker is not None
        self.worker.send_signal(number)
        return self.worker.wait(30)

    def enqueue(self, kind: str, **params: object) -> str:
        with self.database.transaction() as s:
            return enqueue_job(s, kind, params, created_by="tests").id

    def job(self, job_id: str) -> Job:
        with self.database.session() as s:
            return s.get_one(Job, job_id)

    def wait(self, what: Callable[[], object], told: Callable[[], object] = lambda: "") -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < deadline, told()
            time.sleep(0.1)

    def ended(self, job_id: str) -> Job:
        self.wait(lambda: self.job(job_id).state in FINAL_STATES, lambda: read_log(self.settings, job_id))
        return self.job(job_id)

    def begun(self, job_id: str, times: int = 1) -> None:
        """Wait until its process is at work."""
        self.wait(lambda: read_log(self.settings, job_id, 10**6).count(" begins\n") >= times)

    def process_of(self, job_id: str) -> int:
        found = processes_of(job_id)
        assert len(found) == 1, found
        return found[0]


def processes_of(job_id: str) -> list[int]:
    """The training processes of a job that live now (Linux)."""
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            words = (entry / "cmdline").read_bytes().split(b"\0") if entry.name.isdigit() else []
            if b"desirepath.jobs.run" in words and job_id.encode() in words:
                found.append(int(entry.name))
    return found


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WorkerRig]:
    made = WorkerRig(tmp_path_factory.mktemp("worker"))
    made.start_worker()
    yield made
    assert made.stop_worker() == 0


def test_job_runs_to_an_artefact_with_card_and_lineage(rig):
    done = rig.ended(rig.enqueue("evaluate", policy="study_room/base", scenes=40))
    assert (done.state, done.progress, done.error) == ("succeeded", 1.0, None), done.error
    assert done.started_at <= done.heartbeat_at <= done.finished_at
    with rig.database.session() as s:
        made = s.get_one(Artefact, done.result["evaluation"])
        assert [parent.artefact.name for parent in lineage(s, made.id).parents] == ["study_room/base"]
    assert made.job_id == done.id
    assert made.card["command"] == "desirepath jobs start evaluate --set policy=study_room/base --set scenes=40"
    assert made.card["results"]["n"] == 40
    assert made.card["results"]["success_rate"] > 0.8
    assert "worked for" in read_log(rig.settings, done.id)


def test_trained_policy_is_measured_afterwards(rig):
    trained = rig.ended(
        rig.enqueue("train_base", setup="open_field", updates=240, n_envs=512, batch_size=8, selection_scenes=50)
    )
    assert trained.state == "succeeded", trained.error
    with rig.database.session() as s:
        follow_up = s.scalars(select(Job).where(Job.params["policy"].as_string() == trained.result["policy"])).one()
        curves = set(s.scalars(select(JobMetric.name).where(JobMetric.job_id == trained.id)))
        card = s.get_one(Artefact, trained.result["policy"]).card
    assert follow_up.kind == "evaluate"
    assert {"success_rate", "min_human_distance_m"} <= curves
    assert any("progress" in departure for departure in card["departures"])
    # No need to wait for 2,000 scenes of a poor driver.
    with rig.database.transaction() as s, contextlib.suppress(ValueError):
        cancel_job(s, follow_up.id, by="tests")


def test_command_starts_a_job_and_prints_its_result(rig):
    words = ["jobs", "start", "evaluate", "--set", "policy=study_room/base", "--set", "scenes=30", "--json"]
    told = subprocess.run(
        [sys.executable, "-m", "desirepath", *words],
        cwd=ROOT,
        env=environment_of(rig.settings),
        stdout=subprocess.PIPE,
    )
    result = json.loads(told.stdout)
    assert told.returncode == 0
    assert result["measured"]["n"] == 30
    assert rig.job(result["job"]).created_by == "command line"


def test_cancel_ends_the_training_and_its_process(rig):
    job = rig.enqueue("train_base", **ENDLESS)
    rig.begun(job)
    with rig.database.transaction() as s:
        cancel_job(s, job, by="tests")
    assert rig.ended(job).state == "cancelled"
    rig.wait(lambda: not processes_of(job))


@pytest.mark.parametrize(
    ("kind", "params", "says"),
    [
        ("align", {"snapshot": "f" * 64}, "no snapshot"),
        ("evaluate", {"policy": "kitchen/base"}, "kitchen/base"),
        ("evaluate", {"policy": "study_room/base", "scenes": 1}, "scenes = 1"),
        ("bake", {}, "known: align"),
    ],
)
def test_job_that_cannot_work_says_why(rig, kind, params, says):
    failed = rig.ended(rig.enqueue(kind, **params))
    assert failed.state == "failed"
    assert says in failed.error


def test_process_that_is_killed_is_tried_once_more_then_given_up(rig):
    job = rig.enqueue("train_base", **ENDLESS)
    for attempt in (1, 2):
        rig.begun(job, times=attempt)
        os.kill(rig.process_of(job), signal.SIGKILL)
    failed = rig.ended(job)
    assert failed.state == "failed"
    assert "SIGKILL" in failed.error
    assert "tried again once" in failed.error


def test_two_orderly_restarts_within_one_training_are_no_attempts(tmp_path):
    rig = WorkerRig(tmp_path)
    job = rig.enqueue("evaluate", policy="study_room/base", scenes=600)
    for times, asked in enumerate((signal.SIGTERM, signal.SIGINT), 1):
        rig.start_worker()
        rig.begun(job, times)
        assert rig.stop_worker(asked) == 0
        assert not processes_of(job)
        assert (rig.job(job).state, rig.job(job).error) == ("running", None)
    rig.start_worker()
    try:
        done = rig.ended(job)
    finally:
        rig.stop_worker()
    assert done.state == "succeeded", done.error
    with rig.database.session() as s:
        assert [one.outcome for one in attempts_at(s, job)] == ["stopped", "stopped", "succeeded"]
    assert "attempt" not in done.message


def test_who_waits_goes_first_while_a_completed_sessions_search_pauses_and_goes_on(tmp_path):
    """One training process, and a search for something better than what its participant has seen to the end."""
    rig = WorkerRig(tmp_path)
    study = add_answered_study(rig.database, rig.files, participants=2)
    with rig.database.transaction() as s:
        over, waits = s.scalars(
            select(Session.id).join(Participant).where(Participant.study_id == study).order_by(Participant.code)
        )
        snapshot = take_snapshot(s, rig.files, session_id=over)
        asked = {"snapshot": snapshot.id, "setup": "study_room", "recipe": "conditioning_search", "tried": 10_000}
        search = enqueue_job(s, "align", asked, priority=REFINES, session_id=over).id
    rig.start_worker()
    try:
        rig.begun(search)
        rig.wait(lambda: rig.job(search).progress > 0.03, lambda: read_log(rig.settings, search))
        with rig.database.transaction() as s:
            few = {"setup": "open_field", "updates": 2_400, "n_envs": 256, "batch_size": 8, "selection_scenes": 50}
            training = enqueue_job(s, "train_base", few, priority=PARTICIPANT_WAITS, session_id=waits).id
        rig.begun(training)
        rig.wait(lambda: PAUSED in read_log(rig.settings, search), lambda: read_log(rig.settings, search))
        assert rig.ended(training).state == "succeeded", rig.job(training).error
        assert rig.job(search).state == "running"
        rig.wait(lambda: "goes on" in read_log(rig.settings, search), lambda: read_log(rig.settings, search))
        with rig.database.session() as s:
            assert [one.worker for one in attempts_at(s, search)] == [one.worker for one in attempts_at(s, training)]
    finally:
        rig.stop_worker()


def test_a_service_manager_that_ends_the_training_first_costs_no_attempt(tmp_path):
    """systemd asks the whole service to end: the training may be gone before its worker has heard of it."""
    rig = WorkerRig(tmp_path)
    rig.start_worker()
    job = rig.enqueue("train_base", **ENDLESS)
    rig.begun(job)
    os.kill(rig.process_of(job), signal.SIGTERM)
    rig.wait(lambda: not processes_of(job))
    assert rig.stop_worker() == 0
    assert (rig.job(job).state, rig.job(job).error) == ("running", None)
    with rig.database.session() as s:
        assert [one.outcome for one in attempts_at(s, job)] == ["stopped"]


def test_killed_worker_leaves_no_orphan_and_the_next_one_finishes_the_job(tmp_path):
    rig = WorkerRig(tmp_path)
    rig.start_worker()
    job = rig.enqueue("evaluate", policy="study_room/base", scenes=200)
    cancelled = rig.enqueue("train_base", **ENDLESS)
    rig.begun(job)
    orphan = rig.process_of(job)
    assert rig.stop_worker(signal.SIGKILL) == -signal.SIGKILL
    rig.wait(lambda: orphan not in processes_of(job))
    assert rig.job(job).state == "running"
    with rig.database.transaction() as s:
        cancel_job(s, cancelled, by="tests")
    rig.start_worker()
    try:
        done = rig.ended(job)
        assert done.state == "succeeded", done.error
        assert rig.ended(cancelled).state == "cancelled"
        with rig.database.session() as s:
            assert len(list(s.scalars(select(Artefact).where(Artefact.kind == "evaluation")))) == 1
    finally:
        rig.stop_worker()

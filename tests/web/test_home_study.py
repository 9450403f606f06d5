"""A study in furnished homes from end to end: bots walk and draw over HTTP, what they drew becomes a controller that
goes by its depth camera, and the evaluation shows it. Every part is real, with budgets that teach nobody."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from sqlalchemy import select

from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.depth.depth_controller import DepthController
from desirepath.jobs import controller_training
from desirepath.jobs.context import JobContext, Progress
from desirepath.jobs.demonstrating import train_demonstrations
from desirepath.jobs.kinds import TrainDemonstrationsParams
from desirepath.store.artefacts import load_trajectory
from desirepath.store.demonstration_snapshots import read_demonstrations
from desirepath.store.models import Artefact, Job, Response, Session, TrajectoryRow, Trial
from desirepath.study.personalising import alignment_jobs
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.simulated.http import simulate_study
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services

PROTOCOL = Path(__file__).resolve().parents[2] / "study_protocols" / "demonstration_study.yaml"
SHORTER = {  # one appointment, and only homes, in which the participant walks while the robot drives
    "environment: corridor, pairs: 4, per_pair: 3, up_to: 5, view: top_down":
        "environment: home, pairs: 2, per_pair: 1, view: top_down, person: walks",
    "  - demonstrations: {environment: room, pairs: 4, per_pair: 3, up_to: 5, view: top_down}\n": "",
    "  - appointment: {text: texts/drawing_appointment.md, after_days: 1, within_days: 14}\n": "",
}  # fmt: skip


def work(services: Services, over: threading.Event) -> None:
    """Does every job as a worker would, but lets a controller pass that never arrives."""
    while not over.wait(0.05):
        with services.database.transaction() as s:
            job = s.scalars(select(Job).where(Job.state == "queued")).first()
            if job is None:
                continue
            job.state = "running"
        params = TrainDemonstrationsParams(**{**job.params, "gate_min_success": 0.0})
        context = JobContext(
            services.settings, services.database, services.files, job, Progress(services.database, job.id)
        )
        made = train_demonstrations(context, params)
        with services.database.transaction() as s:
            done = s.get_one(Job, job.id)
            done.state, done.progress, done.result = "succeeded", 1.0, made


@pytest.fixture
def study(services: Services) -> str:
    """Its recruiting link."""
    text = PROTOCOL.read_text()
    for there, instead in SHORTER.items():
        assert there in text
        text = text.replace(there, instead)
    with services.database.transaction() as s:
        return create_study(s, services.files, freeze_text(text), name="Homes", created_by=None).recruiting_token


def test_paths_drawn_in_homes_beside_a_walking_person_become_a_depth_controller_that_the_evaluation_shows(
    client, services: Services, study: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(alignment_jobs, "UPDATES_WHILE_ONE_WAITS", 16)
    monkeypatch.setattr(controller_training, "EXPLORED_HOMES", 2)
    over = threading.Event()
    worker = threading.Thread(target=work, args=(services, over))
    worker.start()
    try:
        done = simulate_study("", study, 1, Character(style="behind"), client=client)
    finally:
        over.set()
        worker.join()
    assert (done["participants"], done["completed"]) == (1, 1)
    with services.database.session() as s:
        session = s.scalars(select(Session)).one()
        assert session.personalisation == "shown"
        job = s.scalars(select(Job)).one()
        controller = s.get_one(Artefact, job.result["policy"])
        assert (controller.kind, controller.setup, controller.simulated) == ("depth_controller", "home", True)
        assert controller.card["config"]["sensor"] == "depth"
        assert DepthController.from_bytes(services.files.get(controller.id)).configuration.name == "VAE-HA"
        _, kept = read_demonstrations(services.files.get(job.params["snapshot"]))
        shown = [Demonstration.from_bytes(services.files.get(one.demonstration)) for one in kept]
        assert len(shown) == 2
        assert all(one.scene.setup == "home" and one.scene.walk is not None for one in shown)
        trials = s.scalars(select(Trial).where(Trial.kind == "evaluation")).all()
        by: dict[str | None, list[TrajectoryRow]] = {}
        for trial in trials:
            assert trial.phase == "answered"
            by.setdefault(trial.block, []).append(s.get_one(TrajectoryRow, trial.trajectory_a))
        ratings = s.scalars(select(Response.step_key).where(Response.step_key.endswith("drawing_rating"))).all()
    assert {block: len(rows) for block, rows in by.items()} == {"own": 2, "dwa": 2, "social_cost": 2}
    assert {row.made_by for row in by["own"]} == {controller.id}
    assert len(ratings) == 3  # of three robots in homes
    for rows in by.values():
        assert {load_trajectory(services.files, row.id).scene.setup for row in rows} == {"home"}

"""The study among pedestrians from end to end: bots judge over HTTP, their answers become a policy that is compared
blind with the base policy, and report and data set hold it all. Every part is real, with budgets that teach nobody."""

from __future__ import annotations

import csv
import json
import threading
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from desirepath import Report
from desirepath.jobs.aligning import align
from desirepath.jobs.alignments.instant import InstantParams
from desirepath.jobs.context import JobContext, Progress
from desirepath.learning.preferences.objectives import CROWD_NAMES
from desirepath.report.study_report import write_study_report
from desirepath.report.tidy_tables import read_folder
from desirepath.store.artefacts import load_trajectory
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Artefact, Job, Session, Trial
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.simulated.http import simulate_study
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services

PROTOCOLS = Path(__file__).resolve().parents[2] / "study_protocols"
PROTOCOL = PROTOCOLS / "crowd_study.yaml"
SOCIAL = (
    "personal_space_violations",
    "min_time_to_collision_s",
    "path_irregularity_rad_per_m",
    "mean_jerk_m_per_s3",
    "stalled_time_s",
)


class Worker(threading.Thread):
    """Works until it is told that it is over; what goes wrong in it is raised where it is left."""

    def __init__(self, services: Services) -> None:
        super().__init__()
        self.services, self.over, self.wrong = services, threading.Event(), list[BaseException]()

    def run(self) -> None:
        try:
            work(self.services, self.over)
        except BaseException as wrong:  # whatever it is, the test fails with it
            self.wrong.append(wrong)

    def __enter__(self) -> None:
        self.start()

    def __exit__(self, *_: object) -> None:
        self.over.set()
        self.join()
        if self.wrong:
            raise AssertionError("the worker stopped") from self.wrong[0]


def work(services: Services, over: threading.Event) -> None:
    """Makes the instant policy as a worker would, with a tenth of the gate's scenes; nobody waits for the search."""
    while not over.wait(0.05):
        with services.database.transaction() as s:
            job = s.scalars(select(Job).where(Job.state == "queued")).first()
            if job is None:
                continue
            job.state = "running"
        state, made = "failed", {"why": "nothing is searched in this test"}
        if job.params["recipe"] == "instant":
            state, made = "succeeded", _aligned(services, job)
        with services.database.transaction() as s:
            done = s.get_one(Job, job.id)
            done.state, done.progress, done.result = state, 1.0, made


def _aligned(services: Services, job: Job) -> dict[str, Any]:
    easy = {"gate_scenes": 50, "gate_min_success": 0.5, "gate_max_loss": 0.5, "surely_better": 0.5}
    progress = Progress(services.database, job.id)
    context = JobContext(services.settings, services.database, services.files, job, progress)
    return align(context, InstantParams(**{**job.params, **easy}))


@pytest.fixture
def study(services: Services) -> tuple[str, str]:
    """Its id and its recruiting link; four pairs instead of fifteen."""
    text = PROTOCOL.read_text()
    assert "count: 15" in text
    with services.database.transaction() as s:
        frozen = freeze_text(text.replace("count: 15", "count: 4"))
        made = create_study(s, services.files, frozen, name="Crowd", created_by=None)
        return made.id, made.recruiting_token


def test_who_judges_a_crowd_gets_a_policy_of_their_own_blind_against_the_base_policy(
    client, services: Services, study: tuple[str, str], tmp_path: Path
) -> None:
    with Worker(services):
        done = simulate_study("", study[1], 1, Character("fastest"), client=client)
    assert (done["participants"], done["completed"]) == (1, 1)
    with services.database.session() as s:
        session = s.scalars(select(Session)).one()
        job = next(one for one in s.scalars(select(Job)) if one.params["recipe"] == "instant")
        policy = s.get_one(Artefact, job.result["policy"])
        trials = s.scalars(select(Trial).order_by(Trial.index)).all()
        shown = [load_trajectory(services.files, one.trajectory_a).scene for one in trials]
    assert session.personalisation == "shown", job.result
    assert policy.setup == "crowd_hall"
    assert any(f'"{name}"' in json.dumps(policy.card) for name in CROWD_NAMES)
    assert [one.kind for one in trials].count("comparison") == 3
    assert {scene.setup for scene in shown} == {"crowd_hall"}
    assert all(len(scene.crowd.pedestrians) == 2 for scene in shown if scene.crowd)
    export_study(services.database, services.files, study[0], tmp_path / "out")
    with (tmp_path / "out" / "trajectory_metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows
    assert all(row[name] != "" for row in rows for name in SOCIAL)
    report = Report(tmp_path / "out", who="simulated")  # as a notebook reads a data set
    assert report.findings.flow.analysed == 1
    assert "Crowd" in report.write(tmp_path / "report").read_text()


def test_the_interface_study_runs_among_pedestrians(client, services: Services, tmp_path: Path) -> None:
    text = (PROTOCOLS / "interface_study.yaml").read_text()
    for old, new in (
        ("study_room/queries_500", "crowd_hall/queries_varied_60"),
        ("count: 25, probes: {repeat: 5}", "count: 5, probes: {repeat: 5}"),
    ):
        assert old in text
        text = text.replace(old, new)
    with services.database.transaction() as s:
        made = create_study(s, services.files, freeze_text(text), name="Views", created_by=None)
        study, link = made.id, made.recruiting_token
    done = simulate_study("", link, 1, Character("fastest"), client=client)
    assert done["completed"] == 1
    with services.database.session() as s:
        trials = s.scalars(select(Trial)).all()
        seen = [(one.view, load_trajectory(services.files, one.trajectory_a).scene) for one in trials]
    assert {view for view, _ in seen} == {"top_down", "first_person", "immersive"}
    assert all(len(scene.crowd.pedestrians) == 2 for _, scene in seen)
    export_study(services.database, services.files, study, tmp_path / "out")
    data, load = read_folder(tmp_path / "out")
    write_study_report(data, load, tmp_path / "report", who="simulated", command="desirepath studies report")
    agreement = (tmp_path / "report" / "report.html").read_text()
    assert "first person – immersive 100.0" in agreement, "who always wants the fastest chooses alike in all views"

"""Bots walk whole sessions over HTTP and are marked; nobody else may do what they may."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.oracles import path_length_m
from desirepath.store.artefacts import load_trajectory
from desirepath.store.models import Job, Participant, Response, Session, Study, Trial
from desirepath.store.snapshots import load_snapshot
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.simulated.http import simulate_study
from desirepath.study.simulated.participant import Character, SimulationError
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services
from tests.web.participant_services import logged, to_first_trial


@contextmanager
def failing_worker(services: Services) -> Iterator[None]:
    """Ends every training as failed: a real one takes half a minute, and what it makes is tested with the jobs."""
    over = threading.Event()

    def work() -> None:
        while not over.wait(0.05):
            with services.database.transaction() as s:
                for job in s.scalars(select(Job).where(Job.state == "queued")):
                    job.state, job.error = "failed", "no worker in this test"

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def worker_that_is_sure_from(services: Services, answers: int) -> Iterator[None]:
    """Ends every training: surely better from so many answers on; with one comparison of two stored trajectories."""
    over = threading.Event()

    def work() -> None:
        while not over.wait(0.05):
            with services.database.transaction() as s:
                for job in s.scalars(select(Job).where(Job.state == "queued")):
                    snapshot = load_snapshot(s, services.files, job.params["snapshot"])
                    given = snapshot.training_answers()
                    sure = len(given) >= answers
                    pair = {"base": given[0].trajectory_a, "own": given[0].trajectory_b, "look_alike": False}
                    job.state, job.result = (
                        "succeeded",
                        {
                            "policy": "own-policy",
                            "passed": sure,
                            "why": "passed" if sure else "not_surely_better",
                            "personal": {"passed": sure, "probability_better": 0.95 if sure else 0.7},
                            "comparisons": [pair] if sure else [],
                        },
                    )

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_bots_walk_to_the_end_and_are_marked(client, services, link):
    with failing_worker(services):
        done = simulate_study("", link, 2, Character("shortest"), client=client)
    assert (done["participants"], done["completed"]) == (2, 2)
    assert done["responses"] == 2 * (4 + 4 + 1)
    with services.database.session() as s:
        people = list(s.scalars(select(Participant)))
        trials = list(s.scalars(select(Trial)))
        sessions = list(s.scalars(select(Session)))
        jobs = list(s.scalars(select(Job)))
    assert all(person.simulated for person in people)
    assert [person.oracle["name"] for person in people] == ["shortest", "shortest"]
    assert {session.personalisation for session in sessions} == {"job_failed"}
    assert all(trial.phase == "answered" for trial in trials)
    assert [job.priority for job in jobs] == [5, 5]  # behind people


def test_the_oracle_decides_from_the_drives(client, services, link):
    with failing_worker(services):
        simulate_study("", link, 1, Character("shortest"), client=client)
    with services.database.session() as s:
        pairs = s.execute(select(Trial, Response.value).join(Response, Response.trial_id == Trial.id)).all()
    assert len(pairs) == 4
    for trial, value in pairs:
        a, b = (path_length_m(load_trajectory(services.files, t)) for t in (trial.trajectory_a, trial.trajectory_b))
        assert value["choice"] == ("b" if b < a else "a")


def test_a_bot_that_is_asked_on_is_told_so_and_answers_until_its_robot_is_surely_better(client, services, link):
    with services.database.transaction() as s:
        text = s.scalars(select(Study.protocol_yaml).where(Study.recruiting_token == link)).one()
        asking = text.replace("give_up_after_s: 120", "give_up_after_s: 120, ask_on: {at_most: 3, each: 2}")
        assert asking != text
        asked_on = create_study(
            s, services.files, freeze_text(asking), name="Asks on", created_by=None
        ).recruiting_token
    with worker_that_is_sure_from(services, answers=5):
        done = simulate_study("", asked_on, 1, Character("shortest"), client=client)
    assert (done["participants"], done["completed"]) == (1, 1)
    with services.database.session() as s:
        session = s.scalars(select(Session)).one()
        roles = list(s.scalars(select(Trial.role).order_by(Trial.index)))
        told = list(s.scalars(select(Response.step_key).where(Response.kind == "asking_on")))
        jobs = list(s.scalars(select(Job).order_by(Job.created_at)))
    assert session.personalisation == "shown"
    assert roles == ["practice", *["regular"] * 3, *["further"] * 2, "regular"]
    assert told == ["train.more_1"]
    assert [job.result["passed"] for job in jobs] == [False, True]


def test_a_bot_marks_the_moments_that_it_thinks_least_of(client, services, link):
    with services.database.transaction() as s:
        text = s.scalars(select(Study.protocol_yaml).where(Study.recruiting_token == link)).one()
        kept = [line for line in text.splitlines() if not re.search("- (train|comparison|meet_your_robot):", line)]
        marking = "\n".join(kept).replace(
            "  - block:\n", "  - mark: {view: top_down, count: 2, good: true}\n  - block:\n"
        )
        marked = create_study(s, services.files, freeze_text(marking), name="Marks", created_by=None).recruiting_token
    assert simulate_study("", marked, 2, Character("min-human-distance"), client=client)["completed"] == 2
    with services.database.session() as s:
        said = [row.value["marks"] for row in s.scalars(select(Response).where(Response.kind == "mark"))]
    assert len(said) == 4
    assert {"good"} < {mark["why"] for marks in said for mark in marks} <= {"good", "too_close", None}


def test_an_unknown_oracle_is_refused_before_anybody_joins(client, services, link):
    with pytest.raises(LearningError, match="min-human-distance"):
        simulate_study("", link, 1, Character("nearest"), client=client)
    with services.database.session() as s:
        assert s.scalars(select(Participant)).first() is None


def test_a_bot_that_is_refused_says_why(client):
    with pytest.raises(SimulationError, match="404"):
        simulate_study("", "nowhere", 1, client=client)


def test_only_simulated_sessions_may_read_the_drives(client, services, token):
    to_first_trial(client, token)
    assert client.get(f"/api/session/{token}/trial-data").json()["error"]["code"] == "simulated_only"
    assert len(logged(services, "simulated_only")) == 1


def test_a_form_cannot_make_a_simulated_session(client, services, link):
    client.post(f"/join/{link}", data={"language": "en", "simulated": "true"})
    with services.database.session() as s:
        assert not s.scalars(select(Session)).one().simulated


@pytest.mark.parametrize("address", ["203.0.113.7", "2001:db8::7", "no address"])
def test_nobody_elsewhere_can_join_as_a_bot_and_skip_watching(client, services, link, address):
    elsewhere = TestClient(client.app, client=(address, 50_000))
    refused = elsewhere.post(f"/join/{link}", json={"simulated": True, "language": "en"})
    assert (refused.status_code, refused.json()["error"]["code"]) == (403, "bots_from_elsewhere")
    assert len(logged(services, "bots_from_elsewhere")) == 1
    with services.database.session() as s:
        assert s.scalars(select(Participant)).first() is None
    assert elsewhere.post(f"/join/{link}", json={"language": "en"}).json()["simulated"] is False


def test_a_bot_gets_no_code_that_pays_and_takes_no_persons_place(client, services, link):
    with services.database.transaction() as s:
        text = s.scalars(select(Study.protocol_yaml).where(Study.recruiting_token == link)).one()
        kept = [line for line in text.splitlines() if not re.search("- (train|comparison|meet_your_robot):", line)]
        frozen = freeze_text("\n".join(kept).replace("completion_code: random", "completion_code: PAID-2026"))
        paid = create_study(s, services.files, frozen, name="Paid", created_by=None).recruiting_token
    assert simulate_study("", paid, 1, client=client)["completed"] == 1
    with services.database.session() as s:
        assert s.scalars(select(Session.completion_code)).one() not in (None, "PAID-2026")
    someone = {"PROLIFIC_PID": "5f3c0ffee0ddba11"}
    assert client.post(f"/join/{paid}", json={"simulated": True, **someone}).status_code == 201
    assert client.post(f"/join/{paid}", data={"language": "en", **someone}).status_code == 303

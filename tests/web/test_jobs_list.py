"""The list of jobs says whose, what and how good."""

from __future__ import annotations

import re

from sqlalchemy import select

from desirepath.jobs.leases import WorkerName, begin_attempt
from desirepath.store.models import Job, Session, utc_now
from desirepath.store.outbox import enqueue_job
from tests.web.lab_services import csrf


def test_jobs_say_whose_they_are_what_was_asked_and_how_good_it_is(lab, lab_services, walked):
    with lab_services.database.transaction() as s:
        session = s.scalars(select(Session).where(Session.state == "completed")).first()
        for number, recipe in enumerate(("instant", "thesis")):
            s.add(
                Job(
                    kind="align", state="succeeded", params={"recipe": recipe}, study_id=walked.id,
                    session_id=session.id if number == 0 else None, started_at=utc_now(), finished_at=utc_now(),
                    result={"policy": "p", "passed": True, "gate": {"success_rate": 0.93 + number / 100}},
                )
            )  # fmt: skip
    page = lab.get("/lab/jobs").text
    assert "instant (conditioned)</span>" in page
    assert "thesis (relabelled buffer)</span>" in page
    assert re.search(r"93\s?%", page)
    assert "success at the gate" in page
    mine = lab.get(f"/lab/jobs?participant={walked.finished}&kind=align").text
    assert f"/people/{walked.finished}" in mine
    assert "thesis (relabelled buffer)</span>" not in mine
    assert "No job matches" in lab.get("/lab/jobs?participant=nobody").text
    states = re.findall(r'class="tag[^"]*">(succeeded|queued|failed|cancelled)', lab.get("/lab/jobs?sort=-state").text)
    assert states == sorted(states, reverse=True)


def test_a_jobs_page_says_which_machine_had_it_and_how_that_ended(lab, lab_services):
    with lab_services.database.transaction() as s:
        job = enqueue_job(s, "evaluate", {"policy": "study_room/base", "scenes": 2}, created_by="tests")
        for machine in ("cellar", "attic"):
            begin_attempt(s, job, WorkerName(f"{machine}-0-aaaaaaaa", machine))
        id_ = job.id
    page = re.sub(r"<[^>]+>", " ", lab.get(f"/lab/jobs/{id_}/live").text)
    assert re.search(r"cellar\s.*another worker took over.*attic\s.*running", page, re.DOTALL)
    told = lab.get(f"/api/lab/jobs/{id_}").json()["attempts"]
    assert [(one["machine"], one["outcome"]) for one in told] == [("cellar", "lost"), ("attic", "running")]


def test_tasks_of_sweeps_are_shown_and_cancelled_but_nobody_starts_one_by_hand(lab, lab_services):
    asked = {"chapter": "benchmark", "key": "a" * 64, "function": "busy", "params": {"seconds": 1.0}, "needs": []}
    with lab_services.database.transaction() as s:
        job = enqueue_job(s, "task", asked, created_by="command line").id
    for address in ("/lab/jobs", "/lab/jobs?kind=task", f"/lab/jobs/{job}"):
        assert lab.get(address).status_code == 200, address
    assert lab.get("/lab/jobs/new/task").status_code == 404
    form = {"csrf": csrf(lab), "chapter": "benchmark", "key": "a", "function": "busy", "params": "{}"}
    assert lab.post("/lab/jobs/new/task", data=form).status_code == 404
    assert lab.post(f"/lab/jobs/{job}/cancel", data={"csrf": csrf(lab)}).status_code == 303

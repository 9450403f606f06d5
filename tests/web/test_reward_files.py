"""An analyst's own fitted reward is asked like a participant from the page: taken in, asked by a job, told in words."""

from __future__ import annotations

import io
import json

import pytest
import torch
from sqlalchemy import select
from torch import nn

from desirepath.jobs.context import JobContext, Progress
from desirepath.jobs.kinds import get_kind
from desirepath.jobs.process import finish
from desirepath.jobs.runners import ask_person
from desirepath.learning.people.asked_people import PeopleConfig
from desirepath.learning.people.reward_manifest import FILE_BYTES
from desirepath.simulation.setups import get_setup
from desirepath.store.models import Artefact, Job
from tests.web.lab_services import csrf

STUDY_ROOM = get_setup("study_room")

INPUTS = [{"of": "observation", "form": "export"}, {"of": "action", "form": "export"}]
MANIFEST = {"format": "desirepath-reward-2", "setup": "study_room", "file": "net.pt", "inputs": INPUTS}
SMALL = {"pool": 30, "test": 20, "scenes": (6, 6, 8), "queries": "policies"}


def network(inputs: int = STUDY_ROOM.observation_size + 2) -> bytes:
    torch.manual_seed(1)
    content = io.BytesIO()
    torch.save(nn.Linear(inputs, 1).state_dict(), content)
    return content.getvalue()


def take_in(lab, manifest: object = MANIFEST, content: bytes = b"", name: str = "net.pt"):
    files = {
        "manifest": ("somebody.json", json.dumps(manifest).encode(), "application/json"),
        "network": (name, content or network(), "application/octet-stream"),
    }
    form = {"csrf": csrf(lab, "/lab/jobs/new/ask_person")}
    return lab.post("/lab/reward-files", data=form, files=files, follow_redirects=False)


def looks_right(lab, reward: str):
    page = f"/lab/rewards/{reward}"
    return lab.post(f"{page}/looks-right", data={"csrf": csrf(lab, page)}, follow_redirects=False)


def done(services, monkeypatch) -> str:
    """Do the newest job here and now, with few pairs, as its process would; returns its id."""
    monkeypatch.setattr("desirepath.jobs.runners.PeopleConfig", lambda **given: PeopleConfig(**{**given, **SMALL}))
    with services.database.session() as s:
        job = s.scalars(select(Job).where(Job.kind == "ask_person").order_by(Job.created_at.desc())).first()
    context = JobContext(services.settings, services.database, services.files, job, Progress(services.database, job.id))
    result = ask_person(context, get_kind("ask_person").parse(job.params))
    with services.database.transaction() as s:
        row = s.get_one(Job, job.id)
        row.keep_result(json.loads(json.dumps(result)))
        finish(row, "succeeded")
    return job.id


GERMAN = {"Accept-Language": "de"}


def test_a_reward_of_ones_own_is_taken_in_asked_and_told_in_words(lab, lab_services, monkeypatch):
    taken = take_in(lab)
    assert taken.status_code == 303, taken.text
    here = taken.headers["location"]
    reward = here.rpartition("/")[2]
    asked = {"csrf": csrf(lab, "/lab/jobs/new/ask_person"), "reward": reward, "answers": "9"}
    too_early = lab.post("/lab/jobs/new/ask_person", data=asked)
    assert too_early.status_code == 422
    assert f"/lab/rewards/{reward}" in too_early.text
    shown = lab.get(here).text
    assert "close to the person" in shown
    assert "nah an der Person" in lab.get(here, headers=GERMAN).text
    assert shown.count('class="plot"') == 2
    looked = looks_right(lab, reward)
    assert looked.status_code == 303, looked.text
    assert "Looks right: " in lab.get(here).text
    assert "Sieht richtig aus: " in lab.get(here, headers=GERMAN).text
    form = lab.get(looked.headers["location"]).text
    assert f'value="{reward}" data-setup="study_room" selected' in form
    asked = {"csrf": csrf(lab, "/lab/jobs/new/ask_person"), "reward": reward, "answers": "9"}
    started = lab.post("/lab/jobs/new/ask_person", data=asked, follow_redirects=False)
    assert started.status_code == 303, started.text
    job = f"/lab/jobs/{done(lab_services, monkeypatch)}"
    page, german = lab.get(job).text, lab.get(job, headers=GERMAN).text
    for one in ("Predictive accuracy", "20 pairs in other scenes", "Calibration error", "typical differences"):
        assert one in page
    for one in ("Vorhersagegüte", "20 Paare in anderen Szenen", "Kalibrierungsfehler", "Unterschiede"):
        assert one in german
    assert "answers = 9" not in page
    assert "desirepath jobs start ask_person" in page
    assert "uploaded" in page
    assert "hochgeladen" in german


def test_a_reward_model_that_was_learned_here_is_asked_in_the_same_way(lab, two_studies, lab_services, monkeypatch):
    from desirepath.learning.policies.shipped import load_queries
    from desirepath.learning.preferences.oracles import make_oracle
    from desirepath.learning.rewards.linear import fit_linear
    from desirepath.store.artefacts import save_artefact

    learned = fit_linear(make_oracle("shortest").answer(load_queries("study_room/queries_500").queries[:12]))
    with lab_services.database.transaction() as s:
        made = save_artefact(
            s, lab_services.files, kind="reward_model", name="learned", setup="study_room",
            content=learned.to_bytes(), card={},
        ).id  # fmt: skip
    asked = {"csrf": csrf(lab, "/lab/jobs/new/ask_person"), "reward": made, "answers": "8"}
    assert lab.post("/lab/jobs/new/ask_person", data=asked, follow_redirects=False).status_code == 303
    page = lab.get(f"/api/lab/jobs/{done(lab_services, monkeypatch)}").json()
    assert page["result"]["persons"][0]["person"] == "learned"
    assert 0 <= page["result"]["accuracy"]["8"] <= 1


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"manifest": [1]}, "manifest"),
        ({"manifest": MANIFEST | {"setup": "the moon"}}, "the moon"),
        ({"manifest": MANIFEST | {"inputs": ["camera"]}}, "inputs"),
        ({"manifest": {name: MANIFEST[name] for name in ("format", "setup", "file")}}, "inputs"),
        ({"manifest": MANIFEST | {"inputs": [{"of": "observation", "form": "si"}]}}, "state the order of the scan"),
        ({"manifest": MANIFEST | {"file": "../net.pt"}}, "file"),
        ({"name": "other.pt"}, "other.pt"),
        ({"content": b"x" * 2_000_001}, ""),
    ],
)
def test_what_cannot_be_taken_in_says_why_and_nothing_is_kept(lab, lab_services, given, why):
    refused = take_in(lab, **given)
    assert refused.status_code in (413, 422)
    assert why in refused.text
    with lab_services.database.session() as s:
        assert s.scalars(select(Artefact).where(Artefact.name.startswith("uploaded"))).all() == []


def test_a_network_that_does_not_fit_is_refused_and_says_what_would(lab, lab_services):
    refused = take_in(lab, content=network(inputs=5))
    assert refused.status_code == 422
    assert f"needed is (outputs, {STUDY_ROOM.observation_size + 2})" in refused.text


def test_a_wrong_unit_is_seen(lab):
    """What it was given, in the unit that the manifest states, and an order that follows from it."""
    columns = [{"name": "person_distance", "unit": "cm", "scale": 1.0, "offset": 0.0}]
    content = io.BytesIO()
    torch.save({"0.weight": torch.tensor([[1.0]]), "0.bias": torch.tensor([0.0])}, content)
    inputs = [{"of": "observation", "columns": columns}]
    taken = take_in(lab, MANIFEST | {"inputs": inputs, "hidden": "relu"}, content.getvalue())
    assert taken.status_code == 303, taken.text
    page = taken.headers["location"]
    shown = lab.get(page).text
    row = shown[shown.index("observation.person_distance") :]
    assert "<td>cm</td>" in row[:200]
    rows = [line.split(",") for line in lab.get(f"{page}/steps.csv").text.splitlines()[1:]]
    means = {name: [float(one[-1]) for one in rows if one[0] == name] for name in ("close", "far", "slow")}
    assert all(50 < sum(values) / len(values) < 2_000 for values in means.values())  # centimetres, not metres
    assert lab.get(f"{page}/plan.svg").text.startswith("<svg")


def test_what_says_the_same_of_every_step_is_pointed_at(lab):
    content = io.BytesIO()
    width = STUDY_ROOM.observation_size + 2
    torch.save({"0.weight": torch.zeros(1, width), "0.bias": torch.ones(1)}, content)
    page = take_in(lab, content=content.getvalue()).headers["location"]
    assert "The reward is the same for every step" in lab.get(page).text


def test_only_what_was_uploaded_is_looked_over(lab, lab_services, colleague):
    assert lab.get("/lab/rewards/nothing").status_code == 404
    reward = take_in(lab).headers["location"].rpartition("/")[2]
    viewer = colleague("viewer")
    assert viewer.get(f"/lab/rewards/{reward}").status_code == 200
    refused = viewer.post(f"/lab/rewards/{reward}/looks-right", data={"csrf": csrf(viewer)}, follow_redirects=False)
    assert refused.status_code == 403
    with lab_services.database.session() as s:
        assert "looks_right" not in s.get_one(Artefact, reward).card


def test_who_may_start_no_jobs_takes_nothing_in(lab_services, colleague):
    assert FILE_BYTES > 2_000_000
    viewer = colleague("viewer")
    refused = viewer.post("/lab/reward-files", data={"csrf": csrf(viewer)}, follow_redirects=False)
    assert refused.status_code == 403

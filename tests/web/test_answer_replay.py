"""Answers shown again as their participants saw them: one trajectory alone, a drawn path, a guess, another device."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.store.events import log_event
from desirepath.store.models import Response, Session, StrokeRow, Study, Trial, new_id
from desirepath.store.shipped_policies import policy_artefact, register_shipped
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services
from tests.study import walking
from tests.study.small_protocol import small_protocol
from tests.web.lab_services import Walked

WORDS = {"en": "How did you like it?"}
SCALE = {"question": WORDS, "points": 5, "low": {"en": "not at all"}, "high": {"en": "very much"}}
RATING = {"rating": {"each": ["top_down", "first_person"], "count": 2, "scale": SCALE}}


class StageStub:
    """Takes orders as a stage does: a real one needs a browser (`tests/web/test_lab_in_browser.py`)."""

    def __init__(self) -> None:
        self.detail = "full"
        self.orders: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, order: str) -> Callable[..., None]:
        return lambda *given, **named: self.orders.append((order, given, named))


@pytest.fixture
def open_study(lab_services: Services) -> Callable[..., Study]:
    """Opens a study and lets one simulated participant walk through it."""

    def opened(frozen: Any) -> Study:
        with lab_services.database.transaction() as s:
            study = create_study(s, lab_services.files, frozen, name="Seen", created_by=None)
        walk_in_process(lab_services.database, lab_services.files, study, 1, without_jobs=True)
        return study

    return opened


def replays(lab: TestClient, study: str, code: str = "S001") -> list[str]:
    """Addresses of the answers that the person's page offers to show, in order."""
    page = lab.get(f"/lab/studies/{study}/people/{code}").text
    links = re.findall(rf'href="(/lab/studies/{study}/answers/[0-9a-f]+)"', page)
    listed = lab.get(f"/lab/studies/{study}/answers?participant={code}").text
    assert all(one in listed for one in links)
    return links


def shown(lab: TestClient, address: str) -> tuple[str, dict[str, Any]]:
    """The page in plain text, and what its script is given."""
    answered = lab.get(address)
    assert answered.status_code == 200, answered.text
    data = json.loads(re.search(r'id="page-data">(.*?)</script>', answered.text, re.S)[1])  # type: ignore[index]
    return html.unescape(answered.text), data


def on_stage(services: Services, data: dict[str, Any]) -> StageStub:
    """What the stage is told when it has connected, and then when the page asks for the trajectory."""
    stage = StageStub()
    assert services.replays.show(stage, f"replay:{data['stage_token']}")  # type: ignore[arg-type]
    services.replays.find_shown(data["stage_token"]).play(stage, "a")  # type: ignore[union-attr]
    return stage


def test_several_trajectories_are_replayed_with_their_numbers_and_what_was_said(
    lab, lab_services, open_study, tmp_path
):
    queries = walking.twenty_queries(tmp_path)
    ordered = {"order": {"view": "top_down", "count": 1, "of": 4}}
    study = open_study(small_protocol(tmp_path, [ordered], query_set=str(queries)))
    (link,) = replays(lab, study.id)
    with lab_services.database.session() as s:
        said = s.scalars(select(Response.value).where(Response.kind == "order")).one()["order"]
    page, data = shown(lab, link)
    assert f"S001 said order: {', '.join(map(str, said))}" in page
    assert len(data["durations"]) == 4
    assert json.dumps(said) in page, "the participants' own page shows it"
    stage = StageStub()
    assert lab_services.replays.show(stage, f"replay:{data['stage_token']}")
    order, (view, trajectories, _), _ = stage.orders[-1]
    assert (order, view, len(trajectories)) == ("several", "top_down", 4)


def test_a_rated_trajectory_is_replayed_alone_without_a_letter(lab, lab_services, open_study, tmp_path):
    queries = walking.twenty_queries(tmp_path)
    study = open_study(small_protocol(tmp_path, [RATING], query_set=str(queries)))
    links = replays(lab, study.id)
    assert len(links) == 4
    with lab_services.database.session() as s:
        rows = {row.id: row for row in s.scalars(select(Response).where(Response.kind == "rating"))}
    given = rows[links[0].rpartition("/")[2]]
    page, data = shown(lab, links[0])
    assert f"S001 rated {given.value['rating']}" in page
    assert "How did you like it?" in page, "the participants' own page"
    assert len(data["durations"]) == 1
    order, _, named = on_stage(lab_services, data).orders[-1]
    assert (order, named["label"], named["label_s"]) == ("play", "", 0.0)
    asked = lab.post(f"/lab/preview-stage/{data['stage_token']}/a", headers={"X-CSRF": data["csrf"]})
    assert asked.status_code == 404, "allowed, but no stage is open in this test"
    views = [on_stage(lab_services, shown(lab, link)[1]).orders[0][1][1] for link in links]
    assert sorted(views) == ["first_person"] * 2 + ["top_down"] * 2

    with lab_services.database.transaction() as s:
        register_shipped(s, lab_services.files)
        policy, field = (policy_artefact(s, f"{setup}/base").id for setup in ("study_room", "open_field"))
    page, data = shown(lab, f"{links[0]}?policy={policy}&command=turning")
    assert "What determines the command of study_room/base along this path (Turning)." in page
    assert page.count('class="ink-line cursor"') == 1
    order, given_to, _ = on_stage(lab_services, data).orders[0]
    assert order == "show", "nothing is explained before it is played"
    order, given_to, named = on_stage(lab_services, data).orders[-1]
    assert (named["explained"].outlines, named["explained"].lidar) == (True, True)
    assert len(named["explained"].scores) == len(given_to[0].poses)
    assert max(max(row) for row in named["explained"].scores) == 1.0
    plain, _ = shown(lab, links[0])
    assert "cursor" not in plain
    assert policy in plain
    assert field not in plain, "of another setup"
    assert lab.get(f"{links[0]}?policy={field}").status_code == 404


def drawing(text: str) -> str:
    room = next((line for line in text.splitlines(keepends=True) if "environment: room" in line), "")
    return text.replace(room, "").replace("pairs: 4, per_pair: 3, up_to: 5", "pairs: 1, per_pair: 2")


def test_a_drawn_path_is_replayed_with_its_rollout_and_what_was_kept_before(lab, lab_services, open_study):
    text = drawing((PROTOCOLS / "demonstration_study.yaml").read_text())
    study = open_study(freeze_text(text))
    first, second = replays(lab, study.id)
    with lab_services.database.session() as s:
        strokes = s.scalars(select(StrokeRow).where(StrokeRow.state == "kept").order_by(StrokeRow.created_at)).all()
    page, data = shown(lab, second)
    assert "S001 drew and kept this path" in page
    assert 'id="drawing"' in page, "the participants' own page"
    assert (data["state"]["phase"], data["state"]["stroke"]) == ("watched", strokes[1].id)
    (draw, (scene, view, paper), _), (play, (rollout,), named) = on_stage(lab_services, data).orders
    assert (draw, play, view) == ("draw", "play", "top_down")
    assert paper.drawn == strokes[1].drawn
    assert len(paper.kept) == 1
    assert paper.resting
    assert rollout.scene == scene
    assert named["goal"]
    assert not on_stage(lab_services, shown(lab, first)[1]).orders[0][1][2].kept


def test_a_controllers_rollout_is_replayed_alone_and_says_whose_it_was(lab, lab_services, open_study):
    text = drawing((PROTOCOLS / "demonstration_study.yaml").read_text())
    study = open_study(freeze_text(text))
    with lab_services.database.transaction() as s:
        session = s.scalars(select(Session).where(Session.study_id == study.id).order_by(Session.appointment)).all()[-1]
        index, step = next((i, one) for i, one in enumerate(session.plan) if one["kind"] == "evaluation")
        drawn = s.scalars(select(StrokeRow.trajectory).where(StrokeRow.state == "kept")).first()
        sides = {"trajectory_a": drawn, "trajectory_b": drawn, "phase": "answered"}
        trial = Trial(session_id=session.id, step_key=step["key"], index=index, kind="evaluation", **sides)
        trial.block, trial.view = step["block"], step["view"]
        s.add(trial)
        s.flush()
        answered = {"kind": "evaluation", "value": {}, "request_id": new_id()}
        s.add(Response(session_id=session.id, trial_id=trial.id, step_key=step["key"], **answered))
    page, data = shown(lab, replays(lab, study.id)[-1])
    assert f"S001 watched this one alone: {step['block']}" in page
    assert len(data["durations"]) == 1


def test_a_guess_shows_the_pair_that_it_was_about(lab, lab_services, walked: Walked):
    with lab_services.database.transaction() as s:
        guess = s.scalars(select(Response).where(Response.kind == "guess")).one()
        about = s.scalars(select(Trial).where(Trial.step_key == guess.value["about"])).one()
        other = lab.get(f"/lab/studies/{walked.id}/answers/{guess.id}")
        right = "right" if guess.value["right"] else "wrong"
    assert f"/answers/{guess.id}" in lab.get(f"/lab/studies/{walked.id}/people/{walked.finished}").text
    assert f"{walked.finished} guessed that A came from the own answers: {right}" in html.unescape(other.text)
    _, data = shown(lab, f"/lab/studies/{walked.id}/answers/{guess.id}")
    assert len(data["durations"]) == 2
    assert data["key"] == about.step_key


def test_an_answer_is_replayed_on_the_device_that_it_was_given_on(lab, lab_services, walked: Walked):
    link = replays(lab, walked.id, walked.finished)[0]
    with lab_services.database.transaction() as s:
        session = s.get_one(Session, s.get_one(Response, link.rpartition("/")[2]).session_id)
        before = {"width": 800, "height": 600, "scene_detail": "light"}
        after = {"width": 1920, "height": 1080, "scene_detail": "full"}
        log_event(s, "device_checked", session_id=session.id, before=before, after=after)
        session.device = after
    page, data = shown(lab, link)
    assert data["window"] == [800, 600]
    assert "window 800 × 600" in page
    assert "reduced scene detail" in page
    assert on_stage(lab_services, data).detail == "light"


def test_what_was_no_trajectory_or_is_gone_has_no_replay(lab, lab_services, walked: Walked):
    link = replays(lab, walked.id, walked.finished)[0]
    with lab_services.database.session() as s:
        read = s.scalars(select(Response.id).where(Response.kind == "information")).first()
        trial = s.get_one(Trial, s.get_one(Response, link.rpartition("/")[2]).trial_id)
    assert lab.get(f"/lab/studies/{walked.id}/answers/{read}").status_code == 404
    lab_services.files.delete(trial.trajectory_a)
    assert lab.get(link).status_code == 404

"""Analysts move the weights of any conditioned policy by hand, and compare one with its weights."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from desirepath.jobs.comparing import compare_two
from desirepath.jobs.kinds import CompareParams, JobParamsError, get_kind
from desirepath.settings import Settings
from desirepath.store.models import Artefact, Job
from desirepath.store.shipped_policies import policy_artefact, register_shipped
from desirepath.web.analyst.chosen_policies import first_scene
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests.web.analyst_services import _work
from tests.web.lab_services import csrf, sign_in

PAGE = "/lab/live"
PAIR = CompareParams(
    policy_a="study_room/base", policy_b="study_room/conditioned", weights_b="farther=1,smoother=0.5",
    scenes=20, replays=1,
)  # fmt: skip


@pytest.fixture(scope="module")
def services(fresh_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    data = shutil.copytree(fresh_data, tmp_path_factory.mktemp("live") / "data")
    found = build_services(Settings(data=data, _env_file=None))
    with found.database.transaction() as s:
        register_shipped(s, found.files)
    _work(found, None, compare_two, PAIR, "compare")
    yield found
    found.database.close()


@pytest.fixture
def analyst(services: Services) -> Iterator[TestClient]:
    with TestClient(create_application(services), follow_redirects=False) as client:
        found = sign_in(client)
        found.follow_redirects = True  # addresses of before lead on to those of now
        yield found


def shipped(services: Services, name: str) -> str:
    with services.database.session() as s:
        return policy_artefact(s, name).id


def test_any_conditioned_policy_has_the_participants_controls_over_a_stage(analyst, services):
    policy = shipped(services, "study_room/conditioned")
    page = analyst.get(f"{PAGE}?policy_a={policy}&a_farther=0.4").text
    assert len(re.findall(r"data-ends=", page)) == 7
    assert "data-start" in page
    assert "&#34;farther&#34;: 0.4" in page
    granted = re.search(r'data-src="[^"]*/stage/([^/"]+)/"', page).group(1)
    (shown,) = services.replays.find_shown(granted).make()
    assert shown.scene.seed == first_scene()
    assert "base" not in re.search(r'<select id="a".*?</select>', page, re.DOTALL).group(0)


def test_three_can_be_weighed_in_a_triangle(analyst, services):
    policy = shipped(services, "study_room/conditioned")
    page = analyst.get(f"{PAGE}?policy_a={policy}&corner=farther&corner=faster&corner=smoother").text
    assert 'data-triangle="farther faster smoother"' in page
    refused = analyst.get(f"{PAGE}?policy_a={policy}&corner=farther&corner=closer&corner=smoother")
    assert (refused.status_code, "only one can be above 0" in refused.text) == (422, True)
    german = {"Accept-Language": "de"}
    for corners, says in (
        (("farther", "closer", "smoother"), "sind Gegensätze"),
        (("farther", "faster"), "gewählt sind aber 2"),
        (("farther", "farther", "faster"), "ist zweimal gewählt"),
    ):
        address = f"{PAGE}?policy_a={policy}" + "".join(f"&corner={one}" for one in corners)
        refused = analyst.get(address, headers=german)
        assert (refused.status_code, says in refused.text) == (422, True), corners
        assert not {*corners} & set(re.findall(r"[a-z_]+", refused.text.partition('role="alert"')[2][:300]))


def test_the_way_follows_the_weights_and_goes_on_from_where_the_robot_is(analyst, services):
    policy = shipped(services, "study_room/conditioned")
    asked = f"{PAGE}/paths?policy_a={policy}&scene=3500000000"
    usual, far = (analyst.get(asked + more).json()["paths"][0] for more in ("", "&a_farther=1"))
    assert usual["arrives"]
    assert usual["track"] != far["track"]
    _, x, y, yaw = far["track"][len(far["track"]) // 2]
    onward = analyst.get(f"{asked}&a_faster=1&x={x}&y={y}&yaw={yaw}").json()["paths"][0]["track"]
    assert onward[0][1:3] == pytest.approx([x, y], abs=1e-3)
    assert analyst.get(f"{asked}&x=99&y=0&yaw=0").status_code == 422
    assert analyst.get(f"{asked}&a_farther=1&a_closer=1").status_code == 422


def test_the_policy_of_chapter_5_has_its_own_three_weights_in_a_triangle(analyst, services):
    policy = shipped(services, "adaptable/policy")
    assert f"/lab/artefacts/{policy}" in analyst.get("/lab/policies").text
    assert f"/lab/live?policy={policy}" in analyst.get(f"/lab/artefacts/{policy}").text
    page = analyst.get(f"{PAGE}?policy_a={policy}&a_distance=0.5&a_efficiency=0.5").text
    assert 'data-triangle="demonstration distance efficiency"' in page
    assert "&#34;distance&#34;: 0.5" in page
    assert "distance from the person" in page
    assert "Abstand zur Person" in analyst.get(f"{PAGE}?policy_a={policy}", headers={"Accept-Language": "de"}).text
    assert 'name="corner"' not in page
    asked = f"{PAGE}/paths?policy_a={policy}&scene=3500000000"
    corners = ("", "&a_demonstration=1", "&a_distance=1", "&a_efficiency=1")
    paths = [analyst.get(asked + more).json()["paths"][0] for more in corners]
    assert all(one["arrives"] for one in paths)
    assert len({json.dumps(one["track"]) for one in paths}) == 4
    refused = analyst.get(asked + "&a_distance=0.5&a_farther=1")
    assert (refused.status_code, "must sum to 1" in refused.json()["error"]["message"]) == (422, True)
    figure = analyst.get(f"/lab/flow-field?policy_a={policy}&a_efficiency=1")
    assert (figure.status_code, 'name="a_efficiency"' in figure.text) == (200, True)


def test_what_a_tab_cannot_show_is_said_with_what_is_shown_instead_and_kept_for_the_others(analyst, services):
    page = analyst.get(f"{PAGE}?policy={shipped(services, 'study_room/base')}&scene=3500000004&view=immersive")
    assert page.url.query == b"policy=study_room/base&scene=3500000004&view=immersive"
    assert "study_room/base has no preference weights to move; this is study_room/conditioned." in page.text
    kept = "?policy=study_room/base&amp;scene=3500000004&amp;view=immersive"
    assert all(f'href="/lab/{tab}{kept}"' in page.text for tab in ("flow-field", "explain", "attention", "live"))
    assert analyst.get(f"{PAGE}/paths?policy=study_room/base").status_code == 404
    among_people = analyst.get("/lab/attention?policy=study_room/base").text
    assert "study_room/base has no attention; this is crowd_corridor/attention." in among_people
    in_the_open = analyst.get(f"{PAGE}?policy=open_field/base").text
    assert "this is open_field/conditioned." in in_the_open, "of the same setup"


def test_a_comparison_and_its_card_say_which_weights(analyst, services):
    with services.database.session() as s:
        made = s.query(Artefact).filter_by(kind="evaluation").one()
        job = s.query(Job).filter_by(kind="compare").one()
    assert made.name.startswith("study_room/conditioned@farther=1,smoother=0.5 against study_room/base")
    assert made.card["config"]["weights_b"] == "farther=1,smoother=0.5"
    assert "weights_a" not in made.card["config"]
    assert "--set weights_b=farther=1,smoother=0.5" in made.card["command"]
    content = json.loads(services.files.get(made.id))
    assert [one.get("weights") for one in content["policies"]] == [None, "farther=1,smoother=0.5"]
    assert content["compared"]["paired"]["min_human_distance_m"]["difference"]["value"] > 0
    for scene in (0, 5):  # one that was kept, one that is rolled out again
        page = analyst.get(f"/lab/compare/{made.id}?scene={scene}").text
        assert "@farther=1,smoother=0.5" in page
        assert "@farther%3D1%2Csmoother%3D0.5" in page
    assert job.params["weights_b"] == "farther=1,smoother=0.5"


def test_the_form_takes_weights_of_conditioned_policies_alone(analyst, services):
    base, conditioned = (shipped(services, f"study_room/{name}") for name in ("base", "conditioned"))
    form = analyst.get(f"/lab/compare?policy_b={conditioned}&weights_b=farther%3D1").text
    assert re.search(r'name="weights_b" value="farther=1"', form)
    given = {"csrf": csrf(analyst), "policy_a": base, "policy_b": conditioned}
    for wrong, says in (
        ({"weights_a": "farther=1"}, "policy_a takes none"),
        ({"weights_b": "kinder=1"}, "is unknown; known are"),
        ({"weights_b": "farther=2"}, "must be between 0 and 1"),
    ):
        refused = analyst.post("/lab/jobs/new/compare", data=given | wrong)
        assert (refused.status_code, says in refused.text) == (422, True), wrong
    opposites = given | {"weights_b": "farther=1,closer=1"}
    german = analyst.post("/lab/jobs/new/compare", data=opposites, headers={"Accept-Language": "de"})
    assert (german.status_code, "Gegensätze" in german.text, "are opposites" in german.text) == (422, True, False)
    assert (
        analyst.post(
            "/lab/jobs/new/compare", data=given | {"weights_b": "farther=1"}, follow_redirects=False
        ).status_code
        == 303
    )


def test_comparisons_of_before_are_read_and_asked_for_as_they_were():
    old = get_kind("compare").parse({"policy_a": "study_room/base", "policy_b": "study_room/ensemble/1"})
    assert "weights_a" not in old.asked()
    with pytest.raises(JobParamsError, match="weights_b"):
        get_kind("compare").parse({"policy_a": "a", "policy_b": "b", "weights_b": "far"})


def test_an_adaptable_policy_is_compared_with_itself_at_other_weights(services):
    params = CompareParams(
        policy_a="adaptable/policy", policy_b="adaptable/policy", weights_a="efficiency=1", weights_b="distance=1",
        scenes=20, replays=0,
    )  # fmt: skip
    _work(services, None, compare_two, params, "compare")
    with services.database.session() as s:
        made = s.query(Artefact).filter(Artefact.name.startswith("adaptable/policy@distance=1 against")).one()
    content = json.loads(services.files.get(made.id))
    assert content["compared"]["paired"]["min_human_distance_m"]["difference"]["value"] > 0.1
    with pytest.raises(ValueError, match="NAME=WEIGHT"):
        CompareParams(policy_a="a", policy_b="b", weights_a="distance=1,farther=1")

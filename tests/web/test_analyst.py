"""The analysts' pages over real artefacts: launching, following and ending jobs, cards, downloads, comparisons."""

from __future__ import annotations

import csv
import html
import io
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import httpx
import numpy as np
import onnxruntime
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select
from stable_baselines3 import TD3

from desirepath.deploy.controller import Controller
from desirepath.explain.sketches import INKS, ROLLOUTS, draw_sketch, shipped_sketches
from desirepath.learning.policies.policy import Policy, read_policy
from desirepath.settings import Settings
from desirepath.simulation.fast import make_engine
from desirepath.simulation.setups import get_setup
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.example_study import packed_policies
from desirepath.store.models import Artefact, Job, Response, Study, utc_now
from desirepath.store.shipped_policies import REGISTERED, came_with_product, policy_artefact
from desirepath.study.personalising.live_rollouts import scenes_of
from desirepath.web.analyst.compared_scenes import rollouts_in
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests.accessible import violations_in_both_schemes
from tests.answered_study import add_answered_study
from tests.running import served
from tests.s3 import s3_store
from tests.web.lab_services import PASSWORD, csrf, sign_in

LANGUAGES = ("en", "de")


@pytest.fixture
def worked(worked_data: Path, tmp_path: Path) -> Services:
    return build_services(Settings(data=shutil.copytree(worked_data, tmp_path / "data"), _env_file=None))


@pytest.fixture
def analyst(worked: Services) -> Iterator[TestClient]:
    with TestClient(create_application(worked), follow_redirects=False) as client:
        yield sign_in(client)


@pytest.fixture
def known(worked: Services) -> SimpleNamespace:
    """Ids of what is there."""
    with worked.database.session() as s:
        evaluations = list(s.scalars(select(Artefact).where(Artefact.kind == "evaluation")))
        return SimpleNamespace(
            study=s.scalars(select(Study.id)).one(),
            snapshot=s.scalars(select(Artefact.id).where(Artefact.kind == "snapshot")).one(),
            reward_model=s.scalars(select(Artefact.id).where(Artefact.kind == "reward_model")).one(),
            base=policy_artefact(s, "study_room/base").id,
            field=policy_artefact(s, "open_field/base").id,
            conditioned=policy_artefact(s, "study_room/conditioned").id,
            comparison=next(one.id for one in evaluations if "paired" in one.card["results"]),
            evaluation=next(one.id for one in evaluations if "paired" not in one.card["results"]),
            answer=s.scalars(select(Response.id).limit(1)).one(),
            jobs={job.kind: job.id for job in s.scalars(select(Job))},
        )


def pages(known: SimpleNamespace) -> dict[str, str]:
    """Every page, with something that only it says."""
    return {
        "/lab/jobs": known.jobs["align"],
        "/lab/jobs/new": "/lab/jobs/new/train_base",
        "/lab/jobs/new/align": 'name="recipe"',
        "/lab/jobs/new/queries": 'name="members"',
        f"/lab/jobs/{known.jobs['align']}": "second &lt;b&gt;line",
        f"/lab/jobs/{known.jobs['train_base']}": "SIGKILL",
        f"/lab/jobs/{known.jobs['reward_model']}": "desirepath jobs start reward_model",
        "/lab/snapshots": known.snapshot,
        f"/lab/snapshots/{known.snapshot}": known.answer,
        f"/lab/snapshots/{known.snapshot}/answers/{known.answer}": "polyline",
        "/lab/policies": "study_room/ensemble/3",
        "/lab/policies#conditioned_policy": known.conditioned,
        f"/lab/policies/{known.base}": "policy.onnx",
        f"/lab/artefacts/{known.conditioned}": f"/lab/flow-field?policy={known.conditioned}",
        f"/lab/artefacts/{known.reward_model}": "P002",
        f"/lab/artefacts/{known.evaluation}": "study_room/base",
        "/lab/compare": known.comparison,
        f"/lab/compare/{known.comparison}?scene=1&measure=time_s&stage=1": "<iframe",
        **{f"/lab/{tab}": 'class="workspace"' for tab in ("flow-field", "explain", "attention", "live")},
    }


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_page_says_what_it_should_in_both_languages(analyst, known, language):
    for address, telling in pages(known).items():
        shown = analyst.get(address, headers={"Accept-Language": language})
        assert shown.status_code == 200, address
        assert telling in shown.text, address
        assert f'<html lang="{language}">' in shown.text


def test_policies_stand_in_groups_that_sort_and_each_has_a_drawing(analyst, worked, known):
    page = analyst.get("/lab/policies?sort=-success").text
    room = page[page.index('id="setup-study_room"') :].partition("</details>")[0]
    shares = [float(share) for share in re.findall(r'<td class="number">([\d.]+)%', room)]
    assert len(shares) >= 6
    assert shares == sorted(shares, reverse=True)
    assert room.count('aria-sort="descending"') == 1
    assert f'src="/lab/policies/{known.base}/sketch.svg"' in room
    assert analyst.get("/lab/policies/study_room/base").headers["location"] == f"/lab/policies/{known.base}"
    drawn = {scheme: analyst.get(f"/lab/policies/{known.base}/sketch.svg?scheme={scheme}") for scheme in INKS}
    for scheme, ink in INKS.items():
        assert ink["path"] in drawn[scheme].text
        assert drawn[scheme].text.count("<polyline") == ROLLOUTS
    mark = drawn["dark"].headers["etag"]
    again = analyst.get(f"/lab/policies/{known.base}/sketch.svg?scheme=dark", headers={"If-None-Match": mark})
    assert again.status_code == 304
    assert analyst.get(f"/lab/policies/{known.snapshot}/sketch.svg").status_code == 404
    assert worked.figures.child is None, "no process was needed for what is shipped"


def test_shipped_sketches_are_of_all_shipped_policies_and_what_these_drive(worked, known):
    with worked.database.session() as s:
        shipped = set(s.scalars(select(Artefact.id).where(Artefact.kind.in_(REGISTERED), Artefact.study_id.is_(None))))
        shipped = {one for one in shipped if came_with_product(one)}
    assert set(shipped_sketches()) == shipped | set(packed_policies())
    base = read_policy(worked.files.get(known.base)).driving()
    drawn = draw_sketch(base.rollout_policy, scenes_of("study_room")[0])
    assert drawn.svg("light") == shipped_sketches()[known.base].svg("light")


def test_pages_are_accessible_in_both_schemes(worked, known, chromium):
    found = {}
    with served(create_application(worked)) as url:
        context = chromium.new_context(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
        page = context.new_page()
        page.goto(f"{url}/lab/sign-in")
        page.fill("#name", "experimenter")
        page.fill("#password", PASSWORD)
        page.click("main button.main")
        alike = ("/lab/jobs/new/queries", f"/lab/jobs/{known.jobs['train_base']}", f"/lab/artefacts/{known.evaluation}")
        for address in pages(known).keys() - set(alike):
            page.goto(f"{url}{address.replace('&stage=1', '')}")
            if wrong := violations_in_both_schemes(page, None):
                found[address] = wrong
            assert page.evaluate("document.documentElement.scrollWidth") <= 1280, address
        context.close()
    assert not found


def test_nobody_gets_in_without_signing_in_and_nothing_changes_without_the_token(worked, known):
    with TestClient(create_application(worked), follow_redirects=False) as stranger:
        for address in (*pages(known), f"/lab/policies/{known.base}/policy.zip", "/lab/snapshots"):
            assert stranger.get(address).headers["location"].startswith("/lab/sign-in")
        assert stranger.get(f"/api/lab/jobs/{known.jobs['align']}").status_code == 401
        sign_in(stranger)
        for address in (f"/lab/jobs/{known.jobs['align']}/cancel", "/lab/jobs/new/train_base", "/lab/snapshots"):
            assert stranger.post(address, data={}).status_code == 403


def test_launched_job_holds_only_what_differs_from_the_defaults(analyst, worked, known):
    token = csrf(analyst, "/lab/jobs/new/align")
    form = {"csrf": token, "snapshot": known.snapshot, "recipe": "thesis", "updates": "500", "seed": "0"}
    answered = analyst.post("/lab/jobs/new/align", data=form)
    assert answered.status_code == 303, answered.text
    with worked.database.session() as s:
        job = s.get_one(Job, answered.headers["location"].rsplit("/", 1)[1])
    assert job.params == {"snapshot": known.snapshot, "recipe": "thesis", "updates": 500}
    assert (job.state, job.created_by, job.study_id, job.session_id) == ("queued", "experimenter", known.study, None)
    form_again = analyst.get(f"/lab/jobs/new/align?again={job.id}").text
    assert 'name="recipe" value="thesis"' in form_again
    assert re.search(r'id="updates"[^>]*value="500"', form_again)


@pytest.mark.parametrize(
    ("recipe", "own", "of_others"),
    [
        ("instant", "conditioned", "updates"),
        ("conditioning_search", "tried", "reward_weight"),
        ("fine_tuning", "reward_weight", "tried"),
        ("thesis", "updates", "conditioned"),
        ("each_scene", "policies", "updates"),
        ("each_scene_trained", "updates", "tried"),
    ],
)
def test_each_algorithm_of_an_alignment_asks_for_its_own_fields(analyst, recipe, own, of_others):
    form = analyst.get(f"/lab/jobs/new/align?recipe={recipe}").text
    assert f'name="recipe" value="{recipe}"' in form
    assert f'id="{own}"' in form
    assert f'id="{of_others}"' not in form
    assert form.count("?recipe=") == 6  # the six to choose from


@pytest.mark.parametrize(
    ("kind", "given", "field", "says"),
    [
        ("align", {"recipe": "thesis", "reward_weight": "2"}, "reward_weight", "at most 1"),
        ("align", {}, "snapshot", "Choose or fill in"),
        ("align", {"snapshot": "f" * 64}, "snapshot", "no snapshot"),
        ("evaluate", {"policy": "study_room/base", "scenes": "3"}, "scenes", "at least 20"),
        ("train_base", {"updates": "many"}, "updates", "not a whole number"),
        ("queries", {}, "members", "At least 2"),
    ],
)
def test_wrong_settings_come_back_at_their_field_and_start_nothing(analyst, worked, known, kind, given, field, says):
    before = len(known.jobs)
    answered = analyst.post(f"/lab/jobs/new/{kind}", data={"csrf": csrf(analyst), **given})
    assert answered.status_code == 422
    assert says in re.search(f'id="{field}-problem">([^<]*)<', answered.text).group(1)
    with worked.database.session() as s:
        assert len({job.kind for job in s.scalars(select(Job))}) == before


def test_policies_of_two_setups_are_refused(analyst, known):
    form = {"csrf": csrf(analyst), "policy_a": known.base, "policy_b": known.field}
    refused = analyst.post("/lab/jobs/new/compare", data=form)
    assert refused.status_code == 422
    assert "different setups" in refused.text


def test_queued_job_is_cancelled_once_and_then_tried_again(analyst, worked, known):
    token, job = csrf(analyst), known.jobs["align"]
    assert analyst.post(f"/lab/jobs/{job}/retry", data={"csrf": token}).status_code == 409
    assert analyst.post(f"/lab/jobs/{job}/cancel", data={"csrf": token}).status_code == 303
    assert analyst.get(f"/api/lab/jobs/{job}").json()["state"] == "cancelled"
    assert analyst.post(f"/lab/jobs/{job}/cancel", data={"csrf": token}).status_code == 409
    answered = analyst.post(f"/lab/jobs/{job}/retry", data={"csrf": token})
    with worked.database.session() as s:
        new = s.get_one(Job, answered.headers["location"].rsplit("/", 1)[1])
        old = s.get_one(Job, job)
    assert (new.retry_of, new.params, new.state) == (old.id, old.params, "queued")


def test_running_job_refreshes_itself_and_a_finished_one_does_not(analyst, known):
    assert f'data-live="/lab/jobs/{known.jobs["align"]}/live"' in analyst.get(f"/lab/jobs/{known.jobs['align']}").text
    assert "data-live" not in analyst.get(f"/lab/jobs/{known.jobs['train_base']}").text
    part = analyst.get(f"/lab/jobs/{known.jobs['align']}/live").text
    assert "<html" not in part
    assert "second" in part


def test_curves_are_there_as_data_csv_and_svg(analyst, known):
    job = known.jobs["train_base"]
    curves = analyst.get(f"/api/lab/jobs/{job}").json()["curves"]
    name, points = next(iter(curves.items()))
    assert "polyline" in analyst.get(f"/lab/jobs/{job}").text
    lines = analyst.get(f"/lab/jobs/{job}/curves/{name}.csv").text.splitlines()
    assert lines[0] == f"updates,{name}"  # what this kind of job counts
    assert [[float(value) for value in line.split(",")] for line in lines[1:]] == points
    assert analyst.get(f"/lab/jobs/{job}/curves/{name}.svg").text.startswith("<svg")
    assert analyst.get(f"/lab/jobs/{job}/curves/elsewhere.svg").status_code == 404


def test_a_reward_models_accuracy_per_person_is_no_curve(analyst, known):
    assert analyst.get(f"/api/lab/jobs/{known.jobs['reward_model']}").json()["curves"] == {}


def test_snapshot_of_one_participant_is_taken_and_too_few_answers_are_told(analyst, worked, known):
    form = {"csrf": csrf(analyst), "study": known.study, "answers": "simulated"}
    taken = analyst.post("/lab/snapshots", data={**form, "participant": "P002"})
    assert taken.status_code == 303
    page = analyst.get(taken.headers["location"]).text
    assert "P002" in page
    assert "P001" not in page
    assert "8 answers of P002" in page
    assert "from simulated answers" in page
    unknown = analyst.post("/lab/snapshots", data={**form, "participant": "P999"})
    assert unknown.status_code == 422
    assert "P999" in unknown.text
    lonely = add_answered_study(worked.database, worked.files, answers=1, name="Lonely")
    refused = analyst.post("/lab/snapshots", data={**form, "study": lonely})
    assert refused.status_code == 422
    assert "Usable answers of simulated participants: only one; at least two are needed." in refused.text
    german = analyst.post("/lab/snapshots", data={**form, "study": lonely}, headers={"Accept-Language": "de"}).text
    assert "Brauchbare Antworten von simulierten Teilnehmenden: nur eine; mindestens zwei sind nötig." in german
    assert "are needed" not in german
    nobody = analyst.post("/lab/snapshots", data={"csrf": form["csrf"], "study": known.study})
    assert nobody.status_code == 422
    assert "Usable answers of people: 0" in nobody.text
    assert "There are answers of simulated participants" in nobody.text
    mixed = analyst.post("/lab/snapshots", data={**form, "answers": "everybody"})
    assert "must be one of people, simulated, all" in mixed.text


def test_downloaded_policies_act_like_ours(analyst, worked, known, tmp_path):
    ours = Policy.from_bytes(worked.files.get(known.base))
    observations = make_engine(get_setup(ours.setup), 20, seed=5).observations  # such as occur in drives
    expected = ours.act(observations)
    (tmp_path / "policy.zip").write_bytes(analyst.get(f"/lab/policies/{known.base}/policy.zip").content)
    theirs = TD3.load(tmp_path / "policy.zip", device="cpu")
    np.testing.assert_allclose(theirs.predict(observations, deterministic=True)[0], expected, atol=1e-5)
    network = onnxruntime.InferenceSession(analyst.get(f"/lab/policies/{known.base}/policy.onnx").content)
    np.testing.assert_allclose(network.run(None, {"observation": observations})[0], expected, atol=1e-5)
    manifest = analyst.get(f"/lab/policies/{known.base}/manifest.json").json()
    assert len(manifest["observation"]["layout"]) == ours.shape.observation_size
    assert analyst.get(f"/lab/artefacts/{known.base}/content").content == worked.files.get(known.base)
    assert f"/lab/policies/{known.base}/bundle.zip" in analyst.get(f"/lab/policies/{known.base}").text
    driven = Controller.load(analyst.get(f"/lab/policies/{known.base}/bundle.zip").content)
    driven.decide(observations[0])
    np.testing.assert_allclose(driven.action, expected[0], atol=1e-5)


def test_a_file_comes_from_the_store_by_a_signed_link_where_browsers_reach_it(analyst, worked, known):
    content = worked.files.get(known.base)
    with s3_store() as store:
        worked.files, worked.settings.links_to_store = ArtefactStore(store.url), True
        worked.files.put(content)
        led = analyst.get(f"/lab/artefacts/{known.base}/content")
        assert (led.status_code, led.headers["cache-control"]) == (307, "no-store")
        assert httpx.get(led.headers["location"]).content == content
        worked.settings.links_to_store = False
        assert analyst.get(f"/lab/artefacts/{known.base}/content").content == content


def test_card_walks_back_to_every_answer(analyst, worked, known):
    card = analyst.get(f"/lab/artefacts/{known.reward_model}/card.json").json()
    with worked.database.session() as s:
        assert sorted(card["answers"]) == sorted(s.scalars(select(Response.id)))
    assert card["card"]["command"].startswith("desirepath jobs start reward_model")
    page = analyst.get(f"/lab/artefacts/{known.reward_model}").text
    assert f"/lab/snapshots/{known.snapshot}#answers" in page
    assert f"/lab/studies/{known.study}/people/P001" in page


def test_comparison_numbers_are_the_scenes_numbers(analyst, known):
    here = f"/lab/compare/{known.comparison}"
    scenes = np.genfromtxt(io.StringIO(analyst.get(f"{here}/scenes.csv").text), delimiter=",", names=True)
    assert len(scenes) == 30
    table = {
        row[0]: row[1:] for row in (line.split(",") for line in analyst.get(f"{here}/table.csv").text.splitlines())
    }
    assert float(table["success_rate"][0]) == pytest.approx(float(np.mean(scenes["outcome_a"] == 1)))
    assert float(table["path_length_m"][3]) == pytest.approx(float(scenes["path_length_m_b"].mean()), abs=1e-4)
    both = (scenes["outcome_a"] == 1) & (scenes["outcome_b"] == 1)
    gap = scenes["min_human_distance_m_b"][both] - scenes["min_human_distance_m_a"][both]
    difference, low, high = (float(value) for value in table["min_human_distance_m"][6:9])
    assert difference == pytest.approx(gap.mean(), abs=1e-4)
    assert low <= difference <= high
    paired = analyst.get(f"{here}/difference-min_human_distance_m.csv").text.splitlines()
    assert len(paired) == both.sum() + 1
    assert analyst.get(f"{here}/difference-min_human_distance_m.svg").text.count("<rect") > 5
    assert analyst.get(f"{here}/scene-0.csv").text.startswith("policy,time_s,x_m,y_m,yaw_rad\nA,0.0,")
    assert analyst.get(f"{here}/scene-30.svg").status_code == 404


def test_comparisons_open_with_all_policies_measured_in_the_same_scenes(analyst):
    def table(query: str = "") -> list[dict[str, str]]:
        return list(csv.DictReader(io.StringIO(analyst.get(f"/lab/compare/policies.csv{query}").text)))

    page = analyst.get("/lab/compare").text
    assert 'aria-label="5 policies in the same scenes of study_room"' in page
    assert "study_room: 30 scenes, seed 0 (2 policies)" in page
    rows = table()
    assert {row["policy"] for row in rows} == {"study_room/base", *(f"study_room/ensemble/{k}" for k in range(4))}
    distances = [float(row["min_human_distance_m"]) for row in rows]
    assert distances == sorted(distances, reverse=True)
    assert all(float(row["time_s_low"]) <= float(row["time_s"]) <= float(row["time_s_high"]) for row in rows)
    quickest = table("?of=study_room/30/0&sort=time_s")
    assert [row["scenes"] for row in quickest] == ["30", "30"]
    assert float(quickest[0]["time_s"]) <= float(quickest[1]["time_s"])
    drawn = analyst.get("/lab/compare/policies.svg?of=study_room/30/0&measures=all", headers={"Accept-Language": "de"})
    assert "Erfolg" in drawn.text
    assert "<a " not in drawn.text, "a file leads nowhere"
    assert analyst.get("/lab/compare?sort=beauty").status_code == 404
    assert analyst.get("/lab/compare/policies.svg?of=study_room/31/0").status_code == 404


SOCIAL = ("personal_space_violations", "personal_space_time_s", "min_time_to_collision_s", "stalled_time_s")


def test_a_comparison_shows_social_metrics_and_one_made_before_them_still_opens(analyst, worked, known, monkeypatch):
    here = f"/lab/compare/{known.comparison}"
    page = analyst.get(here).text
    assert "Minimum time to collision (s)" in page
    assert 'value="spl"' in page
    older = json.loads(worked.files.get(known.comparison))
    for one, scenes in zip(older["policies"], older["scenes"]["policies"], strict=True):
        for name in (*SOCIAL, "mean_jerk_m_s3", "path_irregularity_rad_m", "spl"):
            del one["measured"][name], one["measured"]["intervals"][name], scenes[name]
            older["compared"]["paired"].pop(name, None)
    stored = worked.files.get
    monkeypatch.setattr(
        worked.files, "get", lambda one: json.dumps(older).encode() if one == known.comparison else stored(one)
    )
    page = analyst.get(here).text
    assert "Minimum time to collision (s)" not in page
    assert "Self-intersections" in page
    assert analyst.get(f"{here}?measure=spl").status_code == 404


def test_a_policys_page_shows_the_social_metrics_of_its_evaluation(analyst, known):
    page = analyst.get(f"/lab/policies/{known.base}").text
    assert "Social metrics" in page
    for name in ("Minimum time to collision (s)", "Personal-space violations (1.2 m)"):
        assert name in page
    assert "Soziale Metriken" in analyst.get(f"/lab/policies/{known.base}", headers={"Accept-Language": "de"}).text
    assert "The model card was written before these metrics existed" in analyst.get(f"/lab/policies/{known.field}").text


def _listed(page: str) -> list[str]:
    """Scene seeds of the table of scenes."""
    return re.findall(r'<th scope="row">(\d+)</th>', page)


def test_every_collision_and_bar_of_a_comparison_leads_to_its_scenes(analyst, known):
    here = f"/lab/compare/{known.comparison}"
    page = html.unescape(analyst.get(here).text)
    scenes = np.genfromtxt(io.StringIO(analyst.get(f"{here}/scenes.csv").text), delimiter=",", names=True)
    for number, outcome in enumerate(("success", "collision", "timeout"), 1):
        for side in "ab":
            link = f"?measure=min_human_distance_m&only={side}-{outcome}"
            assert f'href="{link}#scenes"' in page
            listed = _listed(analyst.get(here + link).text)
            assert listed == [f"{seed:.0f}" for seed in scenes["scene_seed"][scenes[f"outcome_{side}"] == number]]
    bars = re.findall(r'<a href="([^"]+only=bar-\d+)#scenes" aria-label="(One scene|\d+ scenes), from', page)
    counts = [1 if told == "One scene" else int(told.split()[0]) for _, told in bars]
    assert sum(counts) == ((scenes["outcome_a"] == 1) & (scenes["outcome_b"] == 1)).sum()
    behind = [_listed(analyst.get(link).text) for link, _ in bars]
    assert [len(one) for one in behind] == counts
    assert len({seed for seeds in behind for seed in seeds}) == sum(counts), "every scene stands behind one bar"
    assert analyst.get(f"{here}?only=bar-x").status_code == 404
    assert "<a " not in analyst.get(f"{here}/difference-min_human_distance_m.svg").text


def test_every_scene_of_a_comparison_can_be_replayed_as_it_was_measured(analyst, worked, known):
    here = f"/lab/compare/{known.comparison}"
    with worked.database.session() as s:
        content = json.loads(worked.files.get(known.comparison))
        for number, seed in enumerate(content["scenes"]["scene_seed"]):
            pair = rollouts_in(s, worked.files, content, number)
            assert [one.scene.seed for one in pair] == [seed, seed]
            for one, measured in zip(pair, content["scenes"]["policies"], strict=True):
                assert int(one.outcome) == measured["outcome"][number]
                assert one.duration_s == pytest.approx(measured["time_s"][number])
    page = html.unescape(analyst.get(f"{here}?scene=29&stage=1").text)
    assert "Rolled out again in this scene" in page
    assert "other outcome" not in page
    assert '<iframe class="replay"' in page


def test_replay_of_two_policies_opens_a_stage_for_this_browser_only(analyst, worked, known):
    page = analyst.get(f"/lab/compare/{known.comparison}?stage=1").text
    token = re.search(r'<iframe[^>]*src="[^"]*/stage/([^/"]+)/"', page).group(1)
    replays = worked.replays
    assert replays.key_of(token) == f"replay:{token}"
    assert replays.key_of(token[:-1]) is None
    shown = []
    stage = SimpleNamespace(replay=lambda drives, names, **_: shown.append((drives, names)))
    assert replays.show(stage, f"replay:{token}")
    (left, right), names = shown[0]
    assert left.scene == right.scene
    assert names == ("A: study_room/base", "B: study_room/ensemble/1")
    assert not replays.show(stage, "a participant's key")


def test_quarantined_artefacts_are_shown_as_such_and_not_handed_out(analyst, worked, known):
    with worked.database.transaction() as s:
        for artefact in (known.snapshot, known.reward_model, known.comparison):
            s.get_one(Artefact, artefact).quarantined_at = utc_now()
    assert "quarantined" in analyst.get(f"/lab/snapshots/{known.snapshot}").text
    assert analyst.get(f"/lab/artefacts/{known.reward_model}").status_code == 200
    for gone in (
        f"/lab/artefacts/{known.reward_model}/content",
        f"/lab/snapshots/{known.snapshot}/answers/{known.answer}",
        f"/lab/compare/{known.comparison}",
    ):
        assert analyst.get(gone).status_code == 410
    assert known.snapshot not in analyst.get("/lab/jobs/new/align").text


@pytest.mark.parametrize(
    "address", ["jobs/x", "jobs/new/bake", "snapshots/x", "policies/x", "artefacts/x", "compare/x", "jobs/x/log.txt"]
)
def test_unknown_addresses_are_refused_kindly(analyst, address):
    refused = analyst.get(f"/lab/{address}")
    assert refused.status_code == 404
    assert "<h1>There is no" in refused.text

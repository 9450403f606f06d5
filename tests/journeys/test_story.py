"""The whole story in a real browser: a study is opened, answered, watched, exported, aligned again and compared.

The tests run in order on one installation. The browser's clock is driven fast for the simulated participant; another
one watches a pair in real time, and so does a bot in a browser of its own. Pictures go to $DESIREPATH_SCREENSHOTS.
"""

import csv
import io
import json
import re
import time
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect
from sqlalchemy import select

from desirepath.analysis.metrics import measure
from desirepath.installed import PROTOCOLS
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.queries.queries import QuerySet
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.database import Database
from desirepath.store.models import Job, Response, Session, Trial
from desirepath.study.links import token_hash
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from desirepath_experiments.browser.client import walk_with_browser
from tests.journeys.conftest import Installation
from tests.running import until
from tests.web.protocol_writing import write_yaml

pytestmark = pytest.mark.journey

NEW_PASSWORD = "a bridge of paper boats"
STUDY = "Story study"
ALIGNMENT_PATIENCE_MS = 600_000  # a busy machine is slow, not wrong
SPEED = 12
PAIRS = 7  # of the shipped protocol's 15


def sign_in(page: Page, installation: Installation, password: str) -> None:
    page.goto(f"{installation.url}/lab/studies")
    page.get_by_label("Name").fill("experimenter")
    page.get_by_label("Password", exact=True).fill(password)
    page.get_by_role("button", name="Sign in").click()
    page.wait_for_url(lambda url: "sign-in" not in url)


def state_of(installation: Installation, token: str) -> dict:
    return httpx.get(f"{installation.url}/api/session/{token}", timeout=60).json()


def answer_page(page: Page) -> None:
    """Fill in what is visible (first label of every choice, the middle of every scale) and go on."""
    for box in page.locator("main input[type=checkbox]:visible").all():
        box.check()
    names = {radio.get_attribute("name") for radio in page.locator("main input[type=radio]:visible").all()}
    for name in names:
        options = page.locator(f'main input[type=radio][name="{name}"]:visible')
        options.nth(options.count() // 2).check()
    for number in page.locator("main input[type=number]:visible").all():
        number.fill("34")
    page.locator("main button.main:visible").click()


def walk_until(page: Page, installation: Installation, token: str, kinds: set[str]) -> dict:
    """Answer page after page until the session stands at a step of one of these kinds."""
    for _ in range(60):
        state = state_of(installation, token)
        if state["step"]["kind"] in kinds:
            return state
        key = state["step"]["key"]
        answer_page(page)
        # The next screen may be the same step's next part, so look at the page before asking again.
        page.wait_for_timeout(400)
        if page.locator("#step[aria-busy=true]").count():
            page.wait_for_function("() => !document.querySelector('#step[aria-busy=true]')")
        assert key
    pytest.fail(f"never came to {kinds}; still at {state_of(installation, token)['step']}")


def trial_of(installation: Installation, token: str) -> Trial:
    """The current one."""
    with Database(Settings(data=installation.data).database).session() as s:
        session = s.scalars(select(Session).where(Session.token_hash == token_hash(token))).one()
        key = session.plan[session.position]["key"]
        return s.scalars(select(Trial).where(Trial.session_id == session.id, Trial.step_key == key)).one()


def own_side(installation: Installation, token: str) -> str:
    """The side of the current comparison on which the robot drives that learned."""
    return (trial_of(installation, token).arms or {})["own"]


def roomier(installation: Installation, token: str) -> str:
    """The side of the current trial that keeps farther from the person, as somebody would choose who wants room."""
    files, trial = ArtefactStore(Settings(data=installation.data).artefacts), trial_of(installation, token)
    a, b = (load_trajectory(files, one) for one in (trial.trajectory_a, trial.trajectory_b))
    room = measure([a, b]).min_human_distance
    return "a" if room[0] >= room[1] else "b"


def watch_and_choose(page: Page, by_keyboard: bool, side: str = "a") -> None:
    """One trial as a participant does it: Start, both drives, then a choice."""
    start = page.locator("#start")
    expect(start).to_have_attribute("aria-disabled", "false", timeout=60_000)
    choice = page.locator(f"button[data-choice={side}]")
    expect(choice).to_have_attribute("aria-disabled", "true")
    start.click()
    expect(choice).to_have_attribute("aria-disabled", "false", timeout=90_000)
    if by_keyboard:
        page.keyboard.press(side)
    else:
        choice.click()


def test_1_experimenter_opens_a_study(installation: Installation, open_page: Callable[..., Page], screenshots):
    page = open_page(width=1280, height=800)
    page.goto(installation.link)
    expect(page).to_have_url(f"{installation.url}/lab/studies")
    page.goto(f"{installation.url}/lab/password")
    for field in page.locator("input[type=password]").all():
        field.fill(NEW_PASSWORD)
    page.get_by_role("button", name="Change password").last.click()
    page.goto(f"{installation.url}/lab/studies")
    expect(page.get_by_role("heading", name="Studies")).to_be_visible()
    screenshots(page, "experimenter_no_studies")
    page.goto(f"{installation.url}/lab/new")
    screenshots(page, "experimenter_choose_protocol")
    page.locator("input[value='shipped:quick_preference_study']").check()
    page.get_by_role("button", name="Check it").first.click()
    yaml = page.locator("textarea[name=yaml]").input_value()
    # First a mistake: it is pointed out with its line, and nothing is opened.
    write_yaml(page, yaml.replace("view: top_down", "view: from_the_moon"))
    line = next(n for n, text in enumerate(yaml.splitlines(), 1) if "view: top_down" in text)
    expect(page.get_by_role("link", name=f"Line {line}", exact=False).first).to_be_visible()
    expect(page.locator("#editor-part .notice.error")).to_be_visible()
    screenshots(page, "experimenter_protocol_mistake")
    # A CI machine may need longer for the alignment than a participant would be asked to wait.
    longer = yaml.replace("give_up_after_s: 120", "give_up_after_s: 900")
    assert "count: 15," in longer
    write_yaml(page, longer.replace("count: 15,", f"count: {PAIRS},"))
    page.get_by_role("button", name="Check again").click()
    page.locator("input[name=name]").fill(STUDY)
    screenshots(page, "experimenter_check")
    page.get_by_label("Start with a pilot phase").uncheck()
    page.get_by_role("button", name="Open the study").click()
    page.wait_for_url(re.compile(r"/lab/studies/[0-9a-f]{32}"))
    study = re.search(r"/lab/studies/([0-9a-f]{32})", page.url)
    assert study
    installation.notes["study"] = study.group(1)
    page.goto(f"{installation.url}/lab/studies/{study.group(1)}/recruit")
    link = re.search(rf"{installation.url}/join/[\w-]+", page.content())
    assert link
    installation.notes["link"] = link.group()
    screenshots(page, "experimenter_recruit")


def test_2_a_participant_watches_one_pair_in_real_time(
    installation: Installation, open_page: Callable[..., Page], screenshots
):
    page = open_page()
    page.goto(installation.notes["link"])
    expect(page.get_by_text("3D pictures work.")).to_be_visible()
    screenshots(page, "participant_welcome")
    page.get_by_role("button", name="Continue").click()
    page.wait_for_url("**/p/*")
    token = page.url.rsplit("/p/", 1)[1].split("?")[0]
    screenshots(page, "participant_information")
    state = walk_until(page, installation, token, {"trial"})
    shown_s = 2 * state["step"]["trial"]["label_s"] + sum(
        state["step"]["trial"][name] for name in ("duration_a_s", "duration_b_s")
    )
    expect(page.locator("#start")).to_have_attribute("aria-disabled", "false", timeout=60_000)
    screenshots(page, "participant_trial_ready")
    began = time.monotonic()
    # Before both drives were shown the server takes no choice, whatever the page says.
    refused = httpx.post(
        f"{installation.url}/api/session/{token}/steps/{state['step']['key']}",
        json={"request_id": "early-answer-000000000000000000", "value": {"choice": "a"}},
        timeout=60,
    )
    assert refused.status_code == 409, refused.text
    watch_and_choose(page, by_keyboard=True)
    expect(page.locator(f".step-body[data-key='{state['step']['key']}']")).to_have_count(0, timeout=60_000)
    assert time.monotonic() - began >= shown_s - 0.5
    assert state_of(installation, token)["step"]["index"] == state["step"]["index"] + 1
    screenshots(page, "participant_second_trial")
    # A reload returns to the same trial.
    page.reload()
    expect(page.locator("#start")).to_have_attribute("aria-disabled", "false", timeout=60_000)
    assert state_of(installation, token)["step"]["index"] == state["step"]["index"] + 1


def test_3_a_participant_teaches_the_robot_and_compares(
    installation: Installation, open_page: Callable[..., Page], screenshots
):
    """All answers, the questionnaire while the robot learns, the blind comparison, the completion code."""
    joined = httpx.post(
        installation.notes["link"],
        json={"simulated": True, "language": "en", "oracle": {"name": "min-human-distance", "noise": 0.0, "seed": 0}},
        timeout=60,
    ).json()
    token = joined["token"]
    page = open_page(speed=SPEED)
    page.goto(f"{installation.url}/p/{token}")
    state = walk_until(page, installation, token, {"trial"})
    answered = 0
    while state["step"]["kind"] == "trial":
        if answered == 4:
            screenshots(page, "participant_trial")
        watch_and_choose(page, by_keyboard=answered % 2 == 0, side=roomier(installation, token))
        answered += 1
        state = _next_state(installation, token, state)
    assert answered == 1 + PAIRS  # one for practice
    expect(page.locator("main form")).to_be_visible()
    screenshots(page, "participant_questionnaire_meanwhile")
    state = walk_until(page, installation, token, {"wait", "comparison"})
    if state["step"]["kind"] == "wait":
        screenshots(page, "participant_waiting")
        page.wait_for_selector("#start", timeout=ALIGNMENT_PATIENCE_MS)
        state = state_of(installation, token)
    compared = guessed = met = 0  # only scenes in which the robots can be told apart are compared
    while state["state"] == "active" and state["step"]["kind"] != "debriefing":
        if state["step"]["kind"] == "comparison":
            watch_and_choose(page, by_keyboard=False, side=own_side(installation, token))
            compared += 1
        elif state["step"]["kind"] == "meet_your_robot":
            page.locator("[data-drive][aria-disabled=false]").click(timeout=60_000)
            page.locator("[data-drive][data-driving]").wait_for()
            page.locator("[data-drive]:not([data-driving])").wait_for(timeout=90_000)
            page.locator("label:has([data-agreement][value='4'])").click()
            screenshots(page, "participant_meets_the_robot")
            page.locator("[data-done][aria-disabled=false]").click()
            met += 1
        else:
            assert state["step"]["kind"] == "guess"
            screenshots(page, "participant_guess")
            answer_page(page)
            guessed += 1
        state = _next_state(installation, token, state)
    assert 1 <= compared <= 6
    assert guessed == 1
    assert met == (compared >= 4)
    expect(page.locator("#completion-code")).to_be_visible()
    code = page.locator("#completion-code").inner_text()
    assert len(code.strip()) >= 6
    expect(page.locator(".about-me")).to_contain_text(
        re.compile(rf"You chose it in {compared} of {compared} pairs?, and ")
    )
    screenshots(page, "participant_debriefing")
    installation.notes["simulated"], installation.notes["compared"] = joined["participant"], str(compared)


def _next_state(installation: Installation, token: str, before: dict) -> dict:
    """The session's state once it has left the step it was at."""
    for _ in range(300):
        state = state_of(installation, token)
        if state["state"] != "active" or state["step"]["key"] != before["step"]["key"]:
            return state
        time.sleep(0.2)
    pytest.fail(f"the session stays at {before['step']['key']}")


def test_4_experimenter_sees_it_and_exports(
    installation: Installation, open_page: Callable[..., Page], screenshots, tmp_path
):
    page = open_page(width=1280, height=800)
    sign_in(page, installation, NEW_PASSWORD)
    study = f"{installation.url}/lab/studies/{installation.notes['study']}"
    page.goto(study)
    screenshots(page, "experimenter_now")
    page.goto(f"{study}/people?show=all")
    expect(page.get_by_text(installation.notes["simulated"]).first).to_be_visible()
    screenshots(page, "experimenter_people")
    page.goto(f"{study}/data")
    screenshots(page, "experimenter_data")
    with page.expect_download() as download:
        page.get_by_role("button", name="Export").click()
    archive = tmp_path / "export.zip"
    download.value.save_as(archive)
    with zipfile.ZipFile(archive) as packed:
        names = {name.rsplit("/", 1)[-1]: name for name in packed.namelist()}
        responses = list(csv.DictReader(io.StringIO(packed.read(names["responses.csv"]).decode())))
    choices = [row for row in responses if row["kind"] == "preference"]
    # Two practice pairs: the real-time participant's and the simulated one's.
    assert [row["practice"] for row in choices].count("true") == 2
    assert sum(row["practice"] == "false" and row["simulated"] == "true" for row in choices) == PAIRS
    assert sum(row["kind"] == "comparison" for row in responses) == int(installation.notes["compared"])


def test_5_analyst_aligns_again_and_compares(installation: Installation, open_page: Callable[..., Page], screenshots):
    page = open_page(width=1280, height=800)
    sign_in(page, installation, NEW_PASSWORD)
    # The session's own snapshot is where its policy came from; start the alignment again from it.
    page.goto(f"{installation.url}/lab/snapshots")
    screenshots(page, "analyst_snapshots")
    snapshot = page.locator('a[href^="/lab/snapshots/"]').first.get_attribute("href").rsplit("/", 1)[1]
    page.goto(f"{installation.url}/lab/jobs/new/align?snapshot={snapshot}")
    page.locator("input[name=updates]").fill("400")  # a tiny budget: real parts, no science
    screenshots(page, "analyst_align_form")
    page.locator("main form button.main").click()
    page.wait_for_url(re.compile(r"/lab/jobs/[0-9a-f]{32}"))
    job = re.search(r"/lab/jobs/([0-9a-f]{32})", page.url).group(1)
    aligned = _finished(page, installation, job)
    screenshots(page, "analyst_job")
    page.goto(f"{installation.url}/lab/policies/{aligned['policy']}")
    screenshots(page, "analyst_policy")
    page.goto(f"{installation.url}/lab/compare")
    base = page.locator("select[name=policy_a] option", has_text="study_room/base").first.get_attribute("value")
    page.locator("select[name=policy_a]").select_option(base)
    page.locator("select[name=policy_b]").select_option(aligned["policy"])
    page.locator("input[name=scenes]").fill("100")
    page.locator("main form button.main").click()
    page.wait_for_url(re.compile(r"/lab/(jobs|compare)/[0-9a-f]{32,64}"))
    compared = _finished(page, installation, re.search(r"/([0-9a-f]{32,64})", page.url).group(1))
    page.goto(f"{installation.url}/lab/compare/{compared['evaluation']}")
    expect(page.get_by_role("table").first).to_be_visible()
    screenshots(page, "analyst_compare")
    page.get_by_role("link", name="Show in 3D").click()
    stage = page.frame_locator("iframe").first
    expect(stage.locator("canvas").first).to_be_visible()
    page.wait_for_timeout(1000)  # for the picture only: let both robots drive
    screenshots(page, "analyst_replay")
    # Nothing is chosen first, and what is chosen is kept from tab to tab.
    page.goto(f"{installation.url}/lab/flow-field")
    expect(stage.locator("canvas").first).to_be_visible()
    page.get_by_role("link", name="Next scene").click()
    page.get_by_role("link", name="immersive").click()
    page.get_by_role("link", name="Interactive weights").click()
    expect(page.get_by_text("study_room/base has no preference weights to move")).to_be_visible()
    expect(stage.locator("canvas").first).to_be_visible()
    page.get_by_role("link", name="Explanation").click()
    expect(stage.locator("canvas").first).to_be_visible()
    assert page.url.endswith("/lab/explain?policy=study_room/base&scene=3500000005&view=immersive")
    screenshots(page, "analyst_workspace")
    page.goto(f"{installation.url}/lab/compare")
    with page.expect_download() as picture:
        page.get_by_role("link", name="PNG").click()
    assert picture.value.suggested_filename == "policies.png"


def _finished(page: Page, installation: Installation, job: str) -> dict:
    """The job's result once it has succeeded, as `desirepath jobs show` tells it."""
    import os
    import subprocess
    import sys

    database = Database(Settings(data=installation.data).database)

    def ended() -> bool:
        with database.session() as s:
            return s.get_one(Job, job).state not in ("queued", "running")

    until(ended, f"job {job} did not finish")
    database.close()
    told = subprocess.run(
        [sys.executable, "-m", "desirepath", "jobs", "show", job, "--json"],
        env={**os.environ, "DESIREPATH_DATA": str(installation.data)},
        capture_output=True,
        text=True,
        check=True,
    )
    shown = json.loads(told.stdout)
    assert shown["state"] == "succeeded", shown
    page.reload()
    return shown["result"]


def one_pair(folder: Path) -> str:
    """The shipped interface study with one short pair, in one view."""
    shipped = load_queries("study_room/queries_500")
    shortest = min(shipped.queries, key=lambda q: q.trajectory_a.duration_s + q.trajectory_b.duration_s)
    QuerySet(shipped.setup, (shortest,), {}).save(folder / "one.npz")
    text = (PROTOCOLS / "interface_study.yaml").read_text()
    declared = text[text.index("analysis:") : text.index("stages:")]  # of three views, which are not compared here
    for old, new in (
        (declared, ""),
        ("  - questionnaire: {use: interface_ranking}\n", ""),
        ("study_room/queries_500", str(folder / "one.npz")),
        ("each: [top_down, first_person, immersive]", "view: immersive"),
        ("        - queries: {count: 1, role: practice}    # for practice: stored, marked, never analysed\n", ""),
        ("count: 25, probes: {repeat: 5}", "count: 1"),
        ("{view}", "immersive"),
        ("scheme: all_orders", "scheme: random"),
        ("      between:\n        - break: {text: texts/interface_break.md}\n", ""),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def test_a_bot_in_a_browser_and_one_over_http_leave_the_same(installation: Installation, tmp_path: Path) -> None:
    settings = Settings(data=installation.data)
    database = Database(settings.database)
    with database.transaction() as s:
        study = create_study(
            s, ArtefactStore(settings.artefacts), freeze_text(one_pair(tmp_path)), name="One pair", created_by=None
        )
        study_id, token = study.id, study.recruiting_token
    pictures, lines = tmp_path / "pictures", list[str]()
    with ThreadPoolExecutor(1) as elsewhere:  # playwright keeps a loop on this thread already
        asked = (installation.url, token, 2, 1, Character(), "de", pictures, lines.append)
        walk = elsewhere.submit(walk_with_browser, *asked).result()
        assert walk["completed"] == 2
    assert len(lines) == walk["responses"], "somebody who waits for minutes sees it go on"
    names = {path.stem.partition("_")[2] for path in pictures.glob("*.png")}
    assert names >= {"join", "consent_consent", "ready_immersive", "playing_immersive", "choosing_immersive", "end"}
    with database.session() as s:
        sessions = list(s.scalars(select(Session.id).where(Session.study_id == study_id)))
        answered = [
            {row.step_key: sorted(row.value) for row in s.scalars(select(Response).where(Response.session_id == one))}
            for one in sessions
        ]
        trials = list(s.scalars(select(Trial).where(Trial.session_id.in_(sessions))))
    assert answered[0] == answered[1]
    assert [(trial.phase, trial.view, trial.restarts) for trial in trials] == [("answered", "immersive", 0)] * 2
    database.close()

"""A study on a headset, from the consent to the code, in an emulated Quest 3: pairs are watched and answered in the
room, and it goes on in the window when the headset is taken off."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Frame, Page, expect
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.queries.queries import QuerySet
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import HeadPose, Session, Trial
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.protocol.headset_words import HEAD
from desirepath.study.studies import create_study
from tests.fewer_pictures import draw_fewer_pictures
from tests.headset import plug_in_headset, pull_trigger_at, put_on, take_off
from tests.journeys.conftest import COARSE, Installation
from tests.journeys.test_story import walk_until

pytestmark = pytest.mark.journey
PAIRS = 2


@pytest.fixture
def page(chromium: Browser) -> Iterator[Page]:
    context = chromium.new_context(viewport={"width": 800, "height": 560}, device_scale_factor=COARSE)
    context.set_default_timeout(60_000)
    draw_fewer_pictures(context)
    plug_in_headset(context)
    page = context.new_page()
    page.on("pageerror", lambda error: pytest.fail(f"script error on the page: {error}"))
    yield page
    context.close()


def link_to(installation: Installation, folder: Path) -> str:
    """The quick study with two short pairs seen from inside, and no training."""
    shipped = load_queries("study_room/queries_varied_200")
    shortest = sorted(shipped.queries, key=lambda query: query.trajectory_a.duration_s + query.trajectory_b.duration_s)
    QuerySet(shipped.setup, tuple(shortest[:4]), {}).save(folder / "short.npz")
    text = (PROTOCOLS / "quick_preference_study.yaml").read_text()
    asked = text.index("\n", text.index("count: 15, choose: information")) + 1
    learnt = text[asked : text.index("  - debriefing")]
    for old, new in (
        (learnt, ""),
        ("study_room/queries_varied_200", str(folder / "short.npz")),
        ("        - queries: {count: 1, role: practice}     # for practice: stored, marked, never analysed\n", ""),
        ("count: 15, choose: information", f"count: {PAIRS}"),
        ("view: top_down", "view: immersive"),
        ("stages:", "device: {headset: offered, head_pose: true, min_width: 600, min_height: 400}\nstages:"),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    settings, told = Settings(data=installation.data), folder / "told"
    shutil.copytree(PROTOCOLS, told)
    for language, sentence in HEAD.items():
        with (told / f"texts/information.{language}.md").open("a") as information:
            information.write(f"\n{sentence}\n")
    frozen = freeze_text(text, folder=told)
    with Database(settings.database).transaction() as s:
        study = create_study(s, ArtefactStore(settings.artefacts), frozen, name="Worn", created_by=None)
        return f"{installation.url}/join/{study.recruiting_token}"


def stage_of(page: Page) -> Frame:
    page.locator("#stage-frame iframe").wait_for()
    frame = page.locator("#stage-frame iframe").element_handle().content_frame()
    assert frame is not None
    return frame


def test_a_study_from_consent_to_code_on_a_headset(installation: Installation, page: Page, tmp_path: Path) -> None:
    page.goto(link_to(installation, tmp_path))
    begin = page.locator("#begin")
    expect(begin).to_be_enabled()
    begin.click()
    page.wait_for_url("**/p/*")
    token = page.url.rpartition("/")[2]
    walk_until(page, installation, token, {"trial"})
    room = stage_of(page)
    put_on(room)
    pull_trigger_at(room, "start")
    expect(page.locator("#playing-letter")).to_have_text("A")
    take_off(room)  # its battery is empty: this drive starts over, at the same step
    expect(page.locator("#banner")).to_contain_text("You took off the headset")
    expect(page.locator("#start")).to_be_visible()
    key = str(page.locator(".step-body").get_attribute("data-key"))
    put_on(room)
    for number in range(PAIRS):
        pull_trigger_at(room, "start")
        room.wait_for_function("window.desirePath.headsetRoom.may('b')", timeout=150_000)
        picture(page, room, number)
        pull_trigger_at(room, "b")
        if number == 0:
            expect(page.locator(".step-body")).not_to_have_attribute("data-key", key)
    room.wait_for_function("window.desirePath.headsetRoom.shown().text.startsWith('This part is over')")
    pull_trigger_at(room, "leave", lets_go=False)  # with the headset goes the frame
    expect(page.locator("#stage")).to_be_hidden()
    expect(page.locator(".step-body")).to_have_attribute("data-kind", "debriefing")
    with Database(Settings(data=installation.data).database).session() as s:
        session = s.scalars(select(Session).order_by(Session.created_at.desc())).first()
        assert session is not None
        assert session.completion_code is not None
        expect(page.locator("#step")).to_contain_text(session.completion_code)
        trials = list(s.scalars(select(Trial).where(Trial.session_id == session.id).order_by(Trial.index)))
        heads = list(s.scalars(select(HeadPose).where(HeadPose.session_id == session.id)))
    assert [(trial.hmd, trial.view) for trial in trials] == [(True, "immersive")] * PAIRS
    assert trials[0].restarts >= 1
    assert trials[0].headset is not None
    assert trials[0].headset["a"]["controllers"] == ["meta-quest-touch-plus"]
    assert {(head.trial_id, head.side) for head in heads} > {(t.id, side) for t in trials for side in "ab"}
    assert len({head.wearing for head in heads}) == 2


def picture(page: Page, room: Frame, name: object) -> None:
    """What both eyes see, where somebody asks for it."""
    if folder := os.environ.get("DESIREPATH_SCREENSHOTS"):
        room.add_style_tag(
            content="canvas:not([id^=desire-path]) { visibility: visible !important; opacity: 1 !important }"
        )
        page.screenshot(path=Path(folder) / f"headset_{name}.png")

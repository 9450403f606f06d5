"""A whole study by keyboard alone in a real browser, every page of it accessible; and pairs under other view rules.

The study is the shipped interface study with fewer pairs. The room is stood in for as in test_session_page.py. Whoever
walks the whole study is a person to the server: its clock decides when a drive can have been seen.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from desirepath.cli.loopback import free_port_pair
from desirepath.installed import PROTOCOLS
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.queries.queries import QuerySet
from desirepath.settings import Settings
from desirepath.store.models import Event, Response, Session, Trial
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.studies import create_study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests.accessible import violations_in_both_schemes
from tests.frontend.empty_room import empty_rooms, room_says
from tests.running import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page, Route


class Studies:
    """A server with studies that differ from the shipped interface study in a few words."""

    def __init__(self, services: Services, url: str, queries: Path) -> None:
        self.services, self.url, self._queries = services, url, queries

    def link(self, *changes: tuple[str, str]) -> str:
        """The recruiting link of a new study with these replacements in its YAML."""
        text = (PROTOCOLS / "interface_study.yaml").read_text()
        small = (
            ("study_room/queries_500", str(self._queries)),
            ("        - queries: {count: 1, role: practice}    # for practice: stored, marked, never analysed\n", ""),
            ("count: 25, probes: {repeat: 5}", "count: 1"),
        )
        for old, new in (*small, *changes):
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        with self.services.database.transaction() as s:
            study = create_study(s, self.services.files, freeze_text(text), name="Small", created_by=None)
            return f"{self.url}/join/{study.recruiting_token}"

    def rows(self, table: type[Any]) -> list[Any]:
        """All rows of the youngest session."""
        with self.services.database.session() as s:
            session = s.scalars(select(Session).order_by(Session.created_at.desc())).first()
            assert session is not None
            found = list(s.scalars(select(table).where(table.session_id == session.id)))
            s.expunge_all()
            return found


@pytest.fixture(scope="module")
def studies(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studies]:
    folder = tmp_path_factory.mktemp("data")
    shipped = load_queries("study_room/queries_500")
    shortest = sorted(shipped.queries, key=lambda q: q.trajectory_a.duration_s + q.trajectory_b.duration_s)
    queries = folder / "short.npz"
    QuerySet(shipped.setup, tuple(shortest[:3]), {}).save(queries)
    port = free_port_pair()
    services = build_services(Settings(data=folder, port=port, worker=False, _env_file=None))
    with served(create_application(services), port=port) as address:
        yield Studies(services, address, queries)


@pytest.fixture
def page(chromium: Browser) -> Iterator[Page]:
    context: BrowserContext = chromium.new_context(
        viewport={"width": 1024, "height": 640}, screen={"width": 1024, "height": 640}, reduced_motion="reduce"
    )
    empty_rooms(context)
    yield context.new_page()
    context.close()


def trial_of(page: Page) -> dict[str, Any]:
    token = page.url.rpartition("/")[2].partition("?")[0]
    found: dict[str, Any] = httpx.get(f"{page.url.partition('/p/')[0]}/api/session/{token}").json()["step"]["trial"]
    return found


def begin(page: Page) -> None:
    """The room stands, and Start is pressed."""
    room_says(page, "ready")
    expect(page.locator("#start")).to_have_attribute("aria-disabled", "false")
    expect(page.locator("#start")).to_be_focused()
    page.keyboard.press("Enter")


def watch(page: Page, letter: str) -> None:
    """The drive plays to its end; the page asks until the server's clock agrees that it can have been seen."""
    expect(page.locator("#playing-letter")).to_have_text(letter, timeout=15_000)
    playback = trial_of(page)["playback_id"]
    room_says(page, "playing", playback_id=playback)
    room_says(page, "played", playback_id=playback)


class Keyboard:
    """Somebody without a mouse: Tab until the thing that is wanted has the focus."""

    def __init__(self, page: Page) -> None:
        self.page = page

    def to(self, wanted: str, key: str = "Tab") -> None:
        """wanted: JavaScript that is true of `focused`, the element with the focus."""
        for _ in range(60):
            if self.page.evaluate(f"(() => {{ const focused = document.activeElement; return {wanted}; }})()"):
                assert self.page.evaluate("document.activeElement.checkVisibility()")
                return
            self.page.keyboard.press(key)
        raise AssertionError(f"60 times {key} did not lead to {wanted}")

    def press_main(self) -> None:
        """The one main button of the step."""
        expect(self.page.locator(".bottombar .main")).to_be_enabled(timeout=20_000)  # measuring frames takes a while
        self.to("focused.matches('.bottombar .main')")
        self.page.keyboard.press("Enter")

    def answer_page(self) -> None:
        """Every question that stands open on this page: the third of a scale, the first of a choice, any ranking."""
        for kind in self.page.locator("[data-item] >> visible=true").evaluate_all(
            "all => all.map((i) => i.dataset.type)"
        ):
            selector = (
                "[data-type=ranking] [data-pool] [data-value]" if kind == "ranking" else f"[data-type={kind}] input"
            )
            open_ = f"focused.matches({json.dumps(selector)}) && !focused.closest('[data-item]').dataset.answered"
            self.to(open_)
            if kind == "ranking":
                for _ in range(3):
                    self.page.keyboard.press("Enter")
                    self.page.keyboard.press("Tab")
                self.page.keyboard.press("Shift+Tab")
            elif kind == "number":
                self.page.keyboard.type("44")
            else:
                self.page.keyboard.press("Space")
                for _ in range(2 if kind == "scale" else 0):
                    self.page.keyboard.press("ArrowRight")
            self.page.evaluate("document.activeElement.closest('[data-item]').dataset.answered = 'yes'")


def test_a_whole_study_by_keyboard_alone(studies: Studies, page: Page) -> None:
    page.goto(studies.link(("device: {min_width: 1000, min_height: 600, min_frame_rate: 10, light_below: 20}", "")))
    keys = Keyboard(page)
    assert violations_in_both_schemes(page) == []
    keys.press_main()
    page.wait_for_url("**/p/*")
    kinds: list[str] = []
    progress: list[float] = []
    checked: set[str] = set()
    while True:
        body = page.locator(".step-body")
        key, kind = body.get_attribute("data-key"), str(body.get_attribute("data-kind"))
        kinds.append(kind)
        progress.append(float(body.get_attribute("data-behind") or 0))
        if kind == "trial":
            begin(page)
            watch(page, "A")
            watch(page, "B")
            expect(page.locator("#question")).to_be_focused(timeout=15_000)
        if kind not in checked:
            checked.add(kind)
            assert violations_in_both_schemes(page) == [], kind
        if kind == "debriefing":
            break
        if kind == "trial":
            page.keyboard.press("b")
        elif kind == "consent":
            for _ in range(page.locator("[data-point]").count()):
                keys.to("focused.matches('[data-point]:not(:checked)')")
                page.keyboard.press("Space")
            keys.answer_page()
            keys.press_main()
        else:
            while kind == "questionnaire":
                keys.answer_page()
                part = page.locator("#page-count").text_content()
                keys.press_main()
                if not part or len(set(re.findall(r"\d+", part))) == 1:
                    break
                expect(page.locator("#page-count")).not_to_have_text(part)
            else:
                keys.press_main()
        expect(page.locator(f".step-body[data-key='{key}']")).to_have_count(0)
    block = ["instruction", "trial", "questionnaire"]
    blocks = [*block, "break", *block, "break", *block]
    expected = ["information", "consent", "questionnaire", *blocks, "questionnaire", "debriefing"]
    assert kinds == expected
    assert progress == sorted(progress)
    assert page.locator("#progress-text").inner_text() == "Finished"
    answers = {row.step_key: row.value for row in studies.rows(Response)}
    assert answers["consent"]["purposes"] == {"training": True, "open_data": True}
    assert sorted(answers["interface_ranking"]["usefulness"]) == ["first_person", "immersive", "top_down"]
    assert answers["block.immersive.interface_items"] == dict.fromkeys(answers["block.top_down.interface_items"], 3)
    trials = {row.block: row for row in studies.rows(Trial)}
    assert trials["top_down"].query_id == trials["immersive"].query_id
    assert trials["top_down"].trajectory_a == trials["immersive"].trajectory_a


def to_the_first_pair(page: Page, link: str, kind: str = "trial") -> None:
    """By API, as a simulated participant, whose drives need not be waited for."""
    joined = httpx.post(link, json={"language": "en", "simulated": True}).json()
    api = f"{link.partition('/join/')[0]}/api/session/{joined['token']}"
    values = {
        "consent": {"given": True},
        "demographics": {"gender": "woman", "vision": "normal", "vr_experience": 1, "robotics_experience": 3},
    }
    while (step := httpx.get(api).json()["step"])["kind"] != kind:
        body = {"request_id": f"setup-{step['key']}-{joined['token']}"[:60], "value": values.get(step["key"], {})}
        httpx.post(f"{api}/steps/{step['key']}", json=body).raise_for_status()
    page.goto(f"{link.partition('/join/')[0]}/p/{joined['token']}")


VIEWING = "viewing: {goal_and_trail: false}"


def test_a_pair_can_be_watched_again_as_often_as_the_protocol_says(studies: Studies, page: Page) -> None:
    to_the_first_pair(page, studies.link((VIEWING, "viewing: {replays: 1}")))
    begin(page)
    for _ in range(2):
        watch(page, "A")
        watch(page, "B")
        expect(page.locator("#question")).to_be_focused()
        if page.locator("#again").is_visible():
            page.locator("#again").press("Enter")
    expect(page.locator("#again")).to_be_hidden()
    page.keyboard.press("a")
    expect(page.locator(".step-body[data-kind=trial]")).to_have_count(0)
    (trial,) = studies.rows(Trial)
    assert trial.replays == 1


def test_an_early_choice_is_possible_once_b_has_begun(studies: Studies, page: Page) -> None:
    to_the_first_pair(page, studies.link((VIEWING, "viewing: {early_choice: true}")))
    begin(page)
    expect(page.locator("#live")).to_have_text("Watch drive A")
    page.keyboard.press("a")
    expect(page.locator("#live")).to_have_text("You can choose as soon as drive B has begun.")
    watch(page, "A")
    expect(page.locator("#playing-letter")).to_have_text("B")
    room_says(page, "playing", playback_id=trial_of(page)["playback_id"])
    expect(page.locator("[data-choice=a]")).to_have_attribute("aria-disabled", "false")
    page.keyboard.press("b")
    expect(page.locator(".step-body[data-kind=trial]")).to_have_count(0)
    assert [row.value for row in studies.rows(Response) if row.kind == "preference"] == [{"choice": "b"}]


def test_when_the_time_to_choose_is_over_the_study_goes_on(studies: Studies, page: Page) -> None:
    to_the_first_pair(page, studies.link((VIEWING, "viewing: {choice_limit_s: 3}")))
    begin(page)
    watch(page, "A")
    watch(page, "B")
    expect(page.locator("#choice-left")).to_contain_text("left to choose")
    expect(page.locator(".step-body[data-kind=trial]")).to_have_count(0, timeout=10_000)
    assert [row.value for row in studies.rows(Response) if row.kind == "preference"] == [{"timed_out": True}]
    assert not [event for event in studies.rows(Event) if event.kind == "refused"]


def test_how_clearly_one_is_better_is_said_by_keyboard_or_that_there_is_no_difference(
    studies: Studies, page: Page
) -> None:
    asked = f"{VIEWING}\n      answers: {{no_difference: true, degree: strength}}"
    to_the_first_pair(page, studies.link((VIEWING, asked), ("{count: 1}   # five", "{count: 2}   # five")))
    begin(page)
    watch(page, "A")
    watch(page, "B")
    assert not violations_in_both_schemes(page)
    page.keyboard.press("a")
    expect(page.locator("#degree-question")).to_have_text("You chose A. How much better is it?")
    expect(page.locator("#degree-question")).to_be_focused()
    assert not violations_in_both_schemes(page)
    page.keyboard.press("b")  # on second thoughts
    expect(page.locator("#degree-question")).to_have_text("You chose B. How much better is it?")
    page.keyboard.press("1")
    expect(page.locator(".step-body[data-key$='.02']")).to_have_count(1)
    begin(page)
    watch(page, "A")
    watch(page, "B")
    expect(page.locator("#question")).to_be_focused()
    page.keyboard.press("0")
    expect(page.locator(".step-body[data-kind=trial]")).to_have_count(0)
    values = [row.value for row in studies.rows(Response) if row.kind == "preference"]
    assert values == [
        {"choice": "b", "degree": "slight", "degree_of": "strength", "possible": 5},
        {"degree": "no_difference", "possible": 5},
    ]


def choose_a_while_b_plays(studies: Studies, page: Page, asked: str) -> str:
    """In the first pair. asked: lines of its block; returns the playback of B."""
    to_the_first_pair(page, studies.link((VIEWING, asked)))
    begin(page)
    watch(page, "A")
    expect(page.locator("#playing-letter")).to_have_text("B")
    playback = trial_of(page)["playback_id"]
    room_says(page, "playing", playback_id=playback)
    page.keyboard.press("a")
    return playback


def test_who_chose_early_and_does_not_say_how_clearly_in_time_goes_on(studies: Studies, page: Page) -> None:
    asked = "viewing: {early_choice: true, choice_limit_s: 3}\n      answers: {degree: strength}"
    choose_a_while_b_plays(studies, page, asked)
    expect(page.locator("#degree-question")).to_be_visible()
    watch(page, "B")
    expect(page.locator(".step-body[data-kind=trial]")).to_have_count(0, timeout=10_000)
    assert [row.value for row in studies.rows(Response) if row.kind == "preference"] == [{"timed_out": True}]


def test_a_choice_that_was_interrupted_is_not_marked_any_more(studies: Studies, page: Page) -> None:
    asked = "viewing: {early_choice: true}\n      answers: {degree: strength}"
    playback = choose_a_while_b_plays(studies, page, asked)
    expect(page.locator(".pick[data-chosen]")).to_have_count(1)
    room_says(page, "interrupted", playback_id=playback, reason="focus")
    expect(page.locator(".pick[data-chosen]")).to_have_count(0)


def test_several_drives_are_watched_in_turn_and_put_in_order_by_their_numbers(studies: Studies, page: Page) -> None:
    before = "  - order: {view: top_down, count: 1, of: 3}\n  - block:\n"
    to_the_first_pair(page, studies.link(("  - block:\n", before)), "order")
    begin(page)
    for number in ("1", "2", "3"):
        expect(page.locator("#playing-number")).to_have_text(number)
        expect(page.locator("#trial")).to_have_attribute("data-shown", "playing")
        page.keyboard.press("1")  # too early: nothing is to be said yet
        room_says(page, "moved", poses=[[0, 0, 0]], clocks=[3], over=True)
    expect(page.locator("#question")).to_be_focused()
    assert not violations_in_both_schemes(page)
    page.keyboard.press("2")
    page.keyboard.press("3")
    page.keyboard.press("Backspace")
    page.keyboard.press("1")
    expect(page.locator("#live")).to_have_text("Drive 1: place 2")
    page.locator("[data-go-on]").press("Enter")
    expect(page.locator("#live")).to_have_text("Still open: 1.")
    page.locator("[data-play='3']").press("Enter")
    expect(page.locator("#playing-number")).to_have_text("3")
    page.keyboard.press("Backspace")  # what was said stands while something plays
    room_says(page, "moved", poses=[[0, 0, 0]], clocks=[3], over=True)
    page.keyboard.press("3")
    expect(page.locator("#live")).to_have_text("Drive 3: place 3 All is said: press Continue.")
    page.locator("[data-go-on]").press("Enter")
    expect(page.locator(".step-body[data-kind=order]")).to_have_count(0)
    assert [row.value for row in studies.rows(Response) if row.kind == "order"] == [
        {"order": [2, 1, 3], "ask": "order"}
    ]


def watch_a_drive_to_be_marked(studies: Studies, page: Page) -> str:
    """Until it plays; its playback."""
    before = "  - mark: {view: top_down, count: 1, good: true}\n  - block:\n"
    to_the_first_pair(page, studies.link(("  - block:\n", before)), "mark")
    begin(page)
    expect(page.locator("#trial")).to_have_attribute("data-shown", "marking")
    playback = trial_of(page)["playback_id"]
    room_says(page, "playing", playback_id=playback)
    return str(playback)


def test_moments_are_marked_by_keys_while_a_drive_plays_and_named_removed_and_kept_over_a_reload(
    studies: Studies, page: Page
) -> None:
    playback = watch_a_drive_to_be_marked(studies, page)
    expect(page.locator("[data-mark=bad]")).to_have_attribute("aria-disabled", "false")
    expect(page.locator("[data-mark=bad]")).to_be_focused()
    for key, count in (("Space", "1 mark"), ("2", "2 marks"), ("1", "3 marks")):
        page.wait_for_timeout(500)
        page.keyboard.press(key)
        expect(page.locator("#mark-count")).to_have_text(count)
    room_says(page, "played", playback_id=playback)
    expect(page.locator("#question")).to_be_focused()
    assert not violations_in_both_schemes(page)
    expect(page.locator("[data-held]")).to_have_count(3)
    page.keyboard.press("1")
    expect(page.locator("[data-held='2']")).to_have_attribute(
        "aria-pressed", "true"
    )  # the next one of which nothing is said
    page.locator("[data-remove]").press("Enter")
    expect(page.locator("[data-held]")).to_have_count(2)
    page.keyboard.press("7")  # what is good stays good
    expect(page.locator("[data-held='1'] b")).to_have_text("✓")
    page.keyboard.press("3")
    page.keyboard.press("3")  # taken back
    expect(page.locator("[data-held='1'] b")).to_have_text("✓")
    page.reload()
    expect(page.locator("[data-held]")).to_have_count(2)
    page.locator("[data-go-on]").press("Enter")
    expect(page.locator(".step-body[data-kind=mark]")).to_have_count(0)
    (said,) = [row.value["marks"] for row in studies.rows(Response) if row.kind == "mark"]
    assert [mark["why"] for mark in said] == ["too_close", "good"]
    assert 0 < said[0]["at_s"] <= said[1]["at_s"]


def test_a_drive_whose_marks_are_not_known_here_starts_over_and_marks_count_from_early_news(
    studies: Studies, page: Page
) -> None:
    playback = watch_a_drive_to_be_marked(studies, page)
    page.keyboard.press("1")
    expect(page.locator("#mark-count")).to_have_text("1 mark")
    room_says(page, "played", playback_id=playback)
    expect(page.locator("#question")).to_be_focused()
    page.evaluate("sessionStorage.clear()")  # as in another browser
    page.reload()
    expect(page.locator("#trial")).to_have_attribute("data-shown", "ready")
    asked: list[Route] = []
    page.route("**/start", lambda route: asked.append(route))
    with page.expect_request("**/start"):
        begin(page)
    answer = asked[0].fetch()
    playback = answer.json()["step"]["trial"]["playback_id"]
    room_says(page, "playing", playback_id=playback)  # faster than the answer
    asked[0].fulfill(response=answer)
    expect(page.locator("#trial")).to_have_attribute("data-shown", "marking")
    expect(page.locator("[data-mark=bad]")).to_have_attribute("aria-disabled", "false")
    page.keyboard.press("2")
    expect(page.locator("#mark-count")).to_have_text("1 mark")
    room_says(page, "played", playback_id=playback)
    expect(page.locator("#question")).to_be_focused()
    page.locator("[data-go-on]").press("Enter")
    expect(page.locator(".step-body[data-kind=mark]")).to_have_count(0)
    said = [row.value["marks"] for row in studies.rows(Response) if row.kind == "mark"]
    assert [[mark["why"] for mark in marks] for marks in said] == [["good"]]

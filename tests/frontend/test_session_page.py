"""The page of a running session in a real browser against the real server: trials, faults, leaving.

The 3D room is stood in for by an empty frame whose messages the tests send themselves: the room is the concern of
tests/app, both together of tests/journeys. Sessions are simulated ones, so that no test has to wait for drives.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from desirepath.cli.loopback import free_port_pair
from desirepath.settings import Settings
from desirepath.store.models import Event, ProblemReport, Response, Session
from desirepath.study.protocol.freezing import freeze
from desirepath.study.session.finding import token_hash
from desirepath.study.studies import create_study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests.frontend.empty_room import empty_rooms, room_says
from tests.running import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page, Route

PROTOCOL = Path(__file__).resolve().parents[2] / "study_protocols" / "quick_preference_study.yaml"
DEMOGRAPHICS = {"gender": "woman", "vision": "normal", "vr_experience": 1, "robotics_experience": 3}
VALUES: dict[str, dict[str, Any]] = {"consent": {"given": True}, "questionnaire": DEMOGRAPHICS}


@dataclass(frozen=True)
class Running:
    """A server with one study."""

    services: Services
    url: str
    recruiting_token: str


def _broken() -> None:
    raise RuntimeError("secret detail")


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    port = free_port_pair()
    services = build_services(Settings(data=tmp_path_factory.mktemp("data"), port=port, worker=False, _env_file=None))
    with services.database.transaction() as s:
        token = create_study(s, services.files, freeze(PROTOCOL), name="Test", created_by=None).recruiting_token
    application = create_application(services)
    application.add_api_route("/broken", _broken)
    with served(application, port=port) as address:
        yield Running(services, address, token)


class Visit:
    """One participant at the first pair, in a browser of their own."""

    def __init__(self, running: Running, context: BrowserContext) -> None:
        self.running, self.context = running, context
        self.http = httpx.Client(base_url=running.url)
        joined = self.http.post(f"/join/{running.recruiting_token}", json={"language": "en", "simulated": True})
        self.token = joined.json()["token"]
        while self.step["kind"] != "trial":
            value = VALUES.get(self.step["kind"], {})
            body = {"request_id": f"setup-{self.token[:12]}-{self.step['key']}", "value": value}
            self.http.post(f"/api/session/{self.token}/steps/{self.step['key']}", json=body).raise_for_status()
        empty_rooms(context)
        self.page = self.open()

    @property
    def step(self) -> dict[str, Any]:
        found: dict[str, Any] = self.http.get(f"/api/session/{self.token}").json()["step"]
        return found

    def open(self) -> Page:
        """The session's page in a new window, with its room standing."""
        page = self.context.new_page()
        page.goto(f"{self.running.url}/p/{self.token}")
        self.room_says("ready", page=page)
        expect(page.locator("#start")).to_have_attribute("aria-disabled", "false")
        return page

    def room_says(self, kind: str, *, page: Page | None = None, **more: str | bool | None) -> None:
        """A message of the stage; the page has heard it when this returns."""
        room_says(page or self.page, kind, **more)

    def watch(self, letter: str) -> None:
        """The drive that plays is played to its end."""
        expect(self.page.locator("#playing-letter")).to_be_visible()  # hidden, it may still have the letter of before
        expect(self.page.locator("#playing-letter")).to_have_text(letter)
        self.room_says("playing", playback_id=self.step["trial"]["playback_id"])
        self.room_says("played", playback_id=self.step["trial"]["playback_id"])

    def watch_both(self) -> None:
        self.page.keyboard.press("Enter")
        self.watch("A")
        self.watch("B")
        expect(self.page.locator("#question")).to_be_focused()

    def answers(self, key: str) -> list[dict[str, Any]]:
        with self.running.services.database.session() as s:
            session = s.scalars(select(Session).where(Session.token_hash == token_hash(self.token))).one()
            rows = s.scalars(select(Response).where(Response.session_id == session.id, Response.step_key == key))
            return [row.value for row in rows]

    def events(self, kind: str) -> list[dict[str, Any]]:
        with self.running.services.database.session() as s:
            session = s.scalars(select(Session).where(Session.token_hash == token_hash(self.token))).one()
            return [e.data for e in s.scalars(select(Event).where(Event.session_id == session.id, Event.kind == kind))]


@pytest.fixture
def visit(running: Running, chromium: Browser) -> Iterator[Visit]:
    context = chromium.new_context(viewport={"width": 1024, "height": 640}, reduced_motion="reduce")
    yield Visit(running, context)
    context.close()


def test_while_the_database_is_busy_the_page_says_so_and_the_answer_counts_once(
    visit: Visit, monkeypatch: pytest.MonkeyPatch
) -> None:
    visit.watch_both()
    key = visit.step["key"]
    monkeypatch.setattr("desirepath.store.database.TURN_PATIENCE_S", 0.1)
    with visit.running.services.database.transaction():  # somebody else keeps writing
        visit.page.keyboard.press("a")
        expect(visit.page.locator("#banner")).to_contain_text("We are trying again")
        assert visit.answers(key) == []
    expect(visit.page.locator("#banner")).to_be_hidden(timeout=15_000)
    expect(visit.page.locator(f".step-body[data-key='{key}']")).to_have_count(0)
    assert visit.answers(key) == [{"choice": "a"}]


TWO_THAT_WAIT = """async () => {
  const [told, gone, tried] = [[], [], {}];
  window.fetch = async (url) => {
    tried[url] = (tried[url] ?? 0) + 1;
    if (tried[url] > (url === "/short" ? 1 : 2)) return new Response("{}", { status: 200 });
    throw new TypeError("no connection");
  };
  const page = document.querySelector("script[src*='session']").src;
  const send = await import(`${page.replace("session.js", "send.js")}#alone`);
  send.watchConnection((waiting) => told.push(waiting));
  await Promise.all(["/short", "/long"].map((url) => send.ask(url).then(() => gone.push(`${url}: ${told.at(-1)}`))));
  return gone;
}"""


def test_the_notice_stays_while_another_request_still_waits(visit: Visit) -> None:
    assert visit.page.evaluate(TWO_THAT_WAIT) == ["/short: connection", "/long: null"]


def test_a_pair_is_watched_and_answered_by_keyboard_alone(visit: Visit) -> None:
    page, key = visit.page, visit.step["key"]
    expect(page.locator("#start")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#live")).to_have_text("Watch drive A")
    assert page.evaluate("document.activeElement.dataset.phase") == "playing", "the focus stays where Start was"
    page.keyboard.press("b")
    expect(page.locator("#live")).to_have_text("You can choose as soon as you have watched both drives to the end.")
    visit.watch("A")
    visit.watch("B")
    expect(page.locator("#question")).to_be_focused()
    page.keyboard.press("b")
    expect(page.locator(".step-body")).not_to_have_attribute("data-key", key)
    expect(page.locator("#start")).to_be_focused()
    assert visit.answers(key) == [{"choice": "b"}]
    assert visit.step["trial"]["phase"] == "ready"
    expect(page.locator("#progress-text")).to_have_text(re.compile("Pair 1 of (3|15) about [0-9]+ minutes left"))


def test_keys_count_while_the_room_has_the_focus(visit: Visit) -> None:
    key = visit.step["key"]
    visit.watch_both()
    visit.room_says("key", key="a")
    expect(visit.page.locator(".step-body")).not_to_have_attribute("data-key", key)
    assert visit.answers(key) == [{"choice": "a"}]


def test_an_answer_is_kept_while_the_connection_is_lost_and_counts_once(visit: Visit) -> None:
    page, key = visit.page, visit.step["key"]
    visit.watch_both()
    sent: list[str] = []

    def fail_twice(route: Route) -> None:
        sent.append(route.request.post_data_json["request_id"])
        if len(sent) <= 2:
            route.abort("internetdisconnected")
        else:
            route.continue_()

    page.route("**/steps/*", fail_twice)
    page.locator("[data-choice=a]").dblclick()
    expect(page.get_by_text("Your answer is kept and sent as soon as the connection is back.")).to_be_visible()
    assert page.locator("[data-choice=b]").get_attribute("aria-disabled") == "true"
    expect(page.locator(".step-body")).not_to_have_attribute("data-key", key)
    expect(page.locator("#banner")).to_be_hidden()
    assert len(sent) == 3
    assert len(set(sent)) == 1
    assert visit.answers(key) == [{"choice": "a"}]


def test_an_acknowledgement_that_gets_lost_is_asked_for_again(visit: Visit) -> None:
    page, key = visit.page, visit.step["key"]
    visit.watch_both()
    lost: list[int] = []

    def lose_the_first_reply(route: Route) -> None:
        if not lost:
            lost.append(route.fetch().status)
            route.abort("connectionreset")
        else:
            route.continue_()

    page.route("**/steps/*", lose_the_first_reply)
    with page.expect_response("**/steps/*"):  # of the second try: the first one gets none
        page.keyboard.press("a")
    expect(page.locator(".step-body")).not_to_have_attribute("data-key", key)
    assert lost == [200]
    assert visit.answers(key) == [{"choice": "a"}]
    assert len(visit.events("duplicate_request")) == 1


def test_an_answer_on_its_way_survives_a_reload(visit: Visit) -> None:
    page, key = visit.page, visit.step["key"]
    visit.watch_both()
    page.route("**/steps/*", lambda route: route.abort("internetdisconnected"))
    page.keyboard.press("b")
    expect(page.locator("#banner")).to_be_visible()
    page.unroute("**/steps/*")
    page.reload()
    expect(page.locator(".step-body")).not_to_have_attribute("data-key", key)
    assert visit.answers(key) == [{"choice": "b"}]
    assert page.evaluate("sessionStorage.length") == 0


def test_a_hidden_window_restarts_the_drive_that_played(visit: Visit) -> None:
    page = visit.page
    page.keyboard.press("Enter")
    visit.watch("A")
    expect(page.locator("#playing-letter")).to_have_text("B")
    page.evaluate(
        "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
        "document.dispatchEvent(new Event('visibilitychange')); delete document.hidden"
    )
    expect(page.locator("#start-hint")).to_contain_text("drive B starts over")
    assert visit.step["trial"] | {"phase": "ready", "next_side": "b", "restarts": 1} == visit.step["trial"]


def test_a_dialog_over_the_drive_restarts_it(visit: Visit) -> None:
    visit.page.keyboard.press("Enter")
    expect(visit.page.locator("#playing-letter")).to_have_text("A")
    visit.page.get_by_role("button", name="Help").click()
    expect(visit.page.locator("#help-dialog")).to_be_visible()
    visit.page.keyboard.press("Escape")
    expect(visit.page.locator("#start-hint")).to_contain_text("this pair starts over")


def test_a_lost_stage_is_greyed_and_the_pair_starts_over(visit: Visit) -> None:
    page = visit.page
    page.keyboard.press("Enter")
    expect(page.locator("#playing-letter")).to_have_text("A")
    visit.room_says("connection-lost")
    expect(page.get_by_text("Reconnecting, your answers are safe").last).to_be_visible()
    expect(page.locator("#start")).to_have_attribute("aria-disabled", "true")
    visit.room_says("connected")
    visit.room_says("ready")
    expect(page.locator("#stage-cover")).to_be_hidden()
    expect(page.locator("#start")).to_have_attribute("aria-disabled", "false")
    assert visit.events("trial_interrupted")[0]["reason"] == "connection"


def test_who_presses_start_before_the_room_stands_is_started_as_soon_as_it_does(visit: Visit) -> None:
    page = visit.page
    page.keyboard.press("Enter")
    expect(page.locator("#playing-letter")).to_have_text("A")
    visit.room_says("connection-lost")
    expect(page.locator("#start")).to_have_attribute("aria-disabled", "true")
    page.locator("#start").dispatch_event("click")
    visit.room_says("connected")
    visit.room_says("ready")
    expect(page.locator("[data-phase=playing]")).to_be_visible()


def test_nobody_waits_for_a_room_that_does_not_begin(running: Running, chromium: Browser) -> None:
    """The order to play was lost on its way: the picture is loaded anew, and the pair starts over."""
    context = chromium.new_context(viewport={"width": 1024, "height": 640}, reduced_motion="reduce")
    context.clock.install()
    visit = Visit(running, context)
    visit.page.keyboard.press("Enter")
    expect(visit.page.locator("#playing-letter")).to_have_text("A")
    with visit.page.expect_event("framenavigated"):  # what the room that goes said last would not be heard
        for _ in range(2):
            visit.page.clock.fast_forward(15_500)
            visit.room_says("state", ready=True, playback_id=None)
    expect(visit.page.locator("#playing-letter")).to_be_hidden()
    assert [event["reason"] for event in visit.events("trial_interrupted")] == ["connection"]
    assert visit.step["trial"]["phase"] == "ready"
    visit.room_says("ready")
    visit.watch_both()
    visit.page.clock.fast_forward(15_500)  # what has begun is waited for, however long it takes
    assert visit.step["trial"]["phase"] == "choosing"
    context.close()


def test_messages_that_do_not_come_from_the_room_are_not_listened_to(visit: Visit) -> None:
    page = visit.page
    page.keyboard.press("Enter")
    expect(page.locator("#playing-letter")).to_have_text("A")
    playback = visit.step["trial"]["playback_id"]
    page.evaluate(
        "id => postMessage({source: 'desirepath-stage', type: 'played', playback_id: id}, location.origin)", playback
    )
    with page.expect_response("**/api/session/*"):  # the page asks the server, and sees that nothing has ended
        visit.room_says("played", playback_id="of another pair")
    assert visit.step["trial"]["phase"] == "playing_a"


def test_the_newest_window_wins_and_the_older_one_can_take_over(visit: Visit) -> None:
    old, new = visit.page, visit.open()
    expect(old.get_by_role("heading", name="This study is open in another window")).to_be_visible()
    assert old.locator("iframe").count() == 0
    old.get_by_role("button", name="Go on in this window").click()
    expect(new.get_by_role("heading", name="This study is open in another window")).to_be_visible()
    expect(old.locator("#trial")).to_be_visible()


def test_pausing_gives_the_link_and_going_on_comes_back(visit: Visit) -> None:
    page, key = visit.page, visit.step["key"]
    page.keyboard.press("Enter")
    expect(page.locator("#playing-letter")).to_have_text("A")
    page.locator("#topbar").get_by_role("button", name="Pause").click()
    expect(page.get_by_role("heading", name="You are taking a break")).to_be_visible()
    expect(page.locator("#own-link")).to_have_text(f"{visit.running.url}/p/{visit.token}")
    page.get_by_role("button", name="Continue the study").click()
    expect(page.locator(".step-body")).to_have_attribute("data-key", key)
    assert visit.step["trial"]["phase"] == "ready"


def test_withdrawing_says_what_happens_and_then_ends(visit: Visit) -> None:
    page = visit.page
    page.get_by_role("button", name="Leave the study").click()
    page.get_by_role("button", name="Withdraw …").click()
    expect(page.get_by_text("What cannot be taken back")).to_be_visible()
    page.get_by_role("button", name="Yes, withdraw").click()
    expect(page.get_by_role("heading", name="You have left the study")).to_be_visible()
    page.reload()
    expect(page.get_by_role("heading", name="You have left the study")).to_be_visible()
    assert len(visit.events("withdrawn")) == 1


def test_a_problem_report_arrives(visit: Visit) -> None:
    page = visit.page
    page.get_by_role("button", name="Help").click()
    page.get_by_label("Something is not right?").fill("The picture is dark.")
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_text("Thank you, your message has arrived.")).to_be_visible()
    with visit.running.services.database.session() as s:
        assert "The picture is dark." in [report.text for report in s.scalars(select(ProblemReport))]


def test_a_whole_form_step_is_answered_and_the_next_one_gets_the_focus(running: Running, chromium: Browser) -> None:
    context = chromium.new_context(viewport={"width": 1024, "height": 640}, locale="de-DE", reduced_motion="reduce")
    page = context.new_page()
    page.goto(f"{running.url}/join/{running.recruiting_token}")
    page.get_by_role("button", name="Weiter").click()
    expect(page.locator("#progress-text")).to_have_text("Noch etwa 15 Minuten")
    page.get_by_role("button", name="Weiter").click()
    expect(page.locator("h1")).to_be_focused()
    for point in page.get_by_role("checkbox").all():
        point.check()
    page.get_by_role("button", name="Ich stimme zu und nehme teil").click()
    expect(page.locator(".step-body")).to_have_attribute("data-kind", "questionnaire")
    page.get_by_role("button", name="Hilfe").click()
    with context.expect_page() as opened:
        page.get_by_role("link", name="Ihre Kopie der Einwilligung").click()
    expect(opened.value.get_by_text("Eingewilligt am")).to_be_visible()
    expect(opened.value.locator("time")).to_be_visible()
    context.close()


def test_links_that_do_not_count_say_what_to_do(running: Running, chromium: Browser) -> None:
    page = chromium.new_page()
    page.goto(f"{running.url}/p/forged")
    expect(page.get_by_role("heading", name="This link does not lead anywhere")).to_be_visible()
    page.goto(f"{running.url}/join/forged")
    expect(page.get_by_role("heading", name="This link does not lead anywhere")).to_be_visible()
    page.close()


def test_trouble_is_a_page_for_people_and_json_for_scripts(running: Running) -> None:
    german = {"Accept-Language": "de"}
    nowhere = httpx.get(f"{running.url}/nowhere", headers=german)
    assert nowhere.status_code == 404
    assert "Hier ist nichts" in nowhere.text
    broken = httpx.get(f"{running.url}/broken", headers=german)
    assert broken.status_code == 500
    assert "Was Sie bisher geantwortet haben, ist sicher." in broken.text
    assert "secret detail" not in broken.text
    assert httpx.get(f"{running.url}/api/nowhere").json()["error"]["code"] == "not_found"

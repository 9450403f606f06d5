"""The session client of a simulated participant who uses the pages: a real Chromium, buttons that are pressed,
trajectories that are watched.

What is answered is the bot's (`participant.py`); this presses it. Trajectories play at their own speed, so a session
takes its time. Playwright and Chromium belong to the tests' equipment and are asked for only here.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx

from desirepath.grammar.words import PLAYING
from desirepath.study.simulated.http import HttpSessionClient
from desirepath.study.simulated.participant import Character, SaidMark, SimulationError, State, walk_all
from desirepath_experiments.browser.hand import BrowserHand

if TYPE_CHECKING:
    from playwright.sync_api import Browser, FloatRect, Locator, Page

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # 3D without a graphics card
WINDOW = {"width": 1024, "height": 640}  # the smallest that everything has to fit into, UI.md
PATIENCE_MS = 120_000.0  # software pictures on a busy machine take their time
LOOK_S = 0.2
WATCHED_FIRST_S = 1.5  # into a trajectory, when its picture is taken


def installed_browser() -> str | None:
    """Path of Chromium's shell, whose pages are the same for a quarter of the work, or else of Chromium."""
    return shutil.which("chromium-headless-shell") or shutil.which("chromium")


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser with 3D pictures. Raises SimulationError saying what is missing."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise SimulationError("--browser needs playwright, which belongs to the test requirements") from None
    executable = installed_browser()
    if executable is None:
        raise SimulationError("--browser needs Chromium; scripts/setup_chromium.sh installs it")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


def walk_with_browser(
    base_url: str,
    recruiting_token: str,
    participants: int,
    in_browser: int,
    character: Character,
    language: str = "en",
    pictures: Path | None = None,
    tell: Callable[[str], None] = lambda words: None,
) -> dict[str, Any]:
    """As `http.simulate_study`, the first `in_browser` participants in a browser and the others over HTTP alone. A
    session takes minutes, so `tell` gets a line after every step."""
    with httpx.Client(base_url=base_url, timeout=60.0) as client, chromium() as browser:
        seeing = (
            BrowserSessionClient(
                browser, client, recruiting_token, language=language, pictures=None if number else pictures
            )
            for number in range(in_browser)
        )
        others = (HttpSessionClient(client, recruiting_token) for _ in range(participants - in_browser))
        return walk_all(chain(seeing, others), character, tell)


CHOSEN = ("trial", "comparison", "method_comparison")  # kinds of step at which A or B is chosen


def _within(spot: FloatRect, window: FloatRect) -> bool:
    """Whether the middle of a box lies in the window."""
    x, y = spot["x"] + spot["width"] / 2, spot["y"] + spot["height"] / 2
    return 0 <= x - window["x"] <= window["width"] and 0 <= y - window["y"] <= window["height"]


class BrowserSessionClient:
    """One participant in a window of their own. pictures: a folder for one picture of every kind of page and view."""

    def __init__(
        self,
        browser: Browser,
        client: httpx.Client,
        recruiting_token: str,
        *,
        language: str = "en",
        pictures: Path | None = None,
    ) -> None:
        self._http = HttpSessionClient(client, recruiting_token, language)
        self._url, self._link = str(client.base_url).rstrip("/"), recruiting_token
        self._language, self._pictures = language, pictures
        self._seen: set[str] = set()
        context = browser.new_context(viewport=WINDOW, locale=language)  # type: ignore[arg-type]  # a plain dict does
        context.set_default_timeout(PATIENCE_MS)
        self._page: Page = context.new_page()

    def join(self, oracle: Mapping[str, Any]) -> str:
        """The welcome page and its device check, then in by the API, which alone takes simulated participants.

        Software pictures on a busy machine may be too slow for the study's gate, which lets bots pass all the same.
        """
        self._page.goto(f"{self._url}/join/{self._link}?lang={self._language}")
        self._page.locator("[data-check=rate]:not([data-result=open])").wait_for()
        self._picture("join")
        code = self._http.join(oracle)
        self._page.goto(f"{self._url}/p/{self._http.token}")
        return code

    def come_back(self) -> State:
        """By the link that the page shows, in the same window."""
        state = self._http.come_back()
        self._page.goto(f"{self._url}/p/{self._http.token}")
        return state

    def state(self) -> State:
        state = self._http.state()
        if state["state"] != "active":
            self._page.locator("[data-kind=debriefing], [data-kind=screened_out], [data-kind=appointment]").wait_for()
            self._picture("end")
        return state

    def start(self, key: str) -> State:
        self._step(key)
        start = self._page.locator("#start[aria-disabled=false]")
        start.wait_for()
        self._picture(f"ready_{self._view()}")
        start.click()
        return self._until(lambda trial: trial["phase"] in PLAYING, f"{key}: the trajectory to play")

    def report_seen(
        self, key: str, side: str, playback_id: str, *, worn: bool = False, marks: Sequence[SaidMark] = ()
    ) -> State:
        """Wait while the page plays the trajectory and tells the server itself."""
        phase = f"playing_{side}"
        if marks:
            self._mark(marks)
        if side == "a":
            self._page.wait_for_timeout(1000 * (self._http.state()["step"]["trial"]["label_s"] + WATCHED_FIRST_S))
            self._picture(f"playing_{self._view()}")
        state = self._until(lambda trial: trial["phase"] != phase, f"{key}: trajectory {side.upper()} to end")
        if state["step"]["trial"]["phase"] == "ready":
            raise SimulationError(f"{key}: trajectory {side.upper()} was interrupted in the browser")
        return state

    def trajectories(self) -> Any:
        return self._http.trajectories()

    def draw(self, key: str, stroke: Mapping[str, Any]) -> State:
        """Draw it with the mouse in the step's own view, at the mean of its speeds."""
        self._step(key)
        self._page.locator("#drawing[data-shown=drawing]").wait_for()
        tried = self._http.state()["step"]["trial"]["attempts"]
        hand = BrowserHand(self._page)
        hand.ready()
        self._picture(f"drawing_{self._view()}")
        again = self._page.locator("[data-do=clear][aria-disabled=false]")
        if tried and again.count():
            again.click()
        if self._page.locator("[data-walk]").count():
            self._page.locator(f"[data-walk='{stroke['walk']}']").click()
        hand.speed(sum(stroke["speeds"]) / len(stroke["speeds"]))
        hand.draw(stroke["points"])
        self._picture(f"drawn_{self._view()}")
        state = self._until(lambda trial: trial["attempts"] > tried, f"{key}: the path to arrive")
        refused = state["step"]["trial"]["phase"] == "drawing"
        return {**state, "problem": self._page.locator("#draw-hint").inner_text() if refused else None}

    def report_walk(self, key: str, playback_id: str, walk: Mapping[str, Any]) -> State:
        """Follow the walk with the keys, as well as they let, until the rollout is over."""
        self._page.locator("#drawing[data-shown=walking]").wait_for()
        BrowserHand(self._page).walk(walk, lambda: self._picture("walking"))
        state = self._until(lambda trial: not trial["walking"], f"{key}: the rollout to end")
        refused = state["step"]["trial"]["phase"] == "drawing"
        return {**state, "problem": self._page.locator("#draw-hint").inner_text() if refused else None}

    def submit(self, key: str, value: Mapping[str, Any]) -> State:
        body = self._step(key)
        kind = str(body.get_attribute("data-kind"))
        self._picture(f"choosing_{self._view()}" if kind in CHOSEN else kind + self._part(key))
        if kind in CHOSEN:
            self._page.locator(f"[data-choice={value.get('choice', 'none')}][aria-disabled=false]").click()
            if value.get("degree") in ("slight", "clear"):
                self._page.locator(f"[data-degree={value['degree']}]").click()
        elif kind == "demonstration":
            self._page.locator("[data-skip]" if value.get("skipped") else "[data-keep]").click()
        elif kind == "evaluation":
            self._page.locator("[data-go-on]").click()
        elif kind == "meet_your_robot":
            self._meet(value)
            self._page.locator("[data-done][aria-disabled=false]").click()
        elif kind == "feedback":
            self._page.locator("[data-done][aria-disabled=false]").wait_for()
            self._page.locator("[data-drive]:not([data-driving])").wait_for()
            self._picture(f"{kind}_seen")
            self._page.locator("[data-done][aria-disabled=false]").click()
        elif kind == "tuning":
            self._tune(value["weights"])
            self._picture(f"{kind}_{self._view()}")
            self._page.locator("[data-done][aria-disabled=false]").click()
        elif kind == "words":
            self._say(value)
            self._picture(f"{kind}_corrected")
            self._page.locator("[data-done][aria-disabled=false]").click()
        elif kind == "rules":
            self._tell_rules(value)
            self._page.locator("[data-done][aria-disabled=false]").click()
        elif kind == "importance_ranking":
            self._rank(key, value["ranking"])
        elif kind == "order":
            self._order(key, value)
        elif kind == "mark":
            self._say_marks(value)
        else:
            self._fill(kind, value)
            self._press_on(key, value)
        self._page.locator(f".step-body[data-key='{key}']").wait_for(state="detached")
        return {"duplicate": False, **self.state()}

    def _meet(self, value: Mapping[str, Any]) -> None:
        """Let both robots drive to their ends, say whether that is them, and correct it where the bot does."""
        page = self._page
        page.locator("[data-drive][aria-disabled=false]").click()
        page.locator("[data-drive][data-driving]").wait_for()
        self._picture("meet_driving")
        page.locator("[data-drive]:not([data-driving])").wait_for()
        page.locator(f"label:has([data-agreement][value='{value['agreement']}'])").click()
        if value["history"]:
            page.locator("[data-correct]").click()
            self._tune(value["weights"])
        self._picture("meet_corrected" if value["history"] else "meet_kept")

    def _say(self, value: Mapping[str, Any]) -> None:
        """Write the sentence, have it read, answer what is asked back, and correct it by hand."""
        page = self._page
        page.locator("#words-sentence").fill(value["sentence"])
        page.locator("[data-read][aria-disabled=false]").click()
        page.locator("#words-found:not([hidden])").wait_for()
        for number, meaning in enumerate(value["meant"]):
            page.locator(f"[name=meant-{number}][data-meant={meaning['objective'] or 'none'}]").check()
        self._picture("words_read")
        self._tune(value["weights"])

    def _tell_rules(self, value: Mapping[str, Any]) -> None:
        """Write each sentence, have it read, look at two paths and choose one."""
        page = self._page
        page.locator("[data-drive][aria-disabled=false]").wait_for()
        for number, rule in enumerate(value["rules"]):
            page.locator("#rules-sentence").fill(rule["words"])
            page.locator("[data-tell][aria-disabled=false]").click()
            page.locator(f"[data-card='{number}'] .floor-picture").wait_for()
            page.locator(f"[data-does=look-{number}]").click()
            chosen = page.locator(f"[data-does=pick-a-{number}]")
            nothing = page.locator(f"[data-card='{number}'] .rule-pair > p")
            chosen.or_(nothing).first.wait_for()
            if chosen.count():
                chosen.click()
        self._picture("rules_told")

    def _tune(self, weights: Mapping[str, float]) -> None:
        """Put every slider where these weights have it, with the keys, and see the robot's way drawn."""
        self._page.locator("[data-drive][aria-disabled=false]").wait_for()
        for slider in self._page.locator("[data-ends]").all():
            ends = str(slider.get_attribute("data-ends")).split()
            least, step = int(slider.get_attribute("min") or 0), int(slider.get_attribute("step") or 1)
            wanted = sum(weights.get(name, 0) * (-1 if len(ends) > k + 1 else 1) for k, name in enumerate(ends))
            slider.press("Home")
            for _ in range(round((100 * wanted - least) / step)):
                slider.press("ArrowRight")
        self._page.locator("#live-way[data-seconds]").wait_for()

    def _rank(self, key: str, things: list[str]) -> None:
        """Object by object where it stands in the room; by its name where nothing of it can be clicked there."""
        from playwright.sync_api import TimeoutError as NothingThere

        name = self._page.locator("[data-thing]").first
        name.wait_for()
        room = self._page.frame_locator("#stage-frame iframe")
        for place, thing in enumerate(things, 1):
            listed = self._page.locator(f"[data-thing='{thing}']")
            tag = room.locator(f".desire-path-tag[data-thing='{thing}']")
            spot = tag.bounding_box()
            window = self._page.locator("#stage").bounding_box()
            if spot and window and _within(spot, window):
                self._page.mouse.click(spot["x"] + spot["width"] / 2, spot["y"] + spot["height"] / 2)
                with contextlib.suppress(NothingThere):
                    listed.and_(self._page.locator("[aria-pressed=true]")).wait_for(timeout=3000)
            if listed.get_attribute("aria-pressed") != "true":
                listed.click()
            if place == len(things):
                self._picture(f"ranked_{self._view()}{self._part(key)}")
        self._page.locator("[data-go-on][aria-disabled=false]").click()

    def _order(self, key: str, value: Mapping[str, Any]) -> None:
        """Watch all, then press their numbers, or numbers and piles."""
        self._page.locator("#start[aria-disabled=false]").click()
        self._page.locator("#trial[data-shown=playing]").wait_for()
        self._page.wait_for_timeout(1000 * WATCHED_FIRST_S)
        self._picture(f"order_playing_{key}")
        self._page.locator("#trial[data-shown=choosing]").wait_for()
        for number in value.get("order", ()):
            self._page.locator(f"[data-drive='{number}']").click()
        for pile, numbers in enumerate(value.get("groups", ())):
            for number in numbers:
                self._page.locator(f"[data-drive='{number}']").click()
                self._page.locator(f"[data-pile='{pile}']").click()
        self._picture(f"ordered_{key}")
        self._page.locator("[data-go-on][aria-disabled=false]").click()

    def _mark(self, marks: Sequence[SaidMark]) -> None:
        """Press the button at those times."""
        self._page.locator("[data-mark=bad][aria-disabled=false]").wait_for()
        began = time.monotonic()
        for mark in marks:
            self._page.wait_for_timeout(max(0.0, 1000 * (mark["at_s"] - time.monotonic() + began)))
            self._page.locator(f"[data-mark={'good' if mark['why'] == 'good' else 'bad'}]").click()

    def _say_marks(self, value: Mapping[str, Any]) -> None:
        """What each was, where something is said of it."""
        self._page.locator("#trial[data-shown=choosing]").wait_for()
        for number, mark in enumerate(value["marks"]):
            if mark["why"] not in (None, "good"):
                self._page.locator(f"[data-held='{number}']").click()
                self._page.locator(f"[data-why={mark['why']}]").click()
        self._picture("marked")
        self._page.locator("[data-go-on]").click()

    def _step(self, key: str) -> Locator:
        body = self._page.locator(f".step-body[data-key='{key}']")
        body.wait_for(state="attached")
        return body

    def _fill(self, kind: str, value: Mapping[str, Any]) -> None:
        """What is ticked on a consent: its points, and what else was agreed to."""
        if kind != "consent":
            return
        for point in self._page.locator("[data-point]").all():
            point.check()
        agreed = value.get("purposes") or {}
        for item in self._page.locator("[data-item]").all():
            name = str(item.get_attribute("data-item"))
            item.locator(f"[value={'yes' if agreed.get(name) else 'no'}]").check()

    def _press_on(self, key: str, value: Mapping[str, Any]) -> None:
        """Answer screen after screen of the step until it is sent."""
        while self._page.locator(f".step-body[data-key='{key}']").count():
            for item in self._page.locator("[data-item]").all():
                if item.is_visible():  # asked after the answers before it
                    self._answer(item, value.get(str(item.get_attribute("data-item"))))
            before = self._screen()
            self._page.locator(".bottombar .main:enabled").click()
            deadline = time.monotonic() + PATIENCE_MS / 1000
            while self._screen() == before:
                if self._page.locator("[data-missing]").count() or time.monotonic() > deadline:
                    self._picture(f"stuck_{key}")
                    raise SimulationError(f"{key}: the page does not take {value!r}")
                self._page.wait_for_timeout(50)

    def _answer(self, item: Locator, answer: Any) -> None:
        if answer is None:
            return
        kind = item.get_attribute("data-type")
        if kind == "ranking":
            for option in answer:
                item.locator(f"[data-pool] [data-value='{option}']").click()
        elif kind in ("scale", "choice"):
            item.locator(f"[value='{answer}']").check()
        else:
            item.locator("input, textarea").fill(str(answer))

    def _screen(self) -> str:
        """Which screen of which step is shown."""
        shown = self._page.evaluate(
            "[document.querySelector('.step-body')?.dataset.key, document.querySelector('#page-count')?.textContent]"
        )
        return str(shown)

    def _until(self, holds: Any, waited_for: str) -> State:
        deadline = time.monotonic() + PATIENCE_MS / 1000
        while time.monotonic() < deadline:
            state = self._http.state()
            if holds(state["step"]["trial"]):
                return state
            self._page.wait_for_timeout(1000 * LOOK_S)  # lets the page's own events through meanwhile
        self._picture("stuck")
        raise SimulationError(f"waited {PATIENCE_MS / 1000:.0f} s for {waited_for}")

    def _view(self) -> str:
        return str(self._http.state()["step"].get("view", "stage"))

    def _part(self, key: str) -> str:
        return "_" + key.rpartition(".")[2]

    def _picture(self, name: str) -> None:
        """One picture per name, numbered in the order in which they were met."""
        if self._pictures is None or name in self._seen:
            return
        self._seen.add(name)
        self._pictures.mkdir(parents=True, exist_ok=True)
        self._page.screenshot(path=self._pictures / f"{len(self._seen):02d}_{name}.png")

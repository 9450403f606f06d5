"""The page's part of a headset: a sentence for everything that stands against it, and how the head moves, sent on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, Route, expect

from desirepath.installed import FRONTEND
from desirepath.web.core.catalogues import Texts

ASK = """async ([asked, wanted, told]) => {
  const { Headset } = await import("/static/js/headset.js");
  const orders = [], banners = [];
  const headset = new Headset(asked, {
    say: (key) => key, tell: (order) => orders.push(order), banner: (text) => banners.push(text), notice: () => {},
    changed: () => {}, headPose: false,
  });
  headset.use(wanted);
  headset.hear({ type: "state" });
  headset.hear({ type: "headset", here: true, on: false, why: null, ...told });
  clearInterval(headset.clock);
  const offered = orders.findLast((one) => one.do === "offer").words;
  const panel = headset.on ? headset.panel().text : null;
  return { missing: headset.missing, offered, banner: banners.at(-1) ?? null, panel };
}"""
PRESS = """async ([presses, phase]) => {
  const { Headset } = await import("/static/js/headset.js");
  const headset = new Headset("offered", {
    say: (key) => key, tell: () => {}, banner: () => {}, notice: () => {}, changed: () => {}, headPose: false,
  });
  for (const part of phase ? document.querySelectorAll("[data-phase]") : []) part.hidden = part.dataset.phase !== phase;
  for (const [id, more] of presses) {
    headset.panel();
    headset.hear({ type: "headset-press", id, ...more });
  }
  const { rows, buttons, beside } = headset.panel();
  return { rows, beside, buttons: buttons.filter((one) => !one.tool) };
}"""
GIVEN = """async (told) => {
  const { Headset } = await import("/static/js/headset.js"), { LivePanel } = await import("/static/js/live.js");
  const headset = new Headset("offered", {
    say: (key) => key, tell: () => {}, banner: () => {}, notice: () => {}, changed: () => {}, headPose: false,
  });
  const given = [];
  const bar = Object.assign(Object.create(LivePanel.prototype), {
    root: document.createElement("div"), over: true, needs: { headset, answer: async (value) => given.push(value) },
  });
  for (const on of [false, true, false]) {
    headset.hear({ type: "headset", here: true, on, why: null });
    if (on) headset.hear({ type: "headset-press", id: "done", headset: told });
    await bar.decide({ weights: {} });
  }
  return given;
}"""
REFUSED = """async (taken) => {
  const { StageBar } = await import("/static/js/stage-bar.js"), { Refused } = await import("/static/js/send.js");
  const sent = [];
  class Bar extends StageBar { get playing() { return this.state.phase === "playing_a"; } }
  const post = async (path, body) => {
    sent.push(path);
    if (path === "seen" && !taken) throw new Refused(409, { code: "headset_required" });
    return { step: { key: "one", trial: { phase: path === "seen" ? "choosing" : "ready", playback_id: null } } };
  };
  const bar = new Bar(document.createElement("div"), { phase: "playing_a", playback_id: "p" }, {
    key: "one", post, refresh: async () => {}, cover: () => {}, headset: { worn: true }, announce: () => {},
  });
  await bar.reportPlayed("p", () => ({ path: "seen", body: {} }));
  bar.leave();
  return [sent, bar.state.phase];
}"""
SEND = """async () => {
  const { HeadPoses } = await import("/static/js/head-pose.js");
  const heads = new HeadPoses("/sent/head", () => window.step);
  const poses = { times_s: [0], poses: [[0, 0, 1.6, 0, 0, 0, 1]] };
  const of = "a1b2c3d4e5f60718";
  const part = (n) => heads.hear({ type: "head", head: { wearing: of, part: n, began_s: n, ...poses } });
  window.step = "block.01";
  part(0);
  part(1);
  window.step = undefined; // a questionnaire
  part(2);
}"""


@pytest.fixture(scope="module")
def page(chromium: Browser, pages: str) -> Iterator[Page]:
    opened = chromium.new_page()
    opened.goto(f"{pages}/step/trial")
    yield opened
    opened.close()


@pytest.mark.parametrize(
    ("asked", "wanted", "told", "missing"),
    [
        ("required", None, {}, "headset.needed"),
        ("required", None, {"on": True}, None),
        *(("required", None, {"why": why}, f"headset.refused.{why}") for why in ("blocked", "insecure", "browser")),
        *(("required", None, {"why": why}, f"headset.refused.{why}") for why in ("missing", "denied", "failed")),
        ("required", None, {"here": False}, None),
        ("offered", None, {}, None),
        ("offered", None, {"why": "blocked"}, None),
        ("required", True, {}, "headset.needed"),
        ("required", False, {}, None),
        ("required", False, {"on": True}, "headset.window"),
    ],
)
def test_what_stands_against_beginning_is_said(
    page: Page, asked: str, wanted: bool | None, told: dict[str, object], missing: str | None
) -> None:
    page.evaluate("document.body.dataset.layout = 'text'")
    found = page.evaluate(ASK, [asked, wanted, told])
    assert found["missing"] == missing
    assert (found["offered"] is None) == (wanted is False), "no button for what is seen in the window"
    if told.get("on"):
        assert found["panel"] == ("headset.window" if wanted is False else "headset.off")
    elif missing:
        assert found["banner"] == missing


@pytest.mark.parametrize(("secure", "told"), [("true", "this browser finds none"), ("false", "(https) only")])
def test_the_first_page_says_what_is_missing(chromium: Browser, pages: str, secure: str, told: str) -> None:
    opened = chromium.new_page()
    opened.add_init_script(
        f"Object.defineProperty(window, 'isSecureContext', {{ value: {secure} }});"
        "Object.defineProperty(navigator, 'xr', { value: undefined });"
    )
    opened.goto(f"{pages}/join?headset=required")
    expect(opened.get_by_role("alert").get_by_text(told)).to_be_visible()
    expect(opened.locator("#begin")).to_be_disabled()
    opened.close()


def test_every_refusal_has_a_sentence_in_both_languages() -> None:
    for language in ("en", "de"):
        words = Texts(FRONTEND / "locales").get(language).table("participant.script")["headset"]
        assert set(words["refused"]) == {"blocked", "insecure", "browser", "missing", "denied", "failed"}
        assert all(
            sentence.endswith(".") for sentence in [*words["refused"].values(), words["needed"], words["window"]]
        )


@pytest.fixture
def pressed(chromium: Browser, pages: str) -> Iterator[Callable[..., dict[str, Any]]]:
    """Press buttons in the room on a page of that kind, one after the other; then the panel's rows and buttons."""
    page = chromium.new_page()
    page.route("**/live/*/paths", lambda route: route.abort())

    def press(kind: str, presses: list[tuple[str, dict[str, Any]]], phase: str = "") -> dict[str, Any]:
        page.goto(f"{pages}/step/{kind}")
        page.locator(".step-body[data-live]").wait_for(state="attached")
        found: dict[str, Any] = page.evaluate(PRESS, [presses, phase])
        return found

    yield press
    page.close()


def test_sliders_are_moved_in_the_room_and_whose_hand_it_was_is_noted(pressed: Callable[..., dict[str, Any]]) -> None:
    moves = [("slider-0-less", {}), ("slider-0-set", {"share": 1.0, "settled": True}), ("slider-4-more", {})]
    found = pressed("tuning", moves)
    assert found["beside"]
    rows = found["rows"]
    assert [len(row["buttons"]) for row in rows] == [3] * 7
    assert rows[0]["share"] == 1
    assert rows[0]["text"].endswith("100")
    assert rows[4]["share"] == pytest.approx(0.3)
    assert all("\n" not in row["text"] and "undefined" not in row["text"] for row in rows)


@pytest.mark.parametrize(("kind", "name", "points"), [("rating", "rating", 7), ("meet_your_robot", "agreement", 5)])
def test_points_of_a_scale_are_pressed_in_the_room(
    pressed: Callable[..., dict[str, Any]], kind: str, name: str, points: int
) -> None:
    found = pressed(kind, [(f"{name}-2", {}), (f"{name}-4", {})], "choosing" if kind == "rating" else "")
    row = found["rows"][0]
    assert [one["text"] for one in row["buttons"]] == [str(n + 1) for n in range(points)]
    assert [one["text"] for one in row["buttons"] if one["pressed"]] == ["4"]
    assert len(row["ends"]) == 2
    resting = [one["resting"] for one in found["buttons"] if one["text"] == "Continue"]
    assert resting == [kind != "rating"], "the robots are to be watched first"


def test_objects_are_listed_in_the_room_with_their_names(pressed: Callable[..., dict[str, Any]]) -> None:
    found = pressed("importance_ranking", [], "choosing")
    assert [one["text"] for one in found["buttons"]][:4] == ["Couch", "Table", "Cupboard", "Sideboard 1"]


def test_what_is_for_the_window_alone_is_left_out_of_the_room(pressed: Callable[..., dict[str, Any]]) -> None:
    assert [one["text"] for one in pressed("robot_drive", [])["buttons"]] == ["Continue"], "nobody types there"


@pytest.mark.parametrize(
    ("taken", "sent", "phase"), [(True, ["seen"], "choosing"), (False, ["seen", "interrupted"], "ready")]
)
def test_what_was_watched_and_does_not_count_can_be_begun_again(
    page: Page, taken: bool, sent: list[str], phase: str
) -> None:
    assert page.evaluate(REFUSED, taken) == [sent, phase]


def test_an_answer_by_sliders_says_with_what_headset_it_is_given(page: Page) -> None:
    page.evaluate("document.body.dataset.layout = 'text'")
    worn = {"controllers": ["meta-quest-touch-plus"], "refresh_rate": 90, "pointing": ["controller"]}
    given = page.evaluate(GIVEN, worn | {"frames": 12, "dropped": 0})
    assert given == [{"weights": {}, "headset": headset} for headset in (None, worn, None)]


def test_how_the_head_moves_is_sent_in_order_until_it_is_taken(page: Page) -> None:
    came: list[tuple[str, int]] = []

    def taken(route: Route) -> None:
        came.append((route.request.url.rpartition("/")[2], json.loads(route.request.post_data or "{}")["part"]))
        if len(came) == 1:
            route.abort()  # the connection is lost
        elif len(came) == 3:
            route.fulfill(status=409, json={"error": {"code": "enough", "message": "enough"}})
        else:
            route.fulfill(status=204)

    page.route("**/sent/head/*", taken)
    page.evaluate(SEND)
    for _ in range(600):
        if len(came) >= 4:
            break
        page.wait_for_timeout(50)
    assert came == [("block.01", 0), ("block.01", 0), ("block.01", 1), ("block.01", 2)]

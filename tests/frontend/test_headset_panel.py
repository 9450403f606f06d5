"""The page's part of a headset: a sentence for everything that stands against it, and how the head moves, sent on."""

from __future__ import annotations

import json
from collections.abc import Iterator

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

"""Ways redrawn while a weight is dragged: two requests at once, the newest wish last, no old way over a newer one."""

from __future__ import annotations

import json
from typing import Any

from playwright.sync_api import Browser, Route, expect

from tests.frontend.empty_room import room_says

DRAGGED = """async () => {
  const slider = document.querySelector("[data-ends~=farther]");
  for (const value of [20, 40, 60, 80]) {
    slider.value = String(value);
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    await new Promise((go) => setTimeout(go, 5));
  }
}"""


def answer_to(route: Route) -> dict[str, Any]:
    """A way that takes ten seconds per weight of one."""
    farther = json.loads(route.request.post_data or "{}")["weights"].get("farther", 0)
    track = [[0, 0, 0, 0], [round(10 * farther, 3), 1, 0, 0]]
    return {"place": 0, "paths": [{"track": track, "arrives": True, "looks_at": []}]}


def test_of_a_drag_two_requests_are_under_way_and_an_older_way_is_not_drawn_over_a_newer(
    chromium: Browser, pages: str
) -> None:
    page = chromium.new_page()
    held: list[Route] = []
    page.route("**/live/*/paths", lambda route: held.append(route))
    page.goto(f"{pages}/step/tuning")
    expect(page.locator(".step-body[data-live]")).to_be_attached()
    expect(page.locator("[data-done]")).to_have_attribute("aria-disabled", "true")
    page.evaluate(DRAGGED)
    page.wait_for_timeout(100)
    assert [json.loads(one.request.post_data)["weights"]["farther"] for one in held] == [0.2, 0.4], "two, and no more"
    first, second = held
    second.fulfill(json=answer_to(second))
    expect(page.locator("#live-way")).to_have_attribute("data-seconds", "4")
    expect(page.locator("[data-done]")).to_have_attribute("aria-disabled", "false")
    while len(held) < 3:
        page.wait_for_timeout(20)
    first.fulfill(json=answer_to(first))  # late: nothing is drawn of it
    page.wait_for_timeout(50)
    expect(page.locator("#live-way")).to_have_attribute("data-seconds", "4")
    held[2].fulfill(json=answer_to(held[2]))
    expect(page.locator("#live-way")).to_have_attribute("data-seconds", "8")
    assert len(held) == 3, "what was passed over in between is not asked for"
    page.close()


def test_why_a_robot_drove_otherwise_is_said_after_it_drove_and_kept_with_the_answer(
    chromium: Browser, pages: str
) -> None:
    page = chromium.new_page()
    track = [[0, 0, 0, 0], [4, 1, 0, 0]]
    why = [{"did": "farther", "own": 1.44, "usual": 0.9}, {"did": "behind", "own": None, "usual": None}]
    ways = {"place": 0, "paths": [{"track": track, "arrives": True}] * 2, "why": why}
    page.route("**/live/*/paths", lambda route: route.fulfill(json=ways))
    sent: list[dict[str, Any]] = []

    def answered(route: Route) -> None:
        sent.append(json.loads(route.request.post_data or "{}"))
        route.abort()

    page.route("**/steps/*", answered)
    page.goto(f"{pages}/step/meet_your_robot")
    expect(page.locator(".step-body[data-live]")).to_be_attached()
    room_says(page, "ready")
    page.locator("[data-drive][aria-disabled=false]").click()
    expect(page.locator("[data-drive][data-driving]")).to_be_attached()
    expect(page.locator("#meet-why")).to_have_text("")
    room_says(page, "moved", poses=[[1, 0, 0]] * 2, clocks=[4, 4], over=True)
    expect(page.locator("#meet-why")).to_have_text(
        "Here your robot kept more distance from you (1.4 m, the usual one 0.9 m) and passed behind you, "
        "because your answers point that way."
    )
    page.locator("label:has([data-agreement][value='4'])").click()
    page.locator("[data-done][aria-disabled=false]").click()
    while not sent:
        page.wait_for_timeout(20)
    assert sent[0]["value"]["why"] == [{"place": 0, "did": ["farther", "behind"]}]
    page.close()

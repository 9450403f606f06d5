"""Ways redrawn while a weight is dragged: two requests at once, the newest wish last, no old way over a newer one."""

from __future__ import annotations

import json
from typing import Any

from playwright.sync_api import Browser, Route, expect

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

"""A stage without a picture: a test speaks for it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext, Page

EMPTY_ROOM = "<!doctype html><title>room</title><body></body>"

LISTEN = """(kind) => {
  window.heard = new Promise((done) => addEventListener("message", function hear({ data }) {
    if (data?.source !== "desirepath-stage" || data.type !== kind) return;
    removeEventListener("message", hear);
    done();
  }));
}"""  # after the page's own listener
SAY = "([message, origin]) => parent.postMessage(message, origin)"


def empty_rooms(context: BrowserContext) -> None:
    """Every stage of that browser is empty."""
    context.route("**/stage/**", lambda route: route.fulfill(body=EMPTY_ROOM, content_type="text/html"))


def room_says(page: Page, kind: str, **more: Any) -> None:
    """A message of the stage, from its frame and its origin; the page has heard it when this returns."""
    frame = page.locator("#stage-frame iframe").element_handle().content_frame()
    assert frame is not None
    frame.wait_for_load_state()
    origin = re.match(r"https?://[^/]+", page.url)
    assert origin is not None
    page.evaluate(LISTEN, kind)
    frame.evaluate(SAY, [{"source": "desirepath-stage", "type": kind, **more}, origin.group()])
    page.evaluate("heard")

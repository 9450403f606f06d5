"""A stage that draws itself ten times a second: software draws its pictures, and nobody looks at most of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext

EVERY_MS = 85  # between two pictures, besides the wait for the screen
ON_STAGES = """if (location.pathname.startsWith("/stage/")) {
  const frame = window.requestAnimationFrame.bind(window), later = window.setTimeout.bind(window);
  window.requestAnimationFrame = (callback) => later(() => frame(callback), EVERY_MS);
  window.cancelAnimationFrame = window.clearTimeout.bind(window);
}"""


def draw_fewer_pictures(context: BrowserContext) -> None:
    """Of every stage in the pages that this context will have."""
    context.add_init_script(ON_STAGES.replace("EVERY_MS", str(EVERY_MS)))

"""What axe finds wrong on a page in both schemes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from axe_playwright_python.base import AXE_SCRIPT

if TYPE_CHECKING:
    from playwright.sync_api import Page

WCAG = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}}
COLOURS = {"runOnly": {"type": "rule", "values": ["color-contrast"]}}  # nothing else depends on the scheme


# What is right is not listed, which takes longer than finding what is wrong.
RUN = """(options) => axe.run({ ...options, resultTypes: ["violations"] }).then(({ violations }) =>
  violations.map(({ id, nodes }) => [id, nodes.map(({ html }) => html.slice(0, 160))]))"""


def violations(page: Page, options: dict[str, object] | None = WCAG) -> list[tuple[str, list[str]]]:
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE_SCRIPT)
    return [(rule, places) for rule, places in page.evaluate(RUN, options)]


def violations_in_both_schemes(page: Page, options: dict[str, object] | None = WCAG) -> list[tuple[str, list[str]]]:
    """The page stands in the light scheme before and afterwards; without motion, or it may be looked at in between.
    options: of axe in the light scheme; None for its own, which ask for no sizes of targets."""
    found = violations(page, options)
    page.emulate_media(color_scheme="dark")
    found += violations(page, COLOURS)
    page.emulate_media(color_scheme="light")
    return found

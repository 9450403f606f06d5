"""What axe finds wrong on a page in both schemes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from axe_playwright_python.sync_playwright import Axe

if TYPE_CHECKING:
    from playwright.sync_api import Page

WCAG = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}}
COLOURS = {"runOnly": {"type": "rule", "values": ["color-contrast"]}}  # nothing else depends on the scheme


def violations(page: Page, options: dict[str, object] | None = WCAG) -> list[tuple[str, list[str]]]:
    found = Axe().run(page, options=options).response["violations"]
    return [(violation["id"], [node["html"][:160] for node in violation["nodes"]]) for violation in found]


def violations_in_both_schemes(page: Page, options: dict[str, object] | None = WCAG) -> list[tuple[str, list[str]]]:
    """The page stands in the light scheme before and afterwards; without motion, or it may be looked at in between.
    options: of axe in the light scheme; None for its own, which ask for no sizes of targets."""
    found = violations(page, options)
    page.emulate_media(color_scheme="dark")
    found += violations(page, COLOURS)
    page.emulate_media(color_scheme="light")
    return found

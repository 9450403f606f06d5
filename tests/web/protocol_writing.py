"""Writing a protocol in the editor's page, whichever of its two editors there is."""

from __future__ import annotations

from playwright.sync_api import Page, expect


def write_yaml(page: Page, text: str) -> None:
    """Replace all of it, once the editor is there."""
    expect(page.locator("#editor-state")).not_to_be_empty()
    code = page.locator(".cm-content")
    (code if code.count() else page.locator("textarea[name=yaml]")).fill(text)

"""The stage's tests share one Chromium and a house around the stage."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser, sync_playwright

from tests.app.stage_house import CHROMIUM_FLAGS, StageHouse, Visitor


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    executable = shutil.which("chromium")
    if executable is None:
        if os.environ.get("CI"):
            pytest.fail("no `chromium` on the PATH; the stage's tests need a real browser")
        pytest.skip("no `chromium` on the PATH")
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=executable, args=CHROMIUM_FLAGS)
        yield launched
        launched.close()


@pytest.fixture
def house() -> Iterator[StageHouse]:
    """A house whose stages stay empty until the test shows something."""
    built = StageHouse(on_connect=lambda stage, key: None)
    yield built
    built.stop()


@pytest.fixture
def visit(browser: Browser, house: StageHouse) -> Iterator[Callable[..., Visitor]]:
    """Open the stage in a fresh browser context: `visit("key")`."""
    contexts = []

    def open_page(key: str = "amber", width: int = 320, height: int = 200) -> Visitor:
        context = browser.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        return Visitor(context.new_page(), house, key)

    yield open_page
    for context in contexts:
        context.close()

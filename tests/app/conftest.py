"""The stage's tests share one Chromium and a house around the stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser

from tests.app.stage_house import StageHouse, Visitor


@pytest.fixture
def house() -> Iterator[StageHouse]:
    """A house whose stages stay empty until the test shows something."""
    built = StageHouse(on_connect=lambda stage, key: None)
    yield built
    built.stop()


@pytest.fixture
def visit(chromium: Browser, house: StageHouse) -> Iterator[Callable[..., Visitor]]:
    """Open the stage in a fresh browser context: `visit("key")`."""
    contexts = []

    def open_page(key: str = "amber", width: int = 320, height: int = 200) -> Visitor:
        context = chromium.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        return Visitor(context.new_page(), house, key)

    yield open_page
    for context in contexts:
        context.close()

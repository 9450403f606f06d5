"""The stage's tests share one Chromium and one rig around the stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser

from tests.fewer_pictures import draw_fewer_pictures
from tests.stage.stage_rig import StageRig, Visitor


@pytest.fixture
def rig() -> Iterator[StageRig]:
    """A rig whose stages stay empty until the test shows something."""
    built = StageRig(on_connect=lambda stage, key: None)
    yield built
    built.stop()


@pytest.fixture
def visit(chromium: Browser, rig: StageRig) -> Iterator[Callable[..., Visitor]]:
    """Open the stage in a fresh browser context: `visit("key")`; `fluent` draws as often as the browser can."""
    contexts = []

    def open_page(key: str = "amber", width: int = 320, height: int = 200, fluent: bool = False) -> Visitor:
        context = chromium.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        if not fluent:
            draw_fewer_pictures(context)
        return Visitor(context.new_page(), rig, key)

    yield open_page
    for context in contexts:
        context.close()

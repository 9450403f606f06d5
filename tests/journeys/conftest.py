"""A running installation and browsers for the journeys: nothing is faked but the speed of the browser's clock."""

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from desirepath.cli.loopback import loopback_server
from desirepath.settings import Settings
from tests.fewer_pictures import draw_fewer_pictures

COARSE = 1.0 if "DESIREPATH_SCREENSHOTS" in os.environ else 0.25
"""Pixels per point: software draws coarse pictures quickly, and only somebody who asks for pictures looks at them."""

# Everything in the page that measures time runs `speed` times as fast; animation frames still come when they come.
FASTER_CLOCK = """(speed) => {
  const now = performance.now.bind(performance), date = Date.now.bind(Date);
  const zero = now(), zeroDate = date();
  performance.now = () => zero + (now() - zero) * speed;
  Date.now = () => Math.round(zeroDate + (date() - zeroDate) * speed);
  const frame = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (callback) => frame(() => callback(performance.now()));
  const timeout = window.setTimeout.bind(window);
  window.setTimeout = (callback, delay, ...rest) => timeout(callback, (delay || 0) / speed, ...rest);
}"""


@dataclass
class Installation:
    """One running product and what the roles learn on their way."""

    url: str
    data: Path
    link: str
    notes: dict[str, str] = field(default_factory=dict)


@pytest.fixture(scope="module")
def installation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installation]:
    data = tmp_path_factory.mktemp("installation")
    log = data / "server.log"
    with loopback_server(Settings(data=data), log=log) as (url, _):
        link = re.search(r"Experimenter +(\S+)", log.read_text())
        assert link, log.read_text()
        yield Installation(url, data, link.group(1))


@pytest.fixture(scope="module")
def screenshots(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Page, str], None]:
    """Saves pictures of the way: into $DESIREPATH_SCREENSHOTS if set, else into pytest's folder."""
    folder = Path(os.environ.get("DESIREPATH_SCREENSHOTS") or tmp_path_factory.mktemp("screenshots"))
    folder.mkdir(parents=True, exist_ok=True)
    taken: list[str] = []

    def take(page: Page, name: str) -> None:
        taken.append(name)
        page.screenshot(path=folder / f"{len(taken):02d}_{name}.png")

    return take


@pytest.fixture(scope="module")
def open_page(chromium: Browser) -> Iterator[Callable[..., Page]]:
    """Opens a page in a browser profile of its own; a script error in it fails the test that is running."""
    contexts = []

    def opened(*, width: int = 1024, height: int = 640, speed: float = 1.0) -> Page:
        size = {"width": width, "height": height}
        context = chromium.new_context(viewport=size, device_scale_factor=COARSE, accept_downloads=True)
        context.set_default_timeout(60_000)
        contexts.append(context)
        draw_fewer_pictures(context)
        if speed != 1.0:
            context.add_init_script(f"({FASTER_CLOCK})({speed})")
        page = context.new_page()
        page.on("pageerror", lambda error: pytest.fail(f"script error on the page: {error}"))
        return page

    yield opened
    for context in contexts:
        context.close()

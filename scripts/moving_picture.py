"""Make README's moving picture from the running product: a pair is watched and answered, then *meet your robot*.

A simulated participant walks the quick study over HTTP; at two of its steps a real Chromium plays and is filmed.
.venv/bin/python scripts/moving_picture.py [FILE]
"""

from __future__ import annotations

import io
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import httpx
from PIL import Image

from desirepath.cli.loopback import loopback_server
from desirepath.installed import PROTOCOLS
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.shipped_policies import register_shipped
from desirepath.study.protocol.freezing import freeze
from desirepath.study.simulated.http import HttpSessionClient
from desirepath.study.simulated.participant import Character, walk_all
from desirepath.study.studies import create_study
from desirepath_experiments.browser.client import WINDOW, chromium

OUT = Path(__file__).resolve().parents[1] / "docs/images/pair-and-robot.webp"
SIZE, QUALITY, LEAST_S = (512, 320), 36, 0.28  # of the picture; how long each of its frames stands at least
KEYS = {"kmin": 17, "kmax": 33}  # frames between two whole ones: what is gone leaves no traces for long
SLOWED, SPEED = 12, 2  # how much slower the pages' clock goes, as a picture takes long here; how much faster this plays
CLOCK = f"{{ const now = performance.now.bind(performance); performance.now = () => now() / {SLOWED}; }}"
FILMED_TRIAL = 4  # by then a robot has been seen before, and the pairs differ by what the answers leave open


class FilmedClient(HttpSessionClient):
    """Over HTTP, but for two steps."""

    def __init__(self, page: Any, url: str, client: httpx.Client, token: str) -> None:
        super().__init__(client, token)
        self._page, self._url, self._started, self._filmed = page, url, 0, ""
        self.frames: list[tuple[float, Image.Image]] = []

    def start(self, key: str) -> Any:
        self._started += 1
        if self._started != FILMED_TRIAL:
            return super().start(key)
        self._filmed = key
        self._open(key)
        self._page.locator("#start[aria-disabled=false]").click()
        self._film(lambda: bool(self._page.locator("[data-choice=a][aria-disabled=false]").count()))
        return self.state()

    def report_seen(self, key: str, side: Any, playback_id: str) -> Any:
        return self.state() if key == self._filmed else super().report_seen(key, side, playback_id)

    def submit(self, key: str, value: Mapping[str, Any]) -> Any:
        if key == self._filmed:
            self._page.locator(f"[data-choice={value['choice']}]").hover()
            self._film_one(1.5)
        elif self.state()["step"]["kind"] == "meet_your_robot":
            self._open(key)
            drive = self._page.locator("[data-drive][aria-disabled=false]")
            drive.wait_for()
            self._page.wait_for_timeout(5_000)  # both ways are drawn
            self._film_one(3.0)
            drive.click()
            self._page.locator("[data-drive][data-driving]").wait_for()
            self._film(lambda: not self._page.locator("[data-drive][data-driving]").count())
            self._film_one(2.0)
        self._page.goto("about:blank")
        return super().submit(key, value)

    def _open(self, key: str) -> None:
        self._page.goto(f"{self._url}/p/{self.token}")
        self._page.locator(f".step-body[data-key='{key}']").wait_for(state="attached")

    def _film(self, ends: Callable[[], bool]) -> None:
        """What moves, until it ends."""
        while not ends():
            began = time.monotonic()
            self._film_one(0.0)
            self.frames[-1] = ((time.monotonic() - began) / SLOWED / SPEED, self.frames[-1][1])

    def _film_one(self, stands_s: float) -> None:
        shot = Image.open(io.BytesIO(self._page.screenshot()))
        self.frames.append((stands_s, shot.convert("RGB").resize(SIZE, Image.Resampling.LANCZOS)))


def film(data: Path) -> list[tuple[float, Image.Image]]:
    """What the browser showed of a study in a new data folder."""
    settings = Settings(data=data, _env_file=None)
    with loopback_server(settings) as (url, _), httpx.Client(base_url=url, timeout=60) as client, chromium() as browser:
        database, files = Database(settings.database), ArtefactStore(settings.artefacts)
        with database.transaction() as s:
            register_shipped(s, files)
            frozen = freeze(PROTOCOLS / "quick_preference_study.yaml")
            token = create_study(s, files, frozen, name="Pair and robot", created_by=None).recruiting_token
        page = browser.new_page(viewport=WINDOW, color_scheme="light", locale="en")
        page.add_init_script(CLOCK)
        filmed = FilmedClient(page, url, client, token)
        walk_all([filmed], Character(), lambda line: print(line, file=sys.stderr))
        database.close()
    return filmed.frames


def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else OUT
    with tempfile.TemporaryDirectory() as data:
        filmed = film(Path(data))
    frames: list[tuple[float, Image.Image]] = []
    for stands_s, picture in filmed:
        if frames and frames[-1][0] < LEAST_S:
            frames[-1] = (frames[-1][0] + stands_s, frames[-1][1])
        else:
            frames.append((stands_s, picture))
    stands = [round(1000 * seconds) for seconds, _ in frames]
    first, *others = [picture for _, picture in frames]
    first.save(out, append_images=others, duration=stands, loop=0, quality=QUALITY, method=6, **KEYS)
    print(f"{out}: {len(frames)} frames, {sum(stands) / 1000:.0f} s, {out.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()

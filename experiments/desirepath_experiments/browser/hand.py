"""The hand and feet of a simulated participant at the stage: real mouse moves and keys in a real browser.

Where things are is asked of the stage's own page; what to draw and where to walk is the bot's.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from desirepath.study.simulated.participant import SimulationError

if TYPE_CHECKING:
    from playwright.sync_api import Frame, Page

EDGE = 0.2  # of the window: what lies nearer to its edge is brought to the middle before it is drawn on
TURNS = 24  # of the gaze until a place must have come into sight
SPACING_M = 0.12  # between two moves of the mouse
STEP_S = 0.08  # between two looks of the feet
NEAR_M = 0.25  # from where the walk is: near enough to stand
AIMED_RAD = 0.35
LOOK = """(places) => {
  const { viser, camera } = window.desirePath;
  const [project, turns, width, height] = [viser.projector(), camera.mayTurn(), innerWidth, innerHeight];
  return places.map(([x, y]) => ({ at: project(x, y), left: camera.isLeft(x, y), turns, width, height }));
}"""
FEET = """() => {
  const { poses, times_s: times } = window.desirePath.walk.recording();
  return { pose: poses[poses.length - 1] ?? null, time: times[times.length - 1] ?? 0,
    on: document.documentElement.dataset.walking === "on", heading: window.desirePath.camera.heading() };
}"""


class BrowserHand:
    """On the stage of the page's current step."""

    def __init__(self, page: Page) -> None:
        self._page = page

    @property
    def _frame(self) -> Frame:
        for frame in self._page.frames:
            if "/stage/" in frame.url:
                return frame
        raise SimulationError("the page has no stage")

    def ready(self) -> None:
        """Wait until the pen can be put down."""
        self._page.locator("#stage-frame iframe").wait_for()
        self._frame.wait_for_function(
            "document.documentElement.dataset.stage === 'ready' && document.documentElement.dataset.drawing === 'on'"
        )

    def speed(self, speed: float) -> None:
        """Move the slider to a speed, m/s."""
        self._page.locator("#draw-speed").evaluate(
            """(slider, speed) => {
              slider.value = String(100 * (speed - 0.1) / 0.15);
              slider.dispatchEvent(new Event("input", { bubbles: true }));
            }""",
            speed,
        )

    def draw(self, places: Sequence[Sequence[float]]) -> None:
        """Draw through places on the floor, metres, in one go where all of them are in sight; else the pen is lifted,
        the gaze turned, and the path drawn on from its end.
        """
        path = _thin(places)
        done = 0  # places that the path has reached
        while done < len(path):
            end = path[max(0, done - 1)]
            begin, *spots = self._in_sight_from(end, path[done:]) or self._turn_gaze(end, path[done:])
            left, top = self._corner()
            self._page.mouse.move(left + begin[0], top + begin[1])
            self._page.mouse.down()
            for x, y in spots:
                self._page.mouse.move(left + x, top + y)
            self._page.mouse.up()
            done += len(spots)

    def _in_sight_from(self, end: Sequence[float], ahead: Sequence[Sequence[float]]) -> list[list[float]]:
        """Pixels of the path's end and of as many of the next places as can be seen now; nothing if none can."""
        begin, *seen = self._looks([end, *ahead])
        first_hidden = next((k for k, place in enumerate(seen) if not self._in_sight(place)), len(seen))
        return (
            [begin["at"], *(place["at"] for place in seen[:first_hidden])]
            if first_hidden and begin["at"] is not None
            else []
        )

    def _turn_gaze(self, end: Sequence[float], ahead: Sequence[Sequence[float]]) -> list[list[float]]:
        """The same, after the gaze was turned to the next place."""
        self._turn_to(ahead[0])
        spots = self._in_sight_from(end, ahead)
        if not spots:
            raise SimulationError(
                f"the path's end at {end[0]:.2f}, {end[1]:.2f} m cannot be seen together with what follows"
            )
        return spots

    def walk(self, walk: Mapping[str, Any], under_way: Callable[[], None]) -> None:
        """Follow recorded poses with W, Q and E until the rollout is over. under_way: called once, while walking."""
        times, poses = np.array(walk["times_s"]), np.array(walk["poses"])
        held: set[str] = set()
        looks = 0
        while (feet := self._frame.evaluate(FEET))["on"]:
            wanted: set[str] = set()
            if feet["pose"] is not None:
                pose = feet["pose"]
                x, y = (float(np.interp(feet["time"] + 0.5, times, poses[:, axis])) for axis in range(2))
                away = math.dist((x, y), pose[:2])
                off = math.remainder(math.atan2(y - pose[1], x - pose[0]) - feet["heading"], 2 * math.pi)
                if away > NEAR_M:
                    wanted = {"w"} if abs(off) < AIMED_RAD else {"q" if off > 0 else "e"}
            for key in held - wanted:
                self._page.keyboard.up(key)
            for key in wanted - held:
                self._page.keyboard.down(key)
            held, looks = wanted, looks + 1
            if looks == 40:
                under_way()
            time.sleep(STEP_S)
        for key in held:
            self._page.keyboard.up(key)

    def _looks(self, places: Sequence[Sequence[float]]) -> list[dict[str, Any]]:
        seen: list[dict[str, Any]] = self._frame.evaluate(LOOK, [list(place) for place in places])
        return seen

    def _in_sight(self, seen: Mapping[str, Any]) -> bool:
        if seen["at"] is None:
            return False
        margin = EDGE if seen["turns"] else 0.0
        across, along = seen["at"][0] / seen["width"], seen["at"][1] / seen["height"]
        return bool(margin <= across <= 1 - margin and margin <= along <= 1 - margin / 2)

    def _turn_to(self, place: Sequence[float]) -> None:
        """Drag the picture, away from the path's end, until the place is near its middle."""
        for _ in range(TURNS):
            (seen,) = self._looks([place])
            width, height = seen["width"], seen["height"]
            if seen["at"] is None:
                right, down = 0.4 * width if seen["left"] else -0.4 * width, 0.0
            else:
                right, down = width / 2 - seen["at"][0], 0.6 * height - seen["at"][1]
                if self._in_sight(seen) and max(abs(right), abs(down)) < 0.15 * height:
                    return
            right, down = (max(-0.4 * side, min(0.4 * side, way)) for way, side in ((right, width), (down, height)))
            left, top = self._corner()
            x, y = left + 0.5 * width - right / 2, top + (0.1 * height if down >= 0 else 0.5 * height)
            self._page.mouse.move(x, y)
            self._page.mouse.down()
            self._page.mouse.move(x + right, y + down)
            self._page.mouse.up()
        if not self._in_sight(self._looks([place])[0]):
            raise SimulationError(f"the place {place[0]:.2f}, {place[1]:.2f} m does not come into sight")

    def _corner(self) -> tuple[float, float]:
        """Of the stage in the page, pixels."""
        box = self._page.locator("#stage-frame iframe").bounding_box()
        if box is None:
            raise SimulationError("the stage is not to be seen")
        return box["x"], box["y"]


def _thin(places: Sequence[Sequence[float]]) -> list[Sequence[float]]:
    """Places at least SPACING_M apart, the first and the last among them."""
    thinned = [places[0]]
    for place in places[1:-1]:
        if math.dist(place[:2], thinned[-1][:2]) >= SPACING_M:
            thinned.append(place)
    return [*thinned, places[-1]]

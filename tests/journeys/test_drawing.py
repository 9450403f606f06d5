"""A participant draws a path with the mouse, is told kindly what does not work, sees the robot drive it, and keeps it.

On a real installation in a real browser, whose clock is driven fast. Pictures go to $DESIREPATH_SCREENSHOTS.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Frame, Page, Route, expect

from desirepath.simulation.demonstration_scenes import demonstration_scene
from tests.journeys.conftest import Installation

pytestmark = pytest.mark.journey

QUICK = Path(__file__).resolve().parents[2] / "study_protocols" / "quick_demonstration_study.yaml"
SPEED = 12


def created(installation: Installation) -> str:
    """The recruiting link's token of a new study."""
    told = subprocess.run(
        [sys.executable, "-m", "desirepath", "studies", "create", str(QUICK), "--live", "--json"],
        env={**os.environ, "DESIREPATH_DATA": str(installation.data)},
        capture_output=True,
        text=True,
        check=True,
    )
    return str(json.loads(told.stdout)["link"]).rsplit("/", 1)[1]


def stage_of(page: Page) -> Frame:
    return next(frame for frame in page.frames if "/stage/" in frame.url)


def drag(page: Page, places: Sequence[tuple[float, float]]) -> None:
    """Draw through places on the floor, metres."""
    box = page.locator("#stage-frame iframe").bounding_box()
    assert box
    for number, (x, y) in enumerate(places):
        px, py = stage_of(page).evaluate(f"window.desirePath.viser.projector()({x}, {y})")
        page.mouse.move(box["x"] + px, box["y"] + py)
        if number == 0:
            page.mouse.down()
    page.mouse.up()


def test_a_participant_draws_watches_and_keeps(
    installation: Installation, open_page: Callable[..., Page], screenshots: Callable[[Page, str], None]
) -> None:
    link = f"{installation.url}/join/{created(installation)}"
    joined = httpx.post(link, json={"simulated": True, "language": "en"}, timeout=60).json()
    api = f"{installation.url}/api/session/{joined['token']}"
    for step, value in {"information": {}, "consent": {"given": True}, "instruction": {}}.items():
        answer = {"request_id": f"{step}-{joined['token']}"[:64], "value": value}
        assert httpx.post(f"{api}/steps/{step}", json=answer, timeout=60).status_code == 200
    page = open_page(speed=SPEED)
    page.goto(f"{installation.url}/p/{joined['token']}")
    hint = page.locator("#draw-hint")
    expect(hint).to_contain_text("from the robot to the green cone", timeout=60_000)
    screenshots(page, "drawing_ready")
    key = httpx.get(api, timeout=60).json()["step"]["key"]
    scene = demonstration_scene("corridor", int(key.split(".")[1]) - 1)

    def arc(bend_m: float) -> list[tuple[float, float]]:
        along = [k / 30 for k in range(31)]
        x, reach = scene.start.x, scene.goal.x - scene.start.x
        return [(x + reach * u, bend_m * math.sin(math.pi * u)) for u in along]

    drag(page, arc(scene.person.pose.y))
    expect(hint).to_contain_text("would touch the person here", timeout=60_000)
    screenshots(page, "drawing_refused")
    page.get_by_role("button", name="Undo").click()
    expect(hint).to_contain_text("Draw on to the green cone")
    page.get_by_role("button", name="Draw again").first.click()
    drag(page, arc(-0.7 if scene.person.pose.y > 0 else 0.7))
    expect(page.locator("#driving-text")).to_be_visible(timeout=60_000)
    # A reload loses nothing: the path is there, and its drive can be watched, once there is a stage to watch it on.
    held: list[Route] = []
    page.route("**/stage/**", lambda route: held.append(route))
    with page.expect_request("**/stage/**"):
        page.reload(wait_until="domcontentloaded")
    watch = page.get_by_role("button", name="Watch the drive")
    expect(watch).to_have_attribute("aria-disabled", "true")
    for route in held:
        route.continue_()
    page.unroute("**/stage/**")
    watch.click(timeout=60_000)
    screenshots(page, "drawing_driving")
    expect(page.get_by_role("button", name="Keep this path")).to_be_visible(timeout=120_000)
    screenshots(page, "drawing_watched")
    page.get_by_role("button", name="Keep this path").click()
    expect(page.locator(".draw-count")).to_contain_text("Path 2 of 2", timeout=60_000)
    expect(hint).to_contain_text("from the robot to the green cone", timeout=60_000)
    screenshots(page, "drawing_second")
    state = httpx.get(api, timeout=60).json()["step"]
    assert state["key"] == f"{key[:-1]}2"
    assert state["trial"]["phase"] == "drawing"

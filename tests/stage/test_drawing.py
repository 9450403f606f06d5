"""The stage's pen in a real Chromium: mouse, keys, speed, undo and redo, in the views from above and from the eyes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath.simulation.walks import Walk
from desirepath_stage.paper import Paper
from desirepath_stage.stage import Stage
from tests.stage.measure_pen import moved
from tests.stage.stage_rig import StageRig, Visitor, drive

SCENE = demonstration_scene("corridor", 0)
Visit = Callable[..., Visitor]


def paper(rig: StageRig, visit: Visit, view: str, *, fluent: bool = False) -> Visitor:
    """A visitor before an empty sheet."""
    visitor = visit(width=800, height=500, fluent=fluent)
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", timeout_s=60)
    stage = rig.server.stage("amber")
    assert isinstance(stage, Stage)
    stage.draw(SCENE, view, Paper("sheet-1"))  # type: ignore[arg-type]
    visitor.wait_for("ready")
    visitor.wait_for("drawing")
    return visitor


def order(visitor: Visitor, **message: Any) -> None:
    """What the page orders of the pen."""
    visitor.page.evaluate(
        "([message, origin]) => document.getElementById('stage').contentWindow.postMessage(message, origin)",
        [{"type": "draw", **message}, visitor.rig.stage_origin],
    )


def spot(visitor: Visitor, x: float, y: float) -> tuple[float, float]:
    """Where a place on the floor is in the window, pixels."""
    px: list[float] = visitor.frame.evaluate(f"window.desirePath.viser.projector()({x}, {y})")
    return px[0], px[1]


def drag(visitor: Visitor, places: list[tuple[float, float]]) -> None:
    mouse = visitor.page.mouse
    mouse.move(*spot(visitor, *places[0]))
    mouse.down()
    for place in places[1:]:
        mouse.move(*spot(visitor, *place))
    mouse.up()


def arc(share: float = 1.0, bend_m: float = 0.7) -> list[tuple[float, float]]:
    """From the robot towards the goal, `share` of the way."""
    steps = [share * k / 24 for k in range(25)]
    return [(-3.2 + 6.4 * u, bend_m * math.sin(math.pi * u)) for u in steps]


def newest(visitor: Visitor) -> dict[str, Any]:
    return visitor.events("drawing")[-1]


def test_a_path_is_drawn_section_by_section_and_goes_off_at_the_goal(rig: StageRig, visit: Visit) -> None:
    visitor = paper(rig, visit, "top_down")
    order(visitor, do="speed", value=0.1)
    drag(visitor, arc(0.5))
    visitor.wait_until(lambda: newest(visitor)["can_finish"], "half of it is drawn")
    half = newest(visitor)
    assert not visitor.events("stroke"), "away from the goal it waits to be drawn on"
    assert half["length_m"] == pytest.approx(3.35, abs=0.2)
    assert half["seconds"] == pytest.approx(half["length_m"] / 0.1, rel=0.02)
    assert (half["near"]["name"], half["tight"]) == ("wall", None)
    order(visitor, do="undo")
    visitor.wait_until(lambda: newest(visitor)["length_m"] == 0, "undo takes it away")
    order(visitor, do="redo")
    visitor.wait_until(lambda: newest(visitor)["length_m"] == half["length_m"], "redo brings it back")
    order(visitor, do="speed", value=0.25)
    drag(visitor, arc()[12:])
    stroke = visitor.wait_for("stroke", id="sheet-1")
    points, speeds, times = stroke["points"], stroke["speeds"], stroke["times_s"]
    assert len(points) == len(speeds) == len(times)
    assert points[0] == pytest.approx([-3.2, 0.0], abs=0.01)
    assert points[-1] == pytest.approx([3.2, 0.0], abs=0.05)
    assert (speeds[1], speeds[-1]) == (pytest.approx(0.1), pytest.approx(0.25))
    assert times == sorted(times)
    assert stroke["pointer"] == "mouse"


def test_what_is_too_close_is_said_while_drawing(rig: StageRig, visit: Visit) -> None:
    visitor = paper(rig, visit, "top_down")
    drag(visitor, arc(0.6, SCENE.person.pose.y))
    visitor.wait_until(lambda: newest(visitor)["tight"] is not None, "the person is in the way")
    assert newest(visitor)["tight"]["name"] == "person"
    assert newest(visitor)["tight"]["metres"] < 0
    before = newest(visitor)["length_m"]
    order(visitor, do="problem", at=[SCENE.person.pose.x - 0.4, SCENE.person.pose.y], text="would touch the person")
    order(visitor, do="cut")
    visitor.wait_until(lambda: 0 < newest(visitor)["length_m"] < before - 0.5, "the good part is left")


def test_a_stroke_comes_back_with_its_times_and_one_begun_away_is_begun_anew(rig: StageRig, visit: Visit) -> None:
    visitor = paper(rig, visit, "top_down")
    away = {
        "points": [list(place) for place in arc()[8:]],
        "speeds": [0.2] * 17,
        "times_s": [0.1 * k for k in range(17)],
    }
    stage = rig.server.stage("amber")
    assert isinstance(stage, Stage)
    problem = {"code": "starts_away", "at": away["points"][0], "thing": None}
    stage.draw(SCENE, "top_down", Paper("sheet-2", drawn=away, problem=problem))
    visitor.wait_until(lambda: newest(visitor)["problem"], "the stroke of before is there")
    order(visitor, do="finish")
    assert visitor.wait_for("stroke", id="sheet-2")["times_s"] == pytest.approx(away["times_s"])
    length = newest(visitor)["length_m"]
    drag(visitor, arc(0.5))
    visitor.wait_until(lambda: newest(visitor)["can_finish"] and not newest(visitor)["problem"], "drawn from the robot")
    assert newest(visitor)["length_m"] == pytest.approx(3.35, abs=0.2)
    drag(visitor, arc()[12:])
    visitor.wait_until(lambda: len(visitor.events("stroke")) == 2, "it goes off at the goal")
    anew = visitor.events("stroke")[-1]
    assert anew["points"][0] == pytest.approx([-3.2, 0.0], abs=0.01)
    assert anew["times_s"] == sorted(anew["times_s"])
    assert anew["times_s"][0] >= 1.6, "the hand's clock goes on"
    for _ in range(3):
        order(visitor, do="undo")
    visitor.wait_until(lambda: newest(visitor)["length_m"] == length, "undo brings the old one back")


def test_by_keys_alone(rig: StageRig, visit: Visit) -> None:
    visitor = paper(rig, visit, "top_down")
    for _ in range(4):
        order(visitor, do="key", key="ArrowRight", shift=False)
    order(visitor, do="key", key="Enter", shift=False)
    order(visitor, do="key", key="ArrowUp", shift=True)
    order(visitor, do="key", key="Enter", shift=False)
    visitor.wait_until(lambda: newest(visitor)["length_m"] > 0.41, "two points are set")
    order(visitor, do="finish")
    stroke = visitor.wait_for("stroke")
    assert stroke["pointer"] == "keys"
    assert stroke["points"][-1] == pytest.approx([-2.8, 0.02], abs=0.01)


@pytest.mark.parametrize("view", ["first_person", "immersive"])
def test_from_the_eyes_the_ring_begins_a_path_and_elsewhere_the_gaze_turns(
    rig: StageRig, visit: Visit, view: str
) -> None:
    visitor = paper(rig, visit, view)
    before = visitor.camera()
    mouse = visitor.page.mouse
    mouse.move(600, 420)
    mouse.down()
    mouse.move(560, 420, steps=3)
    mouse.up()
    visitor.wait_until(lambda: visitor.camera()[3:] != before[3:], "the gaze turns")
    assert newest(visitor)["length_m"] == 0
    drag(visitor, [(-3.2 + 0.1 * k, 0.02 * k) for k in range(12)])
    visitor.wait_until(lambda: newest(visitor)["length_m"] > 0.9, "a path from the ring")
    assert newest(visitor)["near"]["name"] in ("wall", "you")


def test_every_coalesced_event_counts_and_a_pens_pressure_is_the_speed(rig: StageRig, visit: Visit) -> None:
    visitor = paper(rig, visit, "top_down", fluent=True)
    times = moved(visitor, events=12, coalesced=5, pen=0.4)
    stroke = visitor.wait_for("stroke")
    assert len(stroke["points"]) >= 12 * 5
    assert stroke["pointer"] == "mouse"  # which it was pressed with
    assert stroke["speeds"][-1] == pytest.approx(0.1 + 0.4 * 0.15, abs=0.001)
    assert times["sent"] == 0  # ink needs no server


def test_a_walk_is_shown_and_the_person_is_measured_where_they_will_be(rig: StageRig, visit: Visit) -> None:
    visitor = visit(width=800, height=500)
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", timeout_s=60)
    stage = rig.server.stage("amber")
    assert isinstance(stage, Stage)
    begin = SCENE.person.pose
    away = Walk((0.0, 2.0), (begin.x, begin.x + 1.0), (begin.y, -1.0), (begin.yaw, begin.yaw))
    stands = Walk((0.0, 2.0), (begin.x, begin.x), (begin.y, begin.y), (begin.yaw, begin.yaw))
    walks = [replace(SCENE, walk=walk) for walk in (stands, away)]
    stage.draw(SCENE, "top_down", Paper("sheet-1", walks=walks))
    visitor.wait_for("ready")
    visitor.wait_for("drawing")
    assert newest(visitor)["must_choose"]
    drag(visitor, arc(0.5, begin.y))
    assert newest(visitor)["length_m"] == 0, "first it is chosen how the person walks"
    order(visitor, do="choose", walk=0)
    visitor.wait_until(lambda: newest(visitor)["walk"] == 0, "one is chosen")
    drag(visitor, arc(0.5, begin.y))
    visitor.wait_until(lambda: newest(visitor)["tight"] is not None, "who stands is in the way")
    order(visitor, do="choose", walk=1)
    visitor.wait_until(lambda: newest(visitor)["tight"] is None, "who has gone is not")
    drag(visitor, arc(1.0, begin.y)[12:])
    assert visitor.wait_for("stroke")["walk"] == 1


def test_who_walks_beside_a_drive_is_recorded_and_kept_out_of_walls(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", timeout_s=60)
    stage = rig.server.stage("amber")
    assert isinstance(stage, Stage)
    beside = drive(SCENE, duration_s=3.0, bend_m=0.8)
    drawn = {
        "points": [list(place) for place in arc(bend_m=0.8)],
        "speeds": [0.2] * 25,
        "times_s": [0.1 * k for k in range(25)],
    }
    sketch = Paper("sheet-1", drawn=drawn, resting=True)
    stage.play(beside, label="", view="first_person", playback_id="walk", goal=True, walking=True, paper=sketch)
    visitor.wait_for("playing")
    assert visitor.frame.evaluate("document.documentElement.dataset.drawing") == "rests", "the path lies on the floor"
    order(visitor, do="step", key="w", down=True)
    walk = visitor.wait_for("played", playback_id="walk")["walk"]
    times, poses = np.array(walk["times_s"]), np.array(walk["poses"])
    assert np.diff(times) == pytest.approx(1 / 30, abs=2e-4)
    assert times[-1] == pytest.approx(3.0, abs=0.05)
    assert poses[0, :2] == pytest.approx([SCENE.person.pose.x, SCENE.person.pose.y], abs=1e-3)
    speeds = np.hypot(*np.diff(poses[:, :2], axis=0).T) * 30
    assert 0.5 < speeds.max() < 1.4
    assert SCENE.room is not None
    assert np.abs(poses[:, 1]).max() <= SCENE.room.width / 2 - SCENE.person.radius + 0.011
    # Through where the person stands: they met, and the drive ends there.
    through = drive(SCENE, duration_s=3.0, bend_m=SCENE.person.pose.y)
    stage.play(through, label="", view="first_person", playback_id="met", goal=True, walking=True)
    assert 0.5 < visitor.wait_for("played", playback_id="met")["walk"]["times_s"][-1] < 2.5
    # Both from outside, from above and from the side.
    outside = replace(through, scene=replace(SCENE, walk=Walk.recorded(times, poses)))
    stage.play(outside, label="", view="top_down", playback_id="outside", goal=True)
    visitor.wait_for("playing", playback_id="outside")
    where = (
        "(() => { const poses = window.__viserMutable.nodePoseData;"
        " return poses[Object.keys(poses).find((name) => /person$/.test(name))].position; })()"
    )
    visitor.wait_until(lambda: abs(visitor.frame.evaluate(where)[0] - poses[0, 0]) > 0.5, "the person walks")
    order(visitor, do="look", **{"from": "side"})
    visitor.wait_until(lambda: visitor.frame.evaluate("document.documentElement.dataset.camera") == "free", "it turns")
    visitor.wait_for("played", playback_id="outside")

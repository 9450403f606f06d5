"""The stage as a participant's browser has it: scenes stand, drives play to their end, nothing else can be done."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from desirepath_stage import viser_hooks
from desirepath_stage.paper import Beside
from desirepath_stage.stage import HOLD_S, Stage
from tests.stage.stage_rig import StageRig, Visitor, drive, open_field, study_room

Visit = Callable[..., Visitor]


def stage_of(visitor: Visitor) -> Stage:
    """The server's side of this visitor's stage, once it is connected."""
    visitor.wait_for("connected")
    for _ in range(400):
        stage = visitor.rig.server.stage(visitor.key)
        if stage is not None:
            return stage
        visitor.page.wait_for_timeout(25)
    raise AssertionError("the stage server never saw the page")


LABEL_S = 4.0
"""A slow machine too can look while the label stands."""


def test_a_drive_plays_to_its_end_and_the_page_hears_of_it(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    trajectory = drive(study_room(), duration_s=1.6)
    stage.show(trajectory.scene, "top_down", trajectories=[trajectory])
    visitor.wait_for("ready")
    stage.play(trajectory, label="A", view="top_down", playback_id="first", label_s=LABEL_S)
    visitor.wait_for("label", playback_id="first", label="A")
    label = visitor.frame.locator("#desire-path-label")
    assert label.inner_text() == "A"
    assert np.allclose(visitor.robot()[:2], trajectory.poses[0, :2], atol=1e-3)
    visitor.wait_for("playing", playback_id="first")
    assert not label.is_visible()
    played = visitor.wait_for("played", playback_id="first")
    assert np.allclose(visitor.robot()[:2], trajectory.poses[-1, :2], atol=1e-3)
    assert played["frames"] > 3
    # The browser's clock, not ours: label, motion and rest have all been waited for.
    assert played["duration_ms"] >= 1000 * (LABEL_S + trajectory.duration_s + HOLD_S) - 1
    assert [event["type"] for event in visitor.events() if event.get("playback_id")] == ["label", "playing", "played"]
    assert len(visitor.events("ready")) == 1, "playing in the scene that stands must not rebuild it"


def test_a_slow_machine_gets_a_plain_floor_and_fewer_pixels(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    stage.show(study_room(), "top_down")
    visitor.wait_for("ready")
    full = visitor.frame.evaluate("document.querySelector('canvas').width")
    stage.detail = "light"
    stage.show(study_room(), "first_person")
    visitor.wait_for("ready", count=2)
    light = visitor.frame.evaluate("document.querySelector('canvas').width")
    assert light == pytest.approx(0.6 * full, abs=1)


def test_a_and_b_share_one_frame_in_the_open(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    scene = open_field()
    pair = [drive(scene, duration_s=0.4, bend_m=bend) for bend in (5.0, -0.5)]
    cameras = []
    for count, trajectory in enumerate(pair, start=1):
        stage.play(
            trajectory, label="", view="top_down", playback_id=str(count), trajectories=pair if count == 1 else ()
        )
        visitor.wait_for("played", playback_id=str(count))
        cameras.append(visitor.camera())
    assert cameras[0] == cameras[1]
    assert len(visitor.events("ready")) == 1
    stage.play(drive(scene, duration_s=0.4, bend_m=9.0), label="", view="top_down", playback_id="wide")
    visitor.wait_for("played", playback_id="wide")
    assert visitor.camera()[2] > cameras[0][2], "a path that leaves the frame gets a wider one"


def test_a_stage_whose_page_is_gone_takes_orders_in_silence(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    visitor.page.goto("about:blank")
    while rig.server.stage("amber") is not None:
        visitor.page.wait_for_timeout(50)
    visitor.page.wait_for_timeout(100)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # viser warns about orders that nobody will get
        stage.play(drive(open_field()), label="A", view="top_down", playback_id="late")
        stage.clear()


def test_a_driven_clock_shortens_the_wait(rig: StageRig, chromium: Any) -> None:
    context = chromium.new_context(viewport={"width": 320, "height": 200})
    context.clock.install()
    visitor = Visitor(context.new_page(), rig, "swift")
    stage = stage_of(visitor)
    trajectory = drive(open_field(), duration_s=60.0)
    stage.play(trajectory, label="B", label_s=2.0, view="first_person", playback_id="long")
    visitor.wait_for("label", playback_id="long")
    visitor.page.clock.fast_forward(2100)
    visitor.wait_for("playing", playback_id="long")
    visitor.page.clock.fast_forward(62_000)
    played = visitor.wait_for("played", playback_id="long")
    assert played["duration_ms"] >= 62_600, "by the browser's clock; by ours, `wait_for` gives up before that"
    context.close()


@pytest.mark.parametrize("view", ["top_down", "first_person"])
def test_the_camera_is_locked_and_visers_controls_are_out_of_reach(rig: StageRig, visit: Visit, view: str) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    stage.show(study_room(), view)  # type: ignore[arg-type]
    visitor.wait_for("ready")
    before = visitor.camera()
    mouse, keyboard = visitor.page.mouse, visitor.page.keyboard
    mouse.move(200, 150)
    for button in ("left", "right", "middle"):
        mouse.down(button=button)  # type: ignore[arg-type]
        mouse.move(300, 60, steps=4)
        mouse.up(button=button)  # type: ignore[arg-type]
        mouse.move(200, 150)
    mouse.wheel(0, 600)
    for key in ("w", "a", "s", "d", "q", "e", "ArrowLeft", "ArrowUp", "Control+k", "Control+Shift+p", "Tab", "Enter"):
        keyboard.press(key)
    visitor.page.wait_for_timeout(400)
    assert np.allclose(visitor.camera(), before, atol=1e-6)
    visible = visitor.frame.evaluate(
        "[...document.body.querySelectorAll('*')].filter((e) => getComputedStyle(e).visibility !== 'hidden')"
        ".map((e) => e.id || e.tagName)"
    )
    assert {name for name in visible if name != "CANVAS"} <= {
        "desire-path-sheet",
        "desire-path-label",
        "desire-path-headset",
        "desire-path-sound",
        "desire-path-legend",
        "desire-path-strip",
        "desire-path-finder",
        *("SPAN", "I", "B"),
    }
    hit = visitor.frame.evaluate(
        "[[5,5],[160,100],[315,5],[315,195],[20,185]].map(([x, y]) => document.elementFromPoint(x, y).id)"
    )
    assert set(hit) == {"desire-path-sheet"}
    assert visitor.frame.evaluate("document.activeElement.id || document.activeElement.tagName") in (
        "desire-path-sheet",
        "BODY",
    )


def test_from_above_the_whole_room_is_in_sight_in_any_window(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    scene = study_room()
    stage.show(scene, "top_down")
    visitor.wait_for("ready")
    corners = [[sx * 4.2, sy * 5.7, 0.0] for sx in (-1, 1) for sy in (-1, 1)]

    def spread() -> float:
        """How far out the outermost corner lies: 1 is the edge of the window."""
        on_screen = visitor.frame.evaluate(
            """(corners) => { const { camera, nodeRefFromName } = window.__viserMutable;
            camera.updateMatrixWorld(); const turn = nodeRefFromName[''].quaternion;
            return corners.map((c) => { const v = camera.position.clone().set(...c).applyQuaternion(turn);
            v.project(camera); return [v.x, v.y]; }); }""",
            corners,
        )
        return float(np.abs(np.array(on_screen)).max())

    for width, height in ((480, 300), (300, 480), (640, 200)):
        visitor.page.set_viewport_size({"width": width, "height": height})
        visitor.wait_until(lambda: 0.9 < spread() <= 1.0, f"the room fills {width}x{height} and nothing is cut off")


def test_first_person_looks_from_the_eyes_and_follows_the_robot(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    trajectory = drive(study_room(), duration_s=1.0)
    stage.play(trajectory, label="", view="first_person", playback_id="p")
    visitor.wait_for("played", playback_id="p")
    person, end = trajectory.scene.person.pose, trajectory.poses[-1]
    bearing = math.atan2(end[1] - person.y, end[0] - person.x)

    def watches_the_robot() -> bool:
        dx, dy = visitor.camera()[3:5]
        return math.isclose(math.atan2(dy, dx), bearing, abs_tol=0.01)

    visitor.wait_until(watches_the_robot, "the camera looks at the robot")
    x, y, z, _, _, dz = visitor.camera()
    assert np.allclose((x, y), (person.x, person.y), atol=1e-3)
    assert 1.5 < z < 1.65
    assert dz < 0
    assert visitor.frame.evaluate("window.__viserMutable.camera.fov") == pytest.approx(60)


def test_immersive_turns_the_head_and_never_moves_the_feet(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    stage.show(open_field(), "immersive")
    visitor.wait_for("ready")
    start = visitor.camera()

    def turned_since(before: list[float]) -> float:
        return float(np.linalg.norm(np.subtract(visitor.camera()[3:], before[3:])))

    mouse = visitor.page.mouse
    mouse.move(140, 120)
    mouse.down()
    mouse.move(240, 90, steps=5)
    mouse.up()
    mouse.wheel(0, 900)
    visitor.wait_until(lambda: turned_since(start) > 0.2, "a drag turns the head")
    dragged = visitor.camera()
    assert np.allclose(dragged[:3], start[:3], atol=1e-6)
    visitor.page.keyboard.down("ArrowLeft")
    visitor.wait_until(lambda: turned_since(dragged) > 0.1, "an arrow key turns the head")
    visitor.page.keyboard.up("ArrowLeft")
    assert np.allclose(visitor.camera()[:3], start[:3], atol=1e-6)
    visitor.page.keyboard.press("b")
    assert visitor.wait_for("key")["key"] == "b"


def test_nothing_that_is_sent_tells_the_goal(rig: StageRig, visit: Visit, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[str] = []
    monkeypatch.setattr(viser_hooks, "run_javascript", lambda client, source: sent.append(source))
    visitor = visit()
    stage = stage_of(visitor)
    trajectory = drive(study_room(), duration_s=1.0)
    stage.play(trajectory, label="A", view="top_down", playback_id="x")
    for source in sent:
        order = json.loads(source.removeprefix("window.desirePath.run(").removesuffix(")"))
        assert set(order) <= {
            *("type", "camera", "meshes", "robots", "person", "crowd", "stands", "walk", "start", "sharpness"),
            *("playback_id", "label", "label_s", "hold_s", "tracks", "paper", "explained", "halted", "goal"),
            "robot_size",
        }
        assert order.get("goal") is None
        assert not any(name.endswith(("/goal", "/trail", "/ring")) for name in order.get("meshes", ()))
        assert order.get("paper") is None  # a pair of dots says where a path was to end
        assert order.get("explained") is order.get("halted") is None  # both are asked for where the goal is to be seen


TRAIL = """() => {
  const [mesh] = window.desirePath.viser.meshes("/scene1/trail");
  const { position, color } = mesh.geometry.attributes;
  const at = (k) => [...position.array.slice(3 * k, 3 * k + 3), color.array[4 * k + 3]];
  return Array.from({ length: position.count / 4 }, (_, piece) => at(4 * piece));
}"""


def test_where_it_is_asked_for_the_goal_stands_there_and_a_trail_fades_behind_the_robot(
    rig: StageRig, visit: Visit
) -> None:
    visitor = visit(width=800, height=500)
    stage = stage_of(visitor)
    trajectory = drive(study_room(), duration_s=4.0)
    stage.play(trajectory, label="", view="top_down", playback_id="x", goal=True)
    visitor.wait_for("played", playback_id="x")
    assert math.dist(visitor.position_of("goal")[:2], (trajectory.scene.goal.x, trajectory.scene.goal.y)) < 1e-6
    pieces = np.array(visitor.frame.evaluate(TRAIL))
    shown = pieces[pieces[:, 3] > 0]
    end, start = trajectory.poses[-1, :2], trajectory.poses[0, :2]
    assert math.dist(shown[0, :2], end) < 0.1
    assert math.dist(shown[-1, :2], start) < 0.4
    assert np.all(np.diff(shown[:, 3]) <= 0), "the older, the fainter"
    assert shown[:, 2].max() < 0.02, "on the floor, under the robot"


ON_SCREEN = """(places) => {
  const project = window.desirePath.viser.projector();
  return places.map(([x, y, z]) => project(x, y, z));
}"""
LABEL = """() => {
  const { left, right, top, bottom } = document.getElementById("desire-path-label").getBoundingClientRect();
  return [left, top, right, bottom, document.getElementById("desire-path-label").hidden];
}"""


@pytest.mark.parametrize(("width", "height"), [(1024, 480), (390, 606)])
def test_the_letter_covers_neither_robot_nor_person_nor_goal_and_a_and_b_have_one_place(
    rig: StageRig, visit: Visit, width: int, height: int
) -> None:
    visitor = visit(width=width, height=height)
    stage = stage_of(visitor)
    for seed in (1, 5):
        scene = study_room(seed)
        pair = [drive(scene, duration_s=0.4, bend_m=bend) for bend in (1.5, -1.5)]
        boxes = []
        for letter, trajectory in zip("AB", pair, strict=True):
            key = f"{letter}{seed}"
            stage.play(
                trajectory, label=letter, label_s=1.5, view="top_down", playback_id=key, trajectories=pair, goal=True
            )
            visitor.wait_for("label", playback_id=key)
            visitor.page.wait_for_timeout(400)
            *box, hidden = visitor.frame.evaluate(LABEL)
            assert not hidden
            boxes.append(box)
            places = [(one.x, one.y, 0.2) for one in (scene.start, scene.goal, scene.person.pose)]
            left, top, right, bottom = box
            for x, y in visitor.frame.evaluate(ON_SCREEN, places):
                away = max(left - x, x - right, top - y, y - bottom)
                assert away > 20, f"the letter at {box} covers ({x}, {y})"
            visitor.wait_for("played", playback_id=key)
        assert boxes[0] == boxes[1]


def test_robot_and_person_are_large_enough_to_be_looked_at_where_a_pair_is_shown(rig: StageRig, visit: Visit) -> None:
    """In the stage that a page of 1024 x 640 has, where the whole room gives a robot 20 pixels."""
    visitor = visit(width=1024, height=480)
    stage = stage_of(visitor)
    scene = study_room()
    pair = [drive(scene, duration_s=1.0, bend_m=bend) for bend in (1.0, -0.6)]
    stage.show(scene, "top_down", trajectories=pair, goal=True)
    visitor.wait_for("ready")
    x, y = scene.start.x, scene.start.y
    (a, b) = visitor.frame.evaluate(ON_SCREEN, [(x - 0.18, y, 0.3), (x + 0.18, y, 0.3)])
    assert math.dist(a, b) > 30
    corners = [(*one, 0.0) for one in np.concatenate([one.poses[:, :2] for one in pair])]
    for px, py in visitor.frame.evaluate(ON_SCREEN, [[float(value) for value in one] for one in corners]):
        assert 10 < px < 1014
        assert 10 < py < 470


FINDER = """() => {
  const arrow = document.getElementById("desire-path-finder");
  const box = arrow.getBoundingClientRect();
  return arrow.hidden ? null : [(box.left + box.right) / 2, (box.top + box.bottom) / 2];
}"""


def test_an_arrow_at_the_edge_tells_where_a_robot_is_that_is_out_of_sight(rig: StageRig, visit: Visit) -> None:
    visitor = visit(width=800, height=500)
    stage = stage_of(visitor)
    stage.show(study_room(), "immersive")
    visitor.wait_for("ready")
    visitor.page.wait_for_timeout(200)
    assert visitor.frame.evaluate(FINDER) is None, "the gaze begins at the robot"
    for left, edge in ((1.2, 760), (-2.4, 40)):  # the head turns left: the robot is at the right edge
        visitor.frame.evaluate(f"window.desirePath.camera.turn({left}, 0)")
        visitor.wait_until(lambda: visitor.frame.evaluate(FINDER) is not None, "the arrow is shown")
        visitor.wait_until(lambda x=edge: abs(visitor.frame.evaluate(FINDER)[0] - x) < 3, "at its edge")
    visitor.frame.evaluate("window.desirePath.camera.recentre()")
    visitor.wait_until(lambda: visitor.frame.evaluate(FINDER) is None, "it is in sight again")
    stage.show(study_room(), "top_down")
    visitor.wait_for("ready", count=2)
    visitor.page.wait_for_timeout(200)
    assert visitor.frame.evaluate(FINDER) is None


BRIGHTNESS = """(name) => window.desirePath.viser.meshes(name).map(({ material }) => material.color.r)"""


def test_in_the_dark_the_room_is_dimmed_and_who_is_in_it_is_not(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    stage.show(study_room(), "top_down")
    visitor.wait_for("ready")
    light = visitor.frame.evaluate("getComputedStyle(document.body).backgroundColor")
    assert set(visitor.frame.evaluate(BRIGHTNESS, "/scene1/place")) == {1}
    visitor.page.emulate_media(color_scheme="dark")
    visitor.wait_until(lambda: max(visitor.frame.evaluate(BRIGHTNESS, "/scene1/place")) < 0.6, "it is dimmed")
    assert max(visitor.frame.evaluate(BRIGHTNESS, "/scene1/person")) > 2, "a dark figure is light then"
    assert set(visitor.frame.evaluate(BRIGHTNESS, "/scene1/robot0/body")) == {1}
    assert visitor.frame.evaluate("getComputedStyle(document.body).backgroundColor") != light


def test_a_legend_lies_above_the_picture_and_covers_none_of_it(rig: StageRig, visit: Visit) -> None:
    visitor = visit(width=390, height=500)
    stage = stage_of(visitor)
    scene = study_room()
    stage.show(scene, "top_down")
    visitor.wait_for("ready")
    entries = "[1, 2, 3].map((k) => ({ name: `a way with a long name, ${k}`, colour: [0, 0, 0] }))"
    visitor.frame.evaluate(f"window.desirePath.sheet.legend({entries})")
    covered = "document.getElementById('desire-path-strip').getBoundingClientRect().bottom"
    assert visitor.frame.evaluate(covered) > 40
    assert scene.room is not None
    x, y = scene.room.length / 2, scene.room.width / 2
    corners = [(a * x, b * y, 0.0) for a in (-1, 1) for b in (-1, 1)]

    def free() -> bool:
        bottom = visitor.frame.evaluate(covered)
        return all(bottom <= py < 500 for _, py in visitor.frame.evaluate(ON_SCREEN, corners))

    visitor.wait_until(free, "the whole room lies under the legend")


def test_a_hidden_tab_interrupts_the_drive(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    stage.play(drive(open_field(), duration_s=20), label="", view="top_down", playback_id="h")
    visitor.wait_for("playing", playback_id="h")
    # Headless Chromium never hides a tab: say so in its place.
    visitor.frame.evaluate(
        "Object.defineProperty(document, 'hidden', {get: () => true, configurable: true});"
        "document.dispatchEvent(new Event('visibilitychange'))"
    )
    assert visitor.wait_for("interrupted", playback_id="h")["reason"] == "tab-hidden"
    visitor.wait_for("tab-hidden")
    visitor.page.wait_for_timeout(300)
    assert visitor.events("played") == []


def test_a_lost_webgl_context_interrupts_the_drive(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    stage.play(drive(open_field(), duration_s=20), label="", view="top_down", playback_id="g")
    visitor.wait_for("playing", playback_id="g")
    visitor.frame.evaluate(
        "document.querySelector('#root canvas[data-engine]').getContext('webgl2')"
        ".getExtension('WEBGL_lose_context').loseContext()"
    )
    assert visitor.wait_for("interrupted", playback_id="g")["reason"] == "webgl-lost"
    visitor.wait_for("webgl-lost")


def test_after_a_server_restart_the_page_comes_back_without_focus(rig: StageRig, visit: Visit) -> None:
    rig.on_connect = lambda stage, key: stage.show(study_room(), "top_down")
    visitor = visit()
    visitor.wait_for("ready")
    stage = rig.server.stage("amber")
    assert stage is not None
    stage.play(drive(study_room(), duration_s=30), label="", view="top_down", playback_id="cut")
    visitor.wait_for("playing", playback_id="cut")
    visitor.page.evaluate("document.body.focus(); window.focus()")
    rig.restart_stage_server()
    assert visitor.wait_for("interrupted", playback_id="cut")["reason"] == "connection-lost"
    visitor.wait_for("connection-lost")
    visitor.wait_for("connected", count=2)
    visitor.wait_for("ready", count=2)
    assert rig.connections == ["amber", "amber"]


def test_a_second_tab_takes_over_and_the_first_one_stays_away(rig: StageRig, visit: Visit) -> None:
    rig.on_connect = lambda stage, key: stage.show(open_field(), "top_down")
    first = visit()
    first.wait_for("ready")
    second = visit()
    second.wait_for("ready")
    first.wait_for("replaced")
    second.page.wait_for_timeout(2500)
    assert second.events("connection-lost") == []
    assert rig.connections == ["amber", "amber"]


def test_the_parent_may_say_hello_and_no_one_else_may(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage_of(visitor)
    visitor.frame.evaluate("window.postMessage({type: 'hello'}, '*')")  # not from the parent window
    visitor.page.evaluate(
        f"document.querySelector('#stage').contentWindow.postMessage({{type: 'hello'}}, '{rig.stage_origin}')"
    )
    answer = visitor.wait_for("state")
    assert answer["connected"] is True
    visitor.page.wait_for_timeout(200)
    assert len(visitor.events("state")) == 1


def test_analysts_replay_two_drives_of_one_scene(rig: StageRig, visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    left, right = drive(open_field(), bend_m=1.0), drive(open_field(), bend_m=-1.0)
    with pytest.raises(ValueError, match=r"one scene"):
        stage.replay((left, drive(study_room())), names=("base", "aligned"))
    with pytest.raises(ValueError, match=r"one or two"):
        stage.replay((), names=())
    with pytest.raises(ValueError, match=r"speed"):
        stage.replay((left, right), names=("base", "aligned"), speed=0)
    drawn = Beside("drawn", (47, 106, 61), [left.poses, right.poses[:, :2]])
    stage.replay((left, right), names=("base", "aligned"), speed=3.0, loop=False, beside=[drawn])
    visitor.wait_for("ready")
    assert visitor.frame.locator("#desire-path-legend").inner_text().split() == ["base", "aligned", "drawn"]

    def both_at_the_end() -> bool:
        ends = visitor.frame.evaluate(
            "Object.entries(window.__viserMutable.nodePoseData).filter(([name]) => /robot[01]$/.test(name))"
            ".map(([, pose]) => pose.position.slice(0, 2))"
        )
        return np.allclose(ends, [left.poses[-1, :2], right.poses[-1, :2]], atol=1e-3)

    visitor.wait_until(both_at_the_end, "both robots reach their ends")
    before = visitor.camera()
    visitor.page.mouse.move(240, 150)
    visitor.page.mouse.down()
    visitor.page.mouse.move(300, 100, steps=4)
    visitor.page.mouse.up()
    visitor.wait_until(lambda: not np.allclose(visitor.camera(), before, atol=1e-3), "analysts may move the camera")

"""The immersive view on a headset: put on by a button, standing where the person stands, answered by a ray."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser

from desirepath.explain.ranking_sets import RankingSet
from desirepath.explain.shown_explanation import ShownExplanation
from desirepath.learning.shipped_files import resolve
from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath.store.head_poses import samples_problem
from desirepath.web.participant.sent import HeadMoved
from desirepath_stage.paper import Paper
from desirepath_stage.stage import Stage
from tests.fewer_pictures import draw_fewer_pictures
from tests.headset import (
    EYES_M,
    HEAD,
    LOOK,
    aim,
    draw_by_ray,
    hold_trigger,
    lean_stick,
    plug_in_headset,
    pull_trigger_at,
    put_on,
    take_off,
    wait_for_pictures,
)
from tests.stage.stage_rig import StageRig, Visitor, drive, study_room
from tests.stage.test_stage import stage_of

PANEL = {
    "count": "Pair 3 of 15",
    "text": "Which of the two drives would you rather live with?",
    "hint": "",
    "rows": [],
    "quiet": False,
    "beside": False,
    "progress": None,
    "buttons": [
        {"id": "a", "text": "A", "letter": True},
        {"id": "b", "text": "B", "letter": True, "resting": True},
        {"id": "leave", "text": "Take off the headset", "tool": True},
    ],
}
Wear = Callable[..., Visitor]


@pytest.fixture
def wear(chromium: Browser, rig: StageRig) -> Iterator[Wear]:
    """Open the stage in a browser with a headset; `script` runs before everything in every frame."""
    contexts = []

    def open_page(script: str = "", headset: bool = True, allow: str = "xr-spatial-tracking") -> Visitor:
        context = chromium.new_context(viewport={"width": 320, "height": 200})
        contexts.append(context)
        draw_fewer_pictures(context)
        if headset:
            plug_in_headset(context)
        context.add_init_script(script or "0")
        rig.allow = allow
        return Visitor(context.new_page(), rig, "amber")

    yield open_page
    for context in contexts:
        context.close()


def tell(visitor: Visitor, order: dict[str, Any]) -> None:
    """What the page around the stage says."""
    visitor.page.evaluate(
        "(order) => document.getElementById('stage').contentWindow.postMessage({ type: 'headset', ...order }, '*')",
        order,
    )


def offer(visitor: Visitor) -> Stage:
    """A drive stands ready in the immersive view, in a study that offers a headset."""
    stage = stage_of(visitor)
    trajectory = drive(study_room(), duration_s=1.2)
    stage.show(trajectory.scene, "immersive", trajectories=[trajectory])
    visitor.wait_for("ready")
    tell(visitor, {"do": "offer", "words": {"enter": "Put on the headset"}})
    return stage


def test_one_stands_where_the_person_stands_and_answers_by_ray(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    offer(visitor)
    tell(visitor, {"do": "panel", "panel": PANEL})
    put_on(visitor.frame)
    visitor.wait_for("headset", on=True, here=True)
    scene = study_room()
    person, start = scene.person.pose, scene.start

    def stands() -> bool:
        eyes = np.array(visitor.frame.evaluate(HEAD)["eyes"])
        return bool(np.allclose(eyes.mean(0), [person.x, person.y, EYES_M], atol=0.02))

    visitor.wait_until(stands, "the eyes are above the person's place, as high as they are")
    seen = visitor.frame.evaluate(HEAD)
    left, right = np.array(seen["eyes"])
    assert 0.05 < np.linalg.norm(left - right) < 0.08, "two eyes, as far apart as people's"
    ahead = math.atan2(start.y - person.y, start.x - person.x)
    assert math.cos(math.atan2(seen["along"][1], seen["along"][0]) - ahead) > 0.999, "the robot's start is ahead"
    pull_trigger_at(visitor.frame, "a")
    visitor.wait_for("headset-press", id="a")
    assert visitor.events("headset-press")[-1]["headset"]["controllers"] == ["meta-quest-touch-plus"]
    visitor.frame.evaluate("window.headset.position.y += 0.2")

    def taller() -> bool:
        return bool(abs(np.array(visitor.frame.evaluate(HEAD)["eyes"])[:, 2].mean() - EYES_M - 0.2) < 0.01)

    visitor.wait_until(taller, "who stands up looks from higher up")
    assert not visitor.frame.evaluate("window.desirePath.headsetRoom.may('b')"), "B rests"
    pull_trigger_at(visitor.frame, "leave")
    visitor.wait_for("headset", on=False, count=2)
    window = [person.x, person.y, scene.person.eye_height_m]
    visitor.wait_until(lambda: np.allclose(visitor.camera()[:3], window, atol=1e-3), "the window is as it was")


def test_what_is_watched_in_it_says_so_and_leaving_cuts_it_short(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    stage = offer(visitor)
    trajectory = drive(study_room(), duration_s=1.2)
    stage.play(trajectory, label="A", label_s=0.2, view="immersive", playback_id="window", trajectories=[trajectory])
    assert visitor.wait_for("played", playback_id="window")["headset"] is None
    put_on_with_panel(visitor)
    stage.play(trajectory, label="A", label_s=0.2, view="immersive", playback_id="worn", trajectories=[trajectory])
    told = visitor.wait_for("played", playback_id="worn")["headset"]
    assert told["controllers"] == ["meta-quest-touch-plus"]
    assert told["pointing"] == ["controller"]
    assert told["frames"] > 0
    long = drive(study_room(), duration_s=60)
    stage.play(long, label="", view="immersive", playback_id="cut", trajectories=[trajectory])
    visitor.wait_for("playing", playback_id="cut")
    take_off(visitor.frame)
    assert visitor.wait_for("interrupted", playback_id="cut")["reason"] == "headset"
    put_on_with_panel(visitor)
    visitor.wait_for("headset", on=True, count=2)


def test_how_the_head_moves_is_told_where_it_is_asked_for(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    stage = offer(visitor)
    tell(visitor, {"do": "offer", "words": {"enter": "Put on the headset"}, "head_pose": True})
    put_on_with_panel(visitor)
    wait_for_pictures(visitor.frame)
    trajectory = drive(study_room(), duration_s=1.2)
    stage.play(trajectory, label="A", label_s=0.2, view="immersive", playback_id="worn", trajectories=[trajectory])
    visitor.wait_for("played", playback_id="worn")
    half = 0.7
    visitor.frame.evaluate(f"window.headset.quaternion.set(0, {math.sin(half)}, 0, {math.cos(half)})")  # to the left
    wait_for_pictures(visitor.frame)
    take_off(visitor.frame)
    visitor.wait_for("headset", on=False, count=2)
    heads = [event["head"] for event in visitor.events("head")]
    assert [head["part"] for head in heads] == list(range(len(heads)))
    assert len({head["wearing"] for head in heads}) == 1
    assert {head["playback_id"] for head in heads} == {None, "worn"}
    for head in heads:
        assert samples_problem(head["times_s"], head["poses"]) is None
        HeadMoved.model_validate(head)
    before, *_, after = [pose for head in heads for pose in head["poses"]]
    scene = study_room()
    person, start = scene.person.pose, scene.start
    assert before[:3] == pytest.approx([person.x, person.y, EYES_M], abs=0.02)
    ahead = math.atan2(start.y - person.y, start.x - person.x)
    for pose, yaw in ((before, ahead), (after, ahead + 2 * half)):
        assert abs(np.dot(pose[3:], [0, 0, math.sin(yaw / 2), math.cos(yaw / 2)])) > 0.999, "upright, and turned"


def test_an_arrow_tells_where_the_robot_is_that_is_out_of_sight(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    offer(visitor)
    put_on_with_panel(visitor)
    arrow = "window.desirePath.headsetRoom.found()"
    visitor.wait_until(lambda: visitor.frame.evaluate(arrow) == 0, "the robot is ahead")
    for turned_left, points in ((1.4, -1), (-1.4, 1)):
        half = turned_left / 2
        visitor.frame.evaluate(f"window.headset.quaternion.set(0, {math.sin(half)}, 0, {math.cos(half)})")

        def there(points: int = points) -> bool:
            return bool(visitor.frame.evaluate(arrow) == points)

        visitor.wait_until(there, "it points to where the robot is")


def test_a_pinch_and_a_long_look_press_too(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    offer(visitor)
    put_on_with_panel(visitor)
    visitor.frame.evaluate("window.headset.primaryInputMode = 'hand'")
    wait_for_pictures(visitor.frame)
    pull_trigger_at(visitor.frame, "a")
    visitor.wait_for("headset-press", id="a")
    visitor.frame.evaluate("Object.values(window.headset.hands).forEach((hand) => { hand.connected = false; })")
    wait_for_pictures(visitor.frame)
    visitor.frame.evaluate(LOOK, "a")
    visitor.wait_for("headset-press", id="a", count=2)
    told = visitor.frame.evaluate("window.desirePath.headset.report()")
    assert {"gaze", "hand"} <= set(told["pointing"])


SHEET = demonstration_scene("corridor", 0)


def paper(visitor: Visitor) -> Stage:
    """A sheet to draw on, seen from inside with the headset on."""
    stage = stage_of(visitor)
    stage.draw(SHEET, "immersive", Paper("sheet-1"))
    visitor.wait_for("ready")
    tell(visitor, {"do": "offer", "words": {"enter": "Put on the headset"}})
    visitor.wait_for("drawing")
    put_on_with_panel(visitor)
    visitor.wait_for("headset", on=True)
    return stage


def bend(begin: float, end: float) -> list[tuple[float, float]]:
    """From one share of the way between robot and goal to another, to the side of the person."""
    here, there = np.array([SHEET.start.x, SHEET.start.y]), np.array([SHEET.goal.x, SHEET.goal.y])
    shares = np.linspace(begin, end, 7)
    return [tuple(here + u * (there - here) + (0, 0.6 * math.sin(math.pi * u))) for u in shares]


def newest(visitor: Visitor) -> dict[str, Any]:
    return visitor.events("drawing")[-1]


def test_a_path_is_drawn_with_the_ray_and_goes_on_after_the_headset_was_off(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    paper(visitor)
    draw_by_ray(visitor.frame, [(SHEET.start.x, SHEET.start.y + 2.0), *bend(0.1, 0.2)])
    assert newest(visitor)["length_m"] == 0, "away from the ring nothing begins"
    draw_by_ray(visitor.frame, bend(0, 0.5), lets_go=False)
    visitor.wait_until(lambda: newest(visitor)["drawing"] and newest(visitor)["length_m"] > 2, "the line follows")
    visitor.frame.evaluate("window.headset.controllers.left.updateButtonValue('trigger', 1)")
    wait_for_pictures(visitor.frame)
    assert newest(visitor)["drawing"], "the other hand takes no pen away"
    take_off(visitor.frame)
    visitor.wait_until(lambda: newest(visitor)["can_finish"], "what was under the pen is drawn")
    assert visitor.frame.evaluate("window.desirePath.headsetFloor.lies()") is None, "it is over the window again"
    drawn = newest(visitor)["length_m"]
    visitor.frame.evaluate(
        "Object.values(window.headset.controllers).forEach((c) => c.updateButtonValue('trigger', 0))"
    )
    put_on_with_panel(visitor)
    visitor.wait_for("headset", on=True, count=2)
    assert newest(visitor)["length_m"] == drawn
    draw_by_ray(visitor.frame, bend(0.5, 1))
    stroke = visitor.wait_for("stroke", id="sheet-1")
    points = np.array(stroke["points"])
    assert np.hypot(*(points[-1] - [SHEET.goal.x, SHEET.goal.y])) <= SHEET.goal_radius
    assert np.hypot(*np.diff(points, axis=0).T).max() < 1.5, "no gap where it was taken off"
    assert (stroke["pointer"], stroke["headset"]["pointing"]) == ("controller", ["controller"])
    assert np.all(np.diff(stroke["times_s"]) >= 0)


def test_who_switches_the_controller_off_lifts_the_pen(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    paper(visitor)
    draw_by_ray(visitor.frame, bend(0, 0.4), lets_go=False)
    visitor.wait_until(lambda: newest(visitor)["drawing"], "it is being drawn")
    visitor.frame.evaluate("window.headset.controllers.right.connected = false")
    visitor.wait_until(lambda: newest(visitor)["can_finish"] and not newest(visitor)["drawing"], "it is lifted")


def eyes(visitor: Visitor) -> tuple[np.ndarray, float]:
    """Where they are on the floor, and the way that they look, rad."""
    seen = visitor.frame.evaluate(HEAD)
    return np.array(seen["eyes"]).mean(0)[:2], math.atan2(seen["along"][1], seen["along"][0])


def test_who_walks_does_so_with_real_steps_or_the_stick_and_no_wall_is_walked_through(
    rig: StageRig, wear: Wear
) -> None:
    visitor = wear()
    stage = paper(visitor)
    narrow = "window.desirePath.headsetRoom.narrowed()"
    beside = drive(SHEET, duration_s=40.0, bend_m=-0.8)
    stage.play(beside, label="", view="immersive", playback_id="walk", walking=True)
    visitor.wait_for("playing", playback_id="walk")
    wait_for_pictures(visitor.frame)
    stood, ahead = eyes(visitor)
    person = SHEET.person.pose
    assert stood == pytest.approx([person.x, person.y], abs=0.1)
    lean_stick(visitor.frame, "left", 0, -1)
    visitor.wait_until(lambda: visitor.frame.evaluate(narrow) == 1, "what is seen is narrow while the stick moves one")
    lean_stick(visitor.frame, "left", 0, 0)
    visitor.wait_until(lambda: visitor.frame.evaluate(narrow) == 0, "and wide again")
    walked = eyes(visitor)[0] - stood
    assert walked @ [math.cos(ahead), math.sin(ahead)] > max(0.1, 0.9 * np.hypot(*walked)), "it goes where one looks"
    lean_stick(visitor.frame, "right", 1, 0)
    wait_for_pictures(visitor.frame)
    wait_for_pictures(visitor.frame)
    assert (ahead - eyes(visitor)[1]) % (2 * math.pi) == pytest.approx(math.pi / 6, abs=0.01), "one step to the right"
    lean_stick(visitor.frame, "right", 0, 0)
    here = eyes(visitor)[0]
    visitor.frame.evaluate("window.headset.position.x += 0.3")
    visitor.wait_until(lambda: np.hypot(*(eyes(visitor)[0] - here)) == pytest.approx(0.3, abs=0.05), "a real step")
    tell(visitor, {"do": "comfort", "snap": False, "narrow": False})
    wait_for_pictures(visitor.frame)
    before = eyes(visitor)[1]
    lean_stick(visitor.frame, "right", -1, 0)
    visitor.wait_until(lambda: 0.2 < (eyes(visitor)[1] - before) % (2 * math.pi) < 3, "turned without steps")
    assert visitor.frame.evaluate(narrow) == 0
    lean_stick(visitor.frame, "right", 0, 0)
    visitor.frame.evaluate("window.headset.position.z -= 9; window.headset.position.x -= 9")  # through some wall
    dark = "window.desirePath.headsetRoom.darkness()"
    visitor.wait_until(lambda: visitor.frame.evaluate(dark) == 1, "in a wall nothing is seen")
    walk = visitor.frame.evaluate("window.desirePath.walk.recording()")
    poses = np.array(walk["poses"])
    assert poses[0, :2] == pytest.approx([person.x, person.y], abs=1e-3)
    assert SHEET.room is not None
    assert np.all(
        np.abs(poses[:, :2]) <= np.array([SHEET.room.length, SHEET.room.width]) / 2 - SHEET.person.radius + 0.02
    )
    stage.play(beside, label="", view="immersive", playback_id="again", walking=True)
    visitor.wait_for("playing", playback_id="again")
    visitor.wait_until(lambda: np.allclose(eyes(visitor)[0], [person.x, person.y], atol=0.1), "at the place again")
    visitor.wait_until(lambda: visitor.frame.evaluate(dark) == 0, "and sees")


SLIDER = {
    "text": "farther from me: 50",
    "share": 0.5,
    "ends": None,
    "buttons": [
        {"id": "far-less", "text": "-"},
        {"id": "far-set", "text": "", "slides": True},
        {"id": "far-more", "text": "+"},
    ],
}
BAR = """(share) => {
  const room = window.desirePath.headsetRoom;
  const [less, more] = [room.place("far-less"), room.place("far-more")], middle = room.place("far-set");
  return middle.map((value, i) => value + (share - 0.5) * 0.83 * (more[i] - less[i]));
}"""


def test_a_slider_is_held_and_moved_with_the_ray_or_by_its_buttons(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    offer(visitor)
    tell(visitor, {"do": "panel", "panel": {**PANEL, "rows": [SLIDER], "beside": True}})
    put_on(visitor.frame)
    pull_trigger_at(visitor.frame, "far-more")
    visitor.wait_for("headset-press", id="far-more")
    aim(visitor.frame, visitor.frame.evaluate(BAR, 0.25))
    hold_trigger(visitor.frame, True)
    visitor.wait_until(lambda: visitor.events("headset-press")[-1].get("settled") is False, "it is held")
    aim(visitor.frame, visitor.frame.evaluate(BAR, 0.75))
    visitor.wait_until(lambda: 0.7 < visitor.events("headset-press")[-1]["share"] < 0.8, "it follows the ray")
    take_off(visitor.frame)  # while it is held
    visitor.wait_until(lambda: visitor.events("headset-press")[-1]["settled"] is True, "it stays where it was")


def test_objects_are_named_in_the_room_and_picked_with_the_ray(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    stage = stage_of(visitor)
    one = RankingSet.load(resolve("explained_room/scenarios_48")).rollouts[2]
    scores = tuple(tuple(float(score) for score in row) for row in one.scores)
    shown = ShownExplanation(one.things, scores, outlines=True, lidar=True)
    stage.show(one.trajectory.scene, "immersive", trajectories=(one.trajectory,), explained=shown)
    visitor.wait_for("ready")
    tell(visitor, {"do": "offer", "words": {"enter": "Put on the headset"}})
    put_on_with_panel(visitor)
    first, second, *_ = one.things
    rank = "(message) => window.desirePath.explained.obey({ do: 'rank', ...message })"
    words = {thing: thing.upper() for thing in one.things}
    visitor.frame.evaluate(rank, {"words": words, "places": [], "pointed": None})
    wait_for_pictures(visitor.frame)
    labels = "window.desirePath.headsetRoom.labels()"
    assert set(visitor.frame.evaluate(labels)) >= {first.upper(), second.upper()}
    middle = (
        "(thing) => { const objects = window.desirePath.explained.objects();"
        " const { x, y, height } = objects.find((one) => one.thing === thing); return [x, y, 0.8 * height]; }"
    )
    visitor.frame.evaluate(
        "window.desirePath.headsetRoom.show({ ...window.desirePath.headsetRoom.shown(), quiet: true })"
    )
    for thing in one.things:
        aim(visitor.frame, visitor.frame.evaluate(middle, thing))
        hold_trigger(visitor.frame, True)
        hold_trigger(visitor.frame, False)
    picked = {event["thing"] for event in visitor.events("picked")}
    assert picked, "what stands in front is picked"
    visitor.frame.evaluate(rank, {"words": words, "places": [first], "pointed": None})
    visitor.wait_until(lambda: f"1  {first.upper()}" in visitor.frame.evaluate(labels), "with its place")


def put_on_with_panel(visitor: Visitor) -> None:
    tell(visitor, {"do": "panel", "panel": PANEL})
    put_on(visitor.frame)


@pytest.mark.parametrize(
    ("why", "headset", "allow", "script"),
    [
        ("blocked", True, "", ""),
        ("insecure", True, "xr-spatial-tracking", "Object.defineProperty(window, 'isSecureContext', { value: false })"),
        ("browser", False, "xr-spatial-tracking", "Object.defineProperty(navigator, 'xr', { value: undefined })"),
        ("missing", False, "xr-spatial-tracking", ""),
    ],
)
def test_where_none_can_be_worn_there_is_no_button_and_the_page_is_told_why(
    rig: StageRig, wear: Wear, why: str, headset: bool, allow: str, script: str
) -> None:
    visitor = wear(script, headset, allow)
    offer(visitor)
    visitor.wait_for("headset", on=False, here=True, why=why)
    assert not visitor.frame.locator("#desire-path-headset").is_visible()


def test_who_does_not_allow_it_can_try_again(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    offer(visitor)
    visitor.frame.evaluate(
        "() => { const ask = navigator.xr.requestSession.bind(navigator.xr); let first = true;"
        " navigator.xr.requestSession = (...about) => { if (!first) return ask(...about);"
        " first = false; return Promise.reject(new DOMException('no', 'NotAllowedError')); }; }"
    )
    visitor.frame.locator("#desire-path-headset").click()
    visitor.wait_for("headset", on=False, why="denied")
    put_on_with_panel(visitor)
    visitor.wait_for("headset", on=True, why=None)


def test_what_is_seen_in_the_window_has_no_button_and_leaving_is_told(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    offer(visitor)
    put_on_with_panel(visitor)
    visitor.wait_for("headset", on=True)
    tell(visitor, {"do": "offer", "words": None})
    pull_trigger_at(visitor.frame, "leave")
    visitor.wait_for("headset", on=False, count=2)
    assert not visitor.frame.locator("#desire-path-headset").is_visible()


def test_the_motors_are_heard_from_where_the_robot_is_once_they_are_switched_on(rig: StageRig, wear: Wear) -> None:
    visitor = wear(
        "window.built = 0; window.AudioContext = class extends AudioContext { constructor() { super(); built++; } }"
    )
    stage = offer(visitor)
    trajectory = drive(study_room(), duration_s=60)
    stage.play(trajectory, label="", view="immersive", playback_id="loud", trajectories=[trajectory])
    visitor.wait_for("playing", playback_id="loud")
    assert visitor.frame.evaluate("[window.built, window.desirePath.sound.heard()]") == [0, None], "silent"
    visitor.page.evaluate(
        "document.getElementById('stage').contentWindow.postMessage("
        "{ type: 'sound', words: { on: 'Sound', off: 'Silence' }, on: false }, '*')"
    )
    visitor.frame.get_by_role("button", name="Sound", pressed=False).click()
    visitor.wait_for("sound", on=True)
    heard = (
        "(() => { const { sound, viser } = window.desirePath, now = sound.heard();"
        " return { ...now, at: viser.fromView(now.place) }; })()"
    )

    def drives() -> bool:
        now = visitor.frame.evaluate(heard)
        return bool(now["state"] == "running" and now["gain"] > 0.01 and now["hz"] > 60)

    visitor.wait_until(drives, "it hums as it drives")
    visitor.wait_until(
        lambda: np.allclose(visitor.frame.evaluate(heard)["at"][:2], visitor.robot()[:2], atol=0.2), "there"
    )
    visitor.frame.get_by_role("button", name="Silence", pressed=True).click()
    visitor.wait_for("sound", on=False)
    visitor.wait_until(lambda: visitor.frame.evaluate(heard)["state"] == "suspended", "off")


def test_from_above_there_is_nothing_to_put_a_headset_on_for(rig: StageRig, wear: Wear) -> None:
    visitor = wear()
    stage = offer(visitor)
    visitor.frame.locator("#desire-path-headset").wait_for()
    stage.show(study_room(2), "top_down")
    visitor.wait_for("headset", here=False)
    assert not visitor.frame.locator("#desire-path-headset").is_visible()

"""Paths that the page sends are drawn at once, and a robot under way goes on along a new one without starting anew."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.trajectory import Trajectory
from desirepath_stage.stage import Stage
from tests.stage.stage_rig import StageRig, Visitor, drive, study_room

SCENE = study_room()
Visit = Callable[..., Visitor]
COUNT_RENDERS = """() => {
  const mutable = window.__viserMutable;
  const render = mutable.requestRender;
  window.renders = 0;
  window.renderedAt = performance.now();
  mutable.requestRender = (...given) => {
    window.renders += 1;
    window.renderedAt = performance.now();
    return render(...given);
  };
}"""
INKED = """() => {
  const canvas = document.getElementById("desire-path-ribbon");
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return data.some((value) => value > 0);
}"""
STILL = "performance.now() - window.renderedAt > 1000"


def steer(visitor: Visitor, **message: Any) -> None:
    """What the page orders."""
    visitor.page.evaluate(
        "([message, origin]) => document.getElementById('stage').contentWindow.postMessage(message, origin)",
        [{"type": "steer", **message}, visitor.rig.stage_origin],
    )


def path(rollout: Trajectory) -> dict[str, Any]:
    rows = np.column_stack([np.arange(len(rollout.poses)) * 0.2, rollout.poses]).round(4)
    return {"track": rows.tolist(), "arrives": True, "colour": [47, 106, 61], "hollow": False}


def test_a_robot_under_way_changes_its_style_without_restarting(rig: StageRig, visit: Visit) -> None:
    visitor = visit(width=640, height=400)
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", timeout_s=60)
    stage = rig.server.stage("amber")
    assert isinstance(stage, Stage)
    first = drive(SCENE, duration_s=8.0, bend_m=0.4)
    stage.live(SCENE, "top_down", trajectories=(first,))
    visitor.wait_for("ready")
    steer(visitor, do="paths", id="1", onward=False, paths=[path(first)], legend=[])
    visitor.wait_for("drawn", id="1")
    visitor.frame.evaluate(COUNT_RENDERS)
    visitor.frame.wait_for_function(STILL)  # viser's meshes and its camera come when they come
    before = visitor.frame.evaluate("window.renders")
    shorter = path(first)
    shorter["track"] = shorter["track"][:-5]
    steer(visitor, do="paths", id="2", onward=False, paths=[shorter], legend=[])
    visitor.wait_for("drawn", id="2")
    assert visitor.frame.evaluate("window.renders") == before  # the room is not drawn anew for a robot that stands

    steer(visitor, do="drive")
    visitor.wait_until(lambda: any(event["seconds"] > 1.5 for event in visitor.events("moved")), "it drives")
    here = visitor.events("moved")[-1]["poses"][0]
    start = replace(SCENE.start, x=here[0], y=here[1], yaw=here[2])
    steer(visitor, do="paths", id="3", onward=True, paths=[path(drive(replace(SCENE, start=start), duration_s=2.0))])
    visitor.wait_for("drawn", id="3")
    after = visitor.wait_for("moved", count=len(visitor.events("moved")) + 1)
    assert after["driving"]
    begun = (SCENE.start.x, SCENE.start.y)
    assert math.dist(after["poses"][0][:2], begun) > 0.5 * math.dist(here[:2], begun)
    end = visitor.wait_for("moved", over=True)["poses"][0]
    assert math.dist(end[:2], (SCENE.goal.x, SCENE.goal.y)) < 0.05

    assert visitor.frame.evaluate(INKED)
    steer(visitor, do="paths", id="4", onward=False, since=None, paths=[], legend=[])
    visitor.wait_for("drawn", id="4")
    assert not visitor.frame.evaluate(INKED)
    steer(visitor, do="paths", id="5", onward=False, since=None, paths=[path(first)], legend=[])
    visitor.wait_for("drawn", id="5")
    assert visitor.frame.evaluate(INKED)


def test_who_walks_there_walks_while_the_robots_drive_and_on_with_a_new_path(rig: StageRig, visit: Visit) -> None:
    visitor = visit(width=640, height=400)
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", timeout_s=60)
    stage = rig.server.stage("amber")
    assert isinstance(stage, Stage)
    hall = draw_scene("crowd_hall", 1)
    assert hall.crowd is not None
    walker = hall.crowd.pedestrians[0]
    stage.live(hall, "top_down", robots=2)
    visitor.wait_for("ready")
    way = path(drive(hall, duration_s=8.0, bend_m=0.4))
    steer(visitor, do="paths", id="1", onward=False, since=None, paths=[way, way], legend=[])
    visitor.wait_for("drawn", id="1")
    assert math.dist(visitor.position_of("pedestrian0")[:2], walker.route[0]) < 0.05, (
        "nobody walks before anybody drives"
    )

    steer(visitor, do="drive")
    visitor.wait_until(lambda: any(event["seconds"] > 1.5 for event in visitor.events("moved")), "they drive")
    here = visitor.events("moved")[-1]
    starts = [replace(hall.start, x=x, y=y, yaw=yaw) for x, y, yaw in here["poses"]]
    onward = [path(drive(replace(hall, start=start), duration_s=3.0)) for start in starts]
    steer(visitor, do="paths", id="2", onward=True, since=here["clocks"], paths=onward, legend=[])
    over = visitor.wait_for("moved", over=True)
    assert over["clocks"] == [here["clocks"][0] + 3.0, here["clocks"][1] + 3.0]
    there = walker.places_at(np.array([max(over["clocks"])]))[0]
    assert math.dist(visitor.position_of("pedestrian0")[:2], there) < 0.1, "where they are so long after the start"


INK = """([x, y]) => {
  const canvas = document.getElementById("desire-path-ribbon");
  const [px, py] = window.desirePath.viser.projector()(x, y, 0.2);
  const scale = canvas.width / window.innerWidth;
  return canvas.getContext("2d").getImageData(Math.round(px * scale), Math.round(py * scale), 1, 1).data[3];
}"""


def test_a_way_is_painted_under_the_robot(rig: StageRig, visit: Visit) -> None:
    visitor = visit(width=640, height=400)
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", timeout_s=60)
    stage = rig.server.stage("amber")
    assert isinstance(stage, Stage)
    rollout = drive(SCENE, duration_s=8.0, bend_m=0.4)
    stage.live(SCENE, "top_down", trajectories=(rollout,))
    visitor.wait_for("ready")
    steer(visitor, do="paths", id="1", onward=False, paths=[path(rollout)], legend=[])
    visitor.wait_for("drawn", id="1")
    middle = [float(value) for value in rollout.poses[20, :2]]
    assert visitor.frame.evaluate(INK, middle) == 255
    assert visitor.frame.evaluate(INK, [SCENE.start.x, SCENE.start.y]) == 0, "there the robot stands"


def test_of_several_numbered_ways_the_robot_drives_the_one_that_is_asked_for(rig: StageRig, visit: Visit) -> None:
    visitor = visit(width=640, height=400)
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", timeout_s=60)
    stage = rig.server.stage("amber")
    assert isinstance(stage, Stage)
    ways = [drive(SCENE, duration_s=2.0, bend_m=bend) for bend in (0.4, -0.4, 0.9)]
    stage.several("top_down", ways, [(196, 84, 10), (30, 104, 176), (136, 60, 150)])
    visitor.wait_for("drawn", id="several")
    steer(visitor, do="drive", only=2)
    visitor.wait_for("moved", over=True)
    steer(visitor, do="drive", only=1)
    moved = visitor.wait_for("moved", 2, over=True)
    assert moved["poses"][1][:2] == [round(float(one), 4) for one in ways[1].poses[-1][:2]]
    assert moved["poses"][2][:2] == [round(float(one), 4) for one in ways[2].poses[0][:2]], "only the one moves"

"""What moved the robot, on a stage in Chromium: rays and outlines, a lighter form on phones, a legend, marks that tell
hit from free without colour."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from math import dist
from typing import Any

import pytest

from desirepath.explain.ranking_sets import DRIVE_S, ExplainedRollout, RankingSet
from desirepath.explain.shown_explanation import ShownExplanation
from desirepath.learning.shipped_files import resolve
from desirepath.simulation.scene import Obstacle, Person, Pose
from desirepath_stage.views import View
from tests.stage.stage_rig import StageRig, Visitor

RAYS = """([t, x, y, yaw]) => {
  const { explained, viser } = window.desirePath;
  explained.at(t, x, y, yaw);
  const { position, color } = viser.meshes("/scene1/rays")[0].geometry.attributes;
  const [rays, at] = [[], (corner, axis) => position.array[3 * corner + axis]];
  for (let ray = 0; ray < position.count; ray += 8) {
    if (at(ray, 2) < 0) continue; // not drawn
    const marked = Math.hypot(at(ray + 4, 0) - at(ray + 6, 0), at(ray + 4, 1) - at(ray + 6, 1)) > 0.01;
    rays.push({ marked, red: color.array[4 * ray] > color.array[4 * ray + 1] });
  }
  const shown = (_, k) => viser.meshes(`/scene1/outline${k}`).some((mesh) => mesh.visible);
  return { rays, outlines: explained.objects().map(shown) };
}"""


def shown_to(visitor: Visitor, rig: StageRig, key: str, one: ExplainedRollout, view: View = "top_down") -> Visitor:
    visitor.wait_until(lambda: rig.server.stage(key) is not None, "the stage connects", 120)
    scores = tuple(tuple(float(score) for score in row) for row in one.scores)
    shown = ShownExplanation(one.things, scores, outlines=one.attention is None, lidar=True)
    rig.server.stage(key).show(one.trajectory.scene, view, trajectories=(one.trajectory,), explained=shown)
    visitor.wait_for("ready", timeout_s=120)
    return visitor


@pytest.mark.parametrize(("width", "rays"), [(900, 360), (412, 120)])
def test_rays_and_outlines_are_drawn_lighter_on_a_phone_and_not_told_by_colour_alone(visit, rig, width, rays) -> None:
    one = RankingSet.load(resolve("explained_room/scenarios_48")).rollouts[2]
    visitor = shown_to(visit("amber", width=width, height=500), rig, "amber", one)
    last = [3.0, *(float(value) for value in one.trajectory.poses[-1])]

    def drawn() -> dict[str, Any]:
        found: dict[str, Any] = visitor.frame.evaluate(RAYS, last)
        return found

    visitor.wait_until(lambda: len(drawn()["rays"]) == rays, f"{rays} rays are drawn")
    found = drawn()
    assert any(ray["marked"] for ray in found["rays"])
    assert all(ray["marked"] == ray["red"] for ray in found["rays"]), "what is hit has a mark, whatever its colour"
    assert found["outlines"] == [score > 0 for score in one.scores[-1]]
    words = {"reasons": {name: name for name in ("outline", "free", "hit", "goal")}}
    visitor.frame.evaluate("(words) => window.desirePath.explained.obey({ do: 'words', words })", words)
    legend = visitor.frame.locator("#desire-path-reasons li")
    assert legend.all_inner_texts() == ["outline", "free", "hit", "goal"]


NAMES = """() => [...document.querySelectorAll(".desire-path-tag")].filter((tag) => !tag.hidden).map((tag) => {
  const { left, right, top, bottom } = tag.getBoundingClientRect();
  return { left, right, top, bottom };
})"""


def closest_three_m(one: ExplainedRollout) -> float:
    """Of people when the rollout halts: the largest distance within the three who stand closest together."""
    places = one.trajectory.scene.people_at([DRIVE_S])[:, 0]
    return min(max(dist(a, b) for a, b in combinations(three, 2)) for three in combinations(places, 3))


def test_no_name_covers_another_where_people_stand_close_together(visit, rig) -> None:
    one = min(RankingSet.load(resolve("crowd_corridor/scenarios_24")).rollouts, key=closest_three_m)
    assert closest_three_m(one) < 0.5, "nobody stands close in the shipped scenarios; take a scene of its own"
    visitor = shown_to(visit("beryl", width=1024, height=500), rig, "beryl", one)
    rank = {"do": "rank", "words": {thing: f"Person {k}" for k, thing in enumerate(one.things)}, "places": []}
    visitor.frame.evaluate("(rank) => window.desirePath.picking.obey(rank)", rank)
    visitor.wait_until(lambda: len(visitor.frame.evaluate(NAMES)) == len(one.things), "everybody has a name")
    boxes = visitor.frame.evaluate(NAMES)
    for k, a in enumerate(boxes):
        for b in boxes[:k]:
            apart = a["right"] <= b["left"] or b["right"] <= a["left"] or a["bottom"] <= b["top"]
            assert apart or b["bottom"] <= a["top"], (a, b)


TAGS = """() => Object.fromEntries([...document.querySelectorAll(".desire-path-tag")].map((tag) => {
  const { left, right, bottom } = tag.getBoundingClientRect();
  return [tag.dataset.thing, tag.hidden ? null : [(left + right) / 2, bottom]];
}))"""
PLACES = """(places) => {
  const project = window.desirePath.viser.projector();
  return places.map(([x, y, z]) => project(x, y, z));
}"""


def test_a_name_stands_over_what_is_seen_of_its_object_and_nowhere_where_nothing_is(visit, rig) -> None:
    one = RankingSet.load(resolve("explained_room/scenarios_48")).rollouts[0]
    person = Person(Pose(0.0, 0.0, 0.0))
    wall = Obstacle("cupboard", Pose(4.0, 0.0), 0.5, 2.0, 1.9)
    behind = Obstacle("pillar", Pose(5.5, 0.0), 0.4, 0.4, 1.2)
    beside = Obstacle("couch", Pose(5.5, 1.9), 0.6, 2.4, 0.8)  # its right part is hidden
    scene = replace(one.trajectory.scene, person=person, obstacles=(wall, behind, beside), start=Pose(1.2, -1.5))
    things = ("cupboard", "pillar", "couch")
    here = replace(one, trajectory=replace(one.trajectory, scene=scene), things=things, scores=one.scores[:, :3])
    visitor = shown_to(visit("coral", width=1024, height=500), rig, "coral", here, view="immersive")
    visitor.frame.evaluate("window.desirePath.camera.gaze([4, 0.5])")
    rank = {"do": "rank", "words": {thing: thing for thing in things}, "places": []}
    visitor.frame.evaluate("(rank) => window.desirePath.picking.obey(rank)", rank)
    visitor.wait_until(lambda: len(visitor.frame.evaluate(TAGS)) == 3, "everything has a name")

    def gap_px() -> float:
        (top,) = visitor.frame.evaluate(PLACES, [(3.75, 0.0, 1.9)])
        return abs(visitor.frame.evaluate(TAGS)["cupboard"][0] - top[0])

    visitor.wait_until(lambda: visitor.frame.evaluate(TAGS)["cupboard"], "the cupboard is seen")
    visitor.wait_until(lambda: gap_px() < 40, "its name follows the view")
    tags = visitor.frame.evaluate(TAGS)
    assert tags["pillar"] is None, "the cupboard hides all of it"
    (top, middle, left) = visitor.frame.evaluate(PLACES, [(3.75, 0.0, 1.9), (5.5, 1.9, 0.8), (5.2, 3.1, 0.8)])
    assert abs(tags["cupboard"][0] - top[0]) < 40
    assert tags["cupboard"][1] <= top[1]
    assert tags["couch"][0] < middle[0] - 5, "over its visible part"
    assert tags["couch"][0] > left[0] - 5

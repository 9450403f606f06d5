"""What moved the robot, on a stage in Chromium: rays and outlines, a lighter form on phones, a legend, marks that tell
hit from free without colour."""

from __future__ import annotations

from typing import Any

import pytest

from backend.explain.ranking_sets import RankingSet
from backend.explain.shown_explanation import ShownExplanation
from backend.learning.shipped_files import resolve

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


@pytest.mark.parametrize(("width", "rays"), [(900, 360), (412, 120)])
def test_rays_and_outlines_are_drawn_lighter_on_a_phone_and_not_told_by_colour_alone(visit, rig, width, rays) -> None:
    visitor = visit("amber", width=width, height=500)
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", 120)
    one = RankingSet.load(resolve("explained_room/scenarios_48")).rollouts[2]
    scores = tuple(tuple(float(score) for score in row) for row in one.scores)
    shown = ShownExplanation(one.things, scores, outlines=True, lidar=True)
    rig.server.stage("amber").show(one.trajectory.scene, "top_down", trajectories=(one.trajectory,), explained=shown)
    visitor.wait_for("ready", timeout_s=120)
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

"""What rays, outlines, goal and line add to a picture, in a real Chromium: `python -m tests.stage.measure_explained`.

Prints milliseconds of this machine, which draws its pictures by software; no test asserts them. `work`: what the page's
own code does before a picture (corners of 360 rays and five outlines). `picture`: the whole of a frame, drawing
included, of a trajectory with and without reasons, which a graphics card would draw in a fraction of it.
"""

from __future__ import annotations

import json
import statistics
from typing import Any

from desirepath.explain.ranking_sets import RankingSet
from desirepath.explain.shown_explanation import ShownExplanation
from desirepath.learning.shipped_files import resolve
from desirepath_experiments.browser.client import chromium
from tests.stage.stage_rig import StageRig, Visitor

WORK = """async (moments) => {
  const { explained } = window.desirePath;
  const took = [];
  for (let round = 0; round < 20; round += 1) for (const [t, x, y, yaw] of moments) {
    const begun = performance.now();
    explained.at(t, x, y, yaw);
    took.push(performance.now() - begun);
  }
  return took;
}"""


def milliseconds(values: list[float]) -> dict[str, float]:
    ordered = sorted(values)
    return {
        "mean": round(statistics.fmean(ordered), 3),
        "median": round(ordered[len(ordered) // 2], 3),
        "p95": round(ordered[int(0.95 * len(ordered))], 3),
    }


def measured(visitor: Visitor, view: str, *, phone: bool = False) -> dict[str, Any]:
    """Milliseconds before each picture of the shipped set's first rollouts."""
    stage = visitor.rig.server.stage(visitor.key)
    found = []
    for one in RankingSet.load(resolve("explained_room/scenarios_48")).rollouts[:4]:
        scores = tuple(tuple(float(score) for score in row) for row in one.scores)
        shown = ShownExplanation(one.things, scores, True, True)
        stage.show(one.trajectory.scene, view, trajectories=(one.trajectory,), explained=shown)
        visitor.page.wait_for_timeout(3_000)  # the meshes have come
        assert visitor.frame.evaluate("window.desirePath.explained.objects().length") == len(one.things)
        times = [k * one.trajectory.dt / 6 for k in range(6 * len(one.scores))]  # 30 pictures per second
        poses = one.trajectory.poses
        rows = [[float(value) for value in poses[min(k // 6, len(poses) - 1)]] for k in range(len(times))]
        found += visitor.frame.evaluate(WORK, [[t, *row] for t, row in zip(times, rows, strict=True)])
    return {"view": view, "phone": phone, "pictures": len(found), **milliseconds(found)}


def main() -> None:
    rig = StageRig(on_connect=lambda stage, key: None)
    results = []
    with chromium() as browser:
        for phone in (False, True):
            size = {"width": 412, "height": 800} if phone else {"width": 1280, "height": 720}
            context = browser.new_context(viewport=size)
            visitor = Visitor(context.new_page(), rig, f"amber-{phone}")
            visitor.page.wait_for_timeout(8_000)  # it has connected
            results += [measured(visitor, view, phone=phone) for view in ("top_down", "immersive")]
            context.close()
    rig.stop()
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()

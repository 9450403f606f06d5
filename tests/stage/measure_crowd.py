"""What twenty pedestrians add to a picture, in a real Chromium: `python -m tests.stage.measure_crowd`.

Prints milliseconds of this machine, which draws its pictures by software; no test asserts them. `work`: what the page's
own code does before a picture (twenty people and a robot, moved), of the 16.7 ms that 60 pictures a second leave, on
a phone as elsewhere.
"""

from __future__ import annotations

import json

from desirepath_experiments.browser.client import chromium
from tests.stage.measure_explained import milliseconds
from tests.stage.stage_rig import StageRig, Visitor, drive
from tests.stage.test_crowd_stage import crowded

WORK = """async () => {
  const { player } = window.desirePath;
  const took = [];
  for (let picture = 0; picture < 600; picture += 1) {
    const begun = performance.now();
    player.end([picture / 600, 0, 0]);
    took.push(performance.now() - begun);
  }
  return took;
}"""


def main() -> None:
    rig = StageRig(on_connect=lambda stage, key: None)
    results = []
    scene = crowded()
    with chromium() as browser:
        for phone in (False, True):
            size = {"width": 412, "height": 800} if phone else {"width": 1280, "height": 720}
            context = browser.new_context(viewport=size)
            visitor = Visitor(context.new_page(), rig, f"birch-{phone}")
            visitor.page.wait_for_timeout(8_000)  # it has connected
            stage = rig.server.stage(visitor.key)
            for view in ("top_down", "first_person", "immersive"):
                stage.show(scene, view, trajectories=[drive(scene, duration_s=1.0)])
                visitor.page.wait_for_timeout(4_000)  # the meshes have come
                assert len(visitor.position_of("pedestrian19")) >= 2
                found = visitor.frame.evaluate(WORK)
                results.append({"view": view, "phone": phone, "pictures": len(found), **milliseconds(found)})
            context.close()
    rig.stop()
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()

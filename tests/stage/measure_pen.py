"""How long the pen takes for a pointer event and for its ink, in a real Chromium: `python -m tests.stage.measure_pen`.

Prints milliseconds of this machine, which draws its pictures by software; no test asserts them. An event is timed from
before its handlers to after them, as the browser calls them; at 60 Hz a frame has 16.7 ms for all of it.
"""

from __future__ import annotations

import json
import math
from typing import Any

from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath_experiments.browser.client import chromium
from desirepath_stage.paper import Paper
from desirepath_stage.stage import Stage
from tests.stage.stage_rig import StageRig, Visitor

EVENTS = 300
COALESCED = 4  # a pen that tells 240 Hz on a screen of 60 Hz
MOVES = """async ({ events, coalesced, pen, from, to }) => {
  const sheet = window.desirePath.sheet.element;
  const { ink } = window.desirePath;
  const [handled, painted] = [[], []];
  const paint = ink.paint;
  ink.paint = (picture) => {
    const begun = performance.now();
    paint.call(ink, picture);
    painted.push(performance.now() - begun);
  };
  const sent = [];
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (message, ...more) {
    // camera reports end in the stage's own worker
    if (message?.type === "send" && message.message?.type !== "ViewerCameraMessage") sent.push(message);
    return post.call(this, message, ...more);
  };
  const at = (u) => ({
    clientX: from[0] + (to[0] - from[0]) * u, clientY: from[1] + (to[1] - from[1]) * u - 40 * Math.sin(3 * Math.PI * u),
  });
  const kind = { pointerId: 1, bubbles: true, pointerType: pen ? "pen" : "mouse", pressure: pen || 0.5 };
  for (let k = 1; k <= events; k += 1) {
    const parts = Array.from({ length: coalesced }, (_, i) =>
      new PointerEvent("pointermove", { ...kind, ...at((k - 1 + (i + 1) / coalesced) / events) }));
    const event = new PointerEvent("pointermove", { ...kind, ...at(k / events), coalescedEvents: parts });
    const begun = performance.now();
    sheet.dispatchEvent(event);
    handled.push(performance.now() - begun);
    if (k % 2 === 0) await new Promise((done) => requestAnimationFrame(done));
  }
  ink.paint = paint;
  Worker.prototype.postMessage = post;
  return { handled, painted, sent: sent.length };
}"""


def moved(visitor: Visitor, *, events: int = EVENTS, coalesced: int = COALESCED, pen: float = 0.0) -> dict[str, Any]:
    """Press on the robot's ring and move to the goal; milliseconds of every event and picture, messages to the server.

    pen: pressure, 0 to 1; 0: a mouse.
    """
    scene = demonstration_scene("corridor", 0)
    spots = [
        visitor.frame.evaluate(f"window.desirePath.viser.projector()({place.x}, {place.y})")
        for place in (scene.start, scene.goal)
    ]
    visitor.page.mouse.move(*spots[0])
    visitor.page.mouse.down()
    asked = {"events": events, "coalesced": coalesced, "pen": pen, "from": spots[0], "to": spots[1]}
    times: dict[str, Any] = visitor.frame.evaluate(MOVES, asked)
    visitor.page.mouse.up()
    return times


def main() -> None:
    rig = StageRig(on_connect=lambda stage, key: None)
    with chromium() as browser:
        context = browser.new_context(viewport={"width": 1024, "height": 480})
        visitor = Visitor(context.new_page(), rig, "amber")
        visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", 120)
        stage = rig.server.stage("amber")
        assert isinstance(stage, Stage)
        stage.draw(demonstration_scene("corridor", 0), "top_down", Paper("sheet-1"))
        visitor.wait_for("ready", timeout_s=120)
        times = moved(visitor)
    rig.stop()

    def share(name: str, part: float) -> float:
        ordered = sorted(times[name])
        return round(ordered[min(len(ordered) - 1, math.ceil(part * len(ordered)) - 1)], 3)

    told = {
        f"{name}_p{round(100 * part)}_ms": share(name, part) for name in ("handled", "painted") for part in (0.5, 0.95)
    }
    print(json.dumps({**told, "events": EVENTS, "coalesced": COALESCED, "messages_to_the_server": times["sent"]}))


if __name__ == "__main__":
    main()

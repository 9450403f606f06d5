"""A Quest 3 in Chromium: Meta's emulator (IWER, a development dependency), as nobody here has a headset.

It proves that things work, not how they look on a headset or how fast they are: software draws its pictures.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext, Frame

IWER = Path(__file__).parents[1] / "node_modules" / "iwer" / "build" / "iwer.min.js"
# IWER 2.5 takes a shifted space's XRRigidTransform for a matrix; what it makes of it is no number.
PUT_ON = """;(() => {
  const { XRDevice, metaQuest3 } = window.IWER ?? IWER;
  window.headset = new XRDevice(metaQuest3);
  window.headset.installRuntime({ forceInstall: true });
  window.headset.position.set(0, EYES_M, 0);
  window.headset.stereoEnabled = true;
  const spaces = XRReferenceSpace.prototype, shifted = spaces.getOffsetReferenceSpace;
  spaces.getOffsetReferenceSpace = function (by) { return shifted.call(this, by.matrix); };
})();"""
EYES_M = 1.55
AIM = """(id) => {
  const { viser, headsetRoom } = window.desirePath;
  const at = typeof id === "string" ? headsetRoom.place(id) : id;
  if (!at) return false;
  const head = viser.drawing().gl.xr.getCamera();
  const way = head.position.clone().set(...viser.toView(at));
  way.applyMatrix4(head.matrixWorld.clone().invert()).normalize();
  const turn = head.quaternion.clone().setFromUnitVectors(head.position.clone().set(0, 0, -1), way);
  const { left, right } = window.headset[window.headset.primaryInputMode === "hand" ? "hands" : "controllers"];
  left.quaternion.set(-Math.SQRT1_2, 0, 0, Math.SQRT1_2); // at the floor
  const { x, y, z } = window.headset.position;
  right.position.set(x, y, z);
  right.quaternion.set(turn.x, turn.y, turn.z, turn.w);
  return true;
}"""
LOOK = """(id) => {
  const { viser, headsetRoom } = window.desirePath;
  const head = viser.drawing().gl.xr.getCamera();
  const way = head.position.clone().set(...viser.toView(headsetRoom.place(id)));
  way.applyMatrix4(head.matrixWorld.clone().invert()).normalize();
  const turn = head.quaternion.clone().setFromUnitVectors(head.position.clone().set(0, 0, -1), way);
  const { x, y, z, w } = window.headset.quaternion;
  const after = head.quaternion.clone().set(x, y, z, w).multiply(turn);
  window.headset.quaternion.set(after.x, after.y, after.z, after.w);
}"""
PINCH = "(value) => window.headset.hands.right.updatePinchValue(value)"
POINTS_AT = "(id) => window.desirePath.headsetRoom.pointed().join() === id"
WORN = "document.documentElement.dataset.headset === 'on' && window.desirePath.headsetRoom.place('leave')"
PICTURES = "() => window.desirePath.headset.report()?.frames ?? -1"
TRIGGER = "(value) => window.headset.controllers.right.updateButtonValue('trigger', value)"
HEAD = """() => {
  const { viser } = window.desirePath;
  const head = viser.drawing().gl.xr.getCamera();
  const at = (eye) => viser.fromView(eye.getWorldPosition(eye.position.clone()).toArray());
  const eyes = head.cameras.map(at);
  return { eyes, along: viser.fromView(head.getWorldDirection(head.position.clone()).toArray()) };
}"""


def plug_in_headset(context: BrowserContext) -> None:
    """Every page of this browser finds a headset and can ask for it."""
    if not IWER.is_file():
        pytest.fail("IWER is missing; `make node_modules/.ready` installs it")
    context.add_init_script(IWER.read_text(encoding="utf-8") + PUT_ON.replace("EYES_M", str(EYES_M)))


def put_on(stage: Frame) -> None:
    """Press the stage's button, and see the room."""
    stage.locator("#desire-path-headset").click()
    stage.wait_for_function(
        "document.documentElement.dataset.headset === 'on' && window.desirePath.headsetRoom.place('leave')"
    )
    wait_for_pictures(stage)  # of where one stands now


def pull_trigger_at(stage: Frame, button: str, *, lets_go: bool = True) -> None:
    """Point the right controller, or hand, at a button of the panel and press it; lets_go: of the trigger, too."""
    stage.wait_for_function("(id) => window.desirePath.headsetRoom.may(id)", arg=button)
    for _ in range(20):  # the panel comes to where one looks, and may have been on its way
        stage.evaluate(AIM, button)
        wait_for_pictures(stage)
        if stage.evaluate(POINTS_AT, button):
            break
    pull = PINCH if stage.evaluate("window.headset.primaryInputMode") == "hand" else TRIGGER
    stage.evaluate(pull, 1)
    if lets_go:
        wait_for_pictures(stage)
        stage.evaluate(pull, 0)
        wait_for_pictures(stage)


def aim(stage: Frame, at: tuple[float, ...]) -> None:
    """Point the right controller at a place in the room, x, y and perhaps z in metres, and see it there."""
    stage.evaluate(AIM, [*at, 0][:3])
    wait_for_pictures(stage)


def hold_trigger(stage: Frame, held: bool) -> None:
    """Pull the right controller's trigger, or let go of it, and see what comes of it."""
    stage.evaluate(TRIGGER, int(held))
    wait_for_pictures(stage)


def draw_by_ray(stage: Frame, places: list[tuple[float, float]], *, lets_go: bool = True) -> None:
    """Trigger held from the first place on the floor to the last."""
    aim(stage, places[0])
    hold_trigger(stage, True)
    for place in places[1:]:
        aim(stage, place)
    if lets_go:
        hold_trigger(stage, False)


def lean_stick(stage: Frame, hand: str, x: float, y: float) -> None:
    """Lean the thumbstick of that hand, to the right and towards oneself."""
    stage.evaluate("([hand, x, y]) => window.headset.controllers[hand].updateAxes('thumbstick', x, y)", [hand, x, y])


def wait_for_pictures(stage: Frame) -> None:
    """Until the headset has been shown what is now."""
    before = stage.evaluate(PICTURES)
    more = f"(before) => {{ const now = ({PICTURES})(); return now < 0 || now > before + 1; }}"  # or it was taken off
    stage.wait_for_function(more, arg=before)


def take_off(stage: Frame) -> None:
    """As when its battery is empty: the session ends, and nothing is said before."""
    stage.evaluate("window.desirePath.viser.drawing().gl.xr.getSession().end()")

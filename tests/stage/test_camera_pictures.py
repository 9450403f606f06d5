"""What a robot's depth camera sees, on a replay in Chromium: two small pictures that move on with the rollout."""

from __future__ import annotations

import base64
import io

import numpy as np
from PIL import Image

from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.demonstrations.depth.seen_along import EVERY, EVERY_S, frames_along, kept_of
from desirepath.learning.shipped_files import resolve
from desirepath.perception.beta_vae import DepthEncoder
from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath_stage.camera_pictures import CameraPictures


def test_a_sheet_holds_the_pictures_in_order_with_near_things_light() -> None:
    frames = np.stack([np.full((80, 128), metres, np.float32) for metres in (0.5, 5.5, 0.0)] * 4)
    sheet = CameraPictures("robot", 0, "camera", frames, 0.4, 6.0).as_sheet((60, 120, 200))
    assert (sheet["count"], sheet["across"], sheet["width"], sheet["height"]) == (12, 8, 128, 80)
    image = np.asarray(Image.open(io.BytesIO(base64.b64decode(sheet["image"].partition(",")[2]))).convert("L"))
    assert image.shape == (2 * 80, 8 * 128)
    near, far, nothing = (int(image[40, 128 * number + 64]) for number in range(3))
    assert near > 150 > far > nothing
    assert int(image[80 + 40, 128 + 64]) == near  # the tenth of twelve


def test_a_replay_in_a_home_shows_what_the_robot_sees_and_what_its_encoder_keeps(rig, visit) -> None:
    rollout = demonstrate("behind", demonstration_scene("home", 0), 0).trajectory
    frames = frames_along(rollout)
    assert len(frames) == -(-len(rollout.poses) // EVERY)
    kept = kept_of(frames, DepthEncoder.from_bytes(resolve("home/depth_encoder").read_bytes()))
    pictures = [
        CameraPictures("robot", 0, name, part, EVERY_S, 6.0) for name, part in (("sees", frames), ("keeps", kept))
    ]
    visitor = visit("amber", width=900, height=600)
    visitor.wait_until(lambda: rig.server.stage("amber") is not None, "the stage connects", 120)
    rig.server.stage("amber").replay((rollout,), names=("robot",), speed=4.0, loop=False, pictures=pictures)
    visitor.wait_for("ready", timeout_s=120)
    panel = visitor.frame.locator("#desire-path-pictures")
    assert panel.locator("figcaption").all_inner_texts() == ["sees", "keeps"]
    assert panel.get_by_role("img", name="robot: keeps").count() == 1
    numbers = "[...document.querySelectorAll('#desire-path-pictures canvas')].map((one) => one.dataset.number)"
    last = str(len(frames) - 1)
    visitor.wait_until(lambda: visitor.frame.evaluate(numbers) == [last, last], "the last pictures are shown", 60)
    rig.server.stage("amber").clear()
    visitor.wait_until(lambda: panel.count() == 0, "an empty stage has no pictures")

"""The pictures of robots' depth cameras that analysts see beside a replay: as they came, and what the encoder keeps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from desirepath.perception import SHIPPED_ENCODER
from desirepath.simulation.setups import has_depth_camera
from desirepath.simulation.trajectory import Trajectory
from desirepath.web.core.catalogues import Catalogue
from desirepath_stage.camera_pictures import CameraPictures


def camera_views(
    t: Catalogue, rollouts: Sequence[Trajectory], names: Sequence[str]
) -> Callable[[], Sequence[CameraPictures]]:
    """Two per rollout where robots have a depth camera, else none. They are taken when they are asked for."""

    def take() -> Sequence[CameraPictures]:
        if not rollouts or not has_depth_camera(rollouts[0].scene.setup):
            return ()
        from desirepath.demonstrations.depth.seen_along import EVERY_S, frames_along, kept_of
        from desirepath.learning.shipped_files import resolve
        from desirepath.perception.beta_vae import DepthEncoder  # torch comes with it

        encoder, found = DepthEncoder.from_bytes(resolve(SHIPPED_ENCODER).read_bytes()), []
        for robot, (rollout, name) in enumerate(zip(rollouts, names, strict=True)):
            seen = frames_along(rollout)
            for part, frames in (("sees", seen), ("keeps", kept_of(seen, encoder))):
                caption = t(f"paths.camera.{part}")
                found.append(CameraPictures(name, robot, caption, frames, EVERY_S, encoder.range_m))
        return found

    return take

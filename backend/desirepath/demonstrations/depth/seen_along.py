"""What a depth camera sees along a rollout, and what the encoder keeps of that: for looking at, not for acting."""

from __future__ import annotations

import numpy as np

from desirepath.perception.beta_vae import DepthEncoder
from desirepath.simulation.depth_camera import DEPTH_CAMERA, CameraNoise, Frames, Sights
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath.simulation.trajectory import Trajectory

EVERY = 2  # ours: every so many steps one picture, which a film of 2.5 a second shows well enough
EVERY_S = EVERY * CONTROL_DT_S


def frames_along(trajectory: Trajectory) -> Frames:
    """(n, rows, columns) metres as a real camera gives them, 0 where it found nothing: one every EVERY_S."""
    scene, poses = trajectory.scene, trajectory.poses[::EVERY].astype(np.float64)
    people = np.full((len(poses), 4), scene.person.height)
    people[:, :3] = scene.person_poses(trajectory.times[::EVERY])
    where = np.zeros(len(poses), dtype=np.int64)
    clean = Sights([scene]).pictures(DEPTH_CAMERA, poses, people, where)
    return CameraNoise().applied(clean, DEPTH_CAMERA, np.random.default_rng([0, 0x5EE]))


def kept_of(frames: Frames, encoder: DepthEncoder) -> Frames:
    """The same pictures after the encoder's 32 latents."""
    return encoder.frames(encoder.latents(frames))

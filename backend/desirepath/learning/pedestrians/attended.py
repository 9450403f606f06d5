"""What a policy with attention looked at in a rollout: as the stage shows it, and how much of it each person got.

The weights are `crowd_networks.py`'s.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.learning.pedestrians.crowd_evaluation import CrowdRollout
from desirepath.learning.pedestrians.crowd_networks import Actor, attention_weights
from desirepath.learning.pedestrians.crowd_states import SECTORS
from desirepath.simulation.crowds.crowd_engine import GROUPS
from desirepath.simulation.crowds.crowd_setups import LIDAR_NOISE_M, PED_DEPTH_M, PED_WIDTH_M
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.simulation.walks import Walk

Doubles = NDArray[np.float64]
NEAR_M = 0.02 + 2 * LIDAR_NOISE_M  # ours: a lidar point so near to somebody's body is theirs
Rows = tuple[tuple[float, ...], ...]


def measure_attention(actor: Actor, rolled_out: CrowdRollout) -> tuple[Rows, Rows]:
    """What an actor with attention looked at in its rollout, one row per pose, the last pose's that of the step before:
    weights of the 30 lidar sectors, and of the 30 descriptor rays. Rows are empty of an actor without that stream.

    Raises ValueError for one without attention.
    """
    weights = attention_weights(actor, torch.as_tensor(rolled_out.states))

    def rows(stream: str) -> Rows:
        if stream not in weights:
            return ((),) * len(rolled_out.poses)
        looked_at = [tuple(float(weight) for weight in row) for row in weights[stream]]
        return (*looked_at, looked_at[-1])

    return rows("spatial"), rows("temporal")


def as_trajectory(rolled_out: CrowdRollout) -> Trajectory:
    """The rollout for a stage: poses and the people as they walked; its observations are chapter 4's states."""
    steps = len(rolled_out.actions)
    states = rolled_out.states.astype("float32")
    return Trajectory(
        rolled_out.scene,
        rolled_out.outcome,
        rolled_out.poses.astype("float32"),
        states,
        rolled_out.actions.astype("float32"),
        np.zeros(steps, np.float32),
        np.concatenate([states[1:], states[-1:]]),
        np.arange(steps) == steps - 1,
        dt=CONTROL_DT_S,
    )


def until(rolled_out: CrowdRollout, steps: int) -> CrowdRollout:
    """Its first steps, after which everybody stands still; one state more, of that moment. Raises ValueError where it
    is over before."""
    if len(rolled_out.actions) <= steps:
        raise ValueError(f"the rollout has {len(rolled_out.actions)} steps, no state after {steps}")
    scene, crowd = rolled_out.scene, rolled_out.scene.crowd
    if crowd is not None:
        walked = []
        for pedestrian in crowd.pedestrians:
            knots = None
            if pedestrian.walk is not None:
                every = (pedestrian.walk.times_s, pedestrian.walk.x, pedestrian.walk.y, pedestrian.walk.yaw)
                knots = Walk(*(part[: steps + 1] for part in every))
            walked.append(replace(pedestrian, walk=knots))
        scene = replace(scene, crowd=replace(crowd, pedestrians=tuple(walked)))
    return replace(
        rolled_out,
        scene=scene,
        outcome=Outcome.RUNNING,
        poses=rolled_out.poses[: steps + 1],
        states=rolled_out.states[: steps + 1],
        actions=rolled_out.actions[:steps],
    )


def attention_to_people(rolled_out: CrowdRollout, spatial: Doubles, temporal: Doubles) -> Doubles:
    """(n, people) in [0, 1]: how strongly what a policy looked at was at each person, the scene's first, in n states.

    spatial (n, 30) of lidar sectors, temporal (n, 30) of descriptor rays, as `attention_weights`. Each is divided by
    the moment's strongest, as the stage draws it; a person gets the strongest of the sectors that have a point of
    theirs, and of the rays whose group is around one, and the mean of both. Nobody's point: 0.
    """
    shares = np.zeros((len(spatial), 1 + len(rolled_out.scene.crowd.pedestrians if rolled_out.scene.crowd else ())))
    for k in range(len(spatial)):
        owner, bearing, away = _owners(rolled_out, k)
        sector = np.arange(SECTORS) * len(spatial[k]) // SECTORS
        strengths = spatial[k][sector] / max(float(spatial[k].max()), 1e-9)
        rays = temporal[k] / max(float(temporal[k].max()), 1e-9)
        looked = np.zeros((2, shares.shape[1]))
        np.maximum.at(looked[0], owner[owner >= 0], strengths[owner >= 0])
        for ray in range(GROUPS):
            off = np.abs((bearing - 2 * math.pi * ray / GROUPS + math.pi) % (2 * math.pi) - math.pi)
            near = np.where(off <= math.pi / GROUPS, away, np.inf)
            nearest = int(near.argmin())
            if near[nearest] < np.inf and owner[nearest] >= 0:
                looked[1, owner[nearest]] = max(looked[1, owner[nearest]], rays[ray])
        shares[k] = looked.mean(axis=0)
    return shares


def _owners(rolled_out: CrowdRollout, k: int) -> tuple[NDArray[np.int64], Doubles, Doubles]:
    """Of each lidar point of state k: whose body it is on (-1: nobody's), its bearing and distance from the robot."""
    setup = get_setup(rolled_out.scene.setup)
    points = rolled_out.states[k, : 2 * SECTORS].reshape(SECTORS, 2).astype(np.float64) * setup.robot.lidar.range_m
    x, y, yaw = rolled_out.poses[k]
    c, s = math.cos(yaw), math.sin(yaw)
    world = np.stack([x + c * points[:, 0] - s * points[:, 1], y + s * points[:, 0] + c * points[:, 1]], axis=1)
    people = rolled_out.scene.people_at([k * CONTROL_DT_S])[:, 0]
    facing = [float(rolled_out.scene.person_poses([k * CONTROL_DT_S])[0, 2])]
    for pedestrian in rolled_out.scene.crowd.pedestrians if rolled_out.scene.crowd else ():
        facing.append(float(pedestrian.walk.poses_at([k * CONTROL_DT_S])[0, 2]) if pedestrian.walk else pedestrian.yaw)
    cos, sin = np.cos(facing), np.sin(facing)
    to = world[:, None, :] - people[None, :, :]
    along = np.abs(to[:, :, 0] * cos + to[:, :, 1] * sin) - PED_DEPTH_M / 2
    across = np.abs(to[:, :, 1] * cos - to[:, :, 0] * sin) - PED_WIDTH_M / 2
    gap = np.hypot(np.maximum(along, 0), np.maximum(across, 0))
    owner = np.where(gap.min(axis=1) < NEAR_M, gap.argmin(axis=1), -1)
    return owner, np.arctan2(points[:, 1], points[:, 0]) % (2 * math.pi), np.hypot(points[:, 0], points[:, 1])

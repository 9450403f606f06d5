"""A policy that slows down for what is ahead is found to, and for what."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from desirepath.explain.sight import sight_of
from desirepath.simulation.fast import Floats, rollout
from desirepath.simulation.scene import Obstacle, Person, Pose, Room, Scene
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.explanations.slowing import NOTHING, slow_downs, slowing

EXPLAINED_ROOM = get_setup("explained_room")

SCENE = Scene(
    "explained_room", 0, Pose(-3.0, 0.0), Pose(3.2, 0.0), 0.36, Person(Pose(0.0, 3.0)),
    (Obstacle("couch", Pose(1.0, 0.0), 0.85, 1.9, 0.8), Obstacle("pillar", Pose(-1.0, -2.0), 0.4, 0.4, 2.0)),
    Room(8, 7),
)  # fmt: skip


def careful(seen: Tensor) -> Tensor:
    """Straight ahead, the slower the nearer the ray ahead ends."""
    return torch.stack([torch.clamp(seen[:, 2] * 6 - 1.0, -0.8, 1.0), 0 * seen[:, 0]], dim=1)


def act(seen: Floats) -> Floats:
    return careful(torch.from_numpy(seen)).numpy()


def test_it_slows_down_once_and_for_the_couch() -> None:
    trajectory = rollout(EXPLAINED_ROOM, act, [SCENE], max_steps=40)[0]
    (event,) = slow_downs(careful, sight_of(trajectory), trajectory.actions)
    assert (event.thing, event.fall > 0.5, event.raised > 0.5) == ("couch", True, True)
    told = slowing(careful, [trajectory])
    assert told["for_what"] == {"couch": 1}
    assert told["share_of_trajectories_that_slow_down"] == 1.0


def test_who_slows_down_for_nothing_is_said_to() -> None:
    def tired(seen: Floats) -> Floats:
        return np.stack([np.float32(1.2) * seen[:, 0] * 2 - 0.9, 0 * seen[:, 0]], axis=1).clip(-1, 1)

    trajectory = rollout(EXPLAINED_ROOM, tired, [SCENE], max_steps=12)[0]
    blind = slow_downs(lambda seen: torch.from_numpy(tired(seen.numpy())), sight_of(trajectory), trajectory.actions)
    assert [event.thing for event in blind] == [NOTHING]

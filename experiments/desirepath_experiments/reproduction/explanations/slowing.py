"""How often a policy slows down, and for what: the thing without which it would drive fastest where it drives slowest.

By taking things out of the room, not by attributions, so that these can be compared with it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.explain.attribution import Actor
from desirepath.explain.sight import WALLS, Sight, sight_of
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

FALL = 0.15  # ours: of the speed range, over consecutive steps; less is no slowing down
RAISE = 0.05  # ours: of the speed range; a thing whose absence changes less is not what it slowed down for
NOTHING = "nothing that could be taken out"


@dataclass(frozen=True)
class SlowDown:
    """From step `first` to `last`, where speed is lowest, by `fall` of the speed range. thing: what for (`NOTHING`);
    raised: by how much of the range the policy would drive faster there without it."""

    first: int
    last: int
    fall: float
    thing: str
    raised: float


def slow_downs(actor: Actor, sight: Sight, actions: NDArray[np.float32]) -> list[SlowDown]:
    """Every one of a trajectory; actions (T, 2) in [-1, 1], the first of which is the speed."""
    share = (actions[:, 0].astype(np.float64) + 1) / 2
    slowings, first = [], 0
    for step in range(1, len(share) + 1):
        if step < len(share) and share[step] < share[step - 1]:
            continue
        fall, last = float(share[first] - share[step - 1]), step - 1
        if fall >= FALL:
            thing, raised = _what_for(actor, sight, last)
            slowings.append(SlowDown(first, last, fall, thing, raised))
        first = step
    return slowings


def _what_for(actor: Actor, sight: Sight, step: int) -> tuple[str, float]:
    each = np.eye(len(sight.things), dtype=bool)
    sight_at_step = Sight(
        sight.setup,
        sight.things,
        np.repeat(sight.observations[step : step + 1], len(each), axis=0),
        np.repeat(sight.ranges[step : step + 1], len(each), axis=0),
    )
    with torch.no_grad():
        without = actor(torch.from_numpy(sight_at_step.without(each)))[:, 0].numpy()
        before = actor(torch.from_numpy(sight_at_step.observations[:1]))[0, 0].item()
    raised = (without.astype(np.float64) - before) / 2
    most = int(raised.argmax())
    return (sight.things[most], float(raised[most])) if raised[most] >= RAISE else (NOTHING, 0.0)


def slowing(actor: Actor, trajectories: Sequence[Trajectory]) -> dict[str, object]:
    """Over trajectories of one setup: mean speed, how many slow down at all, slow-downs per trajectory, for what."""
    limits = get_setup(trajectories[0].scene.setup).robot.limits
    events = [slow_downs(actor, sight_of(trajectory), trajectory.actions) for trajectory in trajectories]
    every = [event for of in events for event in of]
    things = Counter("a wall" if event.thing in WALLS else event.thing for event in every)
    speed = np.concatenate([(trajectory.actions[:, 0].astype(np.float64) + 1) / 2 for trajectory in trajectories])
    return {
        "trajectories": len(trajectories),
        "mean_speed_m_s": round(float(limits.v_min + speed.mean() * (limits.v_max - limits.v_min)), 3),
        "share_of_trajectories_that_slow_down": round(float(np.mean([bool(of) for of in events])), 3),
        "slow_downs_per_trajectory": round(len(every) / len(trajectories), 2),
        "mean_fall_of_the_speed_range": round(float(np.mean([event.fall for event in every])), 3) if every else 0.0,
        "for_what": dict(things.most_common()),
    }

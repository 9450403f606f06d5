"""What acts in the comparisons of chapter 2, behind one function: a learned policy, DWA, social cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.dwa import Dwa
from desirepath.demonstrations.social_cost import SocialCost
from desirepath.learning.policies.policy import Policy
from desirepath.simulation import kernels as k
from desirepath.simulation.fast import make_engine, replay, rollout
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.trajectory import Trajectory

DWA, SOCIAL_COST = "dwa", "social_cost"
BASELINES = (DWA, SOCIAL_COST)


def roll_out(controller: str | Policy, scenes: Sequence[Scene]) -> list[Trajectory]:
    """One trajectory per scene, in order, all with the setup's own observations.

    controller: a policy, or a name of BASELINES. Raises ValueError for another name, SetupError for scenes of several
    setups or of another one than the policy's.
    """
    if not scenes:
        return []
    named = {f"scene {i}": scene.setup for i, scene in enumerate(scenes)}
    if isinstance(controller, Policy):
        return rollout(get_setup(require_same(policy=controller.setup, **named)), controller.rollout_policy, scenes)
    setup = get_setup(require_same(**named))
    if controller == DWA:
        dwa = Dwa(setup)
        rollouts = rollout(dwa.setup, dwa.act, scenes)
        return replay(setup, scenes, [trajectory.actions for trajectory in rollouts])
    if controller == SOCIAL_COST:
        return [
            rollout(setup, SocialCost(scene).act, [scene])[0] if setup.solids else _roll_out_localised(scene)
            for scene in scenes
        ]
    raise ValueError(f"controller {controller!r}: known are policies and {', '.join(BASELINES)}")


def _roll_out_localised(scene: Scene) -> Trajectory:
    """The social-cost controller where walls are not observed: it is told where it and the person are."""
    setup, planner = get_setup(scene.setup), SocialCost(scene)
    engine = make_engine(setup, 1, auto_reset=False, scenes=[scene])
    actions: list[NDArray[np.float32]] = []
    while not engine.dones[0] and len(actions) < setup.max_steps:
        person = Pose(*(float(value) for value in engine.rows[0, k.PERSON_X : k.PERSON_YAW + 1]))
        actions.append(planner.steer(Pose(*(float(value) for value in engine.poses[0])), person))
        engine.step(actions[-1][None])
    return replay(setup, [scene], [np.stack(actions)])[0]

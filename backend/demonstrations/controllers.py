"""What acts in the comparisons of chapter 2, behind one function: a learned policy, DWA, social cost."""

from __future__ import annotations

from collections.abc import Sequence

from backend.demonstrations.dwa import Dwa
from backend.demonstrations.social_cost import SocialCost
from backend.learning.policies.policy import Policy
from backend.simulation.fast import replay, rollout
from backend.simulation.scene import Scene
from backend.simulation.setups import get_setup, require_same
from backend.simulation.trajectory import Trajectory

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
        return [rollout(setup, SocialCost(scene).act, [scene])[0] for scene in scenes]
    raise ValueError(f"controller {controller!r}: known are policies and {', '.join(BASELINES)}")

"""Every number of TD3 with demonstrations with its source, and where we depart from the thesis, in words for cards."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from desirepath.demonstrations.demonstration import AUGMENTED
from desirepath.learning.policies.shape import FAST_HEADS

DEPARTURES = [
    "Observed angles are given as cosine and sine.",
    "Many environments in a fast kinematic engine instead of one in PyBullet; far fewer updates, larger learning rate "
    "of the actor, exploration noise spread over the environments.",
    "Rewards of several steps at once (n-step returns): a step is 2-5 cm long; one at a time, too many rollouts from "
    "random starts and to random goals collide.",
    "Reaching the goal in exploration earns half of what it earns in demonstrations (as in chapter 3), not nothing.",
    "A quarter of the episodes mixes demonstrated and random places of robot, person and goal.",
    "Actor and critic read person and goal, and walls and obstacles, through two small extractors, then two layers, "
    "instead of three layers of 256.",
    "The kept weights are the best of several checkpoints, as they are or averaged over recent updates, by success, "
    "likeness to the demonstrations and success in unseen scenes of the selection set.",
    "A beginning drawn beside the robot is drawn to it, the shift fading out along the path.",
]
IMITATION = (
    "Before it learns by reward, the actor imitates (DAgger, Ross et al. 2011): down a drawn path from beside it, and "
    "elsewhere a planner that knows the scene. After that it is held to what it did then."
)
AFTER_IMITATION = 1_800
"""Updates of TD3+BC where the actor has imitated; they bring it closer to the paths."""


@dataclass(frozen=True)
class DemonstrationConfig:
    """How a personal controller is trained. Sources: table 2.1 and section 2.5.6, where not marked ours."""

    seed: int = 0
    heads: tuple[int, int] = FAST_HEADS  # ours, for speed; the thesis has three layers of 256
    updates: int = 40_000  # ours; the thesis has 800,000
    n_envs: int = 256  # DESIGN: many environments, few updates
    updates_per_step: int = 16  # ours: one per 16 interactions, the thesis has one per 5
    random_transitions: int = 10_000  # ours; the thesis has 50,000
    buffer_size: int = 1_000_000
    batch_each: int = 64
    near: float = 0.25  # share of episodes that begin beside a demonstration
    mixed: float = 0.25  # ours: share with robot, person and goal each beside a demonstration or anywhere
    exploration: tuple[float, float] = (0.05, 0.4)  # ours: spread over the environments; the thesis has 0.2 for all
    target_noise: float = 0.05
    goal_boost: float = 5.0  # reward of the goal in demonstration data
    explored_goal: float = 2.5  # reward of the goal in exploration: half, as in ch. 3; ch. 2 has 0
    steps_at_once: int = 6  # ours: n-step returns; the thesis has 1
    rl_weight: tuple[float, float] = (10 / 3, 5.0)  # before and after `reweighted_at`
    bc_weight: tuple[float, float] = (20 / 3, 5.0)
    reweighted_at: float = 350 / 800  # share of the updates
    actor_learning_rate: float = 5e-4  # ours; the thesis has 1e-4
    final_learning_rate: float = 5e-5  # ours; the thesis has 1e-5, from 650 of 800 epochs; here linearly from 1/2 on
    critic_learning_rate: float = 8e-4
    tau: float = 0.05  # ours, as in base training
    augmentation: int = AUGMENTED
    demonstrations: bool = True  # False: plain TD3 for comparison, all of a batch explored
    progress_weight: float = 0.0  # per metre towards the goal, in exploration; only for plain TD3, as in base training
    average_decay: float = 0.999  # running average of the actor's weights, per update; ours, as in base training
    checkpoints: int = 8  # evenly spread, each as it is and averaged; the best is kept
    selection_scenes: int = 200
    imitated: int = 0  # ours: updates of the actor alone, before all others
    imitated_per_step: int = 12
    imitating_rates: tuple[float, float] = (1e-3, 3e-5)  # of the first of them and of the last
    held: float = 20.0  # after these: weight of the mean squared distance from what the actor did then

    def as_dict(self) -> dict[str, Any]:
        """Without imitation where it has no part, as before there was any."""
        later = ("imitated", "imitated_per_step", "imitating_rates", "held")
        return {name: value for name, value in asdict(self).items() if self.imitated or name not in later}


def imitating_config(seed: int, updates: int = AFTER_IMITATION, imitated: int = 4_800) -> DemonstrationConfig:
    """How a controller is trained in seconds: by imitation first, then few updates and small ones."""
    return DemonstrationConfig(
        seed=seed,
        updates=updates,
        imitated=imitated,
        actor_learning_rate=1e-4,
        final_learning_rate=2e-5,
        checkpoints=3,
    )

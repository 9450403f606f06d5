"""Fine-tuning on the learned reward (ours), the alignment that trains and is fast enough for a session.

    r* = r + w R' - c,   R' = clip((R - q98) / std, -cap, 0)

r: the setup's core reward. R: the reward model's output, its 98th percentile and standard deviation those of the base
policy's transitions. w: the reward weight, which follows success. c: what a step costs, so that waiting is not free.
The training itself is `relabelling.py`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.learning.alignment.relabelling import RelabellingConfig, enough_success, model_outputs
from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.td3 import Batch
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class FineTuningConfig(RelabellingConfig):
    """How a base policy is fine-tuned. Spec 06, recipe B, unless marked ours; the rest in `RelabellingConfig`."""

    recipe: ClassVar[str] = "fine_tuning"
    goes_back: ClassVar[bool] = True

    gamma: float | None = 0.99
    # reward_weight (w) None: from the share, and follows success
    preference_share: float = 0.85  # of what is at stake in an episode (goal - timeout reward), to begin with
    max_weight: float = 1.0  # the weight never begins higher; chosen in the open field
    time_cost: float = 0.1  # per step, ours: waiting far from the person must not be free
    weight_up: float = 1.15  # weight None: factor after a checkpoint that lost almost no success (ours)
    weight_down: float = 0.65  # ... and after one that lost too much to be chosen: back to the last good one (ours)
    almost_no_loss: float = 0.01
    penalty_cap: float = 4.0
    weighing_scenes: int = 200  # rollouts of the base policy in which the share is measured

    def reward(self, model: RewardModel, replay: Batch, base: Policy) -> FineTuningReward:
        return FineTuningReward(model, self, replay, base)

    def choose(self, success_rates: Sequence[float], base_success: float) -> int:
        """The last one with enough success; where none has, the one with most."""
        reaching = [k for k, rate in enumerate(success_rates) if rate >= enough_success(base_success, self)]
        return reaching[-1] if reaching else int(np.argmax(success_rates))


class FineTuningReward:
    """r* of fine-tuning, calibrated once on the base policy's transitions.

    weight: what R' is multiplied with. Where the configuration leaves it open, it begins by making an expensive
    trajectory of the base policy (90th percentile) pay `preference_share` of what is at stake (goal - timeout reward),
    beyond what waiting at the start for as long would cost; `adapt` moves it then. A fixed weight of 1, good in the
    open field, made robots in the study room wait for the timeout: passing the person cost more than the goal is worth
    there.
    """

    def __init__(self, model: RewardModel, config: FineTuningConfig, replay: Batch, base: Policy) -> None:
        self._model, self._config = model, config
        raw = model_outputs(model, replay)
        self._std = float(raw.std()) + 1e-6
        self._top = float(np.quantile(raw, 0.98))
        self.weight = config.reward_weight if config.reward_weight is not None else self._fair_weight(base)

    def _fair_weight(self, base: Policy) -> float:
        setup, config = get_setup(base.setup), self._config
        scenes = scene_set(setup.name, config.weighing_scenes, purpose=Purpose.ALIGN_SELECT, seed=config.seed)
        standing = np.array([[-1.0, 0.0]], dtype=np.float32)
        paid = []
        for trajectory in rollout(setup, base.rollout_policy, scenes):
            moving = self._penalty(
                self._model.rewards(trajectory.observations, trajectory.actions, trajectory.next_observations)
            )
            first = trajectory.observations[:1]
            waiting = self._penalty(self._model.rewards(first, standing, first))
            paid.append(max(0.0, float((waiting - moving).sum())))
        dear = float(np.quantile(paid, 0.9))
        at_stake = config.preference_share * (setup.reward.goal - setup.reward.timeout)
        return at_stake / dear if dear * config.max_weight > at_stake else config.max_weight

    def _penalty(self, raw: Floats) -> Floats:
        penalty: Floats = np.clip((raw - self._top) / self._std, -self._config.penalty_cap, 0.0)
        return penalty

    def preference(self, batch: Batch) -> torch.Tensor:
        """R' of every transition, (n,). A reward <= 0 does not pay for loitering."""
        return torch.from_numpy(self._penalty(model_outputs(self._model, batch)))

    def combined(self, core: torch.Tensor, preference: torch.Tensor) -> torch.Tensor:
        """r* = r + w R' - c."""
        return core + self.weight * preference - self._config.time_cost

    def adapt(self, success: float, base_success: float) -> None:
        """Ask for more while success holds, for less once it does not: no fixed weight suited every set of answers."""
        config = self._config
        if config.reward_weight is not None:
            return
        if success < enough_success(base_success, config):
            self.weight *= config.weight_down
        elif success >= base_success - config.almost_no_loss:
            self.weight *= config.weight_up

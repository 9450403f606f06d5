"""Fine-tuning on a reward per step, trajectories being valued by the mean over their steps: on what somebody's answers
say (`train_on_answers`), or what a simulated person truly goes by.

    r* = r + w min((R - top) / s, 0) - c,   top = min(mean R of the policy's own trajectories + margin s, q98)

Dividing by the number of steps is undone by taking off what the policy has reached (Dinkelbach 1967), and a little
more, so that waiting pays nobody: with the usual fine-tuning's top (q98 alone) hurrying drowns what is preferred.
s: the standard deviation of a trajectory's mean within a scene. All ours; measured in experiments/notebook.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch

from desirepath.analysis.metrics import success_rate
from desirepath.learning.alignment.relabelling import RelabellingConfig, enough_success, learn, model_outputs
from desirepath.learning.measures.step_basis import StepBasis
from desirepath.learning.measures.steps import reference
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.rewards.reward_model import Floats, RewardModel
from desirepath.learning.rewards.step_weights import StepWeightsRewardModel
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.learning.td3.replay import collect
from desirepath.learning.td3.td3 import Batch
from desirepath.simulation.fast import make_engine, rollout
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.trajectory import Trajectory

UPDATES_A_SECOND = 450
"""Of this training on one quiet core of the machine of `docs/results.md`."""
UPDATES = 30 * UPDATES_A_SECOND


@dataclass(frozen=True)
class OwnRewardConfig(RelabellingConfig):
    """weight: of the reward, to begin with; it follows success. margin, largest_cost: in s. A checkpoint is kept for
    what it gained, where it arrives as often as asked; while it is stuck, the base policy drives."""

    recipe: ClassVar[str] = "own_reward"
    goes_back: ClassVar[bool] = True

    gamma: float | None = 0.99
    updates: int = 6_000
    checkpoints: int = 6
    replay_transitions: int = 60_000
    weight: float = 0.3
    margin: float = 2.0
    largest_cost: float = 8.0
    time_cost: float = 0.05
    weight_up: float = 1.1
    weight_down: float = 0.7
    selection_scenes: int = 300
    min_success: float = 0.97
    max_selection_loss: float = 0.015

    @classmethod
    def of(cls, updates: int, seed: int) -> OwnRewardConfig:
        """A checkpoint every 1,000 updates or so."""
        return cls(updates=updates, checkpoints=min(updates, max(2, updates // 1_000)), seed=seed)

    def reward(self, model: RewardModel, replay: Batch, base: Policy) -> OwnReward:
        return OwnReward(model, self, replay, base)

    def choose(self, success_rates: Sequence[float], base_success: float) -> int:
        """The last one with enough success; where none has, the one with most."""
        reaching = [k for k, rate in enumerate(success_rates) if rate >= enough_success(base_success, self)]
        return reaching[-1] if reaching else int(np.argmax(success_rates))


class OwnReward:
    """r* as above. `seen` takes up what a checkpoint's trajectories have reached."""

    def __init__(self, model: RewardModel, config: OwnRewardConfig, replay: Batch, base: Policy) -> None:
        self._model, self._config = model, config
        self._top = float(np.quantile(model_outputs(model, replay), 0.98))
        self.weight = config.weight
        self._spread = _spread_of(model, base.setup)
        scenes = scene_set(base.setup, config.selection_scenes, purpose=Purpose.ALIGN_SELECT, seed=config.seed)
        self._reached = float(self.means(rollout(get_setup(base.setup), base.rollout_policy, scenes)).mean())

    @property
    def spread(self) -> float:
        return self._spread

    def means(self, trajectories: Sequence[Trajectory]) -> Floats:
        """(n,) mean reward of each."""
        return means_of(self._model, trajectories)

    def seen(self, trajectories: Sequence[Trajectory]) -> float:
        """Mean reward of a checkpoint's trajectories, in s; from now on it is half of what is taken off."""
        mean = float(self.means(trajectories).mean())
        self._reached += 0.5 * (mean - self._reached)
        return mean / self._spread

    def preference(self, batch: Batch) -> torch.Tensor:
        return torch.from_numpy(model_outputs(self._model, batch))

    def combined(self, core: torch.Tensor, preference: torch.Tensor) -> torch.Tensor:
        config = self._config
        top = min(self._reached + config.margin * self._spread, self._top)
        cost = torch.clamp((preference - top) / self._spread, -config.largest_cost, 0.0)
        return core + self.weight * cost - config.time_cost

    def adapt(self, success: float, base_success: float) -> None:
        config = self._config
        if success < base_success - config.max_selection_loss:
            self.weight *= config.weight_down
        elif success >= base_success - config.max_selection_loss / 2:
            self.weight *= config.weight_up


def _with_recovery(policy: Policy, base: Policy) -> Policy:
    """The same, freed by the base policy where it is stuck."""
    return replace(policy, recovery_policies=(base.actor,))


def means_of(model: RewardModel, trajectories: Sequence[Trajectory]) -> Floats:
    """(n,) mean reward of each trajectory's steps."""
    rewards = model.rewards(
        np.concatenate([trajectory.observations for trajectory in trajectories]),
        np.concatenate([trajectory.actions for trajectory in trajectories]),
        np.concatenate([trajectory.next_observations for trajectory in trajectories]),
    )
    lengths = np.array([len(trajectory.actions) for trajectory in trajectories])
    means: Floats = np.add.reduceat(rewards, np.cumsum(lengths) - lengths) / lengths
    return means


def _spread_of(model: RewardModel, setup: str) -> float:
    """Standard deviation of a trajectory's mean reward within a scene, over the setup's reference pairs."""
    means = means_of(model, reference(setup).trajectories)
    return float((means[0::2] - means[1::2]).std()) / math.sqrt(2) + 1e-6


@dataclass(frozen=True)
class OwnRewardResult:
    """policy: the chosen checkpoint, without critic. gained: mean reward over the base policy's in the selection
    scenes, in s (optimistic: it was chosen there). history: one entry per checkpoint."""

    policy: Policy
    chosen: int
    gained: float
    history: list[dict[str, float]]
    replay_sha256: str
    config: OwnRewardConfig

    def as_dict(self) -> dict[str, Any]:
        """Of the training, for cards."""
        of = {"chosen_checkpoint": self.chosen, "gained": self.gained, "history": self.history}
        return {**self.config.as_dict(), "replay_sha256": self.replay_sha256, **of}

    @property
    def scenes(self) -> dict[str, Any]:
        """In which a checkpoint was chosen."""
        return describe(Purpose.ALIGN_SELECT, self.config.selection_scenes, self.config.seed)


def train_on_answers(
    base: Policy,
    basis: StepBasis,
    believed: StepPosterior,
    config: OwnRewardConfig,
    on_progress: OnProgress = no_progress,
) -> OwnRewardResult:
    """On the mean of what answers say every step is worth. What they are unsure of is trained on as well, so it is for
    choosing from, not for everybody's every scene."""
    model = StepWeightsRewardModel(base.setup, basis, believed.mean.astype(np.float32))
    return tune_to_reward(base, model, config, on_progress)


def tune_to_reward(
    base: Policy, model: RewardModel, config: OwnRewardConfig | None = None, on_progress: OnProgress = no_progress
) -> OwnRewardResult:
    """Train on from the base policy (with critic), keep the checkpoint with the highest mean reward among
    those with enough success. Raises SetupError where setups differ, LearningError for a policy without critic."""
    config = config or OwnRewardConfig()
    setup = get_setup(require_same(policy=base.setup, reward_model=model.setup))
    replay = collect(base, config.replay_transitions, noise=config.replay_exploration, seed=config.seed)
    replay_sha256 = replay.digest()
    reward = config.reward(model, replay.filled(), base)
    scenes = scene_set(setup.name, config.selection_scenes, purpose=Purpose.ALIGN_SELECT, seed=config.seed)
    usual = rollout(setup, base.rollout_policy, scenes)
    before = float(reward.means(usual).mean()) / reward.spread

    def judge(policy: Policy) -> dict[str, float]:
        rolled_out = rollout(setup, _with_recovery(policy, base).rollout_policy, scenes)
        gained = reward.seen(rolled_out) - before
        return {"success_rate": success_rate([trajectory.outcome for trajectory in rolled_out]), "gained": gained}

    learned = learn(
        base,
        make_engine(setup, config.online_envs, seed=config.seed + 1),
        replay,
        reward,
        config,
        judge=judge,
        base_success=success_rate([trajectory.outcome for trajectory in usual]),
        on_progress=on_progress,
    )
    # as often as asked, or as the base policy nearly does
    enough = min(config.min_success, learned.base_success - config.max_selection_loss / 2)
    chosen = max(
        range(len(learned.history)),
        key=lambda k: (min(learned.history[k]["success_rate"], enough), learned.history[k]["gained"]),
    )
    policy = _with_recovery(learned.policies[chosen], base)
    return OwnRewardResult(policy, chosen, learned.history[chosen]["gained"], learned.history, replay_sha256, config)

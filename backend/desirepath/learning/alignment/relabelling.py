"""Training on relabelled rewards: what fine-tuning and the thesis's recipe share.

A base policy goes on learning by TD3, its rewards replaced by r*: the core reward and a learned one together. How these
are put together, which checkpoint is kept and what a lost one means is each algorithm's own: `fine_tuning.py` and
`thesis.py`. The core reward is the setup's; base training's progress term never enters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.analysis.metrics import collision_rate, success_rate, timeout_rate
from desirepath.learning.alignment.gate import Gate, GateRule, at_gate
from desirepath.learning.cards import stored_config
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress, policy_of
from desirepath.learning.td3.checkpoints import checkpoints
from desirepath.learning.td3.ensemble import agent_of
from desirepath.learning.td3.replay import ReplayBuffer, ReplayCollector, collect, concatenate
from desirepath.learning.td3.td3 import Batch, Td3Config, held_to
from desirepath.simulation.fast import EpisodeTable, FastEngine, evaluate, make_engine
from desirepath.simulation.setups import get_setup, require_same

Floats = NDArray[np.float32]


class AlignReward(Protocol):
    """The reward that alignment learns from: core and preference part, kept apart so that they can be reweighed."""

    weight: float

    def preference(self, batch: Batch) -> torch.Tensor: ...

    def combined(self, core: torch.Tensor, preference: torch.Tensor) -> torch.Tensor: ...

    def adapt(self, success: float, base_success: float) -> None: ...


@dataclass(frozen=True)
class RelabellingConfig(ABC):
    """What both algorithms are asked; each has its own file, with its own fields and defaults.

    reward_weight: of the learned reward; None: the algorithm finds it. updates: of the critic, in all. gamma None: the
    setup's. online_share: of each batch, from steps made during the alignment; 0: none are made. replay_transitions: of
    the base policy's regenerated buffer. min_success, max_selection_loss: a checkpoint below, or one that loses more
    against the base policy, is not chosen while another is not.
    """

    recipe: ClassVar[str]
    goes_back: ClassVar[bool]
    """Whether learning goes back to the last good checkpoint from one that lost too much success."""

    seed: int = 0
    reward_weight: float | None = None
    updates: int = 8_000
    checkpoints: int = 8
    gamma: float | None = None
    learning_rate: float = 5e-4
    final_learning_rate: float = 1e-4  # reached linearly over the second half
    tau: float = 0.005
    batch_size: int = 128
    online_share: float = 0.5
    online_envs: int = 64
    updates_per_online_step: int = 16
    replay_transitions: int = 150_000
    replay_exploration: tuple[float, float] = (0.05, 0.6)
    online_exploration: tuple[float, float] = (0.05, 0.4)
    selection_scenes: int = 400
    min_success: float = 0.94
    max_selection_loss: float = 0.025
    gate: GateRule = field(default_factory=GateRule)

    @abstractmethod
    def reward(self, model: RewardModel, replay: Batch, base: Policy) -> AlignReward:
        """r* of this algorithm, calibrated on the replayed transitions."""

    @abstractmethod
    def choose(self, success_rates: Sequence[float], base_success: float) -> int:
        """Which checkpoint is kept, by their success on the selection scenes."""

    def as_dict(self) -> dict[str, Any]:
        """Flat, for cards and hashes."""
        flat = stored_config(self)
        del flat["gate"]
        return {"recipe": self.recipe, **flat, **self.gate.as_dict()}

    def shortened(self, updates: int) -> RelabellingConfig:
        """The same with so many updates, and no more checkpoints than these."""
        return replace(self, updates=updates, checkpoints=min(self.checkpoints, updates))


def enough_success(base_success: float, config: RelabellingConfig) -> float:
    """The success rate that a checkpoint needs to be chosen."""
    return max(config.min_success, base_success - config.max_selection_loss)


def model_outputs(model: RewardModel, batch: Batch) -> Floats:
    """What the model says of every transition, (n,)."""
    chunks = [
        model.rewards(*(part[k : k + 16_384].numpy() for part in (batch[0], batch[1], batch[3])))
        for k in range(0, len(batch.rewards), 16_384)
    ]
    return np.concatenate(chunks)


@dataclass(frozen=True)
class AlignResult:
    """policy: the chosen checkpoint, without critic. chosen: its place in `history`, one entry per checkpoint.

    reward_weight: what the learned reward weighed then.
    """

    policy: Policy
    gate: Gate
    chosen: int
    history: list[dict[str, float]]
    reward_weight: float
    replay_sha256: str


class RelabelledBuffer:
    """A replay buffer whose rewards are r*, and can be recomputed when the weight changes."""

    def __init__(self, buffer: ReplayBuffer, reward: AlignReward) -> None:
        self.buffer, self._reward = buffer, reward
        self._core, self._preference = torch.zeros(buffer.capacity), torch.zeros(buffer.capacity)
        self._relabelled = 0

    def take_up(self) -> None:
        """Relabel the transitions that came since the last call. The buffer never wraps during an alignment."""
        rows = slice(self._relabelled, self.buffer.size)
        new = Batch(*(part[rows] for part in self.buffer.data))
        self._core[rows] = new.rewards
        self._preference[rows] = self._reward.preference(new)
        new.rewards.copy_(self._reward.combined(self._core[rows], self._preference[rows]))
        self._relabelled = self.buffer.size

    def reweigh(self) -> None:
        """Relabel everything with the current weight."""
        rows = slice(0, self._relabelled)
        self.buffer.data.rewards[rows] = self._reward.combined(self._core[rows], self._preference[rows])


def align(
    base: Policy,
    model: RewardModel,
    config: RelabellingConfig,
    on_progress: OnProgress = no_progress,
    checkpoint_folder: Path | None = None,
) -> AlignResult:
    """Align `base` with `model`; both must belong to one setup and `base` must carry its critic.

    config: says which algorithm it is.
    checkpoint_folder: where every checkpoint's policy is written as it comes, if anywhere.
    The caller decides by `result.gate.passed` whether the policy may be shown. Raises SetupError, LearningError.
    """
    _check(config)
    setup = get_setup(require_same(policy=base.setup, reward_model=model.setup))
    replay = collect(base, config.replay_transitions, noise=config.replay_exploration, seed=config.seed)
    replay_sha256 = replay.digest()
    reward = config.reward(model, replay.filled(), base)
    scenes = scene_set(setup.name, config.selection_scenes, purpose=Purpose.ALIGN_SELECT, seed=config.seed)
    learned = learn(
        base,
        make_engine(setup, config.online_envs, seed=config.seed + 1),
        replay,
        reward,
        config,
        judge=lambda policy: _summary(evaluate(policy.rollout_policy, setup, scenes)),
        base_success=success_rate(evaluate(base.rollout_policy, setup, scenes).outcome),
        on_progress=on_progress,
        checkpoint_folder=checkpoint_folder,
    )
    rates = [entry["success_rate"] for entry in learned.history]
    chosen = config.choose(rates, learned.base_success)
    policy = learned.policies[chosen]
    weight = learned.history[chosen]["preference_weight"]
    gate = at_gate(policy, base, config.gate, seed=config.seed)
    return AlignResult(policy, gate, chosen, learned.history, weight, replay_sha256)


class Learned(NamedTuple):
    """What `learn` went through: a policy without critic and its numbers per checkpoint."""

    policies: list[Policy]
    history: list[dict[str, float]]
    base_success: float


def learn(
    start: Policy,
    engine: FastEngine,
    replay: ReplayBuffer,
    reward: AlignReward,
    config: RelabellingConfig,
    *,
    judge: Callable[[Policy], dict[str, float]],
    base_success: float,
    on_progress: OnProgress = no_progress,
    checkpoint_folder: Path | None = None,
) -> Learned:
    """Go on from `start` (with critic) by `reward`, on the replay buffer (relabelled in place) and steps in `engine`.

    judge: the numbers of a checkpoint, `success_rate` among them; what loses too much of `base_success` is gone back
    from where the algorithm does so.
    """
    use_one_thread()
    td3 = Td3Config(
        gamma=config.gamma or engine.setup.gamma,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        tau=config.tau,
    )
    agent = agent_of(start, td3, seed=config.seed, updates=config.updates)
    hold = held_to(start.actor, start.shape, start.held)
    buffers = [RelabelledBuffer(replay, reward)]
    n_online = int(config.batch_size * config.online_share)
    if n_online:
        steps = -(-config.updates // config.updates_per_online_step)
        online = ReplayBuffer(steps * config.online_envs, engine.setup.observation_size)
        collector = ReplayCollector(engine, noise=config.online_exploration, seed=config.seed + 1)
        buffers.append(RelabelledBuffer(online, reward))
    buffers[0].take_up()

    sampler = torch.Generator().manual_seed(config.seed)
    policies: list[Policy] = []
    history: list[dict[str, float]] = []
    last_good = agent.remember()
    update = 0

    def step() -> int:
        nonlocal update
        update += 1
        batch = replay.sample(config.batch_size - n_online, sampler)
        if n_online:
            if update % config.updates_per_online_step == 1:
                collector.step(agent.act, online)
                buffers[1].take_up()
            batch = concatenate(online.sample(n_online, sampler), batch)
        agent.set_learning_rate(_learning_rate(config, update))
        agent.update(batch, hold)
        return update

    def between(updates: int) -> None:
        if updates % 200 == 0:
            on_progress(updates / config.updates, {"updates": updates, **agent.losses})

    marks = [round(config.updates * (k + 1) / config.checkpoints) for k in range(config.checkpoints)]
    for updates in checkpoints(step, marks, between):
        policy = policy_of(agent, engine.setup.name).without_critic()
        policies.append(policy)
        summary = judge(policy)
        history.append({"updates": updates, "preference_weight": reward.weight} | summary)
        on_progress(updates / config.updates, history[-1])
        reward.adapt(summary["success_rate"], base_success)
        if summary["success_rate"] >= enough_success(base_success, config):
            last_good = agent.remember()
        elif config.goes_back:
            agent.go_back(last_good)
        for buffer in buffers:
            buffer.reweigh()
        if checkpoint_folder is not None:
            policy.save(checkpoint_folder / f"checkpoint_{len(policies)}.npz")
    return Learned(policies, history, base_success)


def _learning_rate(config: RelabellingConfig, update: int) -> float:
    late = max(0.0, 2 * update / config.updates - 1)
    return config.learning_rate + late * (config.final_learning_rate - config.learning_rate)


def _check(config: RelabellingConfig) -> None:
    if not 0.0 <= config.online_share < 1.0:
        raise LearningError(f"online_share = {config.online_share}: a share of the batch, from 0 to below 1")
    if not 1 <= config.checkpoints <= config.updates:
        raise LearningError(f"checkpoints = {config.checkpoints}: between 1 and updates ({config.updates})")


def _summary(table: EpisodeTable) -> dict[str, float]:
    return {
        "success_rate": success_rate(table.outcome),
        "collision_rate": collision_rate(table.outcome),
        "timeout_rate": timeout_rate(table.outcome),
        "min_human_distance_m": float(table.min_human_distance.mean()),
        "path_length_m": float(table.path_length.mean()),
        "time_s": float(table.time.mean()),
    }

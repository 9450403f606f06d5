"""Alignment: a base policy and a learned reward become a policy that drives as the answers asked for.

Two recipes on the same TD3 update: `refine` (recipe B of spec 06, the default) and `thesis` (equation 6.5: relabel
the replay buffer, no new interaction). The core reward is the setup's; base training's progress term never enters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from backend.analysis.metrics import collision_rate, success_rate, timeout_rate
from backend.learning.errors import LearningError
from backend.learning.policies.networks import use_one_thread
from backend.learning.policies.policy import Policy
from backend.learning.rewards.reward_model import RewardModel
from backend.learning.scene_sets import Purpose, scene_set
from backend.learning.td3.base import OnProgress, no_progress, policy_of
from backend.learning.td3.ensemble import agent_of
from backend.learning.td3.replay import ReplayBuffer, ReplayCollector, collect, concatenate
from backend.learning.td3.td3 import Batch, Td3Config
from backend.simulation.fast import EpisodeTable, FastEngine, evaluate, rollout
from backend.simulation.setups import get_setup, require_same

Floats = NDArray[np.float32]
Recipe = Literal["refine", "thesis"]


@dataclass(frozen=True)
class AlignConfig:
    """How a policy is aligned. Defaults are recipe B of spec 06; `thesis_config` gives the thesis's recipe."""

    recipe: Recipe = "refine"
    seed: int = 0
    preference_weight: float | None = None  # refine: r = r_core + weight * R', None: from the share; thesis: lambda
    preference_share: float = 0.85  # refine: of what is at stake in an episode (goal - timeout reward), to begin with
    max_weight: float = 1.0  # refine: the weight never begins higher; spec 06's own for the open field
    time_cost: float = 0.1  # refine: per step, ours: waiting far from the person must not be free
    weight_up: float = 1.15  # refine, weight None: factor after a checkpoint that lost almost no success (ours)
    weight_down: float = 0.65  # ... and after one that lost too much to be chosen: back to the last good one (ours)
    almost_no_loss: float = 0.01
    penalty_cap: float = 4.0  # refine: R' = clip((R - q98) / std, -cap, 0)
    updates: int = 8_000
    checkpoints: int = 8
    gamma: float | None = 0.99  # None: the setup's
    learning_rate: float = 5e-4
    final_learning_rate: float = 1e-4  # ours: reached linearly over the second half, steadies the late checkpoints
    tau: float = 0.005
    batch_size: int = 128
    online_share: float = 0.5  # of each batch, from steps made during alignment; 0 means none are made
    online_envs: int = 64
    updates_per_online_step: int = 16
    replay_transitions: int = 150_000  # of the base policy's regenerated buffer
    weighing_scenes: int = 200  # base trajectories in which the share is measured
    replay_exploration: tuple[float, float] = (0.05, 0.6)
    online_exploration: tuple[float, float] = (0.05, 0.4)
    selection_scenes: int = 400
    min_success: float = 0.94  # a checkpoint below is not chosen while another reaches it ...
    max_selection_loss: float = 0.025  # ... nor one that loses more than this against the base policy (ours)
    gate_scenes: int = 500
    gate_max_loss: float = 0.05  # may lose this much success against the base policy on the same scenes ...
    gate_min_success: float = 0.90  # ... and must reach this

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def thesis_config(*, seed: int = 0, epochs: int = 3) -> AlignConfig:
    """The thesis's recipe (6.4.5): lambda 0.06, 10,000 updates per epoch on the relabelled buffer, best epoch kept."""
    return AlignConfig(
        recipe="thesis",
        seed=seed,
        preference_weight=0.06,
        updates=10_000 * epochs,
        checkpoints=epochs,
        gamma=None,
        learning_rate=3e-4,  # ours, constant
        final_learning_rate=3e-4,
        online_share=0.0,
    )


@dataclass(frozen=True)
class Gate:
    """May the policy be shown? Success of both policies on scenes that served nothing else."""

    passed: bool
    success_rate: float
    base_success_rate: float
    scenes: int


@dataclass(frozen=True)
class AlignResult:
    """policy: the chosen checkpoint, without critic. chosen: its place in `history`, one entry per checkpoint."""

    policy: Policy
    gate: Gate
    chosen: int
    history: list[dict[str, float]]
    preference_weight: float
    replay_sha256: str


class AlignReward(Protocol):
    """The reward that alignment learns from: core and preference part, kept apart so that they can be reweighed."""

    weight: float

    def preference(self, batch: Batch) -> torch.Tensor: ...

    def combined(self, core: torch.Tensor, preference: torch.Tensor) -> torch.Tensor: ...

    def adapt(self, success: float, base_success: float) -> None: ...


class PreferenceReward:
    """Turns a reward model's output into the reward of alignment, calibrated once on base trajectories.

    weight: what the preference part is multiplied with. Where the configuration leaves it open, it begins by making an
    expensive trajectory of the base policy (90th percentile) pay `preference_share` of what is at stake (goal - timeout
    reward), beyond what waiting at the start for as long would cost; `adapt` moves it then. A fixed weight of 1, good
    in the open field, made robots in the study room wait for the timeout: passing the person cost more than the goal
    is worth there.
    """

    def __init__(self, model: RewardModel, config: AlignConfig, replay: Batch, base: Policy) -> None:
        self._model, self._config = model, config
        raw = self._raw(replay)
        self._mean, self._std = float(raw.mean()), float(raw.std()) + 1e-6
        self._top = float(np.quantile(raw, 0.98))
        self.weight = config.preference_weight if config.preference_weight is not None else self._fair_weight(base)

    def _fair_weight(self, base: Policy) -> float:
        setup, config = get_setup(base.setup), self._config
        scenes = scene_set(setup.name, config.weighing_scenes, purpose=Purpose.ALIGN_SELECT, seed=config.seed)
        trajectories = rollout(setup, base.rollout_policy, scenes)
        standing = np.array([[-1.0, 0.0]], dtype=np.float32)
        paid = []
        for d in trajectories:
            driving = self._penalty(self._model.rewards(d.observations, d.actions, d.next_observations))
            first = d.observations[:1]
            waiting = self._penalty(self._model.rewards(first, standing, first))
            paid.append(max(0.0, float((waiting - driving).sum())))
        dear = float(np.quantile(paid, 0.9))
        at_stake = config.preference_share * (setup.reward.goal - setup.reward.timeout)
        return at_stake / dear if dear * config.max_weight > at_stake else config.max_weight

    def _raw(self, batch: Batch) -> Floats:
        chunks = [
            self._model.rewards(*(part[k : k + 16_384].numpy() for part in (batch[0], batch[1], batch[3])))
            for k in range(0, len(batch.rewards), 16_384)
        ]
        return np.concatenate(chunks)

    def _penalty(self, raw: Floats) -> Floats:
        penalty: Floats = np.clip((raw - self._top) / self._std, -self._config.penalty_cap, 0.0)
        return penalty

    def preference(self, batch: Batch) -> torch.Tensor:
        """The preference part of every transition, (n,).

        refine: R' = clip((R - q98) / std, -cap, 0). A reward <= 0 does not pay for loitering (spec 06).
        thesis: (R - mean) / std.
        """
        raw = self._raw(batch)
        if self._config.recipe == "thesis":
            return torch.from_numpy((raw - self._mean) / self._std)
        return torch.from_numpy(self._penalty(raw))

    def combined(self, core: torch.Tensor, preference: torch.Tensor) -> torch.Tensor:
        """r*. refine: r + weight R' - time cost. thesis, equation 6.5: lambda R + (1 - lambda) r."""
        if self._config.recipe == "thesis":
            return self.weight * preference + (1 - self.weight) * core
        return core + self.weight * preference - self._config.time_cost

    def adapt(self, success: float, base_success: float) -> None:
        """Ask for more while success holds, for less once it does not: no fixed weight suited every set of answers."""
        config = self._config
        if config.recipe == "thesis" or config.preference_weight is not None:
            return
        if success < enough_success(base_success, config):
            self.weight *= config.weight_down
        elif success >= base_success - config.almost_no_loss:
            self.weight *= config.weight_up


class RelabelledBuffer:
    """A replay buffer whose rewards are r*, and can be made anew when the weight changes."""

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
    config: AlignConfig | None = None,
    on_progress: OnProgress = no_progress,
    checkpoint_folder: Path | None = None,
) -> AlignResult:
    """Align `base` with `model`; both must belong to one setup and `base` must carry its critic.

    checkpoint_folder: where every checkpoint's policy is written as it comes, if anywhere.
    The caller decides by `result.gate.passed` whether the policy may be shown. Raises SetupError, LearningError.
    """
    config = config or AlignConfig()
    _check(config)
    setup = get_setup(require_same(policy=base.setup, reward_model=model.setup))
    replay = collect(base, config.replay_transitions, noise=config.replay_exploration, seed=config.seed)
    replay_sha256 = replay.digest()
    reward = PreferenceReward(model, config, replay.filled(), base)
    scenes = scene_set(setup.name, config.selection_scenes, purpose=Purpose.ALIGN_SELECT, seed=config.seed)
    learned = learn(
        base,
        FastEngine(setup, config.online_envs, seed=config.seed + 1),
        replay,
        reward,
        config,
        judge=lambda policy: _summary(evaluate(policy.rollout_policy, setup, scenes)),
        base_success=success_rate(evaluate(base.rollout_policy, setup, scenes).outcome),
        on_progress=on_progress,
        checkpoint_folder=checkpoint_folder,
    )
    rates = [entry["success_rate"] for entry in learned.history]
    chosen = choose_checkpoint(rates, learned.base_success, config)
    policy = learned.policies[chosen]
    weight = learned.history[chosen]["preference_weight"]
    return AlignResult(policy, check_gate(policy, base, config), chosen, learned.history, weight, replay_sha256)


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
    config: AlignConfig,
    *,
    judge: Callable[[Policy], dict[str, float]],
    base_success: float,
    on_progress: OnProgress = no_progress,
    checkpoint_folder: Path | None = None,
) -> Learned:
    """Go on from `start` (with critic) by `reward`, on the replay buffer (relabelled in place) and steps in `engine`.

    judge: the numbers of a checkpoint, `success_rate` among them; what loses too much of `base_success` is gone back
    from (refine).
    """
    use_one_thread()
    td3 = Td3Config(
        gamma=config.gamma or engine.setup.gamma,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        tau=config.tau,
    )
    agent = agent_of(start, td3, seed=config.seed)
    buffers = [RelabelledBuffer(replay, reward)]
    n_online = int(config.batch_size * config.online_share)
    if n_online:
        steps = -(-config.updates // config.updates_per_online_step)
        online = ReplayBuffer(steps * config.online_envs, engine.setup.observation_size)
        collector = ReplayCollector(engine, noise=config.online_exploration, seed=config.seed + 1)
        buffers.append(RelabelledBuffer(online, reward))
    buffers[0].take_up()

    marks = {round(config.updates * (k + 1) / config.checkpoints) for k in range(config.checkpoints)}
    sampler = torch.Generator().manual_seed(config.seed)
    policies: list[Policy] = []
    history: list[dict[str, float]] = []
    last_good = agent.remember()
    for update in range(1, config.updates + 1):
        batch = replay.sample(config.batch_size - n_online, sampler)
        if n_online:
            if update % config.updates_per_online_step == 1:
                collector.step(agent.act, online)
                buffers[1].take_up()
            batch = concatenate(online.sample(n_online, sampler), batch)
        agent.set_learning_rate(_learning_rate(config, update))
        agent.update(batch)
        if update in marks:
            policy = policy_of(agent, engine.setup.name).without_critic()
            policies.append(policy)
            summary = judge(policy)
            history.append({"updates": update, "preference_weight": reward.weight} | summary)
            on_progress(update / config.updates, history[-1])
            reward.adapt(summary["success_rate"], base_success)
            if summary["success_rate"] >= enough_success(base_success, config):
                last_good = agent.remember()
            elif config.recipe == "refine":
                agent.go_back(last_good)
            for buffer in buffers:
                buffer.reweigh()
            if checkpoint_folder is not None:
                policy.save(checkpoint_folder / f"checkpoint_{len(policies)}.npz")
        elif update % 200 == 0:
            on_progress(update / config.updates, {"updates": update})
    return Learned(policies, history, base_success)


def _learning_rate(config: AlignConfig, update: int) -> float:
    late = max(0.0, 2 * update / config.updates - 1)
    return config.learning_rate + late * (config.final_learning_rate - config.learning_rate)


def _check(config: AlignConfig) -> None:
    if config.recipe not in ("refine", "thesis"):
        raise LearningError(f"recipe = {config.recipe!r}: known are refine, thesis")
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


def enough_success(base_success: float, config: AlignConfig) -> float:
    """The success rate that a checkpoint needs to be chosen."""
    return max(config.min_success, base_success - config.max_selection_loss)


def choose_checkpoint(success_rates: list[float], base_success: float, config: AlignConfig) -> int:
    """Refine: the last one with enough success. Thesis, and where none has: the one with most success."""
    reaching = [k for k, rate in enumerate(success_rates) if rate >= enough_success(base_success, config)]
    if config.recipe == "refine" and reaching:
        return reaching[-1]
    return int(np.argmax(success_rates))


def check_gate(policy: Policy, base: Policy, config: AlignConfig) -> Gate:
    """Drive both policies in the gate's scenes; passed if success is near the base policy's and above the floor."""
    setup = get_setup(require_same(policy=policy.setup, base=base.setup))
    scenes = scene_set(setup.name, config.gate_scenes, purpose=Purpose.GATE, seed=config.seed)
    own, raw = (success_rate(evaluate(p.rollout_policy, setup, scenes).outcome) for p in (policy, base))
    passed = own >= raw - config.gate_max_loss and own >= config.gate_min_success
    return Gate(passed, own, raw, config.gate_scenes)

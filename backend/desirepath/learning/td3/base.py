"""The base policy (RAW in the thesis): TD3 on the core reward plus a progress term, many environments, few updates.

The progress term (+1 per metre towards the goal) and the action smoothness penalty (turning costs, towards the end) are
ours and live only here: without the first every sparse run froze, without the second policies wobble. Neither
enters an alignment reward.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from desirepath.analysis.metrics import collision_rate, success_rate
from desirepath.learning.cards import stored_config
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shape import EXPLAINED_HEADS, FAST_HEADS, NetworkShape
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.backprop import Floats
from desirepath.learning.td3.checkpoints import checkpoints
from desirepath.learning.td3.replay import ReplayBuffer, ReplayCollector
from desirepath.learning.td3.td3 import Td3Agent, Td3Config
from desirepath.simulation.fast import evaluate, make_engine
from desirepath.simulation.setups import get_setup

TURNING = 1  # which of the two actions is the turn rate

OnProgress = Callable[[float, dict[str, float]], None]
"""(fraction done in [0, 1], metrics by name); called from the training loop, must return quickly."""


def smoothness_penalty_gradient(actions: Floats, weight: float) -> Floats:
    """Gradient (n, 2) of what turning costs the actor: weight * mean a_w^2 over actions (n, 2).

    Ours; without it policies wobble.

    In the actor's loss, not in the reward: it acts directly where the critic cannot tell small turns apart, and it
    leaves what the critic has learned of the core reward as it is.
    """
    gradient = np.zeros_like(actions)
    gradient[:, TURNING] = 2 * np.float32(weight) / len(actions) * actions[:, TURNING]
    return gradient


def no_progress(fraction: float, metrics: dict[str, float]) -> None:
    """The progress callback of who does not want any."""


@dataclass(frozen=True)
class BaseConfig:
    """How a base policy is trained. Sources: table 6.1 for gamma and rewards (in the setup), the rest ours."""

    setup: str
    seed: int = 0
    heads: tuple[int, ...] = FAST_HEADS
    updates: int = 60_000  # ours: with the smoothing ones about two minutes on one core
    n_envs: int = 256  # DESIGN: many environments, few updates
    updates_per_step: int = 12
    random_transitions: int = 50_000  # ours: with 10,000, before any episode has ended, some seeds stand still for ever
    buffer_size: int = 1_000_000  # table 6.1
    exploration: tuple[float, float] = (0.05, 0.5)  # std of the action noise, spread over the environments
    progress_weight: float = 1.0  # per metre; ours
    learning_rate: float = 5e-4
    final_learning_rate: float = 5e-5  # reached linearly over the second half: policies stop oscillating
    smoothing_updates: int = 12_000  # ours: after the others, with the action smoothness penalty
    smoothness_penalty: float = 0.2  # its weight, ours; reached linearly over the first half of the smoothing updates
    smoothing_learning_rate: float = 3e-4  # at the beginning of the smoothing updates; falls to the final one
    tau: float = 0.05  # ours: 94 % with half the updates that 0.01 takes
    batch_size: int = 128
    average_decay: float = 0.9995  # running average of the actor's weights, per update
    checkpoints: int = 6  # spread over the second half of the smoothing updates; the best on the selection scenes stays
    selection_scenes: int = 2_000

    def as_dict(self) -> dict[str, Any]:
        return stored_config(self)


def base_config(setup: str, seed: int = 0) -> BaseConfig:
    """How the shipped base policy of that setup is trained."""
    of = get_setup(setup)
    if of.crowded:  # half as long: a step among pedestrians takes five times as long
        return BaseConfig(setup, seed, updates=40_000, smoothing_updates=8_000, selection_scenes=500)
    return BaseConfig(setup, seed, FAST_HEADS if of.extractors else EXPLAINED_HEADS)


@dataclass(frozen=True)
class BaseResult:
    """The selected policy, its success rate on the selection scenes (optimistic: it was chosen there), the history."""

    policy: Policy
    selection_success: float
    transitions: int
    history: list[dict[str, float]]


class BaseTraining:
    """The training loop as an object, so that a benchmark can stop at any update and look."""

    def __init__(self, config: BaseConfig) -> None:
        use_one_thread()
        self.config = config
        self.setup = get_setup(config.setup)
        self.shape = NetworkShape.of(self.setup, config.heads)
        td3 = Td3Config(
            gamma=self.setup.gamma,
            batch_size=config.batch_size,
            learning_rate=config.learning_rate,
            tau=config.tau,
        )
        self.agent = Td3Agent(self.shape, td3, seed=config.seed)
        engine = make_engine(
            self.setup, config.n_envs, seed=config.seed, progress_weight=config.progress_weight, auto_reset=True
        )
        self.collector = ReplayCollector(engine, noise=config.exploration, seed=config.seed)
        self.buffer = ReplayBuffer(config.buffer_size, self.setup.observation_size)
        self.transitions = 0
        self._sampler = torch.Generator().manual_seed(config.seed + 1)
        self._average = self.agent.actor.flat.clone()

    def vector_step(self) -> int:
        """One step of all environments, then `updates_per_step` updates (none while the buffer fills at random).

        Returns how many updates there were in all.
        """
        config = self.config
        warm = self.transitions >= config.random_transitions
        self.collector.step(self.agent.act if warm else None, self.buffer)
        self.transitions += config.n_envs
        if not warm:
            return self.agent.updates
        self.agent.set_learning_rate(self.learning_rate())
        penalty = self.smoothness_penalty()
        term = (lambda _, actions: smoothness_penalty_gradient(actions, penalty)) if penalty > 0 else None
        for _ in range(config.updates_per_step):
            self.agent.update(self.buffer.sample(config.batch_size, self._sampler), term)
            self._average.lerp_(self.agent.actor.flat, 1 - config.average_decay)
        return self.agent.updates

    def learning_rate(self) -> float:
        config = self.config
        smoothing = self.agent.updates - config.updates
        if smoothing > 0:
            begin, share = config.smoothing_learning_rate, smoothing / config.smoothing_updates
        else:
            begin, share = config.learning_rate, max(0.0, 2 * self.agent.updates / config.updates - 1)
        return begin + min(1.0, share) * (config.final_learning_rate - begin)

    def smoothness_penalty(self) -> float:
        smoothing = self.agent.updates - self.config.updates
        if smoothing <= 0:
            return 0.0
        return self.config.smoothness_penalty * min(1.0, 2 * smoothing / self.config.smoothing_updates)

    def policy(self, *, averaged: bool = False) -> Policy:
        """The current policy with its critic; `averaged` takes the running average of the actor's weights."""
        return policy_of(self.agent, self.setup.name, self._average if averaged else None)


def policy_of(agent: Td3Agent, setup: str, actor: torch.Tensor | None = None) -> Policy:
    """The agent's current actor (or the flat weights given) and critic as a policy."""
    kept = agent.actor.flat.clone()
    if actor is not None:
        agent.actor.flat.copy_(actor)
    policy = Policy(setup, agent.shape, tuple(agent.actor.to_arrays()), tuple(agent.critic.to_arrays()))
    agent.actor.flat.copy_(kept)
    return policy


def train_base(config: BaseConfig, on_progress: OnProgress = no_progress) -> BaseResult:
    """Train, then keep the checkpoint (as it is, or averaged) with most success on the selection scenes."""
    training = BaseTraining(config)
    scenes = scene_set(config.setup, config.selection_scenes, purpose=Purpose.SELECT, seed=config.seed)
    total = config.updates + config.smoothing_updates
    apart = config.smoothing_updates / 2 / config.checkpoints
    marks = [round(total - k * apart) for k in reversed(range(config.checkpoints))]
    history: list[dict[str, float]] = []
    best = (-1.0, training.policy())

    def between(updates: int) -> None:
        if updates and updates % (100 * config.updates_per_step) == 0:
            on_progress(
                updates / total, {"updates": updates, "transitions": training.transitions, **training.agent.losses}
            )

    for updates in checkpoints(training.vector_step, marks, between):
        for averaged in (False, True):
            policy = training.policy(averaged=averaged)
            table = evaluate(policy.act, training.setup, scenes)
            success = success_rate(table.outcome)
            metrics = {
                "updates": updates,
                "transitions": training.transitions,
                "averaged": float(averaged),
                "success_rate": success,
                "collision_rate": collision_rate(table.outcome),
                "min_human_distance_m": float(table.min_human_distance.mean()),
                "time_s": float(table.time.mean()),
                "accumulated_angle_rad": float(table.accumulated_angle.mean()),
                "self_intersections": float(table.self_intersections.mean()),
            }
            history.append(metrics)
            on_progress(min(1.0, updates / total), metrics)
            if success > best[0]:
                best = (success, policy)
    return BaseResult(best[1], best[0], training.transitions, history)

"""The training loop of TD3 with demonstrations, and which of its checkpoints is kept. What is learned: `loss.py`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from desirepath.analysis.metrics import success_rate
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.judging import KINDS, judge, unseen_scenes
from desirepath.demonstrations.td3_bc.configuration import DemonstrationConfig
from desirepath.demonstrations.td3_bc.loss import Balance, balance, demonstration_batch, update
from desirepath.demonstrations.td3_bc.placement import Placements
from desirepath.demonstrations.td3_bc.returns import ReturnsBuffer
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.scene_sets import Purpose
from desirepath.learning.td3.base import OnProgress, no_progress, policy_of
from desirepath.learning.td3.checkpoints import checkpoints
from desirepath.learning.td3.replay import ReplayCollector
from desirepath.learning.td3.td3 import Batch, Td3Agent, Td3Config
from desirepath.simulation.fast import evaluate, make_engine
from desirepath.simulation.setups import get_setup, require_same

UPDATES_BETWEEN = 100  # checkpoints; closer ones are hardly different policies


class DemonstrationTraining:
    """The training loop as an object, so that a curve can be drawn of it at any update.

    Raises ValueError for no demonstrations, SetupError for those of two environments.
    """

    def __init__(self, demonstrations: Sequence[Demonstration], config: DemonstrationConfig) -> None:
        if not demonstrations:
            raise ValueError("demonstrations: none given; one is needed at least")
        use_one_thread()
        self.config = config
        named = {f"demonstration {i}": d.scene.setup for i, d in enumerate(demonstrations)}
        setup = get_setup(require_same(**named))
        self.setup = replace(setup, reward=replace(setup.reward, goal=config.explored_goal))
        shape = NetworkShape.of(self.setup, config.heads)
        td3 = Td3Config(
            gamma=self.setup.gamma,
            batch_size=2 * config.batch_each,
            learning_rate=config.actor_learning_rate,
            tau=config.tau,
            target_noise=config.target_noise,
        )
        self.agent = Td3Agent(shape, td3, seed=config.seed)
        self.demonstrated = demonstration_batch(demonstrations, config)
        pool = Placements(
            [d.trajectory for d in demonstrations], near=config.near, mixed=config.mixed, seed=config.seed
        )
        engine = make_engine(
            self.setup, config.n_envs, seed=config.seed, pool=pool, progress_weight=config.progress_weight
        )
        self._collector = ReplayCollector(engine, noise=config.exploration, seed=config.seed)
        self.explored_buffer = ReturnsBuffer(
            min(config.buffer_size, self.planned_transitions() + config.n_envs),
            self.setup.observation_size,
            n_envs=config.n_envs,
            steps=config.steps_at_once,
            gamma=self.setup.gamma,
        )
        self.transitions = 0
        self._average = self.agent.actor.flat.clone()
        self._sampler = torch.Generator().manual_seed(config.seed + 1)

    def planned_transitions(self) -> int:
        """How many interactions the whole training has."""
        config = self.config
        return config.random_transitions + config.n_envs * -(-config.updates // config.updates_per_step)

    @property
    def done(self) -> float:
        """Share of the updates."""
        return self.agent.updates / self.config.updates

    def vector_step(self) -> None:
        """One step of all environments, then `updates_per_step` updates (none while the buffer fills at random)."""
        config = self.config
        warm = self.transitions >= config.random_transitions
        self._collector.step(self.agent.act if warm else None, self.explored_buffer)
        self.transitions += config.n_envs
        if not warm:
            return
        weights = balance(config, self.done)
        falling = max(0.0, 2 * self.done - 1)
        rate = config.actor_learning_rate + falling * (config.final_learning_rate - config.actor_learning_rate)
        self.agent.set_learning_rate(rate, critic=config.critic_learning_rate)
        for _ in range(config.updates_per_step):
            self._update(weights)
            self._average.lerp_(self.agent.actor.flat, 1 - config.average_decay)

    def _update(self, weights: Balance) -> None:
        """One update on transitions drawn anew."""
        config = self.config
        if not config.demonstrations:
            self.agent.update(self.explored_buffer.sample(2 * config.batch_each, self._sampler))
            return
        explored = self.explored_buffer.sample(config.batch_each, self._sampler)
        rows = torch.randint(len(self.demonstrated.rewards), (config.batch_each,), generator=self._sampler)
        update(self.agent, explored, Batch(*(part.index_select(0, rows) for part in self.demonstrated)), weights)

    def policy(self, *, averaged: bool = False) -> Policy:
        """The current controller, with its critic; `averaged` takes the running average of the actor's weights."""
        return policy_of(self.agent, self.setup.name, self._average if averaged else None)


@dataclass(frozen=True)
class TrainedController:
    """The chosen controller and the curve of its training, all of it on selection scenes: two entries per checkpoint.

    Entries: updates, transitions, averaged (0 or 1), everything of `Judgement` from the demonstrated starts,
    unseen_success_rate (scenes in which nothing was demonstrated, as many of each of KINDS), score.
    """

    policy: Policy
    history: list[dict[str, float | None]]
    chosen: int

    @property
    def selection(self) -> dict[str, float | None]:
        """The chosen checkpoint's numbers; optimistic where they count unseen scenes: it was chosen there."""
        return self.history[self.chosen]


def train_with_demonstrations(
    demonstrations: Sequence[Demonstration], config: DemonstrationConfig, on_progress: OnProgress = no_progress
) -> TrainedController:
    """Train, then keep the checkpoint of the highest score.

    score: success from demonstrated starts + success in unseen scenes + (t* - f in metres) of the median rollout; ours.
    Without demonstrations, success in unseen scenes alone, so that nothing of them enters.
    Raises ValueError for no demonstrations, SetupError for those of two environments.
    """
    training = DemonstrationTraining(demonstrations, config)
    pairs = list({d.drawn_in.digest(): d.drawn_in for d in demonstrations}.values())
    each = max(1, config.selection_scenes // len(KINDS))
    unseen = [
        scene for kind in KINDS for scene in unseen_scenes(pairs, kind, each, purpose=Purpose.SELECT, seed=config.seed)
    ]
    count = max(1, min(config.checkpoints, config.updates // UPDATES_BETWEEN))
    marks = [round(config.updates * (k + 1) / count) for k in range(count)]
    history: list[dict[str, float | None]] = []
    best, best_policy = -math.inf, training.policy()

    def step() -> int:
        training.vector_step()
        return training.agent.updates

    def between(updates: int) -> None:
        if updates % (50 * config.updates_per_step) == 0:
            on_progress(training.done, {"updates": updates, **training.agent.losses})

    for updates in checkpoints(step, marks, between):
        for averaged in (False, True):
            policy = training.policy(averaged=averaged)
            judged = judge(policy, demonstrations)
            success = success_rate(evaluate(policy.act, training.setup, unseen).outcome)
            likeness = judged.success_rate + judged.t_star - judged.frechet_m
            score = success + (likeness if config.demonstrations else 0.0)
            history.append(
                {
                    "updates": updates,
                    "transitions": training.transitions,
                    "averaged": float(averaged),
                    **judged.as_dict(),
                    "unseen_success_rate": success,
                    "score": score,
                }
            )
            on_progress(min(1.0, training.done), {name: v for name, v in history[-1].items() if v is not None})
            if score > best:
                best, best_policy = score, policy
    return TrainedController(
        best_policy, history, max(range(len(history)), key=lambda k: history[k]["score"] or -math.inf)
    )

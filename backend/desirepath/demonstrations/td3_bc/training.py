"""The training loop of TD3 with demonstrations, and which of its checkpoints is kept. What is learned: `loss.py`; whom
it imitates before, where it does: `path_guide.py`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from desirepath.analysis.metrics import success_rate
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.judging import KINDS, judge, unseen_scenes
from desirepath.demonstrations.td3_bc.configuration import DemonstrationConfig
from desirepath.demonstrations.td3_bc.loss import Balance, balance, demonstration_batch, update
from desirepath.demonstrations.td3_bc.path_guide import PathGuide
from desirepath.demonstrations.td3_bc.placement import Placements
from desirepath.demonstrations.td3_bc.returns import ReturnsBuffer
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.scene_sets import Purpose
from desirepath.learning.td3.backprop import Floats
from desirepath.learning.td3.base import (
    CHANCE_FIRST,
    CLONING_DECAY,
    GUIDED_LATER,
    GUIDED_SHARE,
    OnProgress,
    no_progress,
    policy_of,
)
from desirepath.learning.td3.checkpoints import checkpoints
from desirepath.learning.td3.replay import ReplayCollector
from desirepath.learning.td3.td3 import CRITIC_ALONE, ActorTerm, Batch, Td3Agent, Td3Config, held_to
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
        self.imitated = 0
        self._guide = PathGuide(engine, [d.trajectory for d in demonstrations]) if config.imitated else None
        guided = config.n_envs * self._imitating_steps()
        self._seen = np.zeros((guided, self.setup.observation_size), dtype=np.float32)
        self._guided = np.zeros((guided, 2), dtype=np.float32)
        """What the guide would have done where the actor has been."""
        self._hold: ActorTerm | None = None
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
        steps = self._imitating_steps() + -(-config.updates // config.updates_per_step)
        return config.random_transitions + config.n_envs * steps

    def _imitating_steps(self) -> int:
        return -(-self.config.imitated // self.config.imitated_per_step)

    @property
    def done(self) -> float:
        """Share of the updates of TD3+BC."""
        return self.agent.updates / self.config.updates

    @property
    def all_done(self) -> float:
        """Share of all updates."""
        return (self.imitated + self.agent.updates) / (self.config.imitated + self.config.updates)

    def vector_step(self) -> None:
        """One step of all environments, then `updates_per_step` updates (none while the buffer fills at random)."""
        config = self.config
        if self._guide is not None and self.imitated < config.imitated:
            self._imitate(self._guide)
            return
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

    def _imitate(self, guide: PathGuide) -> None:
        """The actor drives, in some environments the guide does; the actor alone is drawn to what the guide does, and
        to what was demonstrated. Then it is a policy whose critic has to be taught."""
        config, done = self.config, self.imitated / self.config.imitated
        guided = guide.act()
        rows = slice(self.transitions, self.transitions + config.n_envs)
        self._seen[rows], self._guided[rows] = self._collector.engine.observations, guided
        share = GUIDED_SHARE if done < CHANCE_FIRST else GUIDED_LATER
        drives = np.arange(1, config.n_envs + 1) * share % 1 < share

        def act(observations: Floats) -> Floats:
            return np.where(drives[:, None], guided, self.agent.act(observations))

        self._collector.step(act, self.explored_buffer)
        self.transitions += config.n_envs
        first, last = config.imitating_rates
        self.agent.set_learning_rate(last + (1 + math.cos(math.pi * done)) / 2 * (first - last))
        shown, did = (part.numpy() for part in self.demonstrated[:2])
        for _ in range(config.imitated_per_step):
            at = torch.randint(self.transitions, (2 * config.batch_each,), generator=self._sampler).numpy()
            of = torch.randint(len(shown), (config.batch_each,), generator=self._sampler).numpy()
            self.agent.clone(np.concatenate([self._seen[at], shown[of]]), np.concatenate([self._guided[at], did[of]]))
            self._average.lerp_(self.agent.actor.flat, 1 - CLONING_DECAY)
        self.imitated += config.imitated_per_step
        if self.imitated >= config.imitated:
            self.agent.actor.flat.copy_(self._average)
            self.agent.synchronise_targets()
            self.agent.actor_waits = min(CRITIC_ALONE, config.updates // 4)
            self._hold = held_to(self.agent.actor.to_arrays(), self.agent.shape, config.held)

    def _update(self, weights: Balance) -> None:
        """One update on transitions drawn anew."""
        config = self.config
        if not config.demonstrations:
            self.agent.update(self.explored_buffer.sample(2 * config.batch_each, self._sampler))
            return
        explored = self.explored_buffer.sample(config.batch_each, self._sampler)
        rows = torch.randint(len(self.demonstrated.rewards), (config.batch_each,), generator=self._sampler)
        demonstrated = Batch(*(part.index_select(0, rows) for part in self.demonstrated))
        update(self.agent, explored, demonstrated, weights, self._hold)

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
            on_progress(training.all_done, {"updates": updates, **training.agent.losses})

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
            on_progress(min(1.0, training.all_done), {name: v for name, v in history[-1].items() if v is not None})
            if score > best:
                best, best_policy = score, policy
    return TrainedController(
        best_policy, history, max(range(len(history)), key=lambda k: history[k]["score"] or -math.inf)
    )

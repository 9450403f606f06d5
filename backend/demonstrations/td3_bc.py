"""TD3 with demonstrations (ch. 2): a demonstration buffer that never changes, behavioural cloning, the goal's boost.

One controller per participant and environment. The update of TD3 itself lives in `backend.learning.td3.td3`; where
episodes begin in `placement.py`; how a controller is judged in `judging.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from backend.analysis.metrics import success_rate
from backend.demonstrations.demonstration import AUGMENTED, Demonstration, augmented
from backend.demonstrations.judging import KINDS, judge, unseen_scenes
from backend.demonstrations.placement import Placements
from backend.demonstrations.returns import ReturnsBuffer, returns_along
from backend.learning.policies.networks import use_one_thread
from backend.learning.policies.policy import Policy
from backend.learning.policies.shape import FAST_HEADS, NetworkShape
from backend.learning.scene_sets import Purpose
from backend.learning.td3.backprop import Floats
from backend.learning.td3.base import OnProgress, no_progress, policy_of
from backend.learning.td3.replay import ReplayCollector, concatenate
from backend.learning.td3.td3 import ActorTerm, Batch, Td3Agent, Td3Config
from backend.simulation.fast import FastEngine, evaluate
from backend.simulation.setups import get_setup, require_same
from backend.simulation.trajectory import Trajectory

UPDATES_BETWEEN = 100  # checkpoints; closer ones are hardly different policies
DEPARTURES = [
    "Observed angles are given as cosine and sine.",
    "Many environments in a fast kinematic engine instead of one in PyBullet; far fewer updates, larger learning rate "
    "of the actor, exploration noise spread over the environments.",
    "Rewards of several steps at once (n-step returns): a step is 2-5 cm long; one at a time, too many drives from "
    "random starts and to random goals collide.",
    "Reaching the goal in exploration earns half of what it earns in demonstrations (as in chapter 3), not nothing.",
    "A quarter of the episodes mixes demonstrated and random places of robot, person and goal.",
    "Actor and critic read person and goal, and walls and obstacles, through two small extractors, then two layers, "
    "instead of three layers of 256.",
    "The kept weights are the best of several checkpoints, as they are or averaged over recent updates, by success, "
    "likeness to the demonstrations and success in unseen scenes of the selection set.",
    "A beginning drawn beside the robot is drawn to it, the shift fading out along the path.",
]


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

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def demonstration_batch(demonstrations: Sequence[Demonstration], config: DemonstrationConfig) -> Batch:
    """The demonstration buffer: every transition of every augmented drive, the goal rewarded with the boost."""
    drives = [drive for d in demonstrations for drive in augmented(d, config.augmentation)]
    gamma = get_setup(drives[0].scene.setup).gamma
    led_to = []
    for drive in drives:
        boosted = drive.rewards + np.where(drive.dones, config.goal_boost, 0.0)  # each ends at its goal
        led_to.append(returns_along(drive, boosted, config.steps_at_once, gamma))
    rewards, following, continues = (np.concatenate(parts) for parts in zip(*led_to, strict=True))
    return Batch(
        torch.from_numpy(np.concatenate([drive.observations for drive in drives])),
        torch.from_numpy(np.concatenate([drive.actions for drive in drives])),
        torch.from_numpy(rewards),
        torch.from_numpy(following),
        torch.from_numpy(continues),
    )


def cloning_term(demonstrated: Floats, rl_weight: float, bc_weight: float) -> ActorTerm:
    """Behavioural cloning, the gradient of bc_weight / rl_weight * sum_i ||pi(s_i) - a_i||^2 (equations 2.4, 2.5).

    demonstrated (d, 2): actions of the last d observations of the batch; the others are left alone. Relative to the
    RL gradient's weight, because only the ratio of the two matters to Adam.
    """
    share = np.float32(bc_weight / rl_weight)
    first = -len(demonstrated)

    def term(_: Floats, actions: Floats) -> Floats:
        gradient = np.zeros_like(actions)
        gradient[first:] = 2 * share * (actions[first:] - demonstrated)
        return gradient

    return term


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
        self._demonstrated = demonstration_batch(demonstrations, config)
        drives: list[Trajectory] = [d.trajectory for d in demonstrations]
        pool = Placements(drives, near=config.near, mixed=config.mixed, seed=config.seed)
        engine = FastEngine(
            self.setup, config.n_envs, seed=config.seed, pool=pool, progress_weight=config.progress_weight
        )
        self._collector = ReplayCollector(engine, noise=config.exploration, seed=config.seed)
        self._buffer = ReturnsBuffer(
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
        self._collector.step(self.agent.act if warm else None, self._buffer)
        self.transitions += config.n_envs
        if not warm:
            return
        late = int(self.done >= config.reweighted_at)
        falling = max(0.0, 2 * self.done - 1)
        rate = config.actor_learning_rate + falling * (config.final_learning_rate - config.actor_learning_rate)
        self.agent.set_learning_rate(rate, critic=config.critic_learning_rate)
        for _ in range(config.updates_per_step):
            self._update(late)
            self._average.lerp_(self.agent.actor.flat, 1 - config.average_decay)

    def _update(self, late: int) -> None:
        """One update; late: 0 before the weights change, 1 after."""
        config = self.config
        if not config.demonstrations:
            self.agent.update(self._buffer.sample(2 * config.batch_each, self._sampler))
        else:
            explored = self._buffer.sample(config.batch_each, self._sampler)
            rows = torch.randint(len(self._demonstrated.rewards), (config.batch_each,), generator=self._sampler)
            shown = Batch(*(part.index_select(0, rows) for part in self._demonstrated))
            bc = config.bc_weight[late]
            term = cloning_term(shown.actions.numpy(), config.rl_weight[late], bc) if bc > 0 else None
            self.agent.update(concatenate(explored, shown), term)

    def policy(self, *, averaged: bool = False) -> Policy:
        """The current controller, with its critic; `averaged` takes the running average of the actor's weights."""
        return policy_of(self.agent, self.setup.name, self._average if averaged else None)


@dataclass(frozen=True)
class Trained:
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
) -> Trained:
    """Train, then keep the checkpoint of the highest score.

    score: success from demonstrated starts + success in unseen scenes + (t* - f in metres) of the median drive; ours.
    Without demonstrations, success in unseen scenes alone, so that nothing of them enters.
    Raises ValueError for no demonstrations, SetupError for those of two environments.
    """
    training = DemonstrationTraining(demonstrations, config)
    pairs = list({d.drawn_in.digest(): d.drawn_in for d in demonstrations}.values())
    each = max(1, config.selection_scenes // len(KINDS))
    unseen = [
        scene for kind in KINDS for scene in unseen_scenes(pairs, kind, each, purpose=Purpose.SELECT, seed=config.seed)
    ]
    checkpoints = max(1, min(config.checkpoints, config.updates // UPDATES_BETWEEN))
    marks = [round(config.updates * (k + 1) / checkpoints) for k in range(checkpoints)]
    history: list[dict[str, float | None]] = []
    best, kept = -math.inf, training.policy()
    while marks:
        training.vector_step()
        if training.agent.updates < marks[0]:
            if training.agent.updates % (50 * config.updates_per_step) == 0:
                on_progress(training.done, {"updates": training.agent.updates})
            continue
        marks.pop(0)
        for averaged in (False, True):
            policy = training.policy(averaged=averaged)
            judged = judge(policy, demonstrations)
            found = success_rate(evaluate(policy.act, training.setup, unseen).outcome)
            likeness = judged.success_rate + judged.t_star - judged.frechet_m
            score = found + (likeness if config.demonstrations else 0.0)
            history.append(
                {
                    "updates": training.agent.updates,
                    "transitions": training.transitions,
                    "averaged": float(averaged),
                    **judged.as_dict(),
                    "unseen_success_rate": found,
                    "score": score,
                }
            )
            on_progress(min(1.0, training.done), {name: v for name, v in history[-1].items() if v is not None})
            if score > best:
                best, kept = score, policy
    return Trained(kept, history, max(range(len(history)), key=lambda k: history[k]["score"] or -math.inf))

"""The base policy (RAW in the thesis): TD3 on the core reward plus a progress term, many environments, few updates.

The progress term (+1 per metre towards the goal) and the action smoothness penalty (turning costs, towards the end) are
ours and live only here: without the first every sparse run froze, without the second policies wobble. Neither
enters an alignment reward.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

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
from desirepath.learning.td3.interrupted import REFILLED, Kept, TrainingFile
from desirepath.learning.td3.replay import ReplayBuffer, ReplayCollector
from desirepath.learning.td3.td3 import CRITIC_ALONE, ActorTerm, Td3Agent, Td3Config, pull_gradient
from desirepath.learning.td3.way_guide import WayGuide
from desirepath.simulation.disturbed import randomised_engine
from desirepath.simulation.fast import evaluate, make_engine
from desirepath.simulation.setups import get_setup

TURNING = 1  # which of the two actions is the turn rate
GUIDED_SHARE = 0.5
GUIDANCE = 4.0
CLONED, CLONED_TRANSITIONS = 16, 192_000
AFTER_CLONING, AFTER_CLONING_SMOOTHING = 5_000, 2_000
"""Updates of TD3 where the policy drives already: it mends wobbling and rare failures, held by the guide to the end."""
LAST_GUIDANCE = 2.6
GUIDES = frozenset({"guided_share", "guidance", "guided_updates", "last_guidance", "cloned"})
MOST_RESTARTS = 3
LOOKING_SCENES = 100
CLONING_RATES, CLONING_BATCH, CLONING_DECAY = (1e-3, 3e-5), 256, 0.997
CHANCE_FIRST = 0.02  # of the phase in which the guide is cloned, until the policy drives
GUIDED_LATER = 0.1  # of the environments at least, in which the guide drives for the rest of it

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


class Look(NamedTuple):
    """Of a look at a training: how often a policy that learns arrives by then, at least. Ours."""

    updates: int
    least_success: float


LOOKS = (Look(1_500, 0.02), Look(2_500, 0.02), Look(5_000, 0.10), Look(10_000, 0.25))
"""A training of a setup that can be driven is far above these; one that stands still is at 0 for tens of thousands. The
first is of guided ones: without a guide some that drive in the end stand for 2,000."""


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
    guided_share: float = 0.0  # ours: of the environments, in which a guide drives instead of chance at first
    guidance: float = 0.0  # ours: weight of the squared distance from its actions in the actor's loss, to begin with
    guided_updates: int = 10_000  # ours: over which that weight falls
    last_guidance: float = 0.0  # ours: to which it falls; above 0 the policy is `held`
    cloned: int = 0  # ours: updates that clone the guide, for every step of the environments before the first of TD3
    randomise: bool = False  # whether robots get wrong what real ones do, up to `RANDOMISED`

    def as_dict(self) -> dict[str, Any]:
        """As `stored_config`; without guide and randomness where they have no part, as before there were any."""
        stored = stored_config(self)
        without = frozenset[str]() if self.guided_share else GUIDES
        if not self.randomise:
            without |= {"randomise"}
        return {name: value for name, value in stored.items() if name not in without}


def base_config(setup: str, seed: int = 0) -> BaseConfig:
    """How a base policy of that setup is trained today."""
    of = get_setup(setup)
    usual = BaseConfig(setup, seed, FAST_HEADS if of.extractors else EXPLAINED_HEADS)
    if not of.solids:
        usual = replace(usual, guided_share=GUIDED_SHARE, guidance=GUIDANCE)
    if not of.solids and not of.crowded:
        return replace(
            usual,
            cloned=CLONED,
            random_transitions=CLONED_TRANSITIONS,
            guided_updates=AFTER_CLONING + AFTER_CLONING_SMOOTHING,
            last_guidance=LAST_GUIDANCE,
            updates=AFTER_CLONING,
            smoothing_updates=AFTER_CLONING_SMOOTHING,
            checkpoints=4,
        )
    if of.crowded:  # half as long: a step among pedestrians takes five times as long
        return replace(usual, updates=40_000, smoothing_updates=8_000, selection_scenes=500)
    return usual


@dataclass(frozen=True)
class BaseResult:
    """The selected policy, its success rate on the selection scenes (optimistic: it was chosen there), the history."""

    policy: Policy
    selection_success: float
    transitions: int
    history: list[dict[str, float]]
    restarts: list[dict[str, float]] = field(default_factory=list)
    """Of each time that it stood still and was begun anew: its `seed`, `updates`, `success_rate`, `speed_share`."""


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
        self.make_engine = randomised_engine if config.randomise else make_engine
        engine = self.make_engine(
            self.setup, config.n_envs, seed=config.seed, progress_weight=config.progress_weight, auto_reset=True
        )
        self.collector = ReplayCollector(engine, noise=config.exploration, seed=config.seed)
        self.buffer = ReplayBuffer(config.buffer_size, self.setup.observation_size)
        self.transitions = 0
        self._sampler = torch.Generator().manual_seed(config.seed + 1)
        self._average = self.agent.actor.flat.clone()
        self._guide = WayGuide(engine) if config.guided_share else None
        self._guides = np.zeros((config.buffer_size if self._guide else 0, 2), dtype=np.float32)
        """What the guide would have done instead of each transition of the buffer."""
        self._chance = np.random.default_rng([config.seed, 0x5EE])
        self._cloned = config.cloned if self._guide else 0
        self.agent.actor_waits = CRITIC_ALONE if self._cloned else 0
        self.cloning_updates = 0

    @property
    def cloning_steps(self) -> int:
        """How many steps of the environments the guide is cloned in, before the first update of TD3."""
        return -(-self.config.random_transitions // self.config.n_envs) if self._cloned else 0

    def vector_step(self) -> int:
        """One step of all environments, then `updates_per_step` updates (none while the buffer fills at random).

        Returns how many updates there were in all.
        """
        config = self.config
        warm = self.transitions >= config.random_transitions
        self._step(warm)
        self.transitions += config.n_envs
        if not warm:
            self._clone()
            return self.agent.updates
        if self.agent.updates == 0:
            self.agent.synchronise_targets()
        self.agent.set_learning_rate(self.learning_rate())
        penalty, guidance = self.smoothness_penalty(), self.guidance()
        for _ in range(config.updates_per_step):
            rows = self.buffer.draw_rows(config.batch_size, self._sampler)
            self.agent.update(self.buffer.transitions(rows), self._term(rows, penalty, guidance))
            self._average.lerp_(self.agent.actor.flat, 1 - config.average_decay)
        return self.agent.updates

    def _step(self, warm: bool) -> None:
        if self._guide is None:
            self.collector.step(self.agent.act if warm else None, self.buffer)
        else:
            self._guided_step(self._guide, warm)

    def _guided_step(self, guide: WayGuide, warm: bool) -> None:
        """At first the guide drives in some of the environments and chance in the others, so that the buffer holds
        arrivals; then the policy does. One environment in so many: each has its own noise. What the guide would do is
        noted as long as the policy is drawn to it."""
        cloning = self._cloned_share()
        later = max(GUIDED_LATER, self.config.guided_share - GUIDED_SHARE)  # more of it where training began anew
        share = later if cloning > CHANCE_FIRST else self.config.guided_share
        if warm and self.guidance() <= 0:
            self.collector.step(self.agent.act, self.buffer)
            return
        guided = guide.act()
        self._guides[self.buffer.next_rows(len(guided))] = guided

        def first(observations: Floats) -> Floats:
            if cloning > CHANCE_FIRST:
                actions = self.agent.act(observations)
            else:
                actions = self._chance.uniform(-1, 1, guided.shape).astype(np.float32)
            drives = (np.arange(1, len(actions) + 1) * share) % 1 < share
            actions[drives] = guided[drives]
            return actions

        self.collector.step(self.agent.act if warm else first, self.buffer)

    def _cloned_share(self) -> float:
        """How far the phase before TD3's updates is, if the guide is cloned in it; else 0."""
        return self.transitions / self.config.random_transitions if self._cloned else 0.0

    def _clone(self) -> None:
        """The actor's updates towards what the guide would have done. The policy itself drives in the environments that
        the guide does not drive in, so that its own mistakes are among what is cloned (DAgger, Ross et al. 2011)."""
        first, last = CLONING_RATES
        left = (1 + math.cos(math.pi * min(1.0, self._cloned_share()))) / 2
        self.agent.set_learning_rate(last + left * (first - last))
        for _ in range(self._cloned):
            rows = self.buffer.draw_rows(CLONING_BATCH, self._sampler).numpy()
            self.agent.clone(self.buffer.data.observations.numpy()[rows], self._guides[rows])
            self._average.lerp_(self.agent.actor.flat, 1 - CLONING_DECAY)
            self.cloning_updates += 1

    def _term(self, rows: torch.Tensor, penalty: float, guidance: float) -> ActorTerm | None:
        if penalty <= 0 and guidance <= 0:
            return None

        def term(_: Floats, actions: Floats) -> Floats:
            gradient = smoothness_penalty_gradient(actions, penalty)
            if guidance > 0:
                gradient += pull_gradient(actions, self._guides[rows.numpy()], guidance)
            return gradient

        return term

    def guidance(self) -> float:
        """In the first updates the actor is drawn to what the guide does, less and less. A critic that has seen more
        collisions than arrivals wants to stand, and an actor that stands learns no more."""
        if self._guide is None:
            return 0.0
        first, last = self.config.guidance, self.config.last_guidance
        over = min(self.config.guided_updates, self.config.updates + self.config.smoothing_updates)
        return last + (first - last) * max(0.0, 1 - self.agent.updates / max(1, over))

    def go_on(self, kept: Kept) -> None:
        """Be where an interrupted training was, with another buffer."""
        self.agent.go_back(kept.memory)
        self.agent.updates = kept.updates
        self._average.copy_(kept.average)
        self.cloning_updates = self.cloning_steps * self._cloned
        for _ in range(REFILLED // self.config.n_envs):
            self._step(warm=True)
        self.transitions = max(kept.transitions, self.config.random_transitions)

    def keep(self, file: TrainingFile) -> None:
        """Write it down, to go on with."""
        file.keep(self.agent, self._average, self.transitions)

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
        policy = policy_of(self.agent, self.setup.name, self._average if averaged else None)
        return replace(policy, held=self.config.last_guidance if self._guide else 0.0)


def policy_of(agent: Td3Agent, setup: str, actor: torch.Tensor | None = None) -> Policy:
    """The agent's current actor (or the flat weights given) and critic as a policy."""
    kept = agent.actor.flat.clone()
    if actor is not None:
        agent.actor.flat.copy_(actor)
    policy = Policy(setup, agent.shape, tuple(agent.actor.to_arrays()), tuple(agent.critic.to_arrays()))
    agent.actor.flat.copy_(kept)
    return policy


class _StandsStill(Exception):
    """A look at a training found it below what a policy that learns does by then."""

    def __init__(self, found: dict[str, float]) -> None:
        super().__init__(found)
        self.found = found


def train_base(
    config: BaseConfig, on_progress: OnProgress = no_progress, file: TrainingFile | None = None
) -> BaseResult:
    """Train, then keep the checkpoint (as it is, or averaged) with most success on the selection scenes. file: where it
    is written down on its way, and gone on with.

    A training that stands still is noticed within its first seconds (`LOOKS`) and begun anew with another seed and a
    guide in more of the environments, MOST_RESTARTS times; the last attempt goes on whatever it does.
    """
    restarts: list[dict[str, float]] = []
    while True:
        watched = len(restarts) < MOST_RESTARTS
        try:
            training = BaseTraining(_begun_anew(config, len(restarts)))
            if file is not None and (kept := file.find()) is not None:
                training.go_on(kept)
            return replace(_train(training, config, on_progress, watched, file), restarts=restarts)
        except _StandsStill as still:
            if file is not None:
                file.forget()
            restarts.append(still.found)
            on_progress(0.0, {"begun_anew": float(len(restarts)), **still.found})


def _begun_anew(config: BaseConfig, restarts: int) -> BaseConfig:
    if not restarts or get_setup(config.setup).solids:
        return replace(config, seed=config.seed + 10_000 * restarts)
    share = min(1.0, max(config.guided_share, GUIDED_SHARE) + 0.25 * (restarts - 1))
    guidance = restarts * max(config.guidance, GUIDANCE)
    return replace(config, seed=config.seed + 10_000 * restarts, guided_share=share, guidance=guidance)


def _look(training: BaseTraining, looks: list[Look]) -> None:
    """Look whether the policy drives, if it is time to. Raises _StandsStill."""
    if not looks or training.agent.updates < looks[0].updates:
        return
    least = looks.pop(0).least_success
    scenes = scene_set(training.config.setup, LOOKING_SCENES, purpose=Purpose.SELECT, seed=0)
    table = evaluate(training.policy().act, training.setup, scenes, training.make_engine)
    success = success_rate(table.outcome)
    if success < least:
        speed = float((table.path_length / table.time).mean()) / training.setup.robot.limits.v_max
        found = {"updates": training.agent.updates, "success_rate": success, "speed_share": speed}
        raise _StandsStill({"seed": training.config.seed, **found})


def _train(
    training: BaseTraining, config: BaseConfig, on_progress: OnProgress, watched: bool, file: TrainingFile | None
) -> BaseResult:
    """Raises _StandsStill where `watched`."""
    scenes = scene_set(config.setup, config.selection_scenes, purpose=Purpose.SELECT, seed=config.seed)
    cloning = training.cloning_steps * config.cloned
    total = config.updates + config.smoothing_updates
    while training.agent.updates == 0 and training.transitions < training.cloning_steps * config.n_envs:
        training.vector_step()
        if training.transitions % (100 * config.n_envs) == 0:
            on_progress(training.cloning_updates / (cloning + total), {"transitions": training.transitions})
    apart = config.smoothing_updates / 2 / config.checkpoints
    marks = [round(total - k * apart) for k in reversed(range(config.checkpoints))]
    history: list[dict[str, float]] = []
    best = (-1.0, training.policy())
    begun = training.agent.updates
    marks = [mark for mark in marks if mark > begun] or [begun + 1]
    first = 0 if training.config.guidance else 1
    looks = [look for look in LOOKS[first:] if begun < look.updates < config.updates] if watched else []

    def share_done(updates: int) -> float:
        return min(1.0, (training.cloning_updates + updates) / (cloning + total))

    def between(updates: int) -> None:
        _look(training, looks)
        if file is not None and updates:
            training.keep(file)
        if updates and updates % (100 * config.updates_per_step) == 0:
            on_progress(
                share_done(updates), {"updates": updates, "transitions": training.transitions, **training.agent.losses}
            )

    for updates in checkpoints(training.vector_step, marks, between):
        for averaged in (False, True):
            policy = training.policy(averaged=averaged)
            table = evaluate(policy.act, training.setup, scenes, training.make_engine)
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
            on_progress(share_done(updates), metrics)
            if success > best[0]:
                best = (success, policy)
    return BaseResult(best[1], best[0], training.transitions, history)

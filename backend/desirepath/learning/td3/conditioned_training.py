"""Pre-training of the conditioned policy: TD3 on the core reward plus what each episode's imagined person prefers.

The policy itself lives in `conditioned.py`. All ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.learning.cards import stored_config
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy, settings
from desirepath.learning.policies.mirroring import ACTION_SIGNS, mirror_of
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.steerability import Steerability, measure_rollouts, steerability_of
from desirepath.learning.preferences.objectives import (
    OPPOSITES,
    SIZE,
    best_possible,
    mirrored_of,
    names_of,
    objectives_of,
    preference_weights,
    scales,
    shares_of_reward,
    step_terms_of,
)
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.learning.td3.checkpoints import checkpoints
from desirepath.learning.td3.interrupted import Kept, TrainingFile
from desirepath.learning.td3.replay import ReplayBuffer, ReplayCollector
from desirepath.learning.td3.td3 import ActorTerm, Batch, Td3Agent, Td3Config
from desirepath.learning.td3.way_guide import WayGuide
from desirepath.simulation.disturbed import randomised_engine
from desirepath.simulation.fast import FastEngine, make_engine, rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setup_parts import EpisodeReward
from desirepath.simulation.setups import Setup, SetupError, get_setup

Floats = NDArray[np.float32]
WEIGHING_SCENES = 200
LEAST_COST = 0.1  # of a trajectory of the base policy: what it never does has no scale beyond this


@dataclass(frozen=True)
class RewardWeights(EpisodeReward):
    """What an episode is about during this training, in reward. Evaluation and cards use the setup's core reward.

    scales: per step of each objective's step term at full weight, in the order of OBJECTIVES.
    """

    scales: tuple[float, ...] = ()


def reward_weights_of(base: Policy) -> RewardWeights:
    """Those of the base policy's setup: as its file says; scales that it does not say are measured on what the base
    policy does on selection scenes (`Objective.share`). Raises SetupError."""
    setup = get_setup(base.setup)
    reward, said = setup.conditioning.reward, scales(setup.name)
    objectives = objectives_of(setup.name)
    measured = dict[str, float]()
    if not all(objective.name in said for objective in objectives):
        scenes = scene_set(setup.name, WEIGHING_SCENES, purpose=Purpose.SELECT, seed=0)
        costs = -np.mean(
            [
                step_terms_of(one.actions, one.next_observations, setup).sum(axis=0, dtype=np.float64)
                for one in rollout(setup, base.rollout_policy, scenes)
            ],
            axis=0,
        )
        costs = (costs + costs[mirrored_of(setup.name)]) / 2  # either side is worth the same
        measured = {
            objective.name: objective.share * reward.goal / max(float(cost), LEAST_COST)
            for objective, cost in zip(objectives, costs, strict=True)
        }
    return RewardWeights(
        **asdict(reward), scales=tuple(said.get(one.name, measured.get(one.name, 0.0)) for one in objectives)
    )


MIXTURES = {
    "farther_smoother": {"farther": 1.0, "smoother": 0.5},
    "slower_clearance": {"slower_near_person": 1.0, "clearance": 0.7},
    "left_faster": {"person_on_left": 1.0, "faster": 1.0},
}
"""Preferences whose success counts, beside that of each objective alone, when a checkpoint is chosen."""
CROWD_MIXTURES = {
    "farther_smoother": {"farther": 1.0, "smoother": 0.5},
    "behind_slower": {"passes_behind": 1.0, "slower_near_person": 0.7},
    "front_faster": {"cuts_in_front": 1.0, "faster": 1.0},
}


def judged_settings(setup: str) -> dict[str, Floats]:
    """The preference weights that checkpoints are judged at."""
    return settings(CROWD_MIXTURES if get_setup(setup).pedestrians else MIXTURES, setup)


@dataclass(frozen=True)
class ConditionedConfig:
    """How a conditioned policy is trained. All ours; measured in the open field and the study room (card)."""

    setup: str
    seed: int = 0
    reward_weights: RewardWeights | None = None  # None: `reward_weights_of` the base policy
    updates: int = 50_000
    batch_size: int = 256
    gamma: float = 0.99  # detours take longer than the setups' 0.98 looks ahead
    learning_rate: float = 6e-4
    final_learning_rate: float = 3e-5  # reached linearly over the second half
    tau: float = 0.005
    average_decay: float = 0.9995  # running average of the actor's weights, per update
    n_envs: int = 128
    updates_per_step: int = 8
    buffer_size: int = 1_100_000
    base_transitions: int = 100_000  # of the base policy's regenerated buffer, to begin with
    exploration: tuple[float, float] = (0.03, 0.4)
    neutral_share: float = 0.12  # of the episodes: all weights are zero
    one_share: float = 0.4  # one objective; of the rest, half have two and half three
    full_share: float = 0.7  # of the episodes with a preference: the largest weight is 1, as the posterior gives it
    smallest_weight: float = 0.15
    relabelled_share: float = 0.5  # of each batch: judged by the weights of another episode
    mirrored_share: float = 0.5  # of each batch: left and right exchanged
    checkpoints: int = 4  # over the last third; the best on the selection scenes is kept
    selection_scenes: int = 150
    # Full `farther` shall go this part of the way from base policy to ceiling. Reports are lower by two or three points
    # in the room, and the aim is 85 % there. Set after a look at three trainings of either setup.
    strong_share: float = 0.875
    strengths: tuple[float, ...] = (
        1.0,
        1.125,
        1.25,
        1.375,
        1.5,
    )  # conditioned on so many times full weight: the first that does
    strong_scenes: int = 2_000  # the selection scenes and more of their set, in which that is measured
    strong_success: float = 0.975  # no strength that costs more; the bar in reports is 97 %
    recovery: bool = False  # whether the base policy frees a robot that is stuck
    randomise: bool = False  # as `BaseConfig`
    guidance: float = 0.0  # weight of the squared distance from the guide's actions in the actor's loss
    let_go: float = 0.0  # share of that weight that a full preference takes away
    smoothness: float = 0.0  # weight of the squared turning there
    smoothness_wanted: float = 0.0  # as much more of it for whoever prefers `smoother`, in full

    def as_dict(self) -> dict[str, Any]:
        """As `stored_config`; without what has no part, as before there were randomness, guide and smoothness."""
        later = {"randomise", "guidance", "let_go", "smoothness", "smoothness_wanted"}
        return {name: value for name, value in stored_config(self).items() if value or name not in later}


def conditioned_config(base: Policy, seed: int = 0) -> ConditionedConfig:
    """How the conditioned policy of the base policy's setup is trained: as its file says."""
    given = get_setup(base.setup).conditioning
    own = {one.name: getattr(given, one.name) for one in fields(given) if one.name != "reward"}
    return ConditionedConfig(base.setup, seed, reward_weights_of(base), **own)


@dataclass(frozen=True)
class ConditionedResult:
    """The selected policy, how it moved on the selection scenes (optimistic: it was chosen there), the history.

    strength: how many times what it learned as full `farther` it is conditioned on now (`strong_enough`).
    """

    policy: ConditionedPolicy
    strength: float
    selection: Steerability
    transitions: int
    history: list[dict[str, float]]


def sample_weights(n: int, config: ConditionedConfig, random: np.random.Generator) -> Floats:
    """(n, 9) what n imagined people prefer: nothing, one objective, two or three; never opposites."""
    weights = np.zeros((n, SIZE), dtype=np.float32)
    kind = random.random(n)
    many = config.neutral_share + config.one_share
    for row in np.flatnonzero(kind >= config.neutral_share):
        count = 1 if kind[row] < many else 2 + int(kind[row] > (1 + many) / 2)
        chosen: list[int] = []
        for k in random.permutation(SIZE):
            if len(chosen) < count and not any({int(k), other} in map(set, OPPOSITES) for other in chosen):
                chosen.append(int(k))
        strengths = random.uniform(config.smallest_weight, 1, count)
        if random.random() < config.full_share:
            strengths[0] = 1.0
        weights[row, chosen] = strengths
    return weights


def training_engine(
    setup: Setup, reward_weights: RewardWeights, n_envs: int, *, seed: int, randomise: bool = False
) -> FastEngine:
    """Environments of the setup with the reward weights of how an episode goes, without objectives, time, turning."""
    core = replace(
        setup.reward,
        goal=reward_weights.goal,
        collision=reward_weights.collision,
        self_intersection=reward_weights.self_intersection,
    )
    make = randomised_engine if randomise else make_engine
    return make(replace(setup, reward=core), n_envs, seed=seed, progress_weight=reward_weights.progress)


class ConditionedTransitions(NamedTuple):
    """Transitions with the step terms (n, 9) that they led to, the weights (n, 9) they were rolled out under and what
    the guide would have done (n, 2)."""

    batch: Batch
    terms: torch.Tensor
    weights: torch.Tensor
    guided: torch.Tensor


class ConditionedReplayBuffer(ReplayBuffer):
    """A ring of transitions that also keeps their step terms, and the weights that they were rolled out under."""

    def __init__(self, capacity: int, setup: Setup) -> None:
        super().__init__(capacity, setup.observation_size)
        self._setup = setup
        self.terms, self.weights = torch.zeros(capacity, SIZE), torch.zeros(capacity, SIZE)
        self.guided = torch.zeros(capacity, 2)
        self.rolled_out_by = np.zeros((0, SIZE), dtype=np.float32)
        """(n, 9) the weights of the n transitions that are added next."""
        self.guided_by: Floats | None = None
        """(n, 2) what the guide would do instead of each of these; None without one."""

    def add(
        self,
        observations: Floats,
        actions: Floats,
        rewards: Floats,
        next_observations: Floats,
        dones: NDArray[np.bool_],
    ) -> None:
        rows = self.next_rows(len(rewards))
        self.terms.numpy()[rows] = step_terms_of(actions, next_observations, self._setup)
        self.weights.numpy()[rows] = self.rolled_out_by
        if self.guided_by is not None:
            self.guided.numpy()[rows] = self.guided_by
        super().add(observations, actions, rewards, next_observations, dones)

    def draw(self, n: int, generator: torch.Generator) -> ConditionedTransitions:
        """n transitions drawn uniformly, with replacement."""
        rows = self.draw_rows(n, generator)
        more = (part.index_select(0, rows) for part in (self.terms, self.weights, self.guided))
        return ConditionedTransitions(self.transitions(rows), *more)


class ConditionedTraining:
    """The training loop as an object: one `vector_step` steps every environment once and updates some times."""

    def __init__(self, base: Policy, config: ConditionedConfig) -> None:
        use_one_thread()
        self._rewards = config.reward_weights or reward_weights_of(base)
        _check(base, config, self._rewards)
        self.config = config
        self.setup = get_setup(config.setup)
        polar = self.setup.polar_size
        self._base = base.actor if config.recovery else ()
        self.shape = replace(base.shape, task_inputs=polar + SIZE)
        td3 = Td3Config(config.gamma, config.batch_size, config.learning_rate, config.tau)
        self.agent = Td3Agent(self.shape, td3, seed=config.seed)
        self.agent.actor.load_arrays(_with_weight_inputs(base.actor, polar))
        self.agent.critic.load_arrays(_with_weight_inputs(base.critic, polar))
        self.agent.synchronise_targets()
        self._average = self.agent.actor.flat.clone()
        self._random = np.random.default_rng([config.seed, 9])
        self._sampler = torch.Generator().manual_seed(config.seed + 1)
        self._mirror = mirror_of(self.setup)
        self.buffer = ConditionedReplayBuffer(config.buffer_size, self.setup)
        self._collect_with(base)
        engine = training_engine(
            self.setup, self._rewards, config.n_envs, seed=config.seed + 1, randomise=config.randomise
        )
        self.collector = ReplayCollector(engine, noise=config.exploration, seed=config.seed + 1)
        self._guide = WayGuide(engine) if config.guidance else None
        self._weights = sample_weights(config.n_envs, config, self._random)
        self.transitions = 0

    def _collect_with(self, base: Policy) -> None:
        """Fill the buffer with trajectories of the base policy, judged by weights that had no part in them."""
        config, n_envs = self.config, 256
        engine = training_engine(self.setup, self._rewards, n_envs, seed=config.seed, randomise=config.randomise)
        collector = ReplayCollector(engine, noise=config.exploration, seed=config.seed)
        guide = WayGuide(engine) if config.guidance else None
        for _ in range(-(-config.base_transitions // n_envs)):
            self.buffer.guided_by = guide.act() if guide else None
            self.buffer.rolled_out_by = sample_weights(n_envs, config, self._random)
            collector.step(base.act, self.buffer)

    def vector_step(self) -> int:
        """One step of all environments, each by its own weights, then `updates_per_step` updates; returns how many
        there were in all."""
        config, engine = self.config, self.collector.engine
        self.buffer.rolled_out_by = self._weights
        self.buffer.guided_by = self._guide.act() if self._guide else None
        self.collector.step(lambda o: self.agent.act(self._inputs(o, self._weights)), self.buffer)
        self.transitions += config.n_envs
        ended = engine.dones
        if ended.any():
            self._weights[ended] = sample_weights(int(ended.sum()), config, self._random)
        late = max(0.0, 2 * self.agent.updates / config.updates - 1)
        self.agent.set_learning_rate(
            config.learning_rate + min(1.0, late) * (config.final_learning_rate - config.learning_rate)
        )
        for _ in range(config.updates_per_step):
            batch, guided = self.batch()
            self.agent.update(batch, self._term(guided))
            self._average.lerp_(self.agent.actor.flat, 1 - config.average_decay)
        return self.agent.updates

    def go_on(self, kept: Kept) -> None:
        """Be where an interrupted training was, with another buffer."""
        self.agent.go_back(kept.memory)
        self.agent.updates, self.transitions = kept.updates, kept.transitions
        self._average.copy_(kept.average)

    def keep(self, file: TrainingFile) -> None:
        """Write it down, to go on with."""
        file.keep(self.agent, self._average, self.transitions)

    def _term(self, guided: Floats) -> ActorTerm | None:
        """What the actor's loss holds beside value: how far it is from the guide, less where something is preferred;
        and turning, more for whoever prefers `smoother`."""
        config, first = self.config, self.setup.polar_size
        if not (config.guidance or config.smoothness):
            return None
        smoother = first + names_of(config.setup).index("smoother")

        def term(inputs: Floats, actions: Floats) -> Floats:
            strongest = np.clip(inputs[:, first : first + SIZE].max(axis=1, keepdims=True), 0, 1)
            gradient: Floats = config.guidance * (1 - config.let_go * strongest) * (actions - guided)
            gradient[:, 1] += (config.smoothness + config.smoothness_wanted * inputs[:, smoother]) * actions[:, 1]
            return gradient * np.float32(2 / len(actions))

        return term

    def batch(self) -> tuple[Batch, Floats]:
        """What the agent learns from: reward = core + progress + sum_k scale_k share_k term_k - turning - time; and
        what the guide would do there (n, 2).

        Part of it is judged by the weights of other rows, part of it is mirrored; both are as true as the rollouts.
        """
        config, reward_weights = self.config, self._rewards
        n = config.batch_size
        (observations, actions, rewards, following, continues), terms, rolled_out_by, guides = self.buffer.draw(
            n, self._sampler
        )
        weights, guided = rolled_out_by.numpy(), guides.numpy()
        shuffled = int(n * config.relabelled_share)
        weights[:shuffled] = weights[self._random.permutation(n)[:shuffled]]
        judged = (shares_of_reward(weights) * terms.numpy()) @ np.array(reward_weights.scales, dtype=np.float32)
        judged -= np.float32(reward_weights.turning) * np.abs(actions.numpy()[:, 1]) + np.float32(reward_weights.time)
        mirrored = self._random.random(n) < config.mirrored_share
        seen, then, done = observations.numpy(), following.numpy(), actions.numpy()
        order, signs = self._mirror
        for part in (seen, then):
            part[mirrored] = part[mirrored][:, order] * signs
        done[mirrored] *= ACTION_SIGNS
        guided[mirrored] *= ACTION_SIGNS
        weights[mirrored] = weights[mirrored][:, mirrored_of(config.setup)]
        batch = Batch(
            torch.from_numpy(self._inputs(seen, weights)),
            actions,
            rewards + torch.from_numpy(judged),
            torch.from_numpy(self._inputs(then, weights)),
            continues,
        )
        return batch, guided

    def _inputs(self, observations: Floats, weights: Floats) -> Floats:
        """What the conditioned networks read: task part, weights, lidar."""
        polar = self.setup.polar_size
        return np.concatenate([observations[:, :polar], weights, observations[:, polar:]], axis=1)

    def policy(self, *, averaged: bool) -> ConditionedPolicy:
        """The current policy with its critic; `averaged` takes the running average of the actor's weights."""
        kept = self.agent.actor.flat.clone()
        if averaged:
            self.agent.actor.flat.copy_(self._average)
        actor, critic = tuple(self.agent.actor.to_arrays()), tuple(self.agent.critic.to_arrays())
        self.agent.actor.flat.copy_(kept)
        return ConditionedPolicy(self.setup.name, self.shape, actor, critic, self._rewards.scales, self._base)


def _with_weight_inputs(arrays: tuple[Floats, ...], task_inputs: int) -> list[Floats]:
    """A network's arrays with SIZE more task inputs that have no effect yet."""
    first = arrays[0]
    new = np.zeros((SIZE, first.shape[1]), dtype=np.float32)
    return [np.concatenate([first[:task_inputs], new]), *arrays[1:]]


def _check(base: Policy, config: ConditionedConfig, reward_weights: RewardWeights) -> None:
    if base.setup != config.setup:
        raise SetupError(f"base policy is of {base.setup}, setup = {config.setup}")
    if not base.critic:
        raise LearningError("base policy has no critic: training goes on only from a file that was saved with one")
    given = reward_weights.scales
    if len(given) != SIZE or min(given) < 0:
        raise LearningError(
            f"reward_weights.scales = {given}: {SIZE} numbers >= 0 are needed, in the order of {names_of(config.setup)}"
        )
    if config.mirrored_share and any(given[k] != given[m] for k, m in enumerate(mirrored_of(config.setup))):
        raise LearningError(
            f"reward_weights.scales = {given}: mirroring needs the same scale for the person on either side"
        )
    if config.buffer_size < config.base_transitions + config.n_envs:
        raise LearningError(
            f"buffer_size = {config.buffer_size}: must hold base_transitions ({config.base_transitions}) and more"
        )
    if not 1 <= config.checkpoints <= config.updates:
        raise LearningError(f"checkpoints = {config.checkpoints}: between 1 and updates ({config.updates})")


def train_conditioned(
    base: Policy, config: ConditionedConfig, on_progress: OnProgress = no_progress, file: TrainingFile | None = None
) -> ConditionedResult:
    """Train from the base policy, then keep the checkpoint (averaged weights) that scores best on the selection scenes.

    The score rewards movement in the wanted directions and punishes failures and self-intersections
    (`Steerability.score`). Then `farther` is made as strong as it shall be. file: where it is written down on its way,
    and gone on with. Raises SetupError, LearningError.
    """
    training = ConditionedTraining(base, config)
    if file is not None and (kept := file.find()) is not None:
        training.go_on(kept)
    scenes = scene_set(config.setup, config.selection_scenes, purpose=Purpose.SELECT, seed=config.seed)
    marks = [round(config.updates * (2 / 3 + (k + 1) / config.checkpoints / 3)) for k in range(config.checkpoints)]
    marks = [mark for mark in marks if mark > training.agent.updates] or [training.agent.updates + 1]
    history: list[dict[str, float]] = []
    tried: list[tuple[ConditionedPolicy, Steerability]] = []

    def between(updates: int) -> None:
        if file is not None:
            training.keep(file)
        if updates % (100 * config.updates_per_step) == 0:
            on_progress(updates / config.updates, {"updates": updates, "transitions": training.transitions})

    for updates in checkpoints(training.vector_step, marks, between):
        policy = training.policy(averaged=True)
        movement = _movement(policy, base, scenes)
        metrics = {"updates": updates, "transitions": training.transitions, **movement.summary()}
        history.append(metrics)
        on_progress(min(1.0, updates / config.updates), metrics)
        tried.append((policy, movement))
    policy, movement = max(tried, key=lambda entry: entry[1].score)
    strength = strong_enough(policy, base, config)
    if strength != 1.0:
        policy = policy.stronger("farther", strength)
        movement = _movement(policy, base, scenes)
    return ConditionedResult(policy, strength, movement, training.transitions, history)


def _movement(policy: ConditionedPolicy, base: Policy, scenes: Sequence[Scene]) -> Steerability:
    asked = judged_settings(policy.setup)
    return steerability_of({name: policy.at(weights) for name, weights in asked.items()}, base, scenes)


def strong_enough(policy: ConditionedPolicy, base: Policy, config: ConditionedConfig) -> float:
    """How many times full `farther` must be conditioned on for `strong_share` of the way, at most; 1 for what goes it
    by itself.

    What a training makes of the same weights differs by chance (seed 2 stopped a tenth of the way before seeds 0 and
    1); conditioned on more than it learned from, it goes on smoothly. Only here, since elsewhere the possible is out of
    reach. Of strengths that keep `strong_success`, the smallest that suffices, else the largest.
    """
    scenes = scene_set(config.setup, config.strong_scenes, purpose=Purpose.SELECT, seed=config.seed)
    rolled_out = measure_rollouts(base, scenes)
    possible = best_possible(scenes)
    farther = preference_weights({"farther": 1.0})
    kept = 1.0
    for strength in config.strengths:
        trajectories = measure_rollouts(policy.stronger("farther", strength).at(farther), scenes)
        if trajectories.success.mean() < config.strong_success:
            break
        kept = strength
        reached = Steerability(rolled_out, {"farther": trajectories}, possible, config.setup).shares["farther"]
        if reached >= config.strong_share:
            break
    return kept

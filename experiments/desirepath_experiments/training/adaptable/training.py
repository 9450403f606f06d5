"""MO-TD3-HER (PD-MORL; section 5.3.2): the training loop of the adaptable policy.

Environments in three groups, each exploring its own third of the preference triangle; transitions keep the vector of
rewards, so that hindsight may judge them by any other preference; solutions of the single objectives feed the
interpolator. The update itself lives in `vector_td3.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.frechet import frechet_distance
from desirepath.learning.adaptable.objectives import (
    KEY_PREFERENCES,
    NAMES,
    PROGRESS_PER_M,
    REWARDS,
    SIZE,
    DemonstrationReward,
    objective_rewards,
    sample_preferences_in,
    scalarise,
)
from desirepath.learning.cards import stored_config
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.adaptable import AdaptablePolicy
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.checkpoints import checkpoints
from desirepath.simulation.acting import ActFunction
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath_experiments.training.adaptable.demonstrator import demonstrate_paths
from desirepath_experiments.training.adaptable.ranking import DEMONSTRATED_HEADS
from desirepath_experiments.training.adaptable.rollouts import PreferenceRollouts, roll_out_preferences
from desirepath_experiments.training.adaptable.vector_td3 import (
    Imitated,
    Interpolator,
    VectorBatch,
    VectorReplayBuffer,
    VectorTd3Agent,
    VectorTd3Config,
    relabel,
)

ADAPTABLE = get_setup("adaptable")

Floats = NDArray[np.float32]
PERSON_INPUTS = (2, 3)
ATTEMPTS = 4
STANDS_STILL_AFTER = 2_000  # updates; a training that goes anywhere has 98 % success by then
STANDS_STILL = 0.1  # less success than this over the key preferences is standing still
MEASURE_OF = ("frechet_m", "human_m", "time_s")  # of each objective, in the order of NAMES


@dataclass(frozen=True)
class AdaptableConfig:
    """How an adaptable policy is trained. Sections 5.3.2 and 5.4.1 where named, the rest ours."""

    seed: int = 0
    heads: tuple[int, ...] = DEMONSTRATED_HEADS
    updates: int = 20_000  # ours: success at every preference stands after 3,000
    batch_size: int = 128
    gamma: float = 0.995  # 1 in section 5.4.1; ours: with 1, who only keeps away may stand for ever
    learning_rate: float = 5e-4
    final_learning_rate: float = 5e-5  # reached linearly over the second half
    tau: float = 0.01  # with 0.05 and a fifth of the angle, half of the robots that only keep away never arrived
    angle_weight: float = 0.1
    clone_weight: float = 0.5  # beta: the demonstration's clone draws the actor, by its weight squared; ours
    n_envs: int = 96  # a third of them in each part of the triangle; the thesis has one in each
    updates_per_step: int = 8  # 600,000 steps (section 5.4.1) would be 50,000 updates
    buffer_size: int = 700_000
    random_transitions: int = 20_000
    cloned_transitions: int = 20_000  # of the clone with much noise, judged as all others; ours
    exploration: tuple[float, float] = (0.05, 0.4)  # std of the action noise, spread over the environments
    relabelled_share: float = 0.5  # of each batch: judged by a preference drawn anew
    reward_scale: float = 0.01
    average_decay: float = 0.999  # running average of the actor's weights, per update
    solutions_every: int = 4_000  # updates between looks at the single objectives
    solution_scenes: int = 40
    checkpoints: int = 4  # over the last quarter; the best on the selection scenes is kept
    selection_scenes: int = 40
    without_person: bool = False  # the ablation: the person's pose is hidden from all networks
    alone: str = ""  # an objective's name: the single-objective policy, trained under that weight and no other

    def __post_init__(self) -> None:
        if self.alone and self.alone not in NAMES:
            raise LearningError(f"alone = {self.alone!r}: must be one of {', '.join(NAMES)}, or empty for all of them")

    def as_dict(self) -> dict[str, Any]:
        return stored_config(self)


@dataclass(frozen=True)
class AdaptableResult:
    """The selected policy, its success on the selection scenes (optimistic: it was chosen there), the curve, the
    single-objective solutions (3, 3) per metre of way that the interpolator ended with."""

    policy: AdaptablePolicy
    selection_success: float
    transitions: int
    history: list[dict[str, float]]
    solutions: Floats


def without_person(observations: Floats) -> Floats:
    """The observations with the person's distance and bearing set to 0."""
    hidden = observations.copy()
    hidden[:, PERSON_INPUTS] = 0
    return hidden


class AdaptableTraining:
    """The training loop as an object: one `vector_step` steps every environment once and updates some times."""

    def __init__(
        self,
        config: AdaptableConfig,
        demonstration: DemonstrationReward,
        clone: ActFunction | None = None,
        *,
        attempt: int = 0,
    ) -> None:
        """attempt: other initial networks and another exploration for each; scenes stay the seed's."""
        use_one_thread()
        self.config, self.demonstration, self.setup = config, demonstration, ADAPTABLE
        angle_weight = 0.0 if config.alone else config.angle_weight
        td3 = VectorTd3Config(config.gamma, config.learning_rate, config.tau, angle_weight=angle_weight)
        size, split = self.setup.observation_size, self.setup.polar_size
        self.agent = VectorTd3Agent(size, split, config.heads, td3, seed=config.seed + 1_000 * attempt)
        self.shape = NetworkShape(split + SIZE, self.setup.surroundings_size, 0, config.heads)
        self.buffer = VectorReplayBuffer(config.buffer_size, size)
        self.transitions = 0
        self._random = np.random.default_rng([config.seed, 55, attempt] if attempt else [config.seed, 55])
        self._average = self.agent.actor.flat.clone()
        self._engine = make_engine(self.setup, config.n_envs, seed=config.seed, progress_weight=PROGRESS_PER_M)
        self._parts = np.arange(config.n_envs) % SIZE
        noise = np.geomspace(*config.exploration, config.n_envs // SIZE + 1).astype(np.float32)
        self._noise = noise[np.arange(config.n_envs) // SIZE][:, None]
        self._preferences = self._draw_preferences(self._parts)
        self._best = np.full(SIZE, -np.inf, dtype=np.float32)
        self.solutions = np.zeros((SIZE, SIZE), dtype=np.float32)
        self._clone = clone
        self._begin_with(clone)

    def _draw_preferences(self, parts: NDArray[np.int64]) -> Floats:
        """Preferences of new episodes (n, 3): of their thirds of the triangle, or the only one there is."""
        if self.config.alone:
            return np.tile(np.eye(SIZE, dtype=np.float32)[NAMES.index(self.config.alone)], (len(parts), 1))
        return sample_preferences_in(parts, self._random)

    def _begin_with(self, clone: ActFunction | None) -> None:
        """Random transitions, and the clone's with up to twice the exploration noise."""
        for _ in range(-(-self.config.random_transitions // self.config.n_envs)):
            self._collect(self._random.uniform(-1, 1, (self.config.n_envs, 2)).astype(np.float32))
        if clone is None:
            return
        for _ in range(-(-self.config.cloned_transitions // self.config.n_envs)):
            self._collect(self._noisy(clone(self._seen(self._engine.observations)), 2.0))

    def _seen(self, observations: Floats) -> Floats:
        return without_person(observations) if self.config.without_person else observations

    def _noisy(self, actions: Floats, times: float = 1.0) -> Floats:
        jitter = self._random.standard_normal(actions.shape, dtype=np.float32) * self._noise * np.float32(times)
        return np.clip(actions + jitter, -1, 1)

    def _collect(self, actions: Floats) -> None:
        """One step of every environment into the buffer; who ended gets a new preference of its part."""
        engine = self._engine
        before = engine.observations.copy()
        engine.step(actions)
        rewards = np.empty((len(actions), len(REWARDS)), dtype=np.float32)
        rewards[:, 0] = engine.rewards
        rewards[:, 1:] = objective_rewards(before, actions, engine.next_observations, self.demonstration, self.setup)
        self.buffer.add(
            VectorBatch(
                self._seen(before),
                actions,
                rewards * np.float32(self.config.reward_scale),
                self._seen(engine.next_observations),
                (~engine.dones).astype(np.float32),
                self._preferences,
            )
        )
        self.transitions += len(actions)
        ended = np.flatnonzero(engine.dones)
        if len(ended):
            self._preferences[ended] = self._draw_preferences(self._parts[ended])

    def vector_step(self) -> int:
        """One step of all environments, then `updates_per_step` updates; returns how many there were in all."""
        config, agent = self.config, self.agent
        self._collect(self._noisy(agent.act(self._seen(self._engine.observations), self._preferences)))
        late = min(1.0, max(0.0, 2 * agent.updates / config.updates - 1))
        agent.set_learning_rate(config.learning_rate + late * (config.final_learning_rate - config.learning_rate))
        for _ in range(config.updates_per_step):
            batch = self.buffer.sample(config.batch_size, self._random)
            if not config.alone:
                batch = relabel(batch, config.relabelled_share, self._random)
            agent.update(batch, self.setup.distance_scale_m, self._imitate)
            self._average.lerp_(agent.actor.flat, 1 - config.average_decay)
            if agent.updates % config.solutions_every == 0:
                self.look_at_solutions()
        return agent.updates

    def _imitate(self, batch: VectorBatch) -> Imitated | None:
        if self._clone is None or not self.config.clone_weight:
            return None
        weights = np.float32(self.config.clone_weight) * batch.preferences[:, 0] ** 2
        return Imitated(self._clone(batch.observations), weights)

    def average(self) -> AdaptablePolicy:
        """The running average of the actor. Where the person is hidden, the weights that would read them are 0."""
        arrays, offset = [], 0
        for inputs, outputs in self.agent.actor.sizes:
            for shape in ((inputs, outputs), (outputs,)):
                size = int(np.prod(shape))
                arrays.append(self._average[offset : offset + size].numpy().reshape(shape).copy())
                offset += size
        if self.config.without_person:
            arrays[0][list(PERSON_INPUTS)] = 0
        return AdaptablePolicy(self.setup.name, self.shape, tuple(arrays))

    def look_at_solutions(self) -> None:
        """Roll out each objective alone; what is better than ever before becomes that objective's solution."""
        rollouts = self.roll_out(self.average(), np.eye(SIZE, dtype=np.float32), self.config.solution_scenes)
        scalar = scalarise(rollouts.returns, rollouts.preferences).reshape(SIZE, -1).mean(axis=1)
        per_m = rollouts.returns[:, 1:] / rollouts.start_m[:, None] * self.config.reward_scale
        better = scalar > self._best
        self._best[better] = scalar[better]
        self.solutions[better] = per_m.reshape(SIZE, -1, SIZE).mean(axis=1)[better]
        self.agent.interpolator = Interpolator(self.solutions.copy())

    def scenes(self, n: int) -> list[Scene]:
        """The selection scenes, which nothing reports."""
        return scene_set(self.setup.name, n, purpose=Purpose.ALIGN_SELECT, seed=self.config.seed)

    def roll_out(self, policy: AdaptablePolicy, preferences: Floats, n_scenes: int) -> PreferenceRollouts:
        """Each preference (k, 3) in the same selection scenes, preference after preference."""
        scenes = self.scenes(n_scenes)
        return roll_out_preferences(
            policy.act, scenes * len(preferences), np.repeat(preferences, n_scenes, axis=0), self.demonstration
        )


def train_adaptable(
    config: AdaptableConfig,
    demonstration: DemonstrationReward,
    clone: ActFunction | None = None,
) -> AdaptableResult:
    """Train one adaptable policy. demonstration: R_hat; clone: acts as the demonstration does, to begin with.

    An actor whose outputs saturate before the critics know anything stands for ever: a training whose robots arrive
    nowhere after 2,000 updates is begun again with other initial networks, at most three times; the history keeps its
    points. Of the last quarter's checkpoints the one with most success over the key preferences is kept, the latest of
    equals.
    """
    ended: list[dict[str, float]] = []
    for attempt in range(ATTEMPTS):
        training = AdaptableTraining(config, demonstration, clone, attempt=attempt)
        trained = _train(training, gives_up=attempt + 1 < ATTEMPTS)
        if trained.policy is not None:
            break
        ended.extend(trained.history)
    assert trained.policy is not None  # noqa: S101 - the last attempt does not give up
    return AdaptableResult(
        trained.policy, trained.success, training.transitions, [*ended, *trained.history], training.solutions
    )


@dataclass(frozen=True)
class _Attempt:
    """What one attempt came to. policy: None where it was given up."""

    policy: AdaptablePolicy | None
    success: float
    history: list[dict[str, float]]


def _train(training: AdaptableTraining, *, gives_up: bool) -> _Attempt:
    """Train to the end and keep the best of the last quarter, or give up where it stands still."""
    config = training.config
    quarter = config.updates // 4
    marks = [config.updates - quarter + quarter * (k + 1) // config.checkpoints for k in range(config.checkpoints)]
    early = [config.updates * k // 12 for k in range(2, 9, 2)]
    preferences = np.eye(SIZE, dtype=np.float32)[[NAMES.index(config.alone)]] if config.alone else KEY_PREFERENCES
    ways = demonstrate_paths(training.scenes(config.selection_scenes))
    history: list[dict[str, float]] = []
    best: tuple[dict[str, float], AdaptablePolicy] | None = None

    for updates in checkpoints(training.vector_step, [*early, *marks], lambda updates: None):
        policy = training.average()
        rollouts = training.roll_out(policy, preferences, config.selection_scenes)
        utility = float(scalarise(rollouts.returns, rollouts.preferences).mean())
        point = {"updates": float(updates), "success": float(rollouts.success.mean()), "utility": utility}
        history.append(point | training.agent.losses | _alone(rollouts, ways))
        if gives_up and STANDS_STILL_AFTER <= updates < marks[0]:
            if point["success"] < STANDS_STILL:
                return _Attempt(None, 0.0, history)
            gives_up = False
        if updates >= marks[0] and (best is None or point["success"] >= best[0]["success"]):
            best = point, policy
    assert best is not None  # noqa: S101 - there is at least one mark
    return _Attempt(best[1], best[0]["success"], history)


def _alone(rollouts: PreferenceRollouts, ways: list[NDArray[np.float64]]) -> dict[str, float]:
    """What each objective's measure comes to where it alone counts: `frechet_m`, `human_m`, `time_s`."""
    points = {}
    for k, name in enumerate(MEASURE_OF):
        rows = np.flatnonzero(rollouts.preferences[:, k] > 1 - 1e-6)
        if len(rows) == 0:
            continue
        if name == "frechet_m":
            apart = [frechet_distance(rollouts.paths[i], way, exact_m=1e-3) for i, way in zip(rows, ways, strict=True)]
            points[name] = float(np.mean(apart))
        else:
            points[name] = float(getattr(rollouts, name)[rows].mean())
    return points

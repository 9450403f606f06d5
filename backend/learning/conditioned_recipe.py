"""How a conditioned policy comes about: trained, a checkpoint chosen, finished where it got stuck, made strong enough.

The training loop lives in `conditioned_training.py`, the policy itself in `conditioned.py`. All ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backend.learning.base import OnProgress, no_progress
from backend.learning.conditioned import ConditionedPolicy, settings
from backend.learning.conditioned_training import (
    MIXTURES,
    ConditionedConfig,
    ConditionedTraining,
    Finish,
    sample_weights,
    training_engine,
)
from backend.learning.errors import LearningError
from backend.learning.movement import Movement, best_possible, drives_of, movement_of
from backend.learning.policy import Policy
from backend.learning.scene_sets import Purpose, scene_set
from backend.learning.vocabulary import preference_weights
from backend.simulation.fast import evaluate
from backend.simulation.kernels import Rows
from backend.simulation.scene import Scene
from backend.simulation.scenes import ScenePool, draw_scenes
from backend.simulation.trajectory import Outcome

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class ConditionedResult:
    """The selected policy, how it moved on the selection scenes (optimistic: it was chosen there), the history.

    strength: how many times what it learned as full `farther` it is told now (`strong_enough`).
    """

    policy: ConditionedPolicy
    strength: float
    selection: Movement
    transitions: int
    history: list[dict[str, float]]


class _Chosen(NamedTuple):
    policy: ConditionedPolicy
    transitions: int
    history: list[dict[str, float]]


def train_conditioned(
    base: Policy, config: ConditionedConfig, on_progress: OnProgress = no_progress
) -> ConditionedResult:
    """Train from the base policy, choose a checkpoint, finish it where the configuration says so, make it strong.

    Raises SetupError, LearningError.
    """
    until = config.updates / (config.updates + config.finish.updates) if config.finish else 1.0
    first = _choose(ConditionedTraining(base, config), base, config.seed, lambda at, m: on_progress(until * at, m))
    result = finish(first.policy, base, config, lambda at, m: on_progress(until + (1 - until) * at, m))
    return replace(
        result, transitions=first.transitions + result.transitions, history=[*first.history, *result.history]
    )


def finish(
    trained: ConditionedPolicy, base: Policy, config: ConditionedConfig, on_progress: OnProgress = no_progress
) -> ConditionedResult:
    """The rest of the recipe for a policy that was trained and chosen by this configuration.

    Raises SetupError, LearningError.
    """
    last = _Chosen(trained, 0, [])
    if config.finish is not None:
        last = _choose(FinishingTraining(base, config, trained), base, config.seed, on_progress)
    strength = strong_enough(last.policy, base, config)
    policy = last.policy.stronger("farther", strength)
    scenes = scene_set(config.setup, config.selection_scenes, purpose=Purpose.SELECT, seed=config.seed)
    return ConditionedResult(policy, strength, _movement(policy, base, scenes), last.transitions, last.history)


def _choose(training: ConditionedTraining, base: Policy, seed: int, on_progress: OnProgress) -> _Chosen:
    """Train to the end, then keep the checkpoint (averaged weights) that scores best on the selection scenes of the
    seed: movement in the wanted directions counts, failures and self-intersections are punished (`Movement.score`).
    """
    config = training.config
    scenes = scene_set(config.setup, config.selection_scenes, purpose=Purpose.SELECT, seed=seed)
    marks = [round(config.updates * (2 / 3 + (k + 1) / config.checkpoints / 3)) for k in range(config.checkpoints)]
    history: list[dict[str, float]] = []
    tried: list[tuple[float, ConditionedPolicy]] = []
    while marks:
        training.vector_step()
        updates = training.agent.updates
        if updates < marks[0]:
            if updates % (100 * config.updates_per_step) == 0:
                on_progress(updates / config.updates, {"updates": updates, "transitions": training.transitions})
            continue
        marks.pop(0)
        policy = training.policy(averaged=True)
        movement = _movement(policy, base, scenes)
        metrics = {"updates": updates, "transitions": training.transitions, **movement.summary()}
        history.append(metrics)
        on_progress(min(1.0, updates / config.updates), metrics)
        tried.append((movement.score, policy))
    return _Chosen(max(tried, key=lambda entry: entry[0])[1], training.transitions, history)


def _movement(policy: ConditionedPolicy, base: Policy, scenes: Sequence[Scene]) -> Movement:
    return movement_of({name: policy.at(weights) for name, weights in settings(MIXTURES).items()}, base, scenes)


class StuckScenes:
    """A pool of scenes where a policy got stuck, each with the wants that it was told there."""

    def __init__(self, rows: Rows, wants: Floats, random: np.random.Generator) -> None:
        """rows (n, columns) of scenes and wants (n, 9). Raises LearningError for none."""
        if not len(rows):
            raise LearningError("finish: the policy got stuck nowhere; more scenes_each, or no finishing")
        self._rows, self._wants, self._random = rows, wants, random
        self.taken = np.zeros((0, wants.shape[1]), dtype=np.float32)
        """(count, 9) the wants that belong to the scenes taken last."""

    def take(self, count: int) -> tuple[Rows, NDArray[np.int64]]:
        """Scenes drawn uniformly, with replacement; seeds are not known (0)."""
        chosen = self._random.integers(len(self._rows), size=count)
        self.taken = self._wants[chosen]
        return self._rows[chosen], np.zeros(count, dtype=np.int64)


class FinishingTraining(ConditionedTraining):
    """The training loop of `Finish`: the usual environments, and some without noise in scenes where it got stuck."""

    def __init__(self, base: Policy, config: ConditionedConfig, start: ConditionedPolicy) -> None:
        finish, going_on = config.finish, config.finishing
        if finish is None or going_on is None:
            raise LearningError("finish = None: nothing is said about finishing")
        super().__init__(base, going_on, start)
        self._stuck = self._stuck_scenes(start, finish)
        self._engine = training_engine(
            self.setup, going_on.at_stake, finish.stuck_envs, seed=going_on.seed, pool=self._stuck
        )
        self._stuck_wants = self._stuck.taken.copy()

    def _stuck_scenes(self, policy: ConditionedPolicy, finish: Finish) -> StuckScenes:
        pool = ScenePool(self.setup, self.config.seed + 2)
        rows, wants = [], []
        for k in range(finish.tried):
            told = preference_weights({"farther": 1.0})
            if k >= finish.tried_farther:
                told = sample_weights(1, self.config, self._random)[0]
            found, seeds = pool.take(finish.scenes_each)
            table = evaluate(policy.at(told).act, self.setup, draw_scenes(self.setup, seeds.tolist()))
            stuck = (table.outcome == Outcome.TIMEOUT) | (table.self_intersections >= finish.crossings)
            rows.append(found[stuck])
            wants.append(np.tile(told, (int(stuck.sum()), 1)))
        return StuckScenes(np.concatenate(rows), np.concatenate(wants), self._random)

    def vector_step(self) -> None:
        """One step where it got stuck, by the wants that it was told there, then the usual one with its updates."""
        engine, wants = self._engine, self._stuck_wants
        observations = engine.observations.copy()
        actions = self.agent.act(self.told(observations, wants))
        engine.step(actions)
        self.buffer.driven_by = wants
        self.buffer.add(observations, actions, engine.rewards, engine.next_observations, engine.dones)
        self.transitions += engine.n_envs
        if engine.dones.any():
            wants[engine.dones] = self._stuck.taken
        super().vector_step()


def strong_enough(policy: ConditionedPolicy, base: Policy, config: ConditionedConfig) -> float:
    """How many times full `farther` must be told for `strong_share` of the way, at most; 1 for what goes it by itself.

    What a training makes of the same wants differs by chance (seed 2 stopped a tenth of the way before seeds 0 and 1);
    told more than it learned from, it goes on smoothly. Only here, since elsewhere the possible is out of reach.
    Of strengths that keep `strong_success`, the smallest that suffices, else the largest.
    """
    scenes = scene_set(config.setup, config.strong_scenes, purpose=Purpose.SELECT, seed=config.seed)
    driven = drives_of(base, scenes)
    possible = best_possible(scenes)
    farther = preference_weights({"farther": 1.0})
    kept = 1.0
    for strength in config.strengths:
        drives = drives_of(policy.stronger("farther", strength).at(farther), scenes)
        if drives.success.mean() < config.strong_success:
            break
        kept = strength
        if Movement(driven, {"farther": drives}, possible).shares["farther"] >= config.strong_share:
            break
    return kept

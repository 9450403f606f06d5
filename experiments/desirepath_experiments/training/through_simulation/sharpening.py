"""Sharpening: a conditioned policy is trained on by what whole drives measure, and so serves preferences better.

TD3 (`td3/conditioned_training.py`) learned from what single steps are worth, which only resembles what people compare;
here the measures themselves are followed uphill (`uphill.py`). What was trained is then mixed with what it
began with, as far as it arrives as surely. All ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.policies.conditioned import ConditionedPolicy, settings
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.steerability import Course, Steerability
from desirepath.learning.preferences.objectives import OPPOSITES, SIZE, best_possible
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.learning.td3.conditioned_training import MIXTURES
from desirepath.simulation.setups import require_same
from desirepath_experiments.training.through_simulation.uphill import SharpeningConfig, Uphill

Floats = NDArray[np.float32]
FIRST_SELECTION_SEED = 500  # selection scenes that no other training chose on


class Sharpened(NamedTuple):
    """policy: the mixture. share: of what was trained, 0 where nothing did better. before, selection: summaries on the
    selection scenes (optimistic: it was chosen there). history: per so many steps."""

    policy: ConditionedPolicy
    share: float
    before: dict[str, float]
    selection: dict[str, float]
    history: list[dict[str, float]]


def sharpen(
    start: ConditionedPolicy, base: Policy, config: SharpeningConfig, on_progress: OnProgress = no_progress
) -> Sharpened:
    """Train on from `start` as it was trained, mix, and keep the mixture that serves preferences most. Raises
    SetupError."""
    use_one_thread()
    start = start.as_trained()
    require_same(start=start.setup, base=base.setup, config=config.setup)
    training = Uphill(start, config, drawn_weights)
    history = []
    for step in range(1, config.steps + 1):
        numbers = training.step(step)
        if step % 10 == 0:
            history.append({"step": step, **numbers})
            on_progress(0.9 * step / config.steps, history[-1])
    trained = training.averaged()
    course = Course(
        scene_set(
            config.setup, config.selection_scenes, purpose=Purpose.SELECT, seed=FIRST_SELECTION_SEED + config.seed
        )
    )
    driven_by_base, possible = course.rollout(base), best_possible(course.scenes)

    def tried(policy: ConditionedPolicy) -> Steerability:
        asked = settings(MIXTURES)
        return Steerability(driven_by_base, {n: course.rollout(policy.at(w)) for n, w in asked.items()}, possible)

    before = tried(start)
    best, best_of, share_kept = start, before, 0.0
    for share in config.shares:
        policy = mixed(start, trained, share)
        found = tried(policy)
        on_progress(0.95, {"share": share, **found.summary()})
        if _success(found) >= _success(before) - config.max_loss and found.score > best_of.score:
            best, best_of, share_kept = policy, found, share
    return Sharpened(best, share_kept, before.summary(), best_of.summary(), history)


def mixed(start: ConditionedPolicy, trained: Sequence[Floats], share: float) -> ConditionedPolicy:
    """The policy whose actor lies so far on the way from the start's to the trained one. Without critic: its own
    judged another actor."""
    actor = tuple(
        (one + share * (other - one)).astype(np.float32) for one, other in zip(start.actor, trained, strict=True)
    )
    return replace(start, actor=actor, critic=())


def _success(of: Steerability) -> float:
    return float(np.mean([rollouts.success.mean() for rollouts in of.conditioned.values()]))


def drawn_weights(config: SharpeningConfig, random: np.random.Generator) -> Floats:
    """(batch, 9) what imagined people prefer: nothing, one objective at full weight, or up to two more beside it."""
    weights = np.zeros((config.batch, SIZE), dtype=np.float32)
    opposite = {a: b for pair in OPPOSITES for a, b in (pair, pair[::-1])}
    picked = np.array(config.picked) / sum(config.picked)
    kinds = np.cumsum([config.neutral_share, config.one_share, config.two_share])
    for row, kind in enumerate(np.searchsorted(kinds, random.random(config.batch))):
        chosen: list[int] = []
        while len(chosen) < kind:
            k = int(random.choice(SIZE, p=picked))
            if k not in chosen and opposite.get(k) not in chosen:
                chosen.append(k)
        for place, k in enumerate(chosen):
            weights[row, k] = random.uniform(0.2, 1.0) if place else 1.0
    return weights

"""Experts: policies made for one preference alone, trained until they improve no more. What a conditioned policy could
get at most, as far as training shows: an empirical ceiling, with the same observation and the same duty to arrive.

How measures are followed uphill is `uphill.py`'s; what is compared with experts,
`experiments/benchmarks/policy_ceiling.py`'s. All ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.steerability import Course, MeasuredRollouts
from desirepath.learning.preferences.measures import typical_differences
from desirepath.learning.preferences.objectives import NAMES, gains
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.simulation.setups import require_same
from desirepath.simulation.slowing import Slowing
from desirepath_experiments.training.through_simulation.uphill import SHARPENING, SharpeningConfig, Uphill

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
FIRST_EXPERT_SEED = 600  # selection scenes that no other training chose on
SLOW_STEPS = {"study_room": 300, "open_field": 400}
"""By setup, so long an episode may last where a slow robot is preferred: it arrives late."""
SLOWED_WITHIN_M = (2.4,)
SLOWED_TO = (0.35, 0.3, 0.25, 0.2)  # of full speed
SLOWED_MARGIN = 0.01  # success beyond what is enough: so many are tried that the best is lucky


@dataclass(frozen=True)
class ExpertConfig:
    """round_steps: of Adam, after which the selection scenes say whether it improved. batch, slow_batch: episodes per
    step, where slowness is preferred fewer, longer ones. most_rounds: at most so many; it has converged where so many
    rounds as `patience` together add less than the share `enough` of what was gained by then. max_loss: success it may
    lose against the base policy; needed: or the success that is enough. shares: of a round's change, that are tried.
    aim, like_before, learning_rate: as in `SharpeningConfig`.
    """

    setup: str
    seed: int = 0
    round_steps: int = 50
    batch: int = 96
    slow_batch: int = 32
    most_rounds: int = 4
    enough: float = 0.03
    patience: int = 1
    max_loss: float = 0.01
    needed: float = 0.97
    shares: tuple[float, ...] = (0.25, 0.5, 1.0)
    selection_scenes: int = 400
    aim: float = 4.0
    like_before: tuple[float, float] = (0.001, 0.02)
    learning_rate: float = 5e-4

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    def training(self, weights: Doubles, number: int, failed: int = 0) -> SharpeningConfig:
        """Of one round: what all of `aim` is gained for is this preference alone. failed: rounds just before that added
        nothing; each halves the learning rate."""
        slow = prefers_slowness(weights)
        usual = SHARPENING[self.setup]
        return replace(
            usual,
            seed=10 * self.seed + number,
            steps=self.round_steps,
            batch=self.slow_batch if slow else self.batch,
            most_steps=SLOW_STEPS[self.setup] if slow else usual.most_steps,
            average=0.06,
            learning_rate=self.learning_rate / 2**failed,
            aim=self.aim,
            like_before=self.like_before,
        )


@dataclass(frozen=True)
class Candidate:
    """One policy on the selection scenes. gained: of the preference against the base policy, mean over all scenes,
    nothing where one of them does not arrive (typical differences); may: whether it arrives surely enough."""

    name: str
    policy: Policy
    gained: float
    success: float
    may: bool

    def as_dict(self) -> dict[str, Any]:
        return {"name": self.name, "gained": self.gained, "success": self.success, "may": self.may}


class Selection:
    """The scenes in which candidates for one preference are judged, and the base policy in them."""

    def __init__(self, weights: Doubles, base: Policy, config: ExpertConfig) -> None:
        """weights: (9,), what the preference weighs, summing to 1."""
        require_same(base=base.setup, config=config.setup)
        self._weights, self._config = weights, config
        self._typical = typical_differences(config.setup)
        scenes = scene_set(
            config.setup, config.selection_scenes, purpose=Purpose.SELECT, seed=FIRST_EXPERT_SEED + config.seed
        )
        self._course = Course(scenes)
        self._base = self._course.rollout(base)

    def judged(self, name: str, policy: Policy, margin: float = 0.0) -> Candidate:
        """margin: success that is needed beyond what is enough."""
        rolled = self._course.rollout(policy)
        success = float(rolled.success.mean())
        enough = min(self._config.needed, float(self._base.success.mean()) - self._config.max_loss) + margin
        return Candidate(name, policy, float(self._gained(rolled).mean()), success, success >= enough)

    def _gained(self, rolled: MeasuredRollouts) -> Doubles:
        better = gains((rolled.measured - self._base.measured) / self._typical) @ self._weights
        return np.where(rolled.success & self._base.success, better, 0.0)


def best_of(candidates: Sequence[Candidate]) -> Candidate:
    """The one that gains most among those that arrive surely enough."""
    return max(candidates, key=lambda one: (one.may, one.gained))


def with_and_without_recovery(name: str, policy: Policy) -> dict[str, Policy]:
    """A recovery frees who is stuck, and takes who is slow for stuck: both are tried."""
    bare = replace(policy, critic=(), recovery_policies=())
    return {name: replace(policy, critic=())} | ({f"{name}, no recovery": bare} if policy.recovery_policies else {})


def trained_round(
    start: Candidate,
    weights: Doubles,
    selection: Selection,
    config: ExpertConfig,
    number: int,
    recovery: Sequence[tuple[Floats, ...]] = (),
    failed: int = 0,
    on_progress: OnProgress = no_progress,
) -> Candidate:
    """The best of what stood before the round and what one round of training made of it, with this recovery and
    without."""
    use_one_thread()  # a slowing rule has no part in training: what is kept is judged with it
    conditions = (weights / weights.max()).astype(np.float32)
    training = config.training(weights, number, failed)
    uphill = Uphill(start.policy, training, lambda of, random: np.repeat(conditions[None], of.batch, axis=0))
    for step in range(1, training.steps + 1):
        numbers = uphill.step(step)
        if step % 10 == 0:
            on_progress(step / training.steps, numbers)
    found = [start]
    trained = uphill.averaged()
    for share in config.shares:
        actor = tuple(
            (one + share * (other - one)).astype(np.float32)
            for one, other in zip(start.policy.actor, trained, strict=True)
        )
        whole = replace(start.policy, actor=actor, recovery_policies=tuple(recovery))
        tried = with_and_without_recovery(start.name.partition(",")[0], whole)
        found += [selection.judged(name, policy) for name, policy in tried.items()]
    return best_of(found)


def converged(gained: Sequence[float], config: ExpertConfig) -> bool:
    """Whether training may end. gained: on the selection scenes, before the first and after every round."""
    if len(gained) > config.most_rounds:
        return True
    if len(gained) <= config.patience:
        return False
    return gained[-1] - gained[-1 - config.patience] <= config.enough * max(abs(gained[-1]), 1e-6)


def slowed(found: Sequence[Candidate], selection: Selection) -> Candidate:
    """The best of these candidates driven slowly beside the person, by a rule."""
    return best_of(
        [
            selection.judged(
                f"{one.name}, slowed to {most:g} within {near:g} m",
                replace(one.policy, slowing=Slowing(near, near, most)),
                SLOWED_MARGIN,
            )
            for one in found
            for near in SLOWED_WITHIN_M
            for most in SLOWED_TO
        ]
    )


def prefers_slowness(weights: Doubles) -> bool:
    """Whether slow driving beside the person is part of the preference."""
    return bool(weights[NAMES.index("slower_near_person")] > 0)


def failed_rounds(gained: Sequence[float]) -> int:
    """How many of the last rounds added nothing. gained: before the first and after every round."""
    return next((k for k in range(len(gained) - 1) if gained[-1 - k] > gained[-2 - k]), max(0, len(gained) - 1))


def untrained(starts: Mapping[str, Policy], selection: Selection) -> list[Candidate]:
    """What training may begin with, judged, the best first."""
    tried = [pair for name, policy in starts.items() for pair in with_and_without_recovery(name, policy).items()]
    found = [selection.judged(name, policy) for name, policy in tried]
    return sorted(found, key=lambda one: (one.may, one.gained), reverse=True)

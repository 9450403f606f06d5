"""May somebody be shown this policy? The one place where that is decided, for every job: `decide`.

What is measured, and in which scenes, is the algorithm's (`never_worse.py`: for one very person); here are the success
gate's rule and verdict, what is asked beside it, and how both are stored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, Self

from desirepath.analysis.estimates import Estimate
from desirepath.analysis.metrics import success_rate
from desirepath.learning.policies.evaluate import social_means
from desirepath.learning.policies.policy import DrivingPolicy
from desirepath.learning.preferences.sureness import Sureness
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import evaluate
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup, require_same


@dataclass(frozen=True)
class GateRule:
    """What a policy must reach. All ours.

    scenes: how many serve the gate and nothing else. min_success: the success rate it needs. max_loss: how much success
    it may lose against the base policy in the same scenes; None where it is compared with nothing.
    """

    scenes: int = 500
    min_success: float = 0.90
    max_loss: float | None = 0.05

    def as_dict(self) -> dict[str, Any]:
        """Flat, with the keys that configurations have on cards and in hashes."""
        return {f"gate_{name}": value for name, value in asdict(self).items()}

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> Self:
        """Back from `as_dict`, other keys beside it; what is missing takes its default."""
        names = ("scenes", "min_success", "max_loss")
        return cls(**{name: stored[f"gate_{name}"] for name in names if f"gate_{name}" in stored})


@dataclass(frozen=True)
class Gate:
    """The verdict. success_rate: the policy's, in `scenes` scenes; base_success_rate: the base policy's in the same
    ones, None where it was compared with nothing; min_success, max_loss: what was asked (`GateRule`). social: means of
    the social metrics over these scenes, None of gates from before them."""

    passed: bool
    success_rate: float
    base_success_rate: float | None
    scenes: int
    min_success: float
    max_loss: float | None
    social: Mapping[str, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        return {name: value for name, value in asdict(self).items() if name != "social" or value is not None}


def verdict(rule: GateRule, own_success: float, base_success: float | None = None, *, scenes: int) -> Gate:
    """Passed with enough success, and not much less than the base policy's."""
    enough = own_success >= rule.min_success
    if base_success is not None and rule.max_loss is not None:
        enough = enough and own_success >= base_success - rule.max_loss
    return Gate(enough, own_success, base_success, scenes, rule.min_success, rule.max_loss)


Why = Literal["passed", "gate_not_passed", "not_better_than_instant", "not_surely_better"]
TOLERANCE = 0.075  # typical differences: what is preferred may not be less by more; 4 cm of distance (field), 3 (room)
SURE = 0.9
"""Issue 15: shown as personal only where it is better for this person with at least this probability."""
CLEARLY = 0.85
"""And by LEAST_GAIN (`sureness.py`) with this one. Who was harmed before, was harmed by what is surely better by next
to nothing. Chosen on tuning families."""


@dataclass(frozen=True)
class BesideInstant:
    """A searched policy's advantage over the instant one in the gate's scenes, with intervals: in what is preferred
    alone, and with what every trajectory costs."""

    preferred: Estimate
    score: Estimate

    @property
    def better(self) -> bool:
        """No worse in what is preferred, and better with all costs, by the whole intervals."""
        return self.preferred.low > -TOLERANCE and self.score.low > 0


def surely_better(sure: Sureness, needed: float = SURE) -> bool:
    """For one very person. needed: of the probability that it is better; where that is at most one half nothing is
    asked, and the usual policy itself will do."""
    return sure.better >= needed and (sure.clearly >= CLEARLY or needed <= 0.5)


@dataclass(frozen=True)
class Decision:
    """Whether somebody may be shown a policy, and what it lacks first."""

    passed: bool
    why: Why


def decide(gate: Gate, *, beside_instant: BesideInstant | None = None, surely: bool | None = None) -> Decision:
    """From what was measured. beside_instant: of a searched policy; surely: whether it is surely better for this very
    person (`surely_better`), where that was asked."""
    why: Why = "passed"
    if not gate.passed:
        why = "gate_not_passed"
    elif beside_instant is not None and not beside_instant.better:
        why = "not_better_than_instant"
    elif surely is False:
        why = "not_surely_better"
    return Decision(why == "passed", why)


def gate_scenes(setup: str, rule: GateRule, seed: int) -> list[Scene]:
    """The scenes that serve the gate of this seed and nothing else."""
    return scene_set(setup, rule.scenes, purpose=Purpose.GATE, seed=seed)


def success_in(policy: DrivingPolicy, scenes: list[Scene]) -> float:
    """Success rate of the policy, its recovery included."""
    return success_rate(evaluate(policy.rollout_policy, get_setup(policy.setup), scenes).outcome)


def at_gate(policy: DrivingPolicy, base: DrivingPolicy, rule: GateRule, *, seed: int) -> Gate:
    """Both policies roll out in the gate's scenes. Raises SetupError where they are of two setups."""
    scenes = gate_scenes(require_same(policy=policy.setup, base=base.setup), rule, seed)
    own = evaluate(policy.rollout_policy, get_setup(policy.setup), scenes)
    gate = verdict(rule, success_rate(own.outcome), success_in(base, scenes), scenes=rule.scenes)
    return replace(gate, social=social_means(own))

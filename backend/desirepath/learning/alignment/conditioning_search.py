"""The conditioning search, behind the instant policy that is shown already: what else to condition the policy on, and
where.

Conditioning a policy on just somebody's preference weights need not serve them best: a little of something else can,
more so where the goal is far than beside it. So what it is conditioned on is searched for, as a function of how far
goal and person are; the result is an ordinary policy, and takes over where it is better on held-out scenes. In the
place of fine-tuning: what fits into 30 s of that made no way shorter. All ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import Estimate, mean_estimate
from desirepath.learning.alignment.gate import BesideInstant, Gate, GateRule, decide, gate_scenes, success_in, verdict
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.steerability import Course, MeasuredRollouts
from desirepath.learning.preferences.measures import typical_differences
from desirepath.learning.preferences.objectives import SIZE, check_weights, gains, names_of
from desirepath.learning.preferences.setup_settings import middle
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.simulation.setups import get_setup, require_same

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
LENGTH_WEIGHT = 0.4  # in the score, of the way's length, where nobody prefers it short: ways cost time in any case
CROSSING_COST = 1.0  # in the score, typical differences, of a trajectory that crosses its own way
FAILURE_COST = 10.0  # in the score, typical differences: 1 % of failures weighs as much as a tenth of one
FIRST_SHARE = 0.75  # of LENGTH_WEIGHT, with which the search begins
AIM = -0.025  # typical differences: the search keeps what is preferred about there; 1 or 2 cm of distance
OBSERVED = (0, 2)  # where the observation says how far the goal and the person are
PLACES = ("anywhere", "goal_far", "person_far")


@dataclass(frozen=True)
class ConditioningSearchConfig:
    """How what to condition on is searched for: rounds of changed copies of the best guess so far, in the same scenes.

    The mean of the `survivors`, better ones counting more, is the next guess. tried: copies in all, in whole rounds;
    copies: of them per round, half of them changed the other way round. spread: standard deviation of a change, times
    `narrower` each round.
    """

    seed: int = 0
    tried: int = 144  # as many as fit into the 30 s of an idle core until it is judged
    copies: int = 16
    survivors: int = 5
    spread: float = 0.12
    narrower: float = 0.92
    selection_scenes: int = 500
    # 500 scenes leave open what is better: trajectories differ more from scene to scene
    gate: GateRule = field(default_factory=lambda: GateRule(scenes=1_500))

    def as_dict(self) -> dict[str, Any]:
        """Flat, for cards and hashes."""
        flat = asdict(self)
        del flat["gate"]
        return {**flat, **self.gate.as_dict()}

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> Self:
        """Back from `as_dict`."""
        own = {column.name: stored[column.name] for column in fields(cls) if column.name in stored}
        return cls(**own, gate=GateRule.of(stored))


@dataclass(frozen=True)
class ConditioningSearchResult:
    """policy: the instant policy conditioned otherwise, without critic. offsets: (3, 9) what is added to the preference
    weights that it is conditioned on, in the order of PLACES (`condition_by_place`).

    beside_instant: its advantage over the instant policy on the gate's scenes (`Compared`). history: the guess after
    each round; chosen: which of them, 0 for the instant policy itself.
    """

    policy: Policy
    offsets: Floats
    beside_instant: BesideInstant
    gate: Gate
    chosen: int
    history: list[dict[str, float]]

    @property
    def preferred(self) -> Estimate:
        return self.beside_instant.preferred

    @property
    def score(self) -> Estimate:
        return self.beside_instant.score

    @property
    def takes_over(self) -> bool:
        """Whether it is to be shown instead."""
        return decide(self.gate, beside_instant=self.beside_instant).passed


class Compared(NamedTuple):
    """How much better one policy is than another by somebody's preference weights, in typical differences of a pair.

    preferred: (both succeed,) sum_k w_k gain_k / typical difference. shorter: (both succeed,) the same of the way's
    length alone. other: (n,) what success and crossings add, FAILURE_COST and CROSSING_COST each.
    """

    preferred: Doubles
    shorter: Doubles
    both: NDArray[np.bool_]
    other: Doubles

    def scores(self, length_weight: float) -> Doubles:
        """(n,) per scene: what is preferred, the way's length and the rest together."""
        together = self.other.copy()
        together[self.both] += self.preferred + length_weight * self.shorter
        return together


def compare_policies(own: MeasuredRollouts, other: MeasuredRollouts, weights: Floats, setup: str) -> Compared:
    """`own` against `other`, in the same scenes."""
    both = own.success & other.success
    better = gains((own.measured - other.measured)[both] / typical_differences(setup))
    succeeded = own.success.astype(np.float64) - other.success
    crossed = (own.self_intersections > 0).astype(np.float64) - (other.self_intersections > 0)
    return Compared(
        better @ weights.astype(np.float64),
        better[:, _costs(setup)],
        both,
        FAILURE_COST * succeeded - CROSSING_COST * np.where(both, crossed, 0.0),
    )


def condition_by_place(conditioned: ConditionedPolicy, weights: Floats, offsets: NDArray[np.floating[Any]]) -> Policy:
    """The policy conditioned on weights + offsets[0] + offsets[1] * g + offsets[2] * p, without critic.

    g and p: how far the goal and the person are, from the setup's `middle` on, in its unit. Exact, since weights enter
    the first layer linearly, beside these distances. What it is conditioned on may leave [0, 1]; it goes on where
    training ended.
    """
    start = conditioned.at(weights).without_critic()
    change = middle(conditioned.setup)
    scale = get_setup(conditioned.setup).distance_scale_m
    rows = conditioned.actor[0][start.shape.task_inputs : conditioned.shape.task_inputs]
    first = start.actor[0].copy()
    first[list(OBSERVED)] += (offsets[1:] * (scale / change.unit_m)) @ rows
    bias = start.actor[1] + (offsets[0] - offsets[1:].sum(0) * (change.at_m / change.unit_m)) @ rows
    return replace(start, actor=(first, bias.astype(np.float32), *start.actor[2:]))


def search_conditioning(
    conditioned: ConditionedPolicy,
    weights: Floats,
    base: Policy,
    config: ConditioningSearchConfig | None = None,
    on_progress: OnProgress = no_progress,
) -> ConditioningSearchResult:
    """Search from `conditioned.at(weights)` on; `base` is what the success gate compares with.

    Raises SetupError, LearningError (weights that cannot be).
    """
    use_one_thread()
    config = config or ConditioningSearchConfig()
    setup = require_same(conditioned=conditioned.setup, base=base.setup)
    weights = check_weights(weights, names_of(setup))
    guesses, history = _search(conditioned, weights, config, on_progress)
    # Not worse in what is preferred, as far as the selection scenes tell; the first is the instant policy itself.
    chosen = max(range(len(history)), key=lambda k: (history[k]["preferred"] >= AIM, history[k]["score"]))
    policy = condition_by_place(conditioned, weights, guesses[chosen])
    scenes = gate_scenes(setup, config.gate, config.seed)
    course = Course(scenes)
    own = course.rollout(policy)
    better = compare_policies(own, course.rollout(conditioned.at(weights)), weights, setup)
    gate = verdict(config.gate, float(own.success.mean()), success_in(base, scenes), scenes=config.gate.scenes)
    preferred, score = mean_estimate(better.preferred), mean_estimate(better.scores(length_weight_of(weights, setup)))
    beside_instant = BesideInstant(preferred, score)
    return ConditioningSearchResult(policy, guesses[chosen], beside_instant, gate, chosen, history)


def _search(
    conditioned: ConditionedPolicy, weights: Floats, config: ConditioningSearchConfig, on_progress: OnProgress
) -> tuple[list[Floats], list[dict[str, float]]]:
    """The guess after each round, (3, 9), and how its rollouts were; the first is the preference weights themselves."""
    setup = conditioned.setup
    course = Course(scene_set(setup, config.selection_scenes, purpose=Purpose.ALIGN_SELECT, seed=config.seed))
    instant = course.rollout(conditioned.at(weights))
    usual = length_weight_of(weights, setup)
    length_weight = usual * FIRST_SHARE

    def tried_out(offsets: Doubles) -> Compared:
        return compare_policies(
            course.rollout(condition_by_place(conditioned, weights, offsets)), instant, weights, setup
        )

    random = np.random.default_rng([config.seed, 71])
    guess, spread = np.zeros((1 + len(OBSERVED), SIZE)), config.spread
    guesses = [guess.astype(np.float32)]
    history = [{"tried": 0.0, "preferred": 0.0, "shorter": 0.0, "score": 0.0}]
    rounds = max(1, round(config.tried / config.copies))
    for tried in np.arange(1, rounds + 1) * config.copies:
        changes = random.normal(0.0, spread, (config.copies // 2, *guess.shape))
        copies = guess + np.concatenate([changes, -changes])
        best = np.argsort([-tried_out(offsets).scores(length_weight).mean() for offsets in copies])[: config.survivors]
        shares = np.log(len(best) + 0.5) - np.log(np.arange(1, len(best) + 1))
        guess = np.tensordot(shares / shares.sum(), copies[best], axes=1)
        spread *= config.narrower
        better = tried_out(guess)
        preferred = float(better.preferred.mean()) if len(better.preferred) else -FAILURE_COST
        # Ways grow shorter at the cost of what is preferred: it weighs less once that falls behind, more while it
        # leads.
        length_weight *= 0.85 if preferred < AIM else 1.1
        guesses.append(guess.astype(np.float32))
        shorter = float(better.shorter.mean()) if len(better.shorter) else -FAILURE_COST
        history.append(
            {
                "tried": float(tried),
                "preferred": preferred,
                "shorter": shorter,
                "score": float(better.scores(usual).mean()),
            }
        )
        on_progress(0.95 * float(tried) / (rounds * config.copies), history[-1])
    return guesses, history


def length_weight_of(weights: Floats, setup: str) -> float:
    """What a shorter way counts beside the preference: LENGTH_WEIGHT, less what is preferred of it anyway."""
    return max(0.0, LENGTH_WEIGHT - float(weights[_costs(setup)]))


def _costs(setup: str) -> int:
    """Place of the objective that every trajectory costs something of: the way's length, among pedestrians its time."""
    names = names_of(setup)
    return names.index("shorter" if "shorter" in names else "faster")

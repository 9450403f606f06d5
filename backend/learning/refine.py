"""Refinement behind the policy that is shown already: what to tell the conditioned policy, then recipe B of spec 06.

Telling a conditioned policy just what somebody wants need not serve these wants best: a little of something else can.
So what it is told is searched for first; training goes on from there for this one person. The result takes over where
it is better on scenes that served nothing else. All ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from backend.analysis.metrics import success_rate
from backend.learning.align import AlignConfig, Gate, learn
from backend.learning.base import OnProgress, no_progress
from backend.learning.conditioned import ConditionedPolicy
from backend.learning.conditioned_training import CONFIGS, STAKES, training_engine
from backend.learning.evaluate import Estimate, mean_estimate
from backend.learning.movement import Drives, drives_of
from backend.learning.policy import Policy
from backend.learning.replay import Explorer, ReplayBuffer
from backend.learning.scene_sets import Purpose, scene_set
from backend.learning.td3 import Batch
from backend.learning.vocabulary import (
    NAMES,
    OPPOSITES,
    SIZE,
    check_weights,
    gains,
    step_terms,
    typical_differences,
    worth,
)
from backend.simulation.fast import evaluate
from backend.simulation.setups import Setup, get_setup, require_same

Floats = NDArray[np.float32]
LENGTH_WEIGHT = 0.1  # in the score, of the way's length, where nobody wants it short: ways cost time in any case
FAILURE_COST = 10.0  # in the score, typical differences: 1 % of failures weighs as much as a tenth of one


def refine_config(setup: str, *, seed: int = 0) -> AlignConfig:
    """The refinement's settings on top of recipe B's; 11 to 14 s on one quiet core was the aim (spec 06)."""
    return AlignConfig(
        seed=seed,
        gamma=CONFIGS[setup].gamma,  # that of the critic which it starts with
        preference_weight=1.0,  # of the conditioned policy's own scales
        time_cost=2 * STAKES[setup].time,  # twice that of its training: detours must be worth it
        updates=4_000,
        checkpoints=4,
        learning_rate=1e-4,  # three times as much lost success at once: the start is good already
        final_learning_rate=2e-5,
        tau=0.002,
        replay_transitions=60_000,
        replay_exploration=(0.03, 0.4),
        online_exploration=(0.03, 0.3),
        selection_scenes=300,
    )


@dataclass(frozen=True)
class SearchConfig:
    """How what to tell is searched for: rounds of changed copies of the best so far, compared in the same scenes.

    changed: chance of each weight to be changed; spread: standard deviation of a change, times `narrower` each round.
    """

    rounds: int = 4
    copies: int = 10
    changed: float = 0.4
    spread: float = 0.25
    narrower: float = 0.75


@dataclass(frozen=True)
class RefineResult:
    """policy: of the one found by search (first in `history`) and the checkpoints that training made of it, the one
    with the best score on the selection scenes, without critic. told: (9,) what the search found to tell.

    score: its advantage over the instant policy on the gate's scenes. takes_over: whether it is to be shown instead of
    the instant policy: gate passed and the whole interval of the score above 0.
    """

    policy: Policy
    told: Floats
    takes_over: bool
    score: Estimate
    gate: Gate
    chosen: int
    history: list[dict[str, float]]
    replay_sha256: str


class WantsReward:
    """The reward of the conditioned policy's training for one person's wants:

    core reward + weight * sum_k scale_k worth_k term_k - time cost. The weight stays what the configuration says.
    """

    def __init__(self, setup: Setup, scaled: Floats, config: AlignConfig) -> None:
        """scaled: (9,) scale_k * worth_k."""
        self.weight = 1.0 if config.preference_weight is None else config.preference_weight
        self._setup, self._scaled, self._time_cost = setup, scaled, config.time_cost

    def preference(self, batch: Batch) -> torch.Tensor:
        terms = step_terms(batch.actions.numpy(), batch.next_observations.numpy(), self._setup)
        return torch.from_numpy(terms @ self._scaled)

    def combined(self, core: torch.Tensor, preference: torch.Tensor) -> torch.Tensor:
        return core + self.weight * preference - self._time_cost

    def adapt(self, success: float, base_success: float) -> None:
        del success, base_success  # how much is wanted is known here; it was a guess in recipe B


def advantages(own: Drives, other: Drives, weights: Floats, setup: str) -> NDArray[np.float64]:
    """(n,) per scene, how much better `own` drove than `other` by these wants, in typical differences.

    Where both succeed: sum_k w_k gain_k / typical difference, with at least LENGTH_WEIGHT for a shorter way; a scene
    in which only one succeeds counts FAILURE_COST for it, one in which neither does 0.
    """
    wanted = weights.astype(np.float64)
    wanted[NAMES.index("shorter")] = max(wanted[NAMES.index("shorter")], LENGTH_WEIGHT)
    better = gains((own.measured - other.measured) / typical_differences(setup)) @ wanted
    both = own.success & other.success
    return np.where(both, better, FAILURE_COST * (own.success.astype(np.float64) - other.success))


def refine(
    conditioned: ConditionedPolicy,
    weights: Floats,
    base: Policy,
    config: AlignConfig | None = None,
    on_progress: OnProgress = no_progress,
    search: SearchConfig | None = None,
) -> RefineResult:
    """Refine `conditioned.at(weights)`; `base` is what the success gate compares with.

    Raises SetupError, LearningError (no critic, weights that cannot be).
    """
    setup = get_setup(require_same(conditioned=conditioned.setup, base=base.setup))
    config = config or refine_config(setup.name)
    weights = check_weights(weights)
    scenes = scene_set(setup.name, config.selection_scenes, purpose=Purpose.ALIGN_SELECT, seed=config.seed)
    instant = drives_of(conditioned.at(weights), scenes)

    def judge(policy: Policy) -> dict[str, float]:
        own = drives_of(policy, scenes)
        better = advantages(own, instant, weights, setup.name)
        return {"success_rate": float(own.success.mean()), "score": float(better.mean())}

    told = best_told(weights, lambda wants: judge(conditioned.at(wants))["score"], search, seed=config.seed)
    start = conditioned.at(told)
    found = {"updates": 0, "preference_weight": 0.0} | judge(start)
    on_progress(0.4, found)
    stakes = STAKES[setup.name]
    replay = ReplayBuffer(config.replay_transitions + 256, setup.observation_size)
    explorer = Explorer(
        training_engine(setup, stakes, 256, seed=config.seed), noise=config.replay_exploration, seed=config.seed
    )
    while replay.size < config.replay_transitions:
        explorer.step(start.act, replay)
    replay_sha256 = replay.digest()

    learned = learn(
        start,
        training_engine(setup, stakes, config.online_envs, seed=config.seed + 1),
        replay,
        WantsReward(setup, worth(weights) * np.array(conditioned.scales, dtype=np.float32), config),
        config,
        judge=judge,
        base_success=float(instant.success.mean()),
        on_progress=lambda fraction, metrics: on_progress(0.4 + 0.6 * fraction, metrics),
    )
    history, policies = [found, *learned.history], [start.without_critic(), *learned.policies]
    chosen = int(np.argmax([entry["score"] for entry in history]))
    policy = policies[chosen]
    score, gate = _gate(policy, conditioned.at(weights), base, weights, config)
    takes_over = gate.passed and score.low > 0
    return RefineResult(policy, told, takes_over, score, gate, chosen, history, replay_sha256)


def best_told(
    weights: Floats, score: Callable[[Floats], float], config: SearchConfig | None = None, *, seed: int = 0
) -> Floats:
    """(9,) what to tell for these wants: the highest score that the search met; telling the wants themselves has 0."""
    config = config or SearchConfig()
    random = np.random.default_rng([seed, 71])
    best, best_score, spread = weights, 0.0, config.spread
    for _ in range(config.rounds):
        changes = (random.random((config.copies, SIZE)) < config.changed) * random.normal(
            0.0, spread, (config.copies, SIZE)
        )
        copies = [weights_within(best + change) for change in changes]
        scores = [score(copy) for copy in copies]
        if max(scores) > best_score:
            best, best_score = copies[int(np.argmax(scores))], max(scores)
        spread *= config.narrower
    return best


def weights_within(weights: NDArray[np.floating[Any]]) -> Floats:
    """(9,) the nearest preference weights: in [0, 1], of two opposites the weaker 0."""
    within: Floats = np.clip(weights, 0.0, 1.0).astype(np.float32)
    for a, b in OPPOSITES:
        within[a if within[a] < within[b] else b] = 0.0
    return within


def _gate(policy: Policy, instant: Policy, base: Policy, weights: Floats, config: AlignConfig) -> tuple[Estimate, Gate]:
    """The score against the instant policy and the success gate against the base policy, on the gate's scenes."""
    scenes = scene_set(policy.setup, config.gate_scenes, purpose=Purpose.GATE, seed=config.seed)
    own, other = drives_of(policy, scenes), drives_of(instant, scenes)
    raw = success_rate(evaluate(base.act, get_setup(base.setup), scenes).outcome)
    rate = float(own.success.mean())
    passed = rate >= raw - config.gate_max_loss and rate >= config.gate_min_success
    score = mean_estimate(advantages(own, other, weights, policy.setup))
    return score, Gate(passed, rate, raw, config.gate_scenes)

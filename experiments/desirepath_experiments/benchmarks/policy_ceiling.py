"""The empirical ceiling of policies: what converged training for one preference gets of it, jointly with arriving.

Beside it stand the planner's ceiling (`attainable.py`), which knows more than a robot can, and what the policy of 15
answers gets (`headline.py`). How experts are trained is `through_simulation/experts.py`'s. All simulated.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.policies.steerability import Course, MeasuredRollouts
from desirepath.learning.preferences.measures import typical_differences
from desirepath.learning.preferences.objectives import gains
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.rewards.weights import fit_weights
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.slowing import Slowing
from desirepath_experiments.benchmarks.attainable import NOT_ARRIVED, PlannerConfig, attained
from desirepath_experiments.benchmarks.headline import (
    FIRST_REPORT_SEED,
    MADE_OF_OBJECTIVES,
    fresh_queries,
    true_weights,
)
from desirepath_experiments.training.through_simulation.experts import (
    Candidate,
    ExpertConfig,
    Selection,
    best_of,
    converged,
    failed_rounds,
    prefers_slowness,
    slowed,
    trained_round,
    untrained,
)

Doubles = NDArray[np.float64]
Tell = Callable[[str], None]
SLOWED = "slowed"  # the candidate made by a rule


def silent(words: str) -> None:
    """Who wants no progress lines."""


@dataclass(frozen=True)
class CeilingConfig:
    """seeds, scenes, planned, planner, answers: as in `HeadlineConfig`. trained_from: of the best starts so many are
    trained on from."""

    preferences: tuple[str, ...] = MADE_OF_OBJECTIVES
    seeds: tuple[int, ...] = (0, 1, 2)
    scenes: int = 500
    planned: int = 40
    answers: int = 15
    trained_from: int = 1
    planner: PlannerConfig = field(default_factory=PlannerConfig)


def train_experts(
    setup: str,
    folder: Path,
    others: Mapping[str, ConditionedPolicy],
    config: CeilingConfig,
    expert: ExpertConfig,
    *,
    minutes: float = 1e9,
    tell: Tell = silent,
) -> bool:
    """Train an expert for each preference, and keep every round in `folder`: a run that was stopped goes on there.

    others: conditioned policies by name that experts begin with too, beside the base policy and the shipped conditioned
    one. minutes: no round begins later. Whether all have converged. Raises LearningError.
    """
    unknown = [name for name in config.preferences if name not in MADE_OF_OBJECTIVES]
    if unknown or not config.preferences:
        raise LearningError(f"preferences = {list(config.preferences)}: known are {', '.join(MADE_OF_OBJECTIVES)}")
    began = time.monotonic()
    base = load_policy(f"{setup}/base")
    conditioned = {"conditioned": load_conditioned(f"{setup}/conditioned"), **others}
    for name in config.preferences:
        weights = true_weights(name)
        conditions = (weights / weights.max()).astype(np.float32)
        starts = {one: policy.at(conditions) for one, policy in conditioned.items()}
        recovery = starts["conditioned"].recovery_policies
        starts["base"] = replace(base, recovery_policies=recovery)
        training = ExpertState(folder / setup / name, setup)
        selection = Selection(weights, base, expert)
        new = {source: policy for source, policy in starts.items() if source not in training.state["starts"]}
        if new:  # who joins a run that has begun is a candidate, and trained on from only after those before
            training.begin(untrained(new, selection), expert)
        for start in [source for source in training.roots() if source != SLOWED][: config.trained_from]:
            while not converged(training.gained(start), expert):
                if time.monotonic() - began > 60 * minutes:
                    return False
                number, failed = len(training.gained(start)), failed_rounds(training.gained(start))
                made = trained_round(training.candidate(start), weights, selection, expert, number, recovery, failed)
                training.add(start, made)
                tell(f"{name}, from {start}, round {number}: gained {made.gained:.3f}, success {made.success:.3f}")
        if prefers_slowness(weights) and SLOWED not in training.state["starts"]:
            kept = slowed([training.candidate(source) for source in training.roots()], selection)
            training.begin_from(SLOWED, kept)
            tell(f"{name}: {kept.name}: gained {kept.gained:.3f}, success {kept.success:.3f}")
    return True


class ExpertState:
    """What is known of one preference's training, in a folder: `state.json` and the policies of its starts."""

    def __init__(self, folder: Path, setup: str) -> None:
        self._folder, self._setup = folder, setup
        path = folder / "state.json"
        self.state: dict[str, Any] = (
            json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {"starts": {}, "config": {}}
        )

    def begin(self, candidates: Sequence[Candidate], config: ExpertConfig) -> None:
        """Write down what the untrained ones get, the best first, of each source its better one only."""
        self._folder.mkdir(parents=True, exist_ok=True)
        of_source: dict[str, Candidate] = {}
        for one in candidates:
            of_source.setdefault(one.name.partition(",")[0], one)
        self.state["config"] = config.as_dict()
        for source, one in of_source.items():
            self.begin_from(source, one)

    def begin_from(self, source: str, one: Candidate) -> None:
        """What training from that source begins with, or all that there is of it."""
        self.state["starts"][source] = {"rounds": [one.as_dict()]}
        self._save(source, one)

    def roots(self) -> list[str]:
        """Sources, the one that got most untrained first."""
        return list(self.state["starts"])

    def gained(self, source: str) -> list[float]:
        return [one["gained"] for one in self.state["starts"][source]["rounds"]]

    def candidate(self, source: str) -> Candidate:
        """Where training from that source stands."""
        last = self.state["starts"][source]["rounds"][-1]
        policy = Policy.load(self._folder / f"{source}.npz")
        if "limit" in last:  # as a slowed policy was written down before the rule was part of its file
            limit = last["limit"]
            policy = replace(policy, slowing=Slowing(limit["near_m"], limit["near_m"], limit["most"]))
        return Candidate(policy=policy, **{key: value for key, value in last.items() if key != "limit"})

    def add(self, source: str, made: Candidate) -> None:
        self.state["starts"][source]["rounds"].append(made.as_dict())
        self._save(source, made)

    def chosen(self) -> Candidate:
        """The best on the selection scenes, trained or not: nothing of ours does better there."""
        return best_of([self.candidate(source) for source in self.roots()])

    def _save(self, source: str, one: Candidate) -> None:
        one.policy.save(self._folder / f"{source}.npz")
        text = json.dumps(self.state, indent=1)
        (self._folder / "state.json").write_text(text + "\n", encoding="utf-8")


def benchmark_ceiling(
    setup: str,
    folder: Path,
    compared: Mapping[str, ConditionedPolicy],
    config: CeilingConfig,
    *,
    tell: Tell = silent,
) -> dict[str, Any]:
    """Experts in reporting scenes, against the planner, and what compared policies of 15 answers get of the experts'.

    Result: {"simulated": True, "setup", "config", "scenes", "summary", "preferences", "rows", "experts"}. A row holds
    of one preference and seed `expert_share`: of the way from the base policy to the planner's rollouts, in the planned
    scenes where all three arrive; and for each compared policy its `share`: of the way from the base policy to the
    expert, in all scenes where these three arrive, under the weights of 15 answers (`share_true`: the true ones).
    """
    base = load_policy(f"{setup}/base")
    experts = {name: ExpertState(folder / setup / name, setup) for name in config.preferences}
    rows = []
    for seed in config.seeds:
        scenes = scene_set(setup, config.scenes, purpose=Purpose.REPORT, seed=FIRST_REPORT_SEED + seed)
        queries = fresh_queries(setup, config.answers, seed)
        course = Course(scenes)
        at_base = course.rollout(base)
        few = scenes[: config.planned]
        for name in config.preferences:
            true = true_weights(name)
            plans = folder / "plans" / f"{setup}_{FIRST_REPORT_SEED + seed}_{name}_{config.planned}.npy"
            planned = _planned(plans, few, true, config.planner, base)
            chosen = experts[name].chosen()
            expert = course.rollout(chosen.policy)
            row: dict[str, Any] = {"preference": name, "seed": seed, "expert": chosen.name}
            row |= against_planned(expert, at_base, planned, true, setup)
            for which, policy in compared.items():
                answers = make_oracle(name, seed=seed).answer(queries)
                own = course.rollout(policy.at(fit_weights(answers).preference_weights()).without_critic())
                given = course.rollout(policy.at((true / true.max()).astype(np.float32)).without_critic())
                row[which] = {
                    "share": way_to(own, expert, at_base, true, setup),
                    "share_true": way_to(given, expert, at_base, true, setup),
                    "success": float(own.success.mean()),
                }
            rows.append(row)
            tell(f"seed {seed}, {name}: expert {row['expert_share']:.2f} of the planner's")
    return {
        "simulated": True,
        "setup": setup,
        "config": asdict(config),
        "scenes": [describe(Purpose.REPORT, config.scenes, FIRST_REPORT_SEED + seed) for seed in config.seeds],
        **summarise(rows, tuple(compared)),
        "rows": rows,
        "experts": {name: one.state["starts"] for name, one in experts.items()},
    }


def _planned(kept: Path, scenes: Sequence[Any], weights: Doubles, planner: PlannerConfig, base: Policy) -> Doubles:
    """(n,) what the planner attains, from the file where it was planned before: that takes most of the time."""
    if kept.is_file():
        stored: Doubles = np.load(kept)
        return stored
    guides = [one.poses for one in rollout(get_setup(base.setup), base.rollout_policy, scenes)]
    planned = attained(scenes, weights, planner, guides)[0]
    kept.parent.mkdir(parents=True, exist_ok=True)
    np.save(kept, planned)
    return planned


def against_planned(
    expert: MeasuredRollouts, base: MeasuredRollouts, planned: Doubles, true: Doubles, setup: str
) -> dict[str, Any]:
    """How much of the planner's way the expert goes, where expert, base policy and a plan arrive; success in all.

    What a policy attained itself counts as attained, where the planner found nothing as good.
    """
    few, typical = len(planned), typical_differences(setup)
    at_base, at_expert = (gains(one.measured[:few] / typical) @ true for one in (base, expert))
    all_arrive = base.success[:few] & expert.success[:few] & (planned > NOT_ARRIVED)
    best = np.max([planned, at_base, at_expert], axis=0)[all_arrive]
    possible = float((best - at_base[all_arrive]).mean())
    return {
        "expert_share": float((at_expert - at_base)[all_arrive].mean()) / possible,
        "compared_in": int(all_arrive.sum()),
        "success_expert": float(expert.success.mean()),
        "success_base": float(base.success.mean()),
    }


def way_to(own: MeasuredRollouts, expert: MeasuredRollouts, base: MeasuredRollouts, true: Doubles, setup: str) -> float:
    """The share of the way from the base policy to the expert, where all three arrive; above 1: farther than it. Nan
    where the expert gains nothing: then the base policy is the best there is."""
    typical = typical_differences(setup)
    at_base, at_expert, at_own = (gains(one.measured / typical) @ true for one in (base, expert, own))
    all_arrive = own.success & expert.success & base.success
    possible = float((at_expert - at_base)[all_arrive].mean())
    return float((at_own - at_base)[all_arrive].mean()) / possible if possible > 0 else math.nan


def summarise(rows: Sequence[Mapping[str, Any]], compared: Sequence[str]) -> dict[str, Any]:
    """`preferences`: medians over seeds with the lowest and highest; `summary`: the median over all runs, and the worst
    preference by its median, of the experts against the planner and of each compared policy against the experts."""

    def shares(of: Sequence[Mapping[str, Any]], which: str) -> list[float]:
        return [row["expert_share"] if which == "expert" else row[which]["share"] for row in of]

    names = list(dict.fromkeys(row["preference"] for row in rows))
    lines = []
    for name in names:
        of = [row for row in rows if row["preference"] == name]
        line: dict[str, Any] = {"preference": name, "success_expert": float(np.mean([r["success_expert"] for r in of]))}
        for which in ("expert", *compared):
            found = shares(of, which)
            line[which] = {
                "share": float(np.median(found)),
                "lowest": float(np.min(found)),
                "highest": float(np.max(found)),
            }
        lines.append(line)
    summary = {}
    for which in ("expert", *compared):
        every = shares(rows, which)
        worst = min(lines, key=lambda line: float(np.nan_to_num(line[which]["share"], nan=math.inf)))
        summary[which] = {
            "runs": int(np.isfinite(every).sum()),
            "median_share": float(np.nanmedian(every)),
            "quartiles": [float(q) for q in np.nanquantile(every, (0.25, 0.75))],
            "worst_preference": worst["preference"],
            "worst_share": worst[which]["share"],
        }
    return {"summary": summary, "preferences": lines}

"""How far 15 answers of each oracle move the instant policy, over query seeds and pre-trainings: one table.

One alignment at a time, with its clock, is measured in `alignment.py`; what an oracle is lives in `oracles.py`.
Everything here is simulated and says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import mean_estimate, wilson
from desirepath.learning.errors import LearningError
from desirepath.learning.people.asked_pairs import LONGEST_SHOWN_S
from desirepath.learning.policies.conditioned import ConditionedPolicy, settings
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_ensemble, load_policy
from desirepath.learning.policies.steerability import MeasuredRollouts, Steerability
from desirepath.learning.preferences.objectives import NAMES, best_possible
from desirepath.learning.preferences.oracles import HELD_OUT, ORACLE_PREFERENCES, Oracle, make_oracle
from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.preferences.spans import seen_in
from desirepath.learning.queries.queries import Query, QueryConfig, generate_queries
from desirepath.learning.queries.varied_queries import VariedConfig, generate_varied_queries
from desirepath.learning.rewards.weights import fit_weights
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.asking import asked_in_turn, by_objectives
from desirepath_experiments.benchmarks.alignment import FIRST_QUERY_SEED

Doubles = NDArray[np.float64]
Source = Literal["ensemble", "varied"]


@dataclass(frozen=True)
class PreferencesConfig:
    """What is measured. queries: rollouts of the ensemble, or of the shipped conditioned policy at different preference
    weights, as in `queries_varied_200`. choose: how the next query is chosen from a pool, as in studies; at random, all
    `answers` queries that were made are asked. report_seed: reporting scenes that no card and no other benchmark uses.
    """

    oracles: tuple[str, ...] = tuple(ORACLE_PREFERENCES)
    noises: tuple[float, ...] = (0.0,)
    query_seeds: tuple[int, ...] = tuple(range(70, 80))
    queries: Source = "varied"
    choose: str = "random"
    pool: int = 60
    answers: int = 15
    scenes: int = 2_000
    report_seed: int = 600


@dataclass(frozen=True)
class _RolledOut:
    """One policy in the reporting scenes. scores: (n,) by preference that was asked for, of each rollout."""

    trajectories: MeasuredRollouts
    scores: dict[str, Doubles]

    @classmethod
    def of(cls, policy: Policy, scenes: Sequence[Scene], preferences: Sequence[str]) -> _RolledOut:
        trajectories: list[Trajectory] = rollout(get_setup(policy.setup), policy.rollout_policy, scenes)
        return cls(
            MeasuredRollouts.of(trajectories),
            {name: ORACLE_PREFERENCES[name].value(trajectories) for name in preferences},
        )


def benchmark_preferences(
    setup: str,
    pretrainings: Mapping[str, ConditionedPolicy] | None = None,
    config: PreferencesConfig | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Every oracle answers `answers` queries per query seed; each pre-training is conditioned on what the posterior
    says.

    pretrainings: by name; None: the shipped one. All policies roll out in the same scenes. Result: {"simulated": True,
    "setup", "config", "scenes", "base", "neutral" (per pre-training), "rows", "summary"}. A row holds the oracle, what
    the policy was conditioned on, `dominant_found` (its foremost objective has the largest weight; null outside the
    vocabulary), rates, and for each objective that the oracle has weights for `moved`: share of the way, gains against
    base and neutral with intervals (`Steerability.moved`). `preferred`: share of the scenes in which both arrive where
    the oracle itself would rather have the conditioned policy's rollout than the base policy's, a tie half, with its
    Wilson interval (rounded down to whole scenes). Raises LearningError for unknown oracles or no query seeds.
    """
    config = config or PreferencesConfig()
    unknown = [name for name in config.oracles if name not in ORACLE_PREFERENCES]
    if unknown or not config.query_seeds or not config.oracles:
        known = ", ".join(ORACLE_PREFERENCES)
        raise LearningError(f"oracles = {list(config.oracles)}: known are {known}; at least 1 query seed")
    if config.choose not in by_objectives():
        raise LearningError(f"choose = {config.choose!r}: known are {', '.join(by_objectives())}")
    conditioned = (
        dict(pretrainings) if pretrainings else {f"{setup}/conditioned": load_conditioned(f"{setup}/conditioned")}
    )
    scenes = scene_set(setup, config.scenes, purpose=Purpose.REPORT, seed=config.report_seed)
    possible = best_possible(scenes)
    base = _RolledOut.of(load_policy(f"{setup}/base"), scenes, config.oracles)
    neutral = {
        name: _RolledOut.of(policy.at(settings()["neutral"]), scenes, ()) for name, policy in conditioned.items()
    }
    asked = {seed: queries_of(setup, config, seed) for seed in config.query_seeds}
    rows: list[dict[str, Any]] = []
    for row in _rows(conditioned, asked, scenes, possible, base, neutral, config):
        rows.append(row)
        if on_progress:
            cells = len(conditioned) * len(config.oracles) * len(config.noises) * len(asked)
            on_progress(len(rows) / cells)
    described = Steerability(
        base.trajectories, {name: rolled_out.trajectories for name, rolled_out in neutral.items()}, possible
    ).report()
    return {
        "simulated": True,
        "setup": setup,
        "config": asdict(config),
        "scenes": describe(Purpose.REPORT, config.scenes, config.report_seed),
        "base": described["base"],
        "neutral": described["told"],
        "ceiling_m": float(possible[:, NAMES.index("farther")].mean()),
        "summary": summarise(rows),
        "rows": rows,
    }


def queries_of(setup: str, config: PreferencesConfig, seed: int) -> Sequence[Query]:
    """Fresh queries that no shipped set holds."""
    count = config.answers if config.choose == "random" else max(config.answers, config.pool)
    asked = QueryConfig(count=count, seed=FIRST_QUERY_SEED + seed, max_duration_s=LONGEST_SHOWN_S[setup])
    if config.queries == "ensemble":
        return generate_queries(load_ensemble(setup), asked).queries
    return generate_varied_queries(load_conditioned(f"{setup}/conditioned"), VariedConfig(asked)).queries


def answers_to(oracle: Oracle, queries: Sequence[Query], config: PreferencesConfig) -> list[Preference]:
    """The oracle's answers to all queries, or to those of a pool that are chosen one after the other, as in studies."""
    preferences = oracle.answer(queries)
    if config.choose == "random":
        return preferences
    answers = [one.chosen is query.trajectory_a for one, query in zip(preferences, queries, strict=True)]
    prior, numbers = Posterior.prior(queries[0].scene.setup), range(len(queries))
    unused = np.random.default_rng(0)  # one query by the other strategies depends on no chance
    turns = asked_in_turn(prior, seen_in(queries), answers, numbers, config.answers, config.choose, unused)
    return [preferences[k] for k, _ in turns]


def _rows(
    pretrainings: Mapping[str, ConditionedPolicy],
    asked: Mapping[int, Sequence[Query]],
    scenes: Sequence[Scene],
    possible: Doubles,
    base: _RolledOut,
    neutral: Mapping[str, _RolledOut],
    config: PreferencesConfig,
) -> Iterator[dict[str, Any]]:
    rolled_out_by: dict[tuple[str, str, bytes], _RolledOut] = {}
    for oracle, noise, seed in product(config.oracles, config.noises, config.query_seeds):
        answers = answers_to(make_oracle(oracle, lapse_rate=noise, seed=seed), asked[seed], config)
        weights = fit_weights(answers).preference_weights()
        named = ORACLE_PREFERENCES[oracle].objectives
        for name, conditioned in pretrainings.items():
            key = (oracle, name, weights.tobytes())  # many query sets end in the very same weights
            if key not in rolled_out_by:
                rolled_out_by[key] = _RolledOut.of(conditioned.at(weights), scenes, (oracle,))
            rolled_out = rolled_out_by[key]
            both = rolled_out.trajectories.success & base.trajectories.success
            better = np.sign(rolled_out.scores[oracle][both] - base.scores[oracle][both])
            crossings, lengths = (rolled_out.trajectories.self_intersections, rolled_out.trajectories.measured[both, 3])
            yield {
                "oracle": oracle,
                "held_out": oracle in HELD_OUT,
                "noise": noise,
                "query_seed": seed,
                "pretraining": name,
                "preference_weights": {
                    objective: float(weight) for objective, weight in zip(NAMES, weights, strict=True) if weight > 0
                },
                "dominant_found": NAMES[int(weights.argmax())] == named[0] if named else None,
                "success_rate": wilson(int(rolled_out.trajectories.success.sum()), len(scenes)).as_dict(),
                "self_intersections": mean_estimate(crossings).as_dict(),
                "longer_m": float((lengths - base.trajectories.measured[both, 3]).mean()),
                "both_succeed": int(both.sum()),
                "preferred": wilson(int(((better + 1) / 2).sum()), int(both.sum())).as_dict(),
                "moved": {
                    objective: Steerability(
                        base.trajectories,
                        {objective: rolled_out.trajectories, "neutral": neutral[name].trajectories},
                        possible,
                    ).moved(objective)
                    for objective in named
                },
            }


def summarise(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One line per oracle, noise and pre-training, over the query seeds.

    share, share_lowest, share_highest: of the way, of the foremost objective. seeds_better: in how many query sets the
    whole 95 % interval of every named objective's paired gain against the base policy lies above 0. The three are null
    outside the vocabulary.
    """
    lines = []
    for oracle, noise, name in dict.fromkeys((row["oracle"], row["noise"], row["pretraining"]) for row in rows):
        of = [row for row in rows if (row["oracle"], row["noise"], row["pretraining"]) == (oracle, noise, name)]
        moved = [list(row["moved"].values()) for row in of]
        inside = bool(moved[0])
        shares = [one[0]["share_of_the_way"]["value"] for one in moved if one]
        lines.append(
            {
                "oracle": oracle,
                "held_out": of[0]["held_out"],
                "noise": noise,
                "pretraining": name,
                "query_seeds": len(of),
                "share": float(np.mean(shares)) if inside else None,
                "share_lowest": min(shares) if inside else None,
                "share_highest": max(shares) if inside else None,
                "seeds_better": sum(all(way["better_than_base"]["low"] > 0 for way in one) for one in moved)
                if inside
                else None,
                "dominant_found": float(np.mean([row["dominant_found"] for row in of])) if inside else None,
                "preferred": float(np.mean([row["preferred"]["value"] for row in of])),
                "success_lowest": min(row["success_rate"]["value"] for row in of),
                "self_intersections": float(np.mean([row["self_intersections"]["value"] for row in of])),
                "self_intersections_most": max(row["self_intersections"]["value"] for row in of),
                "longer_m": float(np.mean([row["longer_m"] for row in of])),
            }
        )
    return lines

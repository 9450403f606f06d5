"""Chapter 4 reproduced: networks with attention, ablations, baselines and planners; table 4.1 and robustness."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.pedestrians.crowd_networks import VARIANTS
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.reproduction.driver import Chapter, Made
from desirepath_experiments.reproduction.pedestrians.computing import FUNCTIONS
from desirepath_experiments.reproduction.pedestrians.plan import (
    BUDGETS,
    BY_REWARD,
    PLANNED,
    SOCIAL_IN,
    PedestrianPlan,
    learner_of,
    make_plan,
    network_of,
)
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.tasks import Load

SOCIAL_WORDS = {
    "min_human_distance_m": "least distance, m",
    "personal_space_violations": "times within 1.2 m",
    "personal_space_time_s": "s within 1.2 m",
    "min_time_to_collision_s": "least time to collision, s",
    "stalled_time_s": "stalled, s",
    "mean_jerk_m_s3": "jerk, m/s³",
    "path_irregularity_rad_m": "irregularity, rad/m",
    "spl": "SPL",
}
NAMES = {
    name: f"{VARIANTS[network_of(name)].name}, by {learner_of(name).upper() or 'imitation'}"
    for name in (*VARIANTS, *BY_REWARD)
} | {
    "follow": "the path alone",
    "dwa": "DWA on the lidar",
    "orca": "ORCA, told everybody's motion",
    "social_force": "social force, told everybody's motion",
    "constant_velocity": "a search, told everybody's motion",
    "foresight": "a search, told where everybody will be",
}


def make(plan: PedestrianPlan, load: Load) -> Made:
    """Table 4.1, social metrics, robustness, other crowds."""
    rates, social = table(plan, load, "rates"), table(plan, load, "social")
    judged_bars = bars(rates)
    crowds = [name for name in next(iter(rates.values())) if name.split()[0] in ("speed", "number")]
    by_reward = plan.budget.by_reward
    return Made(
        {
            "bars": judged_bars,
            "rates": rates,
            "social": social,
            "leads": leads(plan, load),
            "histories": _histories(plan, load),
        },
        more={
            "names": NAMES,
            "networks": {who: network_of(who) for who in rates},
            "planners": PLANNED,
            "social_words": SOCIAL_WORDS,
            "elsewhere": [*crowds, "homes", "orca", "social_force"],
        },
        answer={"bars": judged_bars},
        card={"config": {"labels": plan.budget.labels, "by_reward": asdict(by_reward) if by_reward else None}},
    )


CHAPTER = Chapter("pedestrians", BUDGETS, FUNCTIONS, make_plan, make, options={"device": "cpu"})


def table(plan: PedestrianPlan, load: Load, of: Literal["rates", "social"]) -> dict[str, dict[str, dict[str, Any]]]:
    """By variant and condition: of each measure the mean over seeds and, of more than one, what each seed has."""

    def over(seeds: list[float]) -> dict[str, Any]:
        return {"mean": float(np.mean(seeds)), **({"seeds": seeds} if len(seeds) > 1 else {})}

    rows: dict[str, dict[str, Any]] = {}
    for who in dict.fromkeys(variant for variant, _ in plan.judged):
        seeds = [load(task).meta[of] for (variant, _), task in plan.judged.items() if variant == who]
        rows[who] = {
            condition: {measure: over([of_seed[condition][measure] for of_seed in seeds]) for measure in measures}
            for condition, measures in seeds[0].items()
        }
    return rows


def bars(rates: dict[str, Any]) -> list[dict[str, Any]]:
    """The specification's bars with what was reached."""
    printed = published("pedestrians")
    of_ours = rates["ours"]["published"]["success"]
    baselines = [rates[who]["published"]["success"]["mean"] for who in ("b1", "b2", "b3") if who in rates]
    lead = of_ours["mean"] - max(baselines) if baselines else float("nan")
    spread = float(np.ptp(of_ours.get("seeds", [of_ours["mean"]])))
    homes = rates["ours"]["homes"]["success"]["mean"]
    return [
        {"name": name, "value": value, "at_least": at_least, "met": bool(value >= at_least)}
        for name, value, at_least in (
            (
                "success by imitation in the published setting, %",
                of_ours["mean"],
                printed["table_4_1"]["ours"]["success"],
            ),
            ("lead over the best baseline, both by imitation, points, against the seeds' spread", lead, spread),
            ("success by imitation in unseen homes, %", homes, printed["homes"]["homes"]["success"]),
        )
    ]


def _histories(plan: PedestrianPlan, load: Load) -> dict[str, Any]:
    """Of each training the columns of its history."""
    histories = {}
    for (variant, seed), task in plan.judged.items():
        if task.needs:
            rows = load(task.needs[0]).meta["history"]
            histories[f"{variant} seed {seed}"] = {name: [row[name] for row in rows] for name in rows[0]}
    return histories


def leads(plan: PedestrianPlan, load: Load) -> dict[str, dict[str, dict[str, Any]]]:
    """By condition and everybody else who learned: points of success that ours is ahead with each seed; their mean with
    its standard errors, over seeds, and over scenes of the mean over seeds."""
    by_condition: dict[str, dict[str, dict[str, Any]]] = {}
    seeds = [seed for variant, seed in plan.judged if variant == "ours"]
    others = dict.fromkeys(variant for variant, seed in plan.judged if seed >= 0 and variant != "ours")
    for condition in SOCIAL_IN:
        success = {
            who: np.array([100.0 * (load(plan.judged[who, s]).arrays[condition] == Outcome.SUCCESS) for s in seeds])
            for who in ("ours", *others)
        }
        by_condition[condition] = {}
        for who in others:
            ahead = success["ours"] - success[who]
            by_condition[condition][who] = {
                "seeds": ahead.mean(axis=1).tolist(),
                "mean": float(ahead.mean()),
                "error_over_seeds": _standard_error(ahead.mean(axis=1)),
                "error_over_scenes": _standard_error(ahead.mean(axis=0)),
            }
    return by_condition


def _standard_error(values: NDArray[np.float64]) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")

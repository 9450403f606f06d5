"""`desirepath reproduce pedestrians`, without the command line: work, table 4.1, robustness and curves, report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from desirepath.explain.printed import Section
from desirepath.explain.printed import Table as PrintedTable
from desirepath.learning.pedestrians.crowd_networks import VARIANTS
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.reproduction.chapter_report import seeds_words
from desirepath_experiments.reproduction.driver import Chapter, Finished, Made
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
from desirepath_experiments.reproduction.pedestrians.published_numbers import (
    DEPARTURES,
    HOMES,
    HOMES_AT_LEAST,
    SUCCESS_AT_LEAST,
    TABLE,
    WITHOUT_ICP,
    WITHOUT_WALLS,
)
from desirepath_experiments.reproduction.tasks import Task, TaskResult

Load = Callable[[str], TaskResult]
MEASURES = ("success", "collision", "timeout", "time_s")
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


def make(finished: Finished) -> Made:
    """Table 4.1, social metrics, robustness, other crowds."""
    plan, load = finished.plan, finished.load
    budget, by_reward = plan.budget, plan.budget.by_reward
    rates, social = table(plan, load, "rates"), table(plan, load, "social")
    judged_bars = bars(rates)
    return Made(
        {
            "bars": judged_bars,
            "rates": rates,
            "social": social,
            "leads": leads(plan, load),
            "histories": _histories(plan, load),
        },
        head=seeds_words(budget),
        sections=_sections(plan, rates, social, judged_bars),
        further=[
            ("By imitation", f"{budget.labels:,} labels per training, {budget.selection_scenes} scenes to choose in"),
            ("By reward", f"{by_reward.updates:,} updates of {by_reward.batch_size}" if by_reward else "nothing"),
            ("Planners", ", ".join(PLANNED)),
        ],
        answer={"bars": judged_bars},
        card={
            "setup": "crowd_corridor, crowd_intersection, crowd_office",
            "seed": budget.seeds[0],
            "config": {"labels": budget.labels, "by_reward": asdict(by_reward) if by_reward else None},
            "scenes": {
                "judged": f"{budget.episodes} reporting scenes of the published setting and of homes, "
                f"{budget.episodes_more} of each other condition, the same for everybody"
            },
            "results": {"bars": judged_bars},
            "departures": DEPARTURES,
            "notes": ["Simulated throughout."],
        },
    )


CHAPTER = Chapter(
    "pedestrians",
    BUDGETS,
    FUNCTIONS,
    make_plan,
    lambda plan: plan.tasks(),
    make,
    task_name=lambda task: _name(task),
    options={"device": "cpu"},
)


def table(plan: PedestrianPlan, load: Load, of: Literal["rates", "social"]) -> dict[str, dict[str, dict[str, Any]]]:
    """By variant and condition: of each measure the mean over seeds and, of more than one, what each seed has."""
    found: dict[str, dict[str, Any]] = {}
    for who in dict.fromkeys(variant for variant, _ in plan.judged):
        seeds = [load(task.key).meta[of] for (variant, _), task in plan.judged.items() if variant == who]
        found[who] = {
            condition: {
                measure: {
                    "mean": float(np.mean([one[condition][measure] for one in seeds])),
                    **({"seeds": [one[condition][measure] for one in seeds]} if len(seeds) > 1 else {}),
                }
                for measure in seeds[0][condition]
            }
            for condition in seeds[0]
        }
    return found


def bars(rates: dict[str, Any]) -> list[dict[str, Any]]:
    """The specification's bars with what was reached."""
    ours = rates["ours"]["published"]["success"]
    baselines = [rates[who]["published"]["success"]["mean"] for who in ("b1", "b2", "b3") if who in rates]
    lead = ours["mean"] - max(baselines) if baselines else float("nan")
    homes = rates["ours"]["homes"]["success"]["mean"]
    return [
        _bar("success by imitation in the published setting, %", ours["mean"], SUCCESS_AT_LEAST),
        _bar("lead over the best baseline, both by imitation, points, against the seeds' spread", lead, _spread(ours)),
        _bar("success by imitation in unseen homes, %", homes, HOMES_AT_LEAST),
    ]


def _bar(name: str, value: float, at_least: float) -> dict[str, Any]:
    return {"name": name, "value": value, "at_least": at_least, "met": bool(value >= at_least)}


def _histories(plan: PedestrianPlan, load: Load) -> dict[str, Any]:
    """Of each training the columns of its history."""
    found = {}
    for (variant, seed), task in plan.judged.items():
        if task.needs:
            rows = load(task.needs[0].key).meta["history"]
            found[f"{variant} seed {seed}"] = {name: [row[name] for row in rows] for name in rows[0]}
    return found


def leads(plan: PedestrianPlan, load: Load) -> dict[str, dict[str, dict[str, Any]]]:
    """By condition and everybody else who learned: points of success that ours is ahead with each seed; their mean with
    its standard errors, over seeds, and over scenes of the mean over seeds."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    seeds = [seed for variant, seed in plan.judged if variant == "ours"]
    others = dict.fromkeys(variant for variant, seed in plan.judged if seed >= 0 and variant != "ours")
    for condition in SOCIAL_IN:
        success = {
            who: np.array([100.0 * (load(plan.judged[who, s].key).arrays[condition] == Outcome.SUCCESS) for s in seeds])
            for who in ("ours", *others)
        }
        found[condition] = {}
        for who in others:
            ahead = success["ours"] - success[who]
            found[condition][who] = {
                "seeds": ahead.mean(axis=1).tolist(),
                "mean": float(ahead.mean()),
                "error_over_seeds": _standard_error(ahead.mean(axis=1)),
                "error_over_scenes": _standard_error(ahead.mean(axis=0)),
            }
    return found


def _standard_error(values: NDArray[np.float64]) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


def _sections(
    plan: PedestrianPlan, rates: dict[str, Any], social: dict[str, Any], judged_bars: Sequence[dict[str, Any]]
) -> list[Section]:
    heads = ["policy", "success, %", "collisions, %", "timeouts, %", "time of success, s", "printed success, %"]
    rows = [
        [
            NAMES[who],
            *(_shown(of["published"][measure]) for measure in MEASURES),
            f"{TABLE[network_of(who)][0]:.1f}" if network_of(who) in TABLE else "-",
        ]
        for who, of in rates.items()
    ]
    ours, printed = rates["ours"], TABLE["ours"][0]
    robust = [
        ["everything as trained", _shown(ours["published"]["success"]), f"{printed:.1f}"],
        ["without ICP", _shown(ours["no_icp"]["success"]), f"{printed + WITHOUT_ICP:.1f}"],
        ["without walls", _shown(ours["no_walls"]["success"]), f"{printed + WITHOUT_WALLS:.1f}"],
        ["unseen homes, ORCA crowds", _shown(ours["homes"]["success"]), f"{HOMES[0]:.1f}"],
    ]
    conditions = [name for name in next(iter(rates.values())) if name.split()[0] in ("speed", "number")]
    more = [*conditions, "homes", "orca", "social_force"]
    return [
        Section(
            "Bars",
            ["None of this is about people."],
            [
                PrintedTable(
                    "Bars of the specification",
                    ["bar", "at least", "here", "met"],
                    [[b["name"], _number(b["at_least"]), _number(b["value"]), _yes(b["met"])] for b in judged_bars],
                )
            ],
        ),
        Section(
            "Table 4.1",
            [
                f"{plan.budget.episodes} episodes, the same for all: two pedestrians at 0.6 m/s, one who stands. Means "
                "over seeds, in brackets the difference between the best and the worst seed. The printed numbers were "
                "learned by DDPG."
            ],
            [PrintedTable("Here, with what was printed", heads, rows)],
        ),
        Section(
            "Social metrics",
            [
                "The field's, in the same episodes as table 4.1, those that fail too. Distances are between centres; "
                "stalled is slower than 0.05 m/s; irregularity is turning beyond facing the goal."
            ],
            [
                PrintedTable(
                    "Means over seeds (best less worst)",
                    ["policy", *SOCIAL_WORDS.values()],
                    [
                        [NAMES[who], *(_shown(of["published"][name], 2) for name in SOCIAL_WORDS)]
                        for who, of in social.items()
                    ],
                )
            ],
        ),
        Section("Robustness", [], [PrintedTable("Success of ours, %", ["setting", "here", "printed"], robust)]),
        Section(
            "Speed, number, other crowds",
            [
                "Success in %. Two pedestrians at that speed; that many at 0.6 m/s; homes as above; crowds that avoid. "
                f"{plan.budget.episodes_more} episodes, in homes {plan.budget.episodes}."
            ],
            [
                PrintedTable(
                    "Success, %",
                    ["policy", *more],
                    [
                        [NAMES[who], *(_number(of[name]["success"]["mean"]) for name in more)]
                        for who, of in rates.items()
                    ],
                )
            ],
        ),
        Section("Where this departs from the thesis", points=DEPARTURES),
    ]


def _spread(measure: dict[str, Any]) -> float:
    return float(np.ptp(measure.get("seeds", [measure["mean"]])))


def _shown(measure: dict[str, Any], digits: int = 1) -> str:
    return f"{_number(measure['mean'], digits)} ({_number(_spread(measure), digits)})"


def _number(value: float, digits: int = 1) -> str:
    return "-" if not np.isfinite(value) else f"{value:.{digits}f}"


def _yes(met: bool) -> str:
    return "yes" if met else "no"


def _name(task: Task) -> str:
    config = task.params.get("config", {})
    if task.kind == "imitated":
        return f"{config['variant']} by imitation, seed {config['seed']}"
    if config:
        return f"{config['variant']} {config['learner']} seed {config['seed']} until {task.params['until']:,} updates"
    return f"{task.kind} {task.params.get('variant', task.params.get('planner'))}"

"""`desirepath reproduce adaptable`, without the command line: work, table 5.1, figures, report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from desirepath.explain.printed import Section, Table, embed_picture
from desirepath_experiments.reproduction.adaptable.computing import FUNCTIONS
from desirepath_experiments.reproduction.adaptable.departures import DEPARTURES
from desirepath_experiments.reproduction.adaptable.plan import BUDGETS, AdaptablePlan, make_plan
from desirepath_experiments.reproduction.adaptable.published_numbers import NAMES, TABLE
from desirepath_experiments.reproduction.adaptable.results import KINDS, bars, rewards, single_objectives, table
from desirepath_experiments.reproduction.chapter_report import seeds_words
from desirepath_experiments.reproduction.driver import Chapter, Finished, Made
from desirepath_experiments.reproduction.tasks import Task
from desirepath_experiments.training.adaptable.training import AdaptableConfig

if TYPE_CHECKING:
    from desirepath.explain.pictures import Picture

MEASURES = {
    "success": "success, %",
    "collision": "collisions, %",
    "human_m": "human distance at full distance, m",
    "frechet_m": "Frechet at full demonstration, m",
    "time_s": "time at full efficiency, s",
}


def make(finished: Finished) -> Made:
    """Table 5.1, its bars and curves."""
    from desirepath_experiments.reproduction.adaptable.figures import pictures  # matplotlib is slow to load

    plan, load = finished.plan, finished.load
    budget = plan.budget
    found = {"table": table(plan, load), "rewards": rewards(plan, load)}
    found["single_objectives"] = single_objectives(plan, load)
    judged_bars = bars(found["table"])
    finished.tell("drawing")
    drawn = pictures(plan, load)
    files = [path for picture in drawn for path in picture.save(finished.figures)]
    return Made(
        {"bars": judged_bars, **found},
        head=seeds_words(budget),
        sections=_sections(plan, found, judged_bars, drawn, finished.figures),
        further=[("Updates", f"{budget.updates:,} per training")],
        answer={"bars": judged_bars},
        files=files,
        card={
            "setup": "adaptable",
            "seed": budget.seeds[0],
            "config": AdaptableConfig(updates=budget.updates).as_dict(),
            "scenes": {"judged": f"{budget.rollouts} reporting scenes per vector, of each seed's own set"},
            "results": {"bars": judged_bars},
            "departures": DEPARTURES,
            "notes": ["Simulated throughout: the demonstration is programmed."],
        },
    )


CHAPTER = Chapter(
    "adaptable", BUDGETS, FUNCTIONS, make_plan, lambda plan: plan.tasks(), make, task_name=lambda task: _name(task)
)


def _sections(
    plan: AdaptablePlan,
    found: dict[str, Any],
    judged_bars: Sequence[dict[str, Any]],
    drawn: Sequence[Picture],
    folder: Path,
) -> list[Section]:
    rows = found["table"]
    printed = [
        [title, *(f"{_number(rows[variant][key])} ({_number(TABLE[variant][key])})" for variant in rows)]
        for key, title in MEASURES.items()
    ]
    heads = ["measure", *(f"{NAMES[variant]}: here (printed)" for variant in rows)]
    followed = [
        [edge, *(_number(of["spearman"][edge]) for of in rows["ours"]["seeds"].values())]
        for edge in next(iter(rows["ours"]["seeds"].values()))["spearman"]
    ]
    away = [
        [f"{NAMES[variant]}, {kind}", *(_number(of[kind][key]) for key in ("success", "collision", "timeout"))]
        for variant, both in rows.items()
        for of in list(both["seeds"].values())[:1]
        for kind in KINDS[1:]
    ]
    seeds = [f"seed {seed}" for seed in rows["ours"]["seeds"]]
    return [
        Section(
            "Bars",
            ["Each with its worst seed."],
            [
                Table(
                    "Bars of the specification",
                    ["bar", "bound", "worst seed", "met"],
                    [
                        [
                            b["name"],
                            f"{'≥' if b['at_least'] else '≤'} {b['bound']:g}",
                            _number(b["worst"]),
                            "yes" if b["met"] else "no",
                        ]
                        for b in judged_bars
                    ],
                )
            ],
        ),
        Section(
            "Table 5.1",
            [
                f"33 preferences, {plan.budget.rollouts} rollouts each, in the same scenes; the last three rows over "
                "the rollouts that arrived under one weight alone. Means over seeds. Scenes are ours."
            ],
            [Table("Here (printed)", heads, printed)],
        ),
        *_single_section(found["single_objectives"]),
        Section(
            "Over the edges of the preference triangle",
            ["Spearman of each measure and its weight, +1: as it should be."],
            [Table("Rank correlation along the edges", ["objective", *seeds], followed)],
            pictures=[embed_picture(one, folder) for one in drawn],
        ),
        Section(
            "Where nothing was trained",
            ["A person who walks towards the robot at 0.5 m/s; an intersection of corridors. First seed."],
            [Table("%, over 33 preferences", ["policy, scenes", "success", "collisions", "timeouts"], away)],
        ),
        Section("Rewards from demonstrations (D-REX)", _rewards_words(), _reward_tables(found["rewards"])),
        Section("Where this departs from the thesis", points=DEPARTURES),
    ]


def _single_section(found: dict[str, Any]) -> list[Section]:
    """How far the scenes allow: nothing where no single-objective policy was trained."""
    if not found:
        return []
    rows = [
        [name, of["measure"], *(_number(of[key]) for key in ("success", "mean", "ours", "ratio"))]
        for name, of in found.items()
    ]
    heads = ["objective", "measure", "its success, %", "it reaches", "adaptable", "ratio"]
    words = "A policy trained for one objective alone, as long, in the same scenes. First seed."
    return [Section("Against single-objective policies", [words], [Table("At full weight", heads, rows)])]


def _rewards_words() -> list[str]:
    return [
        "Held-out rollouts, in scenes of their own. Accuracy: pairs of rollouts of which the less noisy one has more "
        "reward per step; per level, against the noise-free rollout in the same scene. Correlation: Spearman of reward "
        "and nearness to the demonstration (Frechet)."
    ]


def _reward_tables(found: dict[str, Any]) -> list[Table]:
    heads = ["noise", "rollouts", "accuracy", "reward per step", "Frechet, m", "correlation"]
    tables = []
    for name, of in found.items():
        judged = of["judged"]
        caption = (
            f"{name}: {of['demonstrations']} demonstrations, {of['steps']:,} steps; the clone arrives in "
            f"{100 * of['clone']['success']:.0f} %, {of['clone']['frechet_m']:.2f} m from the demonstration. Accuracy "
            f"over all pairs {100 * judged['accuracy']:.0f} %, correlation over all {_number(judged['correlation'])}"
        )
        rows = [
            [
                f"{level['level']:.2f}",
                *(_number(level[key]) for key in ("rollouts", "accuracy", "reward", "frechet_m", "correlation")),
            ]
            for level in judged["levels"]
        ]
        tables.append(Table(caption, heads, rows))
    return tables


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _name(task: Task) -> str:
    config = task.params.get("config", task.params)
    return f"{task.kind} {task.params.get('source', '')} seed {config.get('seed', 0)}".replace("  ", " ")

"""Chapter 5 reproduced: table 5.1 from the finished tasks, how each measure follows its weight, bars."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from desirepath.learning.adaptable.objectives import EDGES, NAMES, thesis_vectors
from desirepath_experiments.reproduction.adaptable.computing import FUNCTIONS
from desirepath_experiments.reproduction.adaptable.plan import BUDGETS, OURS, AdaptablePlan, make_plan
from desirepath_experiments.reproduction.driver import Chapter, Made
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.tasks import Load, TaskResult
from desirepath_experiments.training.adaptable.training import AdaptableConfig

MEASURE_OF = {"distance": "human_m", "demonstration": "frechet_m", "efficiency": "time_s"}
BETTER = {"human_m": 1, "frechet_m": -1, "time_s": -1}
"""+1: more is better."""
ELSEWHERE = ("walking", "intersection")
OUTCOMES = ("success", "collision", "timeout")
POLICIES = {"ours": "ours", "no_person": "no human pose", "sac": "SAC-PR", "sac_0.98": "SAC-PR 0.98"}


def make(plan: AdaptablePlan, load: Load) -> Made:
    """Table 5.1, its bars and curves."""
    from desirepath_experiments.reproduction.adaptable.figures import draw  # matplotlib is slow to load

    rows = table(plan, load)
    judged_bars = bars(rows)
    first = {who: next(iter(of["seeds"].values())) for who, of in rows.items()}
    return Made(
        {
            "bars": judged_bars,
            "table": rows,
            "rewards": rewards(plan, load),
            "single_objectives": single_objectives(plan, load),
        },
        more={
            "names": POLICIES,
            "elsewhere": [(who, kind, of[kind]) for who, of in first.items() for kind in ELSEWHERE],
        },
        answer={"bars": judged_bars},
        drawn=draw(plan, load),
        card={"config": AdaptableConfig(updates=plan.budget.updates).as_dict()},
    )


CHAPTER = Chapter("adaptable", BUDGETS, FUNCTIONS, make_plan, make)


def at_full_weight(arrays: dict[str, NDArray[Any]], objective: str) -> NDArray[Any]:
    """(rollouts,) the objective's measure where it alone counts, of those that arrived, as the thesis's; the corner
    stands twice among the 33 vectors, and is counted once."""
    row = int(np.flatnonzero(thesis_vectors()[:, NAMES.index(objective)] == 1)[0])
    arrived = arrays["static_outcome"][row] == 1
    values: NDArray[Any] = arrays[f"static_{MEASURE_OF[objective]}"][row][arrived]
    return values


def along_edges(arrays: dict[str, NDArray[Any]]) -> dict[str, float | None]:
    """Spearman of the mean measure and its weight along each edge where that weight changes, signed so that +1 is as it
    should be: six numbers, `distance 0->1`: on edge 0, rising."""
    vectors, correlations = thesis_vectors(), dict[str, float | None]()
    for number, (rising, falling) in enumerate(EDGES):
        rows = slice(number * 11, number * 11 + 11)
        for objective in (rising, falling):
            name = NAMES[objective]
            measure = MEASURE_OF[name]
            arrived = arrays["static_outcome"][rows] == 1
            means = [
                float(np.mean(v[a])) for v, a in zip(arrays[f"static_{measure}"][rows], arrived, strict=True) if a.any()
            ]
            weights = vectors[rows, objective][arrived.any(axis=1)]
            against = NAMES[falling if objective == rising else rising]
            same = len(means) < 3 or len(set(means)) < 2
            correlations[f"{name} against {against}"] = (
                None if same else BETTER[measure] * float(spearmanr(weights, means).statistic)
            )
    return correlations


def row_of(result: TaskResult) -> dict[str, Any]:
    """One column of table 5.1, with what else was measured."""
    full = {name: at_full_weight(result.arrays, name) for name in NAMES}
    row_values: dict[str, Any] = {key: result.meta["static"][key] for key in OUTCOMES}
    for name, values in full.items():
        row_values[MEASURE_OF[name]] = float(values.mean()) if len(values) else None
    row = int(np.flatnonzero(thesis_vectors()[:, 0] == 1)[0])
    free = result.arrays["free"] & (result.arrays["static_outcome"][row] == 1)
    row_values["frechet_median_m"] = float(np.median(full["demonstration"])) if len(full["demonstration"]) else None
    row_values["frechet_free_m"] = float(result.arrays["static_frechet_m"][row][free].mean()) if free.any() else None
    row_values["spearman"] = along_edges(result.arrays)
    row_values |= {kind: {key: result.meta[kind][key] for key in OUTCOMES} for kind in ELSEWHERE}
    success = (result.arrays["static_outcome"] == 1).mean(axis=1)
    row_values["worst_vector"] = {
        "preference": thesis_vectors()[int(success.argmin())].tolist(), "success": 100 * float(success.min())
    }  # fmt: skip
    return row_values


def table(plan: AdaptablePlan, load: Load) -> dict[str, dict[str, Any]]:
    """By variant: per seed, and means over seeds of what is a number."""
    by_variant: dict[str, dict[str, Any]] = {}
    for (variant, seed), task in plan.judged.items():
        result, trained = load(task), load(plan.trained[variant, seed])
        row = row_of(result) | {"core_seconds": trained.meta["made"]["cpu_seconds"]}
        row |= {"transitions": trained.meta["transitions"]}
        by_variant.setdefault(variant, {"seeds": {}})["seeds"][str(seed)] = row
    for of in by_variant.values():
        rows = list(of["seeds"].values())
        for key, value in rows[0].items():
            if value is None or isinstance(value, int | float):
                known = [row[key] for row in rows if row[key] is not None]
                of[key] = float(np.mean(known)) if known else None
    return by_variant


def single_objectives(plan: AdaptablePlan, load: Load) -> dict[str, Any]:
    """Per objective, what its single-objective policy reaches in the same scenes and how the adaptable one compares:
    `ratio` is ours over that, of the first seed."""
    first = plan.budget.seeds[0]
    objectives: dict[str, Any] = {}
    for name, task in plan.alone.items():
        reached = {key: value for key, value in load(task).meta.items() if key not in ("made", "params", "kind")}
        at_weight = at_full_weight(load(plan.judged[OURS, first]).arrays, name)
        mean = float(at_weight.mean()) if len(at_weight) else None
        ratio = mean / reached["mean"] if mean is not None and reached["mean"] else None
        objectives[name] = reached | {"ours": mean, "ratio": ratio}
    return objectives


def bars(rows_of: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """The bars of the issue, each with the worst seed's value and whether it is met with every seed."""
    rows = list(rows_of[OURS]["seeds"].values())
    printed, bound = published("adaptable")["table_5_1"][OURS], published("adaptable").numbers
    spearman = [_least(row["spearman"].values()) for row in rows]

    def bar(name: str, values: list[float | None], bound: float, at_least: bool) -> dict[str, Any]:
        known = [value for value in values if value is not None]
        worst = (min(known) if at_least else max(known)) if known else None
        met = worst is not None and len(known) == len(values) and (worst >= bound if at_least else worst <= bound)
        return {"name": name, "bound": bound, "at_least": at_least, "worst": worst, "met": met}

    def of(key: str) -> list[float | None]:
        return [row[key] for row in rows]

    return [
        bar("success over 33 vectors, %", of("success"), bound["success_at_least"], True),
        bar("collisions over 33 vectors, %", of("collision"), bound["collisions_at_most"], False),
        bar("least human distance at full distance, m", of("human_m"), printed["human_m"], True),
        bar("Frechet at full demonstration, m", of("frechet_m"), printed["frechet_m"], False),
        bar("time at full efficiency, s", of("time_s"), printed["time_s"], False),
        bar("Spearman along edges, least", spearman, bound["spearman_at_least"], True),
        bar("one training, seconds of one core", of("core_seconds"), bound["core_seconds_at_most"], False),
    ]


def _least(values: Iterable[float | None]) -> float | None:
    """The least of them, None where one is not known: an edge on which nobody arrived meets no bar."""
    known = list(values)
    return None if not known or None in known else min(v for v in known if v is not None)


def rewards(plan: AdaptablePlan, load: Load) -> dict[str, Any]:
    """Per source and seed, how good the reward from demonstrations is."""
    return {
        f"{source} {seed}": {key: load(task).meta[key] for key in ("judged", "clone", "demonstrations", "steps")}
        for (source, seed), task in plan.learned.items()
    }

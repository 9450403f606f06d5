"""Chapter 6 reproduced: what its finished tasks say, and how far that is from what was published.

Everything is simulated: the one who answers is the thesis's oracle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.tested import holm, mean_of
from desirepath.learning.cards import DEPARTURES
from desirepath.learning.policies.shape import FAST_HEADS
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.reproduction.driver import Chapter, Made
from desirepath_experiments.reproduction.enquery.computing import FUNCTIONS
from desirepath_experiments.reproduction.enquery.plan import (
    BUDGETS,
    CONDITIONS,
    MODELS,
    PRINTED,
    SETUP,
    SOURCES,
    TEST_SETS,
    EnqueryPlan,
    make_plan,
    query_seed,
)
from desirepath_experiments.reproduction.enquery.t_tests import TTest, student_t
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.tasks import Load, TaskResult

Doubles = NDArray[np.float64]
TABLE_6_2 = published("enquery")["table_6_2"]
LOW_ANSWERS = 15
FIRST = "EnQ-15"  # every other row is tested against this one
RAW = "RAW"
ROUNDING_M = 1e-5  # means of float32 distances differ by so little where policies are the same


@dataclass(frozen=True)
class SweepCell:
    """One cell of both heat maps. success_rate: mean over members; worst_member: the lowest of them."""

    kappa: float
    steps: int
    success_rate: float
    worst_member: float
    diversity: float


@dataclass(frozen=True)
class CurvePoint:
    """Accuracy of a reward model on one test set: mean over repetitions with a 95 % t-interval, standard deviation."""

    model: str
    source: str
    test_set: str
    answers: int
    accuracy: float
    low: float
    high: float
    deviation: float
    repetitions: int


@dataclass(frozen=True)
class TableRow:
    """A row like those of table 6.2, means over all alignments and scenes.

    share_of_the_way: from RAW to the ceiling of the same scenes. paired_gain_m: against RAW, over the scenes in which
    both succeed. per_alignment: the mean minimum human distance of each alignment. per_alignment_test compares
    those; per_episode_test takes every trajectory for independent, which those of one policy are not. took_over: in
    how many alignments what the conditioning search found was shown instead of what it began with, where that is asked.
    """

    recipe: str
    name: str
    alignments: int
    episodes: int
    min_human_distance_m: float
    deviation_m: float
    success_rate: float
    collision_rate: float
    timeout_rate: float
    time_s: float
    path_length_m: float
    self_intersections: float
    share_of_the_way: float
    paired_gain_m: float
    gates_passed: int | None
    took_over: int | None
    per_alignment: list[float]
    per_alignment_test: TTest | None
    per_episode_test: TTest | None
    published: dict[str, Any]


@dataclass(frozen=True)
class EnqueryResults:
    """All numbers of the report. tables: by recipe. crossings: test pairing -> number of answers, or None."""

    sweep: list[SweepCell]
    curves: list[CurvePoint]
    crossings: dict[str, int | None]
    tables: dict[str, list[TableRow]]
    ceiling_m: float
    reachable_share: dict[str, float]


def make(plan: EnqueryPlan, load: Load) -> Made:
    """Ensembles, accuracy of reward models, aligned policies and flow fields."""
    from desirepath_experiments.reproduction.enquery.figures import draw  # matplotlib is slow to load

    results = results_of(plan, load)
    summaries = {recipe: {row.name: _row_summary(row) for row in rows} for recipe, rows in results.tables.items()}
    numbers = {"tables": summaries, "ceiling_m": results.ceiling_m, "crossings": results.crossings}
    return Made(
        {"setup": SETUP, "seed": plan.seed, "results": asdict(results)},
        more=_report_values(plan, results),
        answer={"seed": plan.seed, **numbers},
        drawn=draw(plan, load, results),
        card=_card(plan, numbers),
    )


CHAPTER = Chapter("enquery", BUDGETS, FUNCTIONS, make_plan, make, options={"seed": 0})


def _report_values(plan: EnqueryPlan, results: EnqueryResults) -> dict[str, Any]:
    """What the report picks from the results."""
    cell, last = nearest_cell(results.sweep, PRINTED["kappa"], int(PRINTED["ensemble_steps"])), max(plan.budget.marks)
    success = {swept.kappa: swept.success_rate for swept in results.sweep if swept.steps == last}
    without = {swept.steps: swept.diversity for swept in results.sweep if swept.kappa == 0.0}
    falls = PRINTED["kappa_where_success_falls"]
    points = {(p.model, p.source, p.test_set, p.answers): p for p in results.curves}
    low = min(plan.budget.answers, key=lambda answers: abs(answers - LOW_ANSWERS))
    at_15 = {
        m: points[m, "EnQ", TEST_SETS[0], LOW_ANSWERS].accuracy for m in MODELS if LOW_ANSWERS in plan.budget.answers
    }
    gains = {recipe: rows[0].share_of_the_way for recipe, rows in results.tables.items()}
    return {
        "printed": PRINTED,
        "recipes": plan.recipes,
        "models": MODELS,
        "models_and_sources": list(product(MODELS, SOURCES)),
        "test_sets": TEST_SETS,
        "tables": results.tables,
        "by_name": {row.name: row for row in results.tables["thesis"]},
        "ceiling_m": results.ceiling_m,
        "reachable_share": results.reachable_share,
        "crossings": results.crossings,
        "points": points,
        "low_answers": low,
        "low": {source: points["mlp", source, TEST_SETS[0], low] for source in SOURCES},
        "at_15": at_15,
        "better": [model for model, accuracy in at_15.items() if accuracy > at_15["mlp"]],
        "best": max((recipe for recipe in gains if recipe != "thesis"), key=lambda recipe: gains[recipe]),
        "too_far": [name for name, row in TABLE_6_2.items() if row["min_human_distance_m"] > results.ceiling_m],
        "sweep": {
            "cell": cell,
            "last": last,
            "control": without.get(last),
            "control_there": without.get(cell.steps),
            "above": [rate for kappa, rate in success.items() if kappa > falls],
            "below": [rate for kappa, rate in success.items() if kappa <= falls],
        },
        "of_base": [DEPARTURES[key] for key in ("progress", "smoothness", "average", "ensemble_choice")],
        "scenes": plan.raw.params["scenes"],
        "first_query_seed": query_seed(plan.seed, 0),
    }


def _card(plan: EnqueryPlan, numbers: dict[str, Any]) -> dict[str, Any]:
    """What the numbers were made of and how."""
    scenes = plan.raw.params["scenes"]
    begun = (plan.base, plan.ensemble, *(task.needs[0] for task in plan.sweep.values()))
    parents = {
        task.params["name"]: ", ".join(task.params["sha256"]) for task in begun if task.kind.startswith("shipped")
    }
    conditioned = [p.params for tasks in plan.alignments.values() for p in tasks if "conditioned" in p.params]
    if conditioned:
        parents[conditioned[0]["conditioned"]] = conditioned[0]["sha256"]
    heads = ["heads"] if plan.budget.heads == FAST_HEADS else []
    trained = ["progress", "smoothness", *heads, "environments", "average", "ensemble_start", "ensemble_choice"]
    keys = [*trained, "fine_tuning", *(["instant", "conditioning_search"] if conditioned else [])]
    return {
        "config": asdict(plan.budget),
        "scenes": {
            "table": describe(Purpose.REPORT, scenes["n"], scenes["seed"]),
            "sweep": describe(Purpose.SELECT, plan.budget.sweep_scenes, scenes["seed"]),
        },
        "results": numbers,
        "parents": parents,
        "departures": [DEPARTURES[key] for key in keys],
    }


def _row_summary(row: TableRow) -> dict[str, Any]:
    names = ("min_human_distance_m", "success_rate", "collision_rate", "timeout_rate", "share_of_the_way")
    p = row.per_alignment_test.p_corrected if row.per_alignment_test else None
    return {name: getattr(row, name) for name in names} | {"p": p}


def results_of(plan: EnqueryPlan, load: Load) -> EnqueryResults:
    """Put the tasks' results together."""
    curves = curves_of([load(task).arrays["accuracy"] for task in plan.accuracies], plan.budget.answers)
    raw = load(plan.raw)
    tables = {}
    for recipe in plan.recipes:
        runs = {name: [load(task) for task in plan.alignments[recipe, name]] for name in CONDITIONS}
        tables[recipe] = table_of_recipe(recipe, runs, raw)
    ceilings = raw.arrays["ceiling"]
    return EnqueryResults(
        sweep=[cell for kappa in plan.sweep for cell in cells_of(kappa, plan.budget.marks, load(plan.sweep[kappa]))],
        curves=curves,
        crossings=crossings_of(curves),
        tables=tables,
        ceiling_m=float(ceilings.mean()),
        reachable_share={
            name: float((ceilings >= row["min_human_distance_m"]).mean()) for name, row in TABLE_6_2.items()
        },
    )


def cells_of(kappa: float, marks: Sequence[int], result: TaskResult) -> list[SweepCell]:
    """The cells of one kappa, one per mark."""
    return [
        SweepCell(kappa, steps, float(rates.mean()), float(rates.min()), float(diversity))
        for steps, rates, diversity in zip(
            marks, result.arrays["success_rates"], result.arrays["diversity"], strict=True
        )
    ]


def curves_of(repetitions: Sequence[NDArray[Any]], answers: Sequence[int]) -> list[CurvePoint]:
    """repetitions: (models, sources, numbers of answers, test sets) each. What could not be fitted is left out."""
    stacked = np.stack(repetitions)
    points = []
    parts = (enumerate(MODELS), enumerate(SOURCES), enumerate(TEST_SETS), enumerate(answers))
    for (m, model), (s, source), (t, test_set), (k, count) in product(*parts):
        values = stacked[:, m, s, k, t]
        if not np.isnan(values).any():
            of = mean_of(values)
            points.append(CurvePoint(model, source, test_set, count, of.mean, of.low, of.high, of.sd, len(values)))
    return points


def _correct(tests: dict[str, TTest]) -> dict[str, TTest]:
    """The same tests with p corrected for their number by Holm."""
    corrected = holm([test.p for test in tests.values()])
    return {name: replace(test, p_corrected=p) for (name, test), p in zip(tests.items(), corrected, strict=True)}


def crossing(answers: Sequence[int], first: Sequence[float], second: Sequence[float]) -> int | None:
    """The smallest number of answers from which `second` stays above `first` to the end; None if it never does."""
    above = None
    for count, a, b in zip(answers, first, second, strict=True):
        if b <= a:
            above = None
        elif above is None:
            above = count
    return above


def crossings_of(curves: Sequence[CurvePoint]) -> dict[str, int | None]:
    """From how many answers the baseline's neural model is more accurate: each on its own data, and on either set."""
    lines = {
        (source, test_set): {
            p.answers: p.accuracy for p in curves if (p.model, p.source, p.test_set) == ("mlp", source, test_set)
        }
        for source, test_set in product(SOURCES, TEST_SETS)
    }
    pairings = {"each on its own kind": TEST_SETS} | {f"both on {name}": (name, name) for name in TEST_SETS}
    crossings = {}
    for pairing, (of_first, of_second) in pairings.items():
        first, second = lines["EnQ", of_first], lines["BL", of_second]
        crossings[pairing] = crossing(list(first), list(first.values()), list(second.values()))
    return crossings


def table_of_recipe(recipe: str, runs: dict[str, list[TaskResult]], raw: TaskResult) -> list[TableRow]:
    """The five rows with their tests against EnQ-15, corrected by Holm over those of the four that can be made.

    Alignments that all came out alike, as a conditioned policy's do at the same weights, have no spread to test with.
    """
    runs = {**runs, RAW: [raw]}
    distances = {name: _column(of, "min_human_distance") for name, of in runs.items()}
    others = [name for name in runs if name != FIRST]
    means = {name: of.mean(1) for name, of in distances.items()}
    by_alignment: dict[str, TTest] = {}
    if len(means[FIRST]) > 1:
        varying = [name for name in others if max(np.ptp(means[FIRST]), np.ptp(means[name])) > ROUNDING_M]
        units = {**means, RAW: means[RAW][0]}  # one policy: a fixed value
        by_alignment = _correct({name: student_t(units[FIRST], units[name]) for name in varying})
    by_episode = _correct({name: student_t(distances[FIRST].ravel(), distances[name].ravel()) for name in others})
    return [_row(recipe, name, of, raw, by_alignment.get(name), by_episode.get(name)) for name, of in runs.items()]


def _column(runs: Sequence[TaskResult], key: str) -> Doubles:
    """(runs, scenes)"""
    return np.stack([result.arrays[key] for result in runs]).astype(np.float64)


def _row(
    recipe: str,
    name: str,
    runs: Sequence[TaskResult],
    raw: TaskResult,
    by_alignment: TTest | None,
    by_episode: TTest | None,
) -> TableRow:
    outcome, distance = _column(runs, "outcome"), _column(runs, "min_human_distance")
    raw_distance, ceiling = raw.arrays["min_human_distance"].astype(np.float64), raw.arrays["ceiling"]
    way = float(ceiling.mean() - raw_distance.mean())
    both = (outcome == Outcome.SUCCESS) & (raw.arrays["outcome"] == Outcome.SUCCESS)
    gains = (distance - raw_distance)[both]
    return TableRow(
        recipe=recipe,
        name=name,
        alignments=len(runs),
        episodes=distance.size,
        min_human_distance_m=float(distance.mean()),
        deviation_m=float(distance.mean(1).std(ddof=1)) if len(runs) > 1 else math.nan,
        success_rate=float((outcome == Outcome.SUCCESS).mean()),
        collision_rate=float((outcome == Outcome.COLLISION).mean()),
        timeout_rate=float((outcome == Outcome.TIMEOUT).mean()),
        time_s=float(_column(runs, "time").mean()),
        path_length_m=float(_column(runs, "path_length").mean()),
        self_intersections=float(_column(runs, "self_intersections").mean()),
        share_of_the_way=float(distance.mean() - raw_distance.mean()) / way,
        paired_gain_m=float(gains.mean()) if gains.size else math.nan,
        gates_passed=sum(result.meta["gate_passed"] for result in runs) if "gate_passed" in runs[0].meta else None,
        took_over=sum(result.meta["takes_over"] for result in runs) if "takes_over" in runs[0].meta else None,
        per_alignment=[float(value) for value in distance.mean(1)],
        per_alignment_test=by_alignment,
        per_episode_test=by_episode,
        published=TABLE_6_2[name],
    )


def nearest_cell(cells: Sequence[SweepCell], kappa: float, steps: int) -> SweepCell:
    """The cell nearest to a published setting, kappa before steps."""
    return min(cells, key=lambda cell: (abs(cell.kappa - kappa), abs(cell.steps - steps)))

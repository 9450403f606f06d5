"""Chapter 6 in numbers: what the finished tasks say, and how far it is from what was published.

Pure functions on results; nothing is computed anew, drawn or written here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.tested import holm, mean_of
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.reproduction.enquery import published_numbers as thesis
from desirepath_experiments.reproduction.enquery.budgets import CONDITIONS, MODELS, SOURCES, TEST_SETS
from desirepath_experiments.reproduction.enquery.plan import EnqueryPlan
from desirepath_experiments.reproduction.enquery.t_tests import TTest, student_t, student_t_against
from desirepath_experiments.reproduction.tasks import TaskResult

Doubles = NDArray[np.float64]
Load = Callable[[str], TaskResult]
"""Key of a task -> its result."""
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
    published: thesis.AlignmentRow


@dataclass(frozen=True)
class EnqueryResults:
    """All numbers of the report. tables: by recipe. crossings: test pairing -> number of answers, or None."""

    sweep: list[SweepCell]
    curves: list[CurvePoint]
    crossings: dict[str, int | None]
    tables: dict[str, list[TableRow]]
    ceiling_m: float
    reachable_share: dict[str, float]


def results_of(plan: EnqueryPlan, load: Load) -> EnqueryResults:
    """Put the tasks' results together."""
    curves = curves_of([load(task.key).arrays["accuracy"] for task in plan.accuracies], plan.budget.answers)
    raw = load(plan.raw.key)
    tables = {}
    for recipe in plan.recipes:
        runs = {name: [load(task.key) for task in plan.alignments[recipe, name]] for name in CONDITIONS}
        tables[recipe] = table_of_recipe(recipe, runs, raw)
    ceilings = raw.arrays["ceiling"]
    return EnqueryResults(
        sweep=[
            cell for kappa in plan.sweep for cell in cells_of(kappa, plan.budget.marks, load(plan.sweep[kappa].key))
        ],
        curves=curves,
        crossings=crossings_of(curves),
        tables=tables,
        ceiling_m=float(ceilings.mean()),
        reachable_share={
            name: float((ceilings >= row.min_human_distance_m).mean()) for name, row in thesis.TABLE_6_2.items()
        },
    )


def cells_of(kappa: float, marks: Sequence[int], made: TaskResult) -> list[SweepCell]:
    """The cells of one kappa, one per mark."""
    return [
        SweepCell(kappa, steps, float(rates.mean()), float(rates.min()), float(diversity))
        for steps, rates, diversity in zip(marks, made.arrays["success_rates"], made.arrays["diversity"], strict=True)
    ]


def curves_of(repetitions: Sequence[NDArray[Any]], answers: Sequence[int]) -> list[CurvePoint]:
    """repetitions: (models, sources, numbers of answers, test sets) each. What could not be fitted is left out."""
    stacked = np.stack(repetitions)
    points = []
    for m, model in enumerate(MODELS):
        for s, source in enumerate(SOURCES):
            for t, test_set in enumerate(TEST_SETS):
                for k, count in enumerate(answers):
                    values = stacked[:, m, s, k, t]
                    if np.isnan(values).any():
                        continue
                    mean = mean_of(values)
                    points.append(
                        CurvePoint(model, source, test_set, count, mean.mean, mean.low, mean.high, mean.sd, len(values))
                    )
    return points


def _corrected(tests: Sequence[TTest]) -> list[TTest]:
    """The same tests with p corrected for their number by Holm."""
    return [replace(test, p_corrected=p) for test, p in zip(tests, holm([t.p for t in tests]), strict=True)]


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

    def line(source: str, test_set: str) -> tuple[list[int], list[float]]:
        points = [p for p in curves if (p.model, p.source, p.test_set) == ("mlp", source, test_set)]
        return [p.answers for p in points], [p.accuracy for p in points]

    pairings = {"each on its own kind": TEST_SETS} | {f"both on {name}": (name, name) for name in TEST_SETS}
    found = {}
    for pairing, (of_first, of_second) in pairings.items():
        answers, first = line("EnQ", of_first)
        found[pairing] = crossing(answers, first, line("BL", of_second)[1])
    return found


def table_of_recipe(recipe: str, runs: dict[str, list[TaskResult]], raw: TaskResult) -> list[TableRow]:
    """The five rows with their tests against EnQ-15, corrected by Holm over those of the four that can be made.

    Alignments that all came out alike, as a conditioned policy's do at the same weights, have no spread to test with.
    """
    samples = {name: np.stack([made.arrays["min_human_distance"] for made in of]) for name, of in runs.items()}
    first = samples[FIRST].astype(np.float64)
    raw_distances = raw.arrays["min_human_distance"].astype(np.float64)
    others = [name for name in samples if name != FIRST]
    by_alignment: dict[str, TTest] = {}
    if len(first) > 1:
        means = {name: sample.mean(1) for name, sample in samples.items()}
        tests = {name: student_t(means[FIRST], means[name]) for name in others if _vary(means[FIRST], means[name])}
        if _vary(means[FIRST]):
            tests[RAW] = student_t_against(means[FIRST], float(raw_distances.mean()))
        by_alignment = dict(zip(tests, _corrected(list(tests.values())), strict=True))
    episode_tests = [student_t(first.ravel(), samples[name].ravel()) for name in others]
    episode_tests.append(student_t(first.ravel(), raw_distances))
    by_episode = dict(zip([*others, RAW], _corrected(episode_tests), strict=True))
    rows = [_row(recipe, name, of, raw, by_alignment.get(name), by_episode.get(name)) for name, of in runs.items()]
    return [*rows, _row(recipe, RAW, [raw], raw, by_alignment.get(RAW), by_episode.get(RAW))]


def _vary(*samples: Doubles) -> bool:
    """Whether any of the samples has a spread beyond rounding (m)."""
    return any(np.ptp(sample) > ROUNDING_M for sample in samples)


def _row(
    recipe: str,
    name: str,
    runs: Sequence[TaskResult],
    raw: TaskResult,
    by_alignment: TTest | None,
    by_episode: TTest | None,
) -> TableRow:
    def column(key: str) -> Doubles:
        return np.stack([made.arrays[key] for made in runs]).astype(np.float64)

    outcome, distance = column("outcome"), column("min_human_distance")
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
        time_s=float(column("time").mean()),
        path_length_m=float(column("path_length").mean()),
        self_intersections=float(column("self_intersections").mean()),
        share_of_the_way=float(distance.mean() - raw_distance.mean()) / way,
        paired_gain_m=float(gains.mean()) if gains.size else math.nan,
        gates_passed=sum(made.meta["gate_passed"] for made in runs) if "gate_passed" in runs[0].meta else None,
        took_over=sum(made.meta["takes_over"] for made in runs) if "takes_over" in runs[0].meta else None,
        per_alignment=[float(value) for value in distance.mean(1)],
        per_alignment_test=by_alignment,
        per_episode_test=by_episode,
        published=thesis.TABLE_6_2[name],
    )


def nearest_cell(cells: Sequence[SweepCell], kappa: float, steps: int) -> SweepCell:
    """The cell nearest to a published setting, kappa before steps."""
    return min(cells, key=lambda cell: (abs(cell.kappa - kappa), abs(cell.steps - steps)))

"""Chapter 6 as a report: what we found beside what was published, in words computed from the numbers.

A sentence that explains a difference is only written where the numbers carry it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from backend.analysis.t_tests import TTest
from backend.analysis.tested import told_p
from backend.experiments.reproduction.enquery import thesis
from backend.experiments.reproduction.enquery.budgets import MODELS, RECIPES, SOURCES, TEST_SETS
from backend.experiments.reproduction.enquery.plan import EnqueryPlan, query_seed
from backend.experiments.reproduction.enquery.results import (
    FIRST,
    RAW,
    CurvePoint,
    EnqueryResults,
    TableRow,
    nearest_cell,
)
from backend.experiments.reproduction.running import TEMPLATES
from backend.experiments.reproduction.tasks import Run
from backend.explain.pictures import Picture
from backend.explain.printed import Section, Shown, Table, page, shown_picture
from backend.learning.cards import DEPARTURES

LOW_QUERIES = 15


def write_report(path: Path, plan: EnqueryPlan, results: EnqueryResults, pictures: Sequence[Picture], run: Run) -> None:
    """One HTML file with everything in it; figures are SVG."""
    html = page(
        TEMPLATES,
        "enquery.html",
        run={"budget": plan.budget.name, "seed": plan.seed},
        brief=brief(plan, results),
        sections=sections(plan, results, pictures, path.parent / "figures"),
        facts=facts(plan, run),
        kinds=kinds(run),
    )
    path.write_text(html, encoding="utf-8")


def brief(plan: EnqueryPlan, results: EnqueryResults) -> list[str]:
    """The result in a few sentences."""
    told = []
    for recipe, rows in results.tables.items():
        first = _named(rows, FIRST)
        told.append(
            f"{FIRST} by {RECIPES[recipe]}: minimum human distance {_m(first.min_human_distance_m)}, "
            f"{_share(first.share_of_the_way)} of the way from RAW ({_m(_named(rows, RAW).min_human_distance_m)}) to "
            f"the ceiling ({_m(results.ceiling_m)}), success {_share(first.success_rate)}. The thesis: "
            f"{_m(first.published.min_human_distance_m)}, success {_share(first.published.success_rate)}."
        )
    told.append(_accuracy_sentence(results))
    told.append(_sweep_sentence(plan, results))
    return told


def sections(plan: EnqueryPlan, results: EnqueryResults, pictures: Sequence[Picture], folder: Path) -> list[Section]:
    """The report's parts in order."""

    def shown(*beginnings: str) -> list[Shown]:
        return [shown_picture(one, folder) for one in pictures if one.name.startswith(beginnings)]

    tables = results.tables
    return [
        Section("Ensembles over kappa and training steps", [_sweep_sentence(plan, results)], pictures=shown("sweep")),
        Section("Trajectories of all members", pictures=shown("members")),
        Section(
            "Accuracy of the reward models",
            [_accuracy_sentence(results), _crossing_sentence(results)],
            tables=[_accuracy_table(results, test_set) for test_set in TEST_SETS],
            pictures=shown("accuracy"),
        ),
        Section(
            "Aligned policies",
            [
                f"{plan.budget.alignments} alignments per row, each with answers of its own, then trajectories in the "
                f"same {plan.budget.rollouts} scenes. All recipes are given the same answers; all start from the same "
                "base policy, but for the conditioned one, which is shipped. The share of the way is that from RAW to "
                "the ceiling of these scenes, the mean of min(start to person, goal to person).",
            ],
            tables=[_alignment_table(recipe, rows) for recipe, rows in tables.items()],
            pictures=shown("distances"),
        ),
        Section(
            "Tests",
            [
                f"Two-sided Student's t-tests of {FIRST} against every other row, as in table 6.2, p corrected by Holm "
                "over the four tests of a recipe. Alignments are the units; RAW is one policy and enters as a fixed "
                "value. Beside it the same test with every trajectory as a unit: those of one policy are not "
                "independent, so its p is too small; the thesis does not say which was used.",
            ],
            tables=[_test_table(recipe, rows) for recipe, rows in tables.items()],
            points=[
                row.per_alignment_test.sentence(f"By {RECIPES[recipe]}, {FIRST}", row.name, "m")
                for recipe, rows in tables.items()
                for row in rows
                if row.per_alignment_test is not None
            ],
        ),
        Section(
            "Where our numbers differ from the thesis",
            tables=[_difference_table(recipe, rows) for recipe, rows in tables.items()],
            points=explanations(plan, results),
        ),
        Section("Raw and aligned trajectories", pictures=shown("aligned")),
        Section("Flow fields", pictures=shown("flow")),
    ]


def explanations(plan: EnqueryPlan, results: EnqueryResults) -> list[str]:
    """What accounts for the differences, as far as our own numbers show it."""
    told = []
    raw = _named(results.tables["thesis"], RAW)
    above = [name for name, row in thesis.TABLE_6_2.items() if row.min_human_distance_m > results.ceiling_m]
    first = thesis.TABLE_6_2[FIRST].min_human_distance_m
    if above:
        told.append(
            f"The scenes. No policy can keep more than {_m(results.ceiling_m)} on average in ours, less than the "
            f"published {', '.join(above)}; {_m(first)} or more is possible in "
            f"{_share(results.reachable_share[FIRST])} of them. Scenes or the measure must have been different there, "
            "so metres cannot be compared, only shares of the way."
        )
    gap = raw.min_human_distance_m - raw.published.min_human_distance_m
    told.append(
        f"The starting point. Our RAW keeps {_m(raw.min_human_distance_m)}, {_m(abs(gap))} "
        f"{'more' if gap > 0 else 'less'} than the published RAW, before anything was learned from answers."
    )
    gains = {recipe: _named(rows, FIRST).share_of_the_way for recipe, rows in results.tables.items()}
    ours = max((recipe for recipe in gains if recipe != "thesis"), key=lambda recipe: gains[recipe])
    if gains[ours] > gains["thesis"]:
        told.append(
            "The recipe. From the same answers, in the same scenes, the thesis's recipe (lambda 0.06, neural reward "
            f"model, relabelled buffer alone) goes {_share(gains['thesis'])} of the way, {RECIPES[ours]} "
            f"{_share(gains[ours])}: the answers hold more than the published recipe takes from them."
        )
    at = {
        (p.model, p.source): p.accuracy
        for p in results.curves
        if p.answers == LOW_QUERIES and p.test_set == TEST_SETS[0]
    }
    better = [model for model in MODELS if ("mlp", "EnQ") in at and at[model, "EnQ"] > at["mlp", "EnQ"]]
    if better:
        others = ", ".join(f"the model {MODELS[model]!r} {_share(at[model, 'EnQ'])}" for model in better)
        told.append(
            f"The reward model. With {LOW_QUERIES} answers the neural model predicts {_share(at['mlp', 'EnQ'])} of the "
            f"ensemble test pairs, {others}."
        )
    told.append(_diversity_explanation(results))
    told += [
        "The simulator. Fast kinematic engine instead of iGibson; observations, limits and rewards are the chapter's.",
        "The replay buffer is regenerated from the base policy and the seed, not the one that filled up during its "
        "training.",
        *(f"Base and ensemble. {DEPARTURES[key]}" for key in ("progress", "smoothness", "average", "ensemble_choice")),
    ]
    heads = "-".join(str(width) for width in plan.budget.heads)
    told.append(
        f"The networks. Heads of {heads} for base, ensemble, reward models and alignments (the thesis: 400-300); the "
        "sweep over kappa starts from the shipped base policy with its smaller heads."
    )
    return told


def _diversity_explanation(results: EnqueryResults) -> str:
    cell = nearest_cell(results.sweep, thesis.KAPPA, thesis.ENSEMBLE_STEPS)
    control = [other.diversity for other in results.sweep if other.kappa == 0.0 and other.steps == cell.steps]
    without = f" Without the term members that start alike already differ by {control[0]:.2f}." if control else ""
    ratio = cell.diversity / thesis.ENSEMBLE_DIVERSITY
    return (
        f"The action diversity. Ours is {cell.diversity:.2f} at kappa = {cell.kappa:g} and {cell.steps:,} steps, "
        f"{ratio:.1f} times the published {thesis.ENSEMBLE_DIVERSITY}.{without} Ours is the formula of 6.5.1.1 with "
        "actions in [-1, 1], summed over the other members and over both parts of an action; averaged over the two "
        f"parts it would be {cell.diversity / 2:.2f}. The thesis says neither which it is nor in which unit actions "
        "enter, so how much of the difference is behaviour remains unexplained."
    )


def facts(plan: EnqueryPlan, run: Run) -> list[tuple[str, str]]:
    """Command, seeds, durations."""
    budget = plan.budget
    scenes = plan.raw.params["scenes"]
    return [
        ("command", run.command),
        ("commit", run.commit),
        ("this run", f"{run.computed} tasks computed in {_duration(run.seconds)} by {run.processes} process(es)"),
        ("all tasks", f"{len(run.made)} tasks, {_duration(run.core_seconds)} of one core"),
        ("network heads", "-".join(str(width) for width in budget.heads)),
        ("base policy", _policy_words(plan)),
        ("table's scenes", f"{scenes['n']} reporting scenes of seed {scenes['seed']}"),
        (
            "queries",
            f"seeds {query_seed(plan.seed, 0)} and following, one per repetition and alignment; test pairs "
            f"{plan.accuracies[0].params['test_seed']}",
        ),
        (
            "training seeds",
            f"{'base, ensemble, ' if budget.train else ''}sweep: {plan.seed}; alignments and reward models: their "
            f"number from 0 to {max(budget.alignments, budget.repetitions) - 1}",
        ),
        (
            "thesis's recipe",
            f"{budget.thesis_epochs} epochs of {budget.thesis_updates:,} updates, lambda 0.06, best epoch kept",
        ),
        (RECIPES["refine"], f"{budget.refine_updates:,} updates, {budget.refine_checkpoints} checkpoints"),
    ]


def kinds(run: Run) -> list[dict[str, Any]]:
    """Tasks, seconds and commits by kind of work."""
    grouped: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for key, about in run.made.items():
        grouped[key.rpartition("-")[0]].append(about)
    return [
        {
            "kind": kind.replace("_", " "),
            "tasks": len(abouts),
            "seconds": f"{sum(float(about['seconds']) for about in abouts):.0f}",
            "cpu_seconds": f"{sum(float(about['cpu_seconds']) for about in abouts):.0f}",
            "commits": ", ".join(sorted({_short(str(about["commit"])) for about in abouts})),
        }
        for kind, abouts in grouped.items()
    ]


def _short(commit: str) -> str:
    name, _, dirty = commit.partition("-")
    return f"{name[:10]}{'-' + dirty if dirty else ''}"


def _policy_words(plan: EnqueryPlan) -> str:
    if plan.budget.train:
        return "trained in this reproduction, with its own ensemble of four"
    return "the shipped one and its shipped ensemble of four"


def _sweep_sentence(plan: EnqueryPlan, results: EnqueryResults) -> str:
    cell = nearest_cell(results.sweep, thesis.KAPPA, thesis.ENSEMBLE_STEPS)
    last = max(plan.budget.marks)
    final = {cell.kappa: cell for cell in results.sweep if cell.steps == last}
    control = f" The control without the term: diversity {final[0.0].diversity:.2f}." if 0.0 in final else ""
    above = [cell.success_rate for kappa, cell in final.items() if kappa > thesis.KAPPA_WHERE_SUCCESS_FALLS]
    below = [cell.success_rate for kappa, cell in final.items() if kappa <= thesis.KAPPA_WHERE_SUCCESS_FALLS]
    falls = ""
    if above and below:
        falls = (
            f" After {last:,} steps the mean success is {_share(sum(below) / len(below))} for kappa up to "
            f"{thesis.KAPPA_WHERE_SUCCESS_FALLS} and {_share(sum(above) / len(above))} above, where the thesis saw it "
            "fall rapidly."
        )
    return (
        f"At kappa = {cell.kappa:g} and {cell.steps:,} steps members succeed in {_share(cell.success_rate)} (worst "
        f"{_share(cell.worst_member)}) at an action diversity of {cell.diversity:.2f}; the thesis reports "
        f"{_share(thesis.ENSEMBLE_SUCCESS)} and {thesis.ENSEMBLE_DIVERSITY} for kappa = {thesis.KAPPA} and "
        f"{thesis.ENSEMBLE_STEPS:,} steps.{control}{falls}"
    )


def _accuracy_sentence(results: EnqueryResults) -> str:
    at = [p for p in results.curves if p.model == "mlp" and p.test_set == TEST_SETS[0]]
    count = min({p.answers for p in at}, key=lambda answers: abs(answers - LOW_QUERIES))
    told = {p.source: p for p in at if p.answers == count}
    return (
        f"With {count} answers the neural reward model predicts {_share(told['EnQ'].accuracy)} of the ensemble test "
        f"pairs when it learned from ensemble pairs ({_share(told['EnQ'].low)} to {_share(told['EnQ'].high)}), "
        f"{_share(told['BL'].accuracy)} when it learned from segments ({_share(told['BL'].low)} to "
        f"{_share(told['BL'].high)})."
    )


def _crossing_sentence(results: EnqueryResults) -> str:
    def words(count: int | None) -> str:
        return "never" if count is None else f"from {count} answers on"

    told = "; ".join(f"{pairing}: {words(count)}" for pairing, count in results.crossings.items())
    return (
        f"From how many answers the baseline's mean stays above EnQuery's. {told}. The thesis: from "
        f"{thesis.QUERIES_WHERE_BASELINE_OVERTAKES}. Only the numbers of answers that were tried can be found."
    )


def _accuracy_table(results: EnqueryResults, test_set: str) -> Table:
    points = {(p.model, p.source, p.answers): p for p in results.curves if p.test_set == test_set}
    counts = sorted({answers for _, _, answers in points})
    columns = [(model, source) for model in MODELS for source in SOURCES]
    heads = ["answers", *(f"{source}, {MODELS[model]}" for model, source in columns)]
    rows = [
        [str(count), *(_with_interval(points.get((model, source, count))) for model, source in columns)]
        for count in counts
    ]
    caption = f"Share of {test_set} predicted, with half the width of the 95 % interval, in percent."
    return Table(caption, heads, rows)


def _with_interval(point: CurvePoint | None) -> str:
    if point is None:
        return "–"
    if math.isnan(point.low):
        return f"{100 * point.accuracy:.0f}"
    return f"{100 * point.accuracy:.0f} ± {50 * (point.high - point.low):.0f}"


def _alignment_table(recipe: str, rows: Sequence[TableRow]) -> Table:
    heads = [
        "",
        "min human distance (m)",
        "SD of alignments",
        "share of the way",
        "gain where both succeed (m)",
        "success",
        "collision",
        "timeout",
        "time (s)",
        "path (m)",
        "self-intersections",
        "gate passed",
    ]
    note = ""
    if rows[0].took_over is not None:
        took = ", ".join(f"{row.name} {row.took_over} of {row.alignments}" for row in rows if row.name != RAW)
        note = (
            f" Where the refinement was no improvement on other scenes the conditioned one is shown; it was in {took}."
        )
    body = [
        [
            row.name,
            f"{row.min_human_distance_m:.2f}",
            "–" if math.isnan(row.deviation_m) else f"{row.deviation_m:.2f}",
            "–" if row.name == RAW else _share(row.share_of_the_way),
            "–" if row.name == RAW or math.isnan(row.paired_gain_m) else f"{row.paired_gain_m:+.2f}",
            _percent(row.success_rate),
            _percent(row.collision_rate),
            _percent(row.timeout_rate),
            f"{row.time_s:.1f}",
            f"{row.path_length_m:.1f}",
            f"{row.self_intersections:.2f}",
            "–" if row.gates_passed is None else f"{row.gates_passed} of {row.alignments}",
        ]
        for row in rows
    ]
    return Table(f"By {RECIPES[recipe]}.{note}", heads, body)


def _test_table(recipe: str, rows: Sequence[TableRow]) -> Table:
    def words(test: TTest | None) -> list[str]:
        if test is None:
            return ["–"] * 5
        return [
            f"{test.difference:+.2f}",
            f"{test.statistic:.2f} ({test.df:g})",
            told_p(test.p),
            f"{told_p(test.p_corrected)} {test.stars}",
            f"{test.effect_size:.2f}",
        ]

    heads = [
        "against",
        *("difference (m)", "t (df)", "p", "p, Holm", "d"),
        "trajectories as units: t (df)",
        "p, Holm",
        "thesis",
    ]
    body = [
        [
            row.name,
            *words(row.per_alignment_test),
            words(row.per_episode_test)[1],
            words(row.per_episode_test)[3],
            row.published.stars,
        ]
        for row in rows
        if row.name != FIRST
    ]
    return Table(f"{FIRST} against the other rows, by {RECIPES[recipe]}.", heads, body)


def _difference_table(recipe: str, rows: Sequence[TableRow]) -> Table:
    heads = ["", "ours (m)", "thesis (m)", "difference (m)", "ours / RAW", "thesis / RAW", "success, ours", "thesis"]
    raw = _named(rows, RAW)
    body = [
        [
            row.name,
            f"{row.min_human_distance_m:.2f}",
            f"{row.published.min_human_distance_m:.1f}",
            f"{row.min_human_distance_m - row.published.min_human_distance_m:+.2f}",
            f"{row.min_human_distance_m / raw.min_human_distance_m:.2f}",
            f"{row.published.min_human_distance_m / raw.published.min_human_distance_m:.2f}",
            _percent(row.success_rate),
            _percent(row.published.success_rate),
        ]
        for row in rows
    ]
    return Table(f"By {RECIPES[recipe]}, beside {thesis.TABLE_6_2_SOURCE}.", heads, body)


def _named(rows: Sequence[TableRow], name: str) -> TableRow:
    return next(row for row in rows if row.name == name)


def _m(value: float) -> str:
    return f"{value:.2f} m"


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5_400 else f"{seconds / 3_600:.1f} h"

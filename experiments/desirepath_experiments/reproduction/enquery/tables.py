"""The tables of chapter 6's report: numbers as they are printed, beside what was published."""

from __future__ import annotations

import math
from collections.abc import Sequence

from desirepath.analysis.tested import p_in_words
from desirepath.explain.printed import Table
from desirepath_experiments.reproduction.enquery import published_numbers as thesis
from desirepath_experiments.reproduction.enquery.budgets import MODELS, RECIPES, SOURCES
from desirepath_experiments.reproduction.enquery.results import FIRST, RAW, CurvePoint, EnqueryResults, TableRow
from desirepath_experiments.reproduction.enquery.t_tests import TTest


def accuracy_table(results: EnqueryResults, test_set: str) -> Table:
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


def alignment_table(recipe: str, rows: Sequence[TableRow]) -> Table:
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
        note = f" Where the search was no improvement on other scenes the conditioned one is shown; it was in {took}."
    body = [
        [
            row.name,
            f"{row.min_human_distance_m:.2f}",
            "–" if math.isnan(row.deviation_m) else f"{row.deviation_m:.2f}",
            "–" if row.name == RAW else share(row.share_of_the_way),
            "–" if row.name == RAW or math.isnan(row.paired_gain_m) else f"{row.paired_gain_m:+.2f}",
            percent(row.success_rate),
            percent(row.collision_rate),
            percent(row.timeout_rate),
            f"{row.time_s:.1f}",
            f"{row.path_length_m:.1f}",
            f"{row.self_intersections:.2f}",
            "–" if row.gates_passed is None else f"{row.gates_passed} of {row.alignments}",
        ]
        for row in rows
    ]
    return Table(f"By {RECIPES[recipe]}.{note}", heads, body)


def t_test_table(recipe: str, rows: Sequence[TableRow]) -> Table:
    def words(test: TTest | None) -> list[str]:
        if test is None:
            return ["–"] * 5
        return [
            f"{test.difference:+.2f}",
            f"{test.statistic:.2f} ({test.df:g})",
            p_in_words(test.p),
            f"{p_in_words(test.p_corrected)} {test.stars}",
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


def difference_table(recipe: str, rows: Sequence[TableRow]) -> Table:
    heads = ["", "ours (m)", "thesis (m)", "difference (m)", "ours / RAW", "thesis / RAW", "success, ours", "thesis"]
    raw = named(rows, RAW)
    body = [
        [
            row.name,
            f"{row.min_human_distance_m:.2f}",
            f"{row.published.min_human_distance_m:.1f}",
            f"{row.min_human_distance_m - row.published.min_human_distance_m:+.2f}",
            f"{row.min_human_distance_m / raw.min_human_distance_m:.2f}",
            f"{row.published.min_human_distance_m / raw.published.min_human_distance_m:.2f}",
            percent(row.success_rate),
            percent(row.published.success_rate),
        ]
        for row in rows
    ]
    return Table(f"By {RECIPES[recipe]}, beside {thesis.TABLE_6_2_SOURCE}.", heads, body)


def named(rows: Sequence[TableRow], name: str) -> TableRow:
    return next(row for row in rows if row.name == name)


def share(value: float) -> str:
    return f"{100 * value:.0f} %"


def percent(value: float) -> str:
    return f"{100 * value:.1f} %"

"""Ways of telling a robot how to drive, in sentences and tables. Numbers are `method_findings.py`'s."""

from __future__ import annotations

import math

from desirepath.analysis.tested import Mean, Tested
from desirepath.explain.printed import Section, Table
from desirepath.report.findings import Findings
from desirepath.report.method_findings import Methods
from desirepath.report.report_cells import (
    NONE,
    effect_cell,
    name_in_words,
    p_cells,
    pair_words,
    shift_cell,
    statistic_cell,
)

TITLE = "Ways of telling the robot"


def methods_section(found: Findings) -> Section:
    """Empty where no methods' robots were compared."""
    ways = found.ways
    if ways is None:
        return Section(TITLE)
    alpha = found.plan.alpha
    sentences = [
        f"Each way of telling ({', '.join(map(name_in_words, ways.methods))}) resulted in a robot of each "
        f"person's own, and the robots were compared in pairs, blind, in the same new scenes: {ways.comparisons} "
        "comparisons. Of several scenes drawn for a person those were shown in which most of the robots arrive and can "
        "be told apart, so they differ more there than in scenes as they come. All robots "
        "are one policy conditioned on different weights, so they differ in what each way of telling taught and in "
        "nothing else. Whose robot wins says how well a way served; which one people would rather use is a ranking.",
        *(test.sentence(alpha) for test in ways.tests if test is ways.test or test.significant(alpha)),
        *_remarks(ways),
    ]
    tables = [_overview(ways), _pairs(ways), *([_tested(ways, alpha)] if ways.tests else []), _weights(ways)]
    return Section(TITLE, sentences, tables)


def methods_sentence(found: Findings) -> list[str]:
    """The result in one sentence, for the report's beginning."""
    ways = found.ways
    if ways is None:
        return []
    ordered = sorted(ways.methods, key=lambda name: -ways.won[name].mean)
    shares = ", ".join(f"{name_in_words(name)} {100 * ways.won[name].mean:.0f} %" for name in ordered)
    return [f"Share of blind comparisons that the robot of each way of telling won: {shares}."]


def _remarks(ways: Methods) -> list[str]:
    said = []
    if ways.look_alike:
        said.append(f"In {ways.look_alike} of the comparisons a person can hardly tell the two apart; they count.")
    if ways.unfinished:
        said.append(
            f"{ways.unfinished} of the people answered fewer comparisons than the others, because they broke off or "
            "have not come to the end yet; what they answered counts."
        )
    if any(ways.nothing.values()):
        who = ", ".join(f"{name_in_words(name)} {count}" for name, count in ways.nothing.items() if count)
        said.append(f"Taught nothing, so that the robot drove without preferences: {who} (people).")
    return said


def _overview(ways: Methods) -> Table:
    worths = {one.name: one for one in ways.worths}
    rows = []
    for name in ways.methods:
        won, worth, (minutes, median) = ways.won[name], worths[name], ways.minutes[name]
        rows.append(
            [
                name_in_words(name),
                f"{100 * won.mean:.0f} %",
                _interval(won, 100, 0),
                f"{worth.log_worth:.2f}",
                NONE if math.isnan(worth.low) else f"{worth.low:.2f} to {worth.high:.2f}",
                NONE if math.isnan(median) else f"{median:.1f}",
                _interval(minutes, 1, 1),
                str(won.n),
            ]
        )
    heads = ["way", "won", "95 %", "log worth", "95 %", "median minutes", "95 % of the mean", "people"]
    about = (
        "Share of comparisons won, over people; Bradley and Terry's log worths against the mean of all; time from the "
        "page before the first thing done to the answer to the last, pauses and all."
    )
    return Table(about, heads, rows)


def _pairs(ways: Methods) -> Table:
    rows = []
    for pair, share in ways.pairs.items():
        apart = ways.apart[pair]
        rows.append(
            [
                pair_words(pair),
                NONE if math.isnan(share.mean) else f"{100 * share.mean:.0f} %",
                _interval(share, 100, 0),
                NONE if not apart.n else f"{apart.mean:.2f}",
                _interval(apart, 1, 2),
                str(share.n),
            ]
        )
    heads = ["pair", "first chosen", "95 %", "distance of weights", "95 %", "people"]
    return Table("Pairs: how often the first one's robot was chosen; Euclidean distance of the weights.", heads, rows)


def _tested(ways: Methods, alpha: float) -> Table:
    def row(test: Tested) -> list[str]:
        return [test.about, statistic_cell(test), *p_cells(test, alpha), effect_cell(test), shift_cell(test)]

    heads = ["about", "statistic", "p", "p corrected", "method", "effect [95 %]", "shift [95 %]"]
    return Table("Tests of the shares won.", heads, [row(test) for test in ways.tests])


def _weights(ways: Methods) -> Table:
    names = sorted({name for of in ways.weights.values() for name in of})
    rows = [
        [name_in_words(name), *(f"{ways.weights[way].get(name, 0.0):.2f}" for way in ways.methods)] for name in names
    ]
    return Table("Mean weights, over people.", ["objective", *map(name_in_words, ways.methods)], rows)


def _interval(mean: Mean, factor: float, digits: int) -> str:
    if not (math.isfinite(mean.low) and math.isfinite(mean.high)):
        return NONE
    return f"{factor * mean.low:.{digits}f} to {factor * mean.high:.{digits}f}"

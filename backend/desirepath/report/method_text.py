"""Ways of telling a robot how to drive, in sentences and tables. Numbers are `method_findings.py`'s."""

from __future__ import annotations

from desirepath.explain.printed import Section, Table
from desirepath.report.findings import Findings
from desirepath.report.method_findings import Methods
from desirepath.report.report_cells import interval_cell, name_in_words, number_words, pair_words, test_row

TITLE = "Ways of telling the robot"


def methods_section(findings: Findings) -> Section:
    """Empty where no methods' robots were compared."""
    ways = findings.ways
    if ways is None:
        return Section(TITLE)
    alpha = findings.plan.alpha
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
    tables = [_overview(ways), _pairs(ways), *([_tests(ways, alpha)] if ways.tests else []), _weights(ways)]
    return Section(TITLE, sentences, tables)


def methods_sentence(findings: Findings) -> list[str]:
    """The result in one sentence, for the report's beginning."""
    ways = findings.ways
    if ways is None:
        return []
    ordered = sorted(ways.methods, key=lambda name: -ways.won[name].mean)
    shares = ", ".join(f"{name_in_words(name)} {100 * ways.won[name].mean:.0f} %" for name in ordered)
    return [f"Share of blind comparisons that the robot of each way of telling won: {shares}."]


def _remarks(ways: Methods) -> list[str]:
    remarks = []
    if ways.look_alike:
        remarks.append(f"In {ways.look_alike} of the comparisons a person can hardly tell the two apart; they count.")
    if ways.unfinished:
        remarks.append(
            f"{ways.unfinished} of the people answered fewer comparisons than the others, because they broke off or "
            "have not come to the end yet; what they answered counts."
        )
    if any(ways.nothing.values()):
        who = ", ".join(f"{name_in_words(name)} {count}" for name, count in ways.nothing.items() if count)
        remarks.append(f"Taught nothing, so that the robot drove without preferences: {who} (people).")
    return remarks


def _overview(ways: Methods) -> Table:
    worths = {worth.name: worth for worth in ways.worths}
    rows = []
    for name in ways.methods:
        won, worth, (minutes, median) = ways.won[name], worths[name], ways.minutes[name]
        rows.append(
            [
                name_in_words(name),
                f"{100 * won.mean:.0f} %",
                interval_cell(100 * won.low, 100 * won.high, "{:.0f}"),
                f"{worth.log_worth:.2f}",
                interval_cell(worth.low, worth.high),
                number_words(median, "{:.1f}"),
                interval_cell(minutes.low, minutes.high, "{:.1f}"),
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
                number_words(100 * share.mean, "{:.0f} %"),
                interval_cell(100 * share.low, 100 * share.high, "{:.0f}"),
                number_words(apart.mean),
                interval_cell(apart.low, apart.high),
                str(share.n),
            ]
        )
    heads = ["pair", "first chosen", "95 %", "distance of weights", "95 %", "people"]
    return Table("Pairs: how often the first one's robot was chosen; Euclidean distance of the weights.", heads, rows)


def _tests(ways: Methods, alpha: float) -> Table:
    heads = ["about", "statistic", "p", "p corrected", "method", "effect [95 %]", "shift [95 %]"]
    rows = [test_row(test, alpha, "about statistic p corrected method effect shift") for test in ways.tests]
    return Table("Tests of the shares won.", heads, rows)


def _weights(ways: Methods) -> Table:
    names = sorted({name for of in ways.weights.values() for name in of})
    rows = [
        [name_in_words(name), *(f"{ways.weights[way].get(name, 0.0):.2f}" for way in ways.methods)] for name in names
    ]
    return Table("Mean weights, over people.", ["objective", *map(name_in_words, ways.methods)], rows)

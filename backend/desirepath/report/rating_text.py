"""What was rated and ranked, in sentences and tables: items, scores of scales, rankings.

Numbers are `rating_findings.py`'s; the report's other parts `report_text.py`'s.
"""

from __future__ import annotations

from collections.abc import Sequence

from desirepath.explain.printed import Section, Table
from desirepath.report.findings import Findings
from desirepath.report.item_tests import ItemResult
from desirepath.report.report_cells import (
    NONE,
    interval_cell,
    name_in_words,
    number_words,
    plural,
    significant_points,
    test_row,
)
from desirepath.report.study_data import ItemText
from desirepath.report.study_design import StudyDesign

TESTS = {
    "Friedman": "Friedman's test over all conditions",
    "Wilcoxon signed-rank": "Wilcoxon's signed-rank test of the two conditions, without people who rated both alike",
    "Mann-Whitney": "Mann and Whitney's test of the two groups",
    "Kruskal-Wallis": "Kruskal and Wallis's test over all groups",
}
FACTORIAL = (
    "each main effect and interaction by itself: Wilcoxon's signed ranks of every person's contrast where it has one "
    "degree of freedom within people, Mann and Whitney's test where two groups are compared, else an analysis of "
    "variance of aligned ranks (approximate; Greenhouse and Geisser's correction)"
)


def items_section(findings: Findings) -> Section:
    """Ratings of every item and scale under every condition, tested as the design asks."""
    sentences, tables = [], []
    for design in findings.designs:
        if results := [result for result in findings.items if result.design is design]:
            sentences.append(_how(results, design, findings))
            tables += _tables(results, findings.plan.alpha)
    points = [
        point
        for result in findings.items
        for point in significant_points(result.tests, result.pairs, findings.plan.alpha)
    ]
    return Section("Ratings after each block", sentences, tables, points)


def _how(results: Sequence[ItemResult], design: StudyDesign, findings: Findings) -> str:
    tests = FACTORIAL if design.factorial else TESTS[results[0].test.test]
    number = sum(len(result.tests) for result in results)
    family = f"p corrected over {'these' if number > 1 else 'this'} {number} {plural(number, 'test')}"
    text = (
        f"{design.words[:1].upper()}{design.words[1:]}: {tests}; over the people who answered an item under every "
        f"condition that they met, {family} ({results[0].test.correction}). p is exact, or by permutations, for up to "
        "50 people, ties or not, as the table says."
    )
    pair = next((pair for result in results for pair in result.pairs), None)
    if pair is None:
        return text
    which = (
        "For every item, whatever the test over all conditions says:"
        if findings.plan.pairs == "always"
        else f"Where the corrected p is at most {findings.plan.alpha:g}:"
    )
    over = "all items together" if findings.plan.pairs_over == "items" else "an item's pairs, not over the items"
    return (
        f"{text} {which} {pair.test} tests of its pairs, corrected over {over} ({pair.correction}); "
        "people without a difference are left out (used: how many remain), z is the normal approximation."
    )


def _tables(results: Sequence[ItemResult], alpha: float) -> list[Table]:
    shifts = any(test.shift is not None for result in results for test in result.tests)
    means = [[_text(of), *(f"{m.mean:.2f} ± {m.se:.2f}" for m in of.means.values())] for of in results]
    columns = f"statistic p corrected method named_effect {'shift' if shifts else ''} n"
    tests = [
        [test.about if result.design.factorial else _text(result), *test_row(test, alpha, columns)]
        for result in results
        for test in result.tests
    ]
    p = ["p", "p, corrected", "p is"]
    tables = [
        Table("Mean ± standard error.", ["item", *map(name_in_words, results[0].means)], means),
        Table(
            "Tests over all conditions.",
            ["item", "test", *p, "effect, 95 %", *(["shift, 95 %"] if shifts else []), "n"],
            tests,
        ),
        Table(
            "Pairs of conditions; r above 0: the first is rated higher.",
            ["pair", "statistic", "z", *p, "rank-biserial r, 95 %", "shift, 95 %", "n", "used"],
            [
                test_row(test, alpha, "about statistic z p corrected method effect shift n used")
                for result in results
                for test in result.pairs
            ],
        ),
    ]
    return [table for table in tables if table.rows]


def item_in_words(item: ItemText, asking: str) -> str:
    """An item's words, with which asking it was where there were several."""
    return f"{item.text} ({name_in_words(asking)})" if asking else item.text


def _text(result: ItemResult) -> str:
    return f"{result.item.text}{' (as answered: low is good)' if result.item.reversed else ''}"


def rankings_section(findings: Findings) -> Section:
    """Forced rankings: first places."""
    title, rankings, alpha = "Ranking of the conditions", findings.rankings, findings.plan.alpha
    if not rankings:
        return Section(title)
    options = list(dict.fromkeys(name for ranking in rankings for name in ranking.places))
    rows = [
        [
            item_in_words(ranking.item, ranking.about),
            *("/".join(map(str, ranking.places.get(name, ()))) or NONE for name in options),
            *test_row(ranking.test, alpha, "statistic p corrected method effect n"),
        ]
        for ranking in rankings
    ]
    heads = ["question", *map(name_in_words, options), "χ²", "p", "p, corrected", "p is", "V, 95 %", "n"]
    over = "the rankings" if findings.plan.pairs_over == "items" else "one ranking's pairs"
    sentence = (
        "Chi-square test of first choices against equal shares (exact for up to 50 people), p corrected over "
        f"{len(rankings)} {plural(len(rankings), 'ranking')} ({rankings[0].test.correction}); where significant, the "
        f"pairs, corrected over {over}. The choices of one question exclude each other, so z = (a - b) / √(a + b), "
        "with the exact binomial p."
    )
    points = [point for ranking in rankings for point in significant_points([ranking.test], ranking.pairs, alpha)]
    return Section(title, [sentence], [Table("How many put each first/second/third.", heads, rows)], points)


def scales_section(findings: Findings) -> Section:
    """Scores over people, per condition where a scale was asked after blocks."""
    sentences: list[str] = []
    rows = []
    for result in findings.scales:
        scale = result.scale
        source = f"Source: {scale.source}."
        told = f"{scale.names[-1]}, {scale.lowest:g} to {scale.highest:g}; {scale.scoring}."
        sentences.append(told if any(source in before for before in sentences) else f"{told} {source}")
        for name, of in result.means.items():
            numbers = [number_words(value, "{:.1f}") for value in (of.mean, of.sd)]
            interval = interval_cell(of.low, of.high, "{:.1f}")
            rows.append([scale.names[0], name_in_words(name) or "asked once", *numbers, interval, str(of.n)])
        if result.incomplete:
            sentences.append(f"{result.incomplete} answers to {scale.names[0]} were not complete and have no score.")
    heads = ["scale", "about", "mean", "SD", "95 % interval", "people"]
    caption = "Scores by the scales' own scoring, over people; each person's in scales.csv."
    return Section("Validated scales", sentences, [Table(caption, heads, rows)] if rows else [])

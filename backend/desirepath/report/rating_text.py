"""What was rated and ranked, in sentences and tables: items, scores of scales, rankings.

Numbers are `rating_findings.py`'s; the report's other parts `report_text.py`'s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from desirepath.explain.printed import Section, Table
from desirepath.report.findings import Findings
from desirepath.report.item_tests import ItemResult
from desirepath.report.report_cells import (
    NONE,
    effect_cell,
    name_in_words,
    number_words,
    p_cells,
    shift_cell,
    significant_points,
    statistic_cell,
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


def items_section(found: Findings) -> Section:
    """Ratings of every item and scale under every condition, tested as the design asks."""
    title = "Ratings after each block"
    if not found.items:
        return Section(title)
    sentences, tables = [], []
    for design in found.designs:
        of = [one for one in found.items if one.design is design]
        if of:
            sentences.append(_how(of, design, found))
            tables += _tables(of, found)
    points = [
        test.sentence(found.plan.alpha)
        for one in found.items
        for test in significant_points(one.tests, one.pairs, found)
    ]
    return Section(title, sentences, tables, points)


def _how(of: Sequence[ItemResult], design: StudyDesign, found: Findings) -> str:
    tests = FACTORIAL if design.factorial else TESTS[of[0].test.test]
    number = sum(len(one.tests) for one in of)
    family = f"p corrected over {'these' if number > 1 else 'this'} {number} test{'s' if number > 1 else ''}"
    text = (
        f"{design.words[:1].upper()}{design.words[1:]}: {tests}; over the people who answered an item under every "
        f"condition that they met, {family} ({of[0].test.correction}). p is exact, or by permutations, for up to 50 "
        "people, ties or not, as the table says."
    )
    if any(one.pairs for one in of):
        pairs = next(pair for one in of for pair in one.pairs)
        over = "all items together" if found.plan.pairs_over == "items" else "an item's pairs, not over the items"
        text += (
            f" {_which_pairs(found)} {pairs.test} tests of its pairs, corrected over {over} ({pairs.correction}); "
            "people without a difference are left out (used: how many remain), z is the normal approximation."
        )
    return text


def _which_pairs(found: Findings) -> str:
    if found.plan.pairs == "always":
        return "For every item, whatever the test over all conditions says:"
    return f"Where the corrected p is at most {found.plan.alpha:g}:"


def _tables(of: Sequence[ItemResult], found: Findings) -> list[Table]:
    alpha = found.plan.alpha
    means = [[_text(one), *(f"{m.mean:.2f} ± {m.se:.2f}" for m in one.means.values())] for one in of]
    shifts = any(test.shift is not None for one in of for test in one.tests)
    tests = [
        [
            test.about if one.design.factorial else _text(one),
            statistic_cell(test),
            *p_cells(test, alpha),
            f"{test.effect_name} {effect_cell(test)}",
            *([shift_cell(test)] if shifts else []),
            str(test.n),
        ]
        for one in of
        for test in one.tests
    ]
    heads = ["item", "test", "p", "p, corrected", "p is", "effect, 95 %", *(["shift, 95 %"] if shifts else []), "n"]
    tables = [
        Table("Mean ± standard error.", ["item", *map(name_in_words, of[0].means)], means),
        Table("Tests over all conditions.", heads, tests),
    ]
    pairs = [
        [
            test.about,
            statistic_cell(test),
            NONE if test.z is None else f"{test.z:.2f}",
            *p_cells(test, alpha),
            effect_cell(test),
            shift_cell(test),
            str(test.n),
            str(test.used),
        ]
        for one in of
        for test in one.pairs
    ]
    if pairs:
        heads = ["pair", "statistic", "z", "p", "p, corrected", "p is", "rank-biserial r, 95 %", "shift, 95 %", "n"]
        caption = "Pairs of conditions; r above 0: the first is rated higher."
        tables.append(Table(caption, [*heads, "used"], pairs))
    return tables


def asked_words(item: ItemText, asking: str) -> str:
    """An item's words, with which asking it was where there were several."""
    return f"{item.text} ({name_in_words(asking)})" if asking else item.text


def _text(one: ItemResult) -> str:
    return f"{one.item.text}{' (as answered: low is good)' if one.item.reversed else ''}"


def rankings_section(found: Findings) -> Section:
    """Forced rankings: first places."""
    title = "Ranking of the conditions"
    if not found.rankings:
        return Section(title)
    options = list(dict.fromkeys(name for one in found.rankings for name in one.places))
    rows = [
        [
            asked_words(one.item, one.about),
            *("/".join(map(str, one.places.get(name, ()))) or NONE for name in options),
            statistic_cell(one.test),
            *p_cells(one.test, found.plan.alpha),
            effect_cell(one.test),
            str(one.test.n),
        ]
        for one in found.rankings
    ]
    heads = ["question", *map(name_in_words, options), "χ²", "p", "p, corrected", "p is", "V, 95 %", "n"]
    over = "the rankings" if found.plan.pairs_over == "items" else "one ranking's pairs"
    sentences = [
        f"Chi-square test of first choices against equal shares (exact for up to 50 people), p corrected over "
        f"{len(found.rankings)} ranking{'s' if len(found.rankings) > 1 else ''} "
        f"({found.rankings[0].test.correction}); where significant, the pairs, "
        f"corrected over {over}. The choices of one question exclude each other, so z = (a - b) / √(a + b), with "
        "the exact binomial p.",
    ]
    points = [
        test.sentence(found.plan.alpha)
        for one in found.rankings
        for test in significant_points([one.test], one.pairs, found)
    ]
    return Section(title, sentences, [Table("How many put each first/second/third.", heads, rows)], points)


def scales_section(found: Findings) -> Section:
    """Scores over people, per condition where a scale was asked after blocks."""
    sentences, rows = [], []
    for one in found.scales:
        scale = one.scale
        sentences.append(
            f"{scale.names[-1]}, {scale.lowest:g} to {scale.highest:g}; {scale.scoring}. Source: {scale.source}."
        )
        for name, of in one.means.items():
            interval = NONE if math.isnan(of.low) else f"{of.low:.1f} to {of.high:.1f}"
            numbers = [number_words(value, "{:.1f}") for value in (of.mean, of.sd)]
            rows.append([scale.names[0], name.replace("_", " ") or "asked once", *numbers, interval, str(of.n)])
        if one.incomplete:
            sentences.append(f"{one.incomplete} answers to {scale.names[0]} were not complete and have no score.")
    heads = ["scale", "about", "mean", "SD", "95 % interval", "people"]
    caption = "Scores by the scales' own scoring, over people; each person's in scales.csv."
    return Section("Validated scales", sentences, [Table(caption, heads, rows)] if rows else [])

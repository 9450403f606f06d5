"""What stands beside the declared tests, in sentences and tables. Numbers are `further_findings.py`'s."""

from __future__ import annotations

import math

from desirepath.analysis.tested import NO_SPREAD, p_in_words
from desirepath.explain.printed import Section, Table
from desirepath.report.findings import Findings
from desirepath.report.report_cells import NONE, effect_cell, name_in_words, number_words, p_cells, statistic_cell


def further_sections(found: Findings) -> list[Section]:
    """A section each; those without anything are left out by the report."""
    if found.further is None:
        return []
    return [_order(found), _retest(found), _no_difference(found), _reliability(found), _worths(found), _models(found)]


def _order(found: Findings) -> Section:
    of = found.further.order_effects if found.further else ()
    rows = [
        [
            test.about,
            test.test,
            statistic_cell(test),
            *p_cells(test, found.plan.alpha)[::2],
            effect_cell(test),
            str(test.n),
        ]
        for test in of
    ]
    sentence = (
        "Period: whether ratings change from the first condition met to the last, whichever they were. Carry-over, of "
        "two conditions: whether the sum of both ratings depends on which came first (Grizzle 1965), which few people "
        "seldom show. Checks, uncorrected; the conditions' orders are balanced against both."
    )
    heads = ["of", "test", "statistic", "p", "p is", "effect, 95 %", "n"]
    return Section("Order effects", [sentence] if rows else [], [Table("Uncorrected.", heads, rows)] if rows else [])


def _retest(found: Findings) -> Section:
    test = found.further.against_retest if found.further else None
    if test is None:
        return Section("Agreement between conditions against consistency")
    sentence = (
        "Each person's mean agreement between conditions against their mean agreement with their own first answer "
        "within one, which it can hardly exceed."
    )
    return Section("Agreement between conditions against consistency", [sentence, test.sentence(found.plan.alpha)])


def _no_difference(found: Findings) -> Section:
    title, of = "Evidence for no difference", found.further
    if of is None or not (of.equivalent or of.weighed):
        return Section(title)
    tables, sentences = [], []
    if of.equivalent:
        sentences.append(
            "Two one-sided t-tests that a difference lies within the margin that the plan declared; the interval is of "
            f"90 %, p corrected over all of them ({of.equivalent[0].correction})."
        )
        rows = [
            [
                t.about,
                effect_cell(t),
                *p_cells(t, found.plan.alpha)[:2],
                str(t.n),
            ]
            for t in of.equivalent
        ]
        tables.append(Table("Equivalence.", ["of", "difference, 90 %", "p", "p, corrected", "n"], rows))
    if of.weighed:
        sentences.append(
            "Bayes factors: how much likelier the data are with a difference than without one; below 1 they speak for "
            "none. Ratings: Jeffreys, Zellner and Siow's (scale 0.71) of the differences; choices: binomial, uniform."
        )
        rows = [[one.about, NO_SPREAD if math.isnan(one.factor) else f"{one.factor:.3g}"] for one in of.weighed]
        tables.append(Table("Bayes factors.", ["of", "BF10"], rows))
    return Section(title, sentences, tables)


def _reliability(found: Findings) -> Section:
    title, of = "Reliability of scales", found.further.reliabilities if found.further else ()
    rows = [
        [
            one.scale,
            name_in_words(one.condition) or "asked once",
            number_words(one.of.alpha, "{:.2f}"),
            NONE if math.isnan(one.of.low) else f"{one.of.low:.2f} to {one.of.high:.2f}",
            number_words(one.of.omega, "{:.2f}"),
            str(one.of.items),
            str(one.of.n),
        ]
        for one in of
    ]
    heads = ["scale", "about", "Cronbach's alpha", "95 % interval (Feldt)", "omega, one factor", "items", "people"]
    return Section(title, [], [Table("How well a scale's items measure one thing.", heads, rows)] if rows else [])


def _worths(found: Findings) -> Section:
    title, of = "Worths of the policies compared", found.further.worths if found.further else ()
    rows = [
        [
            one.name,
            f"{one.log_worth:.2f}",
            NONE if math.isnan(one.low) else f"{one.low:.2f} to {one.high:.2f}",
            f"{one.share:.0%}",
        ]
        for one in of
    ]
    sentence = (
        "Bradley and Terry's model of all blind comparisons; intervals over people. Log worths are against the "
        "mean of all: a difference of 1 is a choice of 73 to 27."
    )
    heads = ["policy", "log worth", "95 % interval", "share of all worths"]
    return Section(title, [sentence] if rows else [], [Table("Worths.", heads, rows)] if rows else [])


def _models(found: Findings) -> Section:
    title, of = "Mixed models", found.further.models if found.further else ()
    rows = []
    for one in of:
        test = NONE if one.test is None else f"χ²({one.test.df}) = {one.test.statistic:.2f}, {p_in_words(one.test.p)}"
        if one.problem is not None:
            rows.append([one.about, one.problem, NONE, test, NONE])
        for name, at, low, high in one.effects:
            sd = NONE if one.person_sd is None else f"{one.person_sd:.2f}"
            rows.append([one.about, name, f"{at:.2f} [{low:.2f}, {high:.2f}]", test, sd])
    sentence = (
        "Cumulative-link (ratings) and logistic (choices) models with an intercept of each person's own, by maximum "
        "likelihood (adaptive quadrature, 15 nodes): odds ratios of a higher answer, or the median person's chance, "
        "with Wald's 95 % intervals, and the likelihood-ratio test of all conditions. Beside the declared tests, "
        "uncorrected; of few people these intervals are too narrow."
    )
    heads = ["of", "effect", "odds ratio or chance, 95 %", "all conditions", "SD of people"]
    return Section(title, [sentence] if rows else [], [Table("Models.", heads, rows)] if rows else [])

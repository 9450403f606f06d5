"""What stands beside the declared tests, in sentences and tables. Numbers are `further_findings.py`'s."""

from __future__ import annotations

import math
from collections.abc import Sequence

from desirepath.analysis.bradley_terry import Worth
from desirepath.analysis.tested import NO_SPREAD, Tested, p_in_words
from desirepath.explain.printed import Section, Table
from desirepath.report.findings import Findings
from desirepath.report.further_findings import Further, Modelled, ScaleReliability
from desirepath.report.report_cells import NONE, interval_cell, name_in_words, number_words, table_section, test_row


def further_sections(findings: Findings) -> list[Section]:
    """A section each; those without anything are left out by the report."""
    beside, alpha = findings.further, findings.plan.alpha
    if beside is None:
        return []
    return [
        _order(beside.order_effects, alpha),
        _retest(beside.against_retest, alpha),
        _no_difference(beside, alpha),
        _reliability(beside.reliabilities),
        _worths(beside.worths),
        _models(beside.models),
    ]


def _order(tests: Sequence[Tested], alpha: float) -> Section:
    return table_section(
        "Order effects",
        "Uncorrected.",
        ["of", "test", "statistic", "p", "p is", "effect, 95 %", "n"],
        [test_row(test, alpha, "about test statistic p method effect n") for test in tests],
        "Period: whether ratings change from the first condition met to the last, whichever they were. Carry-over, of "
        "two conditions: whether the sum of both ratings depends on which came first (Grizzle 1965), which few people "
        "seldom show. Checks, uncorrected; the conditions' orders are balanced against both.",
    )


def _retest(test: Tested | None, alpha: float) -> Section:
    sentence = (
        "Each person's mean agreement between conditions against their mean agreement with their own first answer "
        "within one, which it can hardly exceed."
    )
    sentences = [] if test is None else [sentence, test.sentence(alpha)]
    return Section("Agreement between conditions against consistency", sentences)


def _no_difference(beside: Further, alpha: float) -> Section:
    tables, sentences = [], []
    if beside.equivalent:
        sentences.append(
            "Two one-sided t-tests that a difference lies within the margin that the plan declared; the interval is of "
            f"90 %, p corrected over all of them ({beside.equivalent[0].correction})."
        )
        rows = [test_row(test, alpha, "about effect p corrected n") for test in beside.equivalent]
        tables.append(Table("Equivalence.", ["of", "difference, 90 %", "p", "p, corrected", "n"], rows))
    if beside.weighed:
        sentences.append(
            "Bayes factors: how much likelier the data are with a difference than without one; below 1 they speak for "
            "none. Ratings: Jeffreys, Zellner and Siow's (scale 0.71) of the differences; choices: binomial, uniform."
        )
        rows = [[of.about, NO_SPREAD if math.isnan(of.factor) else f"{of.factor:.3g}"] for of in beside.weighed]
        tables.append(Table("Bayes factors.", ["of", "BF10"], rows))
    return Section("Evidence for no difference", sentences, tables)


def _reliability(scales: Sequence[ScaleReliability]) -> Section:
    return table_section(
        "Reliability of scales",
        "How well a scale's items measure one thing.",
        ["scale", "about", "Cronbach's alpha", "95 % interval (Feldt)", "omega, one factor", "items", "people"],
        [
            [
                scale.scale,
                name_in_words(scale.condition) or "asked once",
                number_words(scale.of.alpha),
                interval_cell(scale.of.low, scale.of.high),
                number_words(scale.of.omega),
                str(scale.of.items),
                str(scale.of.n),
            ]
            for scale in scales
        ],
    )


def _worths(worths: Sequence[Worth]) -> Section:
    return table_section(
        "Worths of the policies compared",
        "Worths.",
        ["policy", "log worth", "95 % interval", "share of all worths"],
        [[of.name, f"{of.log_worth:.2f}", interval_cell(of.low, of.high), f"{of.share:.0%}"] for of in worths],
        "Bradley and Terry's model of all blind comparisons; intervals over people. Log worths are against the "
        "mean of all: a difference of 1 is a choice of 73 to 27.",
    )


def _models(models: Sequence[Modelled]) -> Section:
    rows = []
    for model in models:
        ratio = model.test
        test = NONE if ratio is None else f"χ²({ratio.df}) = {ratio.statistic:.2f}, {p_in_words(ratio.p)}"
        if model.problem is not None:
            rows.append([model.about, model.problem, NONE, test, NONE])
        for name, at, low, high in model.effects:
            sd = NONE if model.person_sd is None else f"{model.person_sd:.2f}"
            rows.append([model.about, name, f"{at:.2f} [{low:.2f}, {high:.2f}]", test, sd])
    return table_section(
        "Mixed models",
        "Models.",
        ["of", "effect", "odds ratio or chance, 95 %", "all conditions", "SD of people"],
        rows,
        "Cumulative-link (ratings) and logistic (choices) models with an intercept of each person's own, by maximum "
        "likelihood (adaptive quadrature, 15 nodes): odds ratios of a higher answer, or the median person's chance, "
        "with Wald's 95 % intervals, and the likelihood-ratio test of all conditions. Beside the declared tests, "
        "uncorrected; of few people these intervals are too narrow.",
    )

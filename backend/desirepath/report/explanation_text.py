"""Importance rankings (chapter 8) in sentences and tables. Numbers are `explanation_findings.py`'s."""

from __future__ import annotations

from collections.abc import Sequence

from desirepath.analysis.tested import p_in_words
from desirepath.explain.printed import Section, Table
from desirepath.report.explanation_findings import Explained, Outcome
from desirepath.report.findings import Findings
from desirepath.report.report_cells import number_words, p_cell, statistic_cell, test_row

RANKINGS_TITLE = "Importance rankings"
RATED_TITLE = "What was said of the explanations"


def explanation_sections(findings: Findings) -> list[Section]:
    """What was ranked, what was rated; without rankings nothing."""
    of = findings.explained
    return [] if of is None else [_rankings(of, findings), _ratings(of, findings)]


def explanation_brief(findings: Findings) -> list[str]:
    """The result in a sentence per effect on the agreement."""
    if findings.explained is None:
        return []
    agreement = findings.explained.agreement
    means = ", ".join(f"{name} {number_words(mean.mean)}" for name, mean in agreement.means.items())
    sentences = [f"Agreement of rankings with what moved the robot, Kendall's tau-b: {means}."]
    return sentences + [test.sentence(findings.plan.alpha) for test in agreement.tests]


def _rankings(of: Explained, findings: Findings) -> Section:
    n = len(of.trials)
    tied = sum(trial.tied > 0 for trial in of.trials)
    unseen = sum(trial.unseen > 1 for trial in of.trials)
    sentences = [
        f"{n:,} rankings. Kendall's tau-b of each with the objects' scores where the robot stood, its mean per person "
        "and condition. Ties are corrected for, and come from the scores alone: rankings have none. Scores were tied "
        f"in {tied:,} trials ({100 * tied / n:.1f} %), in {unseen:,} because several objects were not seen; "
        f"{of.undefined:,} trials said no order at all and are left out. With ties no ranking reaches 1.",
        *_how([of.agreement], findings),
    ]
    return Section(RANKINGS_TITLE, sentences, _tables([of.agreement], findings))


def _ratings(of: Explained, findings: Findings) -> Section:
    if not of.rated:
        return Section(RATED_TITLE)
    sentences = [
        "Scores after each block. Awareness is the mean of its items, the reversed ones inverted; of single items, "
        "too, more is more.",
        *_how(of.rated, findings),
    ]
    return Section(RATED_TITLE, sentences, _tables(of.rated, findings))


def _how(outcomes: Sequence[Outcome], findings: Findings) -> list[str]:
    tests = [test for outcome in outcomes for test in outcome.tests]
    if not tests:
        return ["Nothing is tested: fewer than three people met every condition, or there is but one."]
    checks = [check for outcome in outcomes for check in outcome.checks]
    fail = [t.about for t, c in zip(tests, checks, strict=True) if not c.normal(findings.plan.alpha)]
    sphericity = (
        "Every effect has one degree of freedom, so sphericity cannot be violated."
        if all(test.df == 1 for test in tests)
        else "p by Greenhouse and Geisser's correction."
    )
    normal = (
        f"People's contrasts are not normal (Shapiro and Wilk's test) in {', '.join(fail)}: read the aligned ranks "
        "there."
        if fail
        else "Nothing speaks against normal contrasts (Shapiro and Wilk's test)."
    )
    return [
        "Analysis of variance of repeated measures, as in chapter 8, over the people who met every condition; "
        f"partial η² with Smithson's interval; p corrected over these {len(tests)} tests ({tests[0].correction}). "
        f"{sphericity} {normal} Beside it the aligned rank transform, uncorrected."
    ]


def _tables(outcomes: Sequence[Outcome], findings: Findings) -> list[Table]:
    means = [
        [of.text, *(f"{number_words(m.mean)} ({number_words(m.sd)})" for m in of.means.values()),
         str(max((m.n for m in of.means.values()), default=0))]
        for of in outcomes
    ]  # fmt: skip
    rows = [
        [
            *test_row(test, findings.plan.alpha, "about statistic p corrected effect"),
            p_cell(check.shapiro_p),
            statistic_cell(check.ranks) + ("" if check.ranks.no_spread else f", {p_in_words(check.ranks.p)}"),
            str(test.n),
        ]
        for of in outcomes
        for test, check in zip(of.tests, of.checks, strict=True)
    ]
    heads = ["effect", "F", "p", "p, corrected", "partial η², 95 %", "normal: p", "aligned ranks", "n"]
    tables = [
        Table("Mean (SD) over people of what was shown.", ["", *outcomes[0].means, "n"], means),
        Table("Effects.", heads, rows),
    ]
    return [table for table in tables if table.rows]

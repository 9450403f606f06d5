"""A study's findings in sentences and tables, as a paper would state them. Numbers come from `findings.py`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from desirepath.explain.printed import Section, Table, embed_picture
from desirepath.report.choice_text import (
    agreement_section,
    disagreement_section,
    personalised_section,
    personalised_sentence,
)
from desirepath.report.explanation_text import RANKINGS_TITLE, RATED_TITLE, explanation_brief, explanation_sections
from desirepath.report.findings import Findings
from desirepath.report.further_text import further_sections
from desirepath.report.marked_moments import marks_section
from desirepath.report.meeting import meeting_section
from desirepath.report.method_text import methods_section, methods_sentence
from desirepath.report.rating_text import item_in_words, items_section, rankings_section, scales_section
from desirepath.report.report_cells import (
    NONE,
    name_in_words,
    number_words,
    pair_words,
    percent,
    share_words,
    table_section,
    test_row,
)
from desirepath.report.told_rules import rules_section

if TYPE_CHECKING:
    from desirepath.explain.pictures import Picture

EVALUATED = {"dwa", "own", "social_cost"}  # of a study's evaluation stage
EVALUATED_SENTENCE = (
    "Each person met the three controllers in one of the orders below, and in the reverse order in the second "
    "environment; in the study of chapter 2 everybody met them in the same order."
)
PART_OF = {
    "items": "Ratings after each block",
    "rankings": "Ranking of the conditions",
    "agreement": "Agreement",
    "disagreement": "What changes where choices differ",
    "personalised": "Does it personalise?",
    "ranking_agreement": RANKINGS_TITLE,
    "explanation_ratings": RATED_TITLE,
}
"""The part that each figure stands in."""


def sections(findings: Findings, drawn: Sequence[Picture], folder: Path) -> list[Section]:
    """The report's parts in order; a part without data is left out."""
    parts = [
        _people(findings),
        *explanation_sections(findings),
        items_section(findings),
        rankings_section(findings),
        scales_section(findings),
        agreement_section(findings),
        disagreement_section(findings),
        personalised_section(findings),
        methods_section(findings),
        meeting_section(findings.met),
        marks_section(findings.marked),
        rules_section(findings.ruled),
        *further_sections(findings),
        _devices(findings),
    ]
    shown = {PART_OF[picture.name]: embed_picture(picture, folder) for picture in drawn}
    return [
        replace(part, pictures=[shown[part.title]]) if part.title in shown else part
        for part in parts
        if part.sentences or part.tables
    ]


def brief(findings: Findings) -> list[str]:
    """The result in a few sentences."""
    sentences = [_who(findings), *explanation_brief(findings), *methods_sentence(findings)]
    if findings.items:
        differ = [
            name_in_words(result.item.key) for result in findings.items if result.significant(findings.plan.alpha)
        ]
        tests = " and ".join(dict.fromkeys(test.test for result in findings.items for test in result.tests))
        sentences.append(
            f"Ratings differ between the conditions in {len(differ)} of {len(findings.items)} items"
            f"{': ' + ', '.join(differ) if differ else ''} ({tests}, {findings.items[0].test.correction})."
        )
        if not any(test.possible(findings.plan.alpha) for result in findings.items for test in result.tests):
            sentences.append(
                f"With {findings.flow.analysed} people no rating can be significant, whatever they answer: the "
                "smallest possible corrected p is above alpha."
            )
    sentences += [ranking.test.sentence(findings.plan.alpha) for ranking in findings.rankings]
    if not findings.tests:
        sentences.append(_why_no_test(findings))
    if findings.between:
        sentences.append(f"Agreement between conditions: {_agreements(findings)}.")
    sentences += [personalised_sentence(findings, k) for k in range(len(findings.personalised))]
    return sentences


def _why_no_test(findings: Findings) -> str:
    """A report without a test says why."""
    if not findings.designs and not findings.personalised:
        return "Nothing is tested: the study compares no conditions, rankings or policies. Answers are described."
    if findings.flow.analysed < 2:
        return "Nothing is tested: one person is too few."
    return (
        "Nothing is tested: conditions differ in what was shown only, no rating, ranking or comparison of policies was "
        "answered under all of them by at least two people (of each group). Agreement is described."
    )


def _who(findings: Findings) -> str:
    n = findings.flow.analysed
    kind = "simulated participants" if findings.simulated == n else "people"
    mixed = f", {findings.simulated} of them simulated" if 0 < findings.simulated < n else ""
    answers = sum(of.answers for of in findings.of_condition.values())
    answered = f", {answers:,} answers to queries" if findings.of_condition else ""  # an evaluation asks none
    return f"{n} {kind}{mixed}{answered}."


def _agreements(findings: Findings) -> str:
    return ", ".join(
        f"{pair_words(pair)} {percent(of.share.mean)} (SD {percent(of.share.sd)})"
        for pair, of in findings.between.items()
    )


def _people(findings: Findings) -> Section:
    flow = findings.flow
    rows = [["joined", str(flow.joined)], ["withdrew", str(flow.withdrawn)]]
    rows += [[f"excluded: {reason}", str(count)] for reason, count in flow.excluded.items()]
    rows += [[f"session {state}, not analysed", str(count)] for state, count in flow.unfinished.items()]
    rows.append(["analysed", str(flow.analysed)])
    tables = [Table("From joining to the analysis.", ["", "people"], rows)]
    if len(findings.conditions) > 1:
        orders = [[name_in_words(order), str(count)] for order, count in findings.orders.items()]
        tables.append(Table("Orders of the conditions among those analysed.", ["order", "people"], orders))
    if findings.demographics:
        rows = [
            [
                item_in_words(described.item, described.asking),
                str(described.n),
                f"{described.numbers.mean:.1f} ({number_words(described.numbers.sd, '{:.1f}')})"
                if described.numbers
                else ", ".join(f"{label} {count}" for label, count in described.counts.items() if count),
            ]
            for described in findings.demographics
        ]
        tables.append(Table("What was asked outside blocks: mean (SD), or how many.", ["question", "people", ""], rows))
    return Section("Who took part", [EVALUATED_SENTENCE] if set(findings.conditions) == EVALUATED else [], tables)


def _devices(findings: Findings) -> Section:
    return table_section(
        "Views and devices",
        "Regular answers by view and device; beside them position bias, and the same query asked again.",
        ["view", "device", "people", "answers", "P(second shown), 95 % interval", "decision (s)", "asked again, alike"],
        [
            [
                name_in_words(view),
                device,
                str(seen.people),
                f"{seen.of.answers:,}",
                share_words(seen.of.second_shown),
                number_words(seen.of.decision_s.mean, "{:.1f}"),
                share_words(seen.of.repeat.share) if seen.of.repeat.share.n else NONE,
            ]
            for (view, device), seen in findings.devices.items()
        ],
    )


def every_test(findings: Findings) -> list[Section]:
    """All tests in one table, at the end; none without tests."""
    columns = "test about statistic p corrected method correction named_effect n"
    rows = [test_row(test, findings.plan.alpha, columns) for test in findings.tests]
    heads = ["test", "of", "statistic", "p", "p, corrected", "p is", "by", "effect, 95 %", "n"]
    caption = "As in tests.csv, which holds a sentence for each, too."
    return [table_section("Every test", caption, heads, rows)] if rows else []


def facts(findings: Findings, *, study: str, protocol: str, protocol_hash: str, command: str) -> list[tuple[str, str]]:
    """Where the numbers come from."""
    plan = ", ".join(f"{name}: {_plan_words(value)}" for name, value in findings.plan.model_dump(mode="json").items())
    return [
        ("study", study),
        ("protocol", protocol),
        ("protocol's hash", protocol_hash or NONE),
        ("analysis plan used", plan),
        ("its hash", findings.plan_hash),
        ("declared plan's hash", findings.declared_hash or "none was declared"),
        ("command", command),
    ]


def _plan_words(value: object) -> str:
    return "all there are" if value is None else ", ".join(map(str, value)) if isinstance(value, list) else str(value)

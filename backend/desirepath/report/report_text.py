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
from desirepath.report.meeting import meeting_section
from desirepath.report.method_text import methods_section, methods_sentence
from desirepath.report.rating_text import item_in_words, items_section, rankings_section, scales_section
from desirepath.report.report_cells import (
    NONE,
    name_in_words,
    number_words,
    pair_words,
    percent,
    table_section,
    test_row,
)

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


def sections(found: Findings, drawn: Sequence[Picture], folder: Path) -> list[Section]:
    """The report's parts in order; a part without data is left out."""
    parts = [
        _people(found),
        *explanation_sections(found),
        items_section(found),
        rankings_section(found),
        scales_section(found),
        agreement_section(found),
        disagreement_section(found),
        personalised_section(found),
        methods_section(found),
        meeting_section(found.met),
        *further_sections(found),
        _devices(found),
    ]
    shown = {PART_OF[picture.name]: embed_picture(picture, folder) for picture in drawn}
    return [
        replace(part, pictures=[shown[part.title]]) if part.title in shown else part
        for part in parts
        if part.sentences or part.tables
    ]


def brief(found: Findings) -> list[str]:
    """The result in a few sentences."""
    sentences = [_who(found), *explanation_brief(found), *methods_sentence(found)]
    if found.items:
        differ = [name_in_words(one.item.key) for one in found.items if one.significant(found.plan.alpha)]
        tests = " and ".join(dict.fromkeys(test.test for one in found.items for test in one.tests))
        sentences.append(
            f"Ratings differ between the conditions in {len(differ)} of {len(found.items)} items"
            f"{': ' + ', '.join(differ) if differ else ''} ({tests}, {found.items[0].test.correction})."
        )
        if not any(test.possible(found.plan.alpha) for one in found.items for test in one.tests):
            sentences.append(
                f"With {found.flow.analysed} people no rating can be significant, whatever they answer: the smallest "
                "possible corrected p is above alpha."
            )
    sentences += [one.test.sentence(found.plan.alpha) for one in found.rankings]
    if not found.tests:
        sentences.append(_why_no_test(found))
    if found.between:
        sentences.append(f"Agreement between conditions: {_agreements(found)}.")
    sentences += [personalised_sentence(found, k) for k in range(len(found.personalised))]
    return sentences


def _why_no_test(found: Findings) -> str:
    """A report without a test says why."""
    if not found.designs and not found.personalised:
        return "Nothing is tested: the study compares no conditions, rankings or policies. Answers are described."
    if found.flow.analysed < 2:
        return "Nothing is tested: one person is too few."
    return (
        "Nothing is tested: conditions differ in what was shown only, no rating, ranking or comparison of policies was "
        "answered under all of them by at least two people (of each group). Agreement is described."
    )


def _who(found: Findings) -> str:
    n = found.flow.analysed
    kind = "simulated participants" if found.simulated == n else "people"
    mixed = f", {found.simulated} of them simulated" if 0 < found.simulated < n else ""
    answers = sum(of.answers for of in found.of_condition.values())
    answered = f", {answers:,} answers to queries" if found.of_condition else ""  # an evaluation asks none
    return f"{n} {kind}{mixed}{answered}."


def _agreements(found: Findings) -> str:
    return ", ".join(
        f"{pair_words(pair)} {percent(of.share.mean)} (SD {percent(of.share.sd)})" for pair, of in found.between.items()
    )


def _people(found: Findings) -> Section:
    flow = found.flow
    rows = [["joined", str(flow.joined)], ["withdrew", str(flow.withdrawn)]]
    rows += [[f"excluded: {reason}", str(count)] for reason, count in flow.excluded.items()]
    rows += [[f"session {state}, not analysed", str(count)] for state, count in flow.unfinished.items()]
    rows.append(["analysed", str(flow.analysed)])
    tables = [Table("From joining to the analysis.", ["", "people"], rows)]
    if len(found.conditions) > 1:
        orders = [[name_in_words(order), str(count)] for order, count in found.orders.items()]
        tables.append(Table("Orders of the conditions among those analysed.", ["order", "people"], orders))
    if found.demographics:
        rows = [
            [
                item_in_words(one.item, one.asking),
                str(one.n),
                f"{one.numbers.mean:.1f} ({number_words(one.numbers.sd, '{:.1f}')})"
                if one.numbers
                else ", ".join(f"{label} {count}" for label, count in one.counts.items() if count),
            ]
            for one in found.demographics
        ]
        tables.append(Table("What was asked outside blocks: mean (SD), or how many.", ["question", "people", ""], rows))
    return Section("Who took part", [EVALUATED_SENTENCE] if set(found.conditions) == EVALUATED else [], tables)


def _devices(found: Findings) -> Section:
    return table_section(
        "Views and devices",
        "Regular answers by view and device. Immersive is a desktop's camera unless the device is a headset.",
        ["view", "device", "answers"],
        [[name_in_words(view), device, f"{n:,}"] for (view, device), n in found.devices.items()],
    )


def every_test(found: Findings) -> list[Section]:
    """All tests in one table, at the end; none without tests."""
    columns = "test about statistic p corrected method correction named_effect n"
    rows = [test_row(test, found.plan.alpha, columns) for test in found.tests]
    heads = ["test", "of", "statistic", "p", "p, corrected", "p is", "by", "effect, 95 %", "n"]
    caption = "As in tests.csv, which holds a sentence for each, too."
    return [table_section("Every test", caption, heads, rows)] if rows else []


def facts(found: Findings, *, study: str, protocol: str, protocol_hash: str, command: str) -> list[tuple[str, str]]:
    """Where the numbers come from."""
    plan = ", ".join(f"{name}: {_plan_words(value)}" for name, value in found.plan.model_dump(mode="json").items())
    return [
        ("study", study),
        ("protocol", protocol),
        ("protocol's hash", protocol_hash or NONE),
        ("analysis plan used", plan),
        ("its hash", found.plan_hash),
        ("declared plan's hash", found.declared_hash or "none was declared"),
        ("command", command),
    ]


def _plan_words(value: object) -> str:
    return "all there are" if value is None else ", ".join(map(str, value)) if isinstance(value, list) else str(value)

"""A study's findings in sentences and tables, as a paper would state them. Numbers come from `findings.py`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from backend.analysis.choices import CHANCE_CIRCULAR
from backend.analysis.tested import Mean, Tested, told_p
from backend.explain.printed import Section, Table, shown_picture
from backend.report.analysis_plan import METRICS
from backend.report.choice_findings import Agreement
from backend.report.findings import Findings

if TYPE_CHECKING:
    from backend.explain.pictures import Picture

NONE = "–"
EVALUATED = {"dwa", "own", "social_cost"}  # of a study's evaluation stage
EVALUATED_SENTENCE = (
    "Each person met the three controllers in one of the orders below, and in the reverse order in the second "
    "environment; in the study of chapter 2 everybody met them in the same order."
)


def sections(found: Findings, drawn: Sequence[Picture], folder: Path) -> list[Section]:
    """The report's parts in order; a part without data is left out."""
    parts = [
        _people(found),
        _items(found),
        _rankings(found),
        _scales(found),
        _agreement(found),
        _disagreement(found),
        _personalised(found),
        _devices(found),
    ]
    shown = {picture.name: shown_picture(picture, folder) for picture in drawn}
    of_part = {
        "Ratings after each block": "items",
        "Ranking of the conditions": "rankings",
        "Agreement": "agreement",
        "What changes where choices differ": "disagreement",
        "Does it personalise?": "personalised",
    }
    return [
        replace(part, pictures=[shown[of_part[part.title]]]) if of_part.get(part.title) in shown else part
        for part in parts
        if part.sentences or part.tables
    ]


def brief(found: Findings) -> list[str]:
    """The result in a few sentences."""
    told = [_who(found)]
    if found.items:
        differ = [one.item.key.replace("_", " ") for one in found.items if one.test.significant(found.plan.alpha)]
        told.append(
            f"Ratings differ between the conditions in {len(differ)} of {len(found.items)} items"
            f"{': ' + ', '.join(differ) if differ else ''} (Friedman, {_correction(found)})."
        )
    told += [one.test.sentence(found.plan.alpha) for one in found.rankings]
    if found.between:
        told.append(f"Agreement between conditions: {_agreements(found)}.")
    told += [_personalised_sentence(found, k) for k in range(len(found.personalised))]
    return told


def _who(found: Findings) -> str:
    n = found.flow.analysed
    kind = "simulated participants" if found.simulated == n else "people"
    mixed = f", {found.simulated} of them simulated" if 0 < found.simulated < n else ""
    answers = sum(of.answers for of in found.of_condition.values())
    told = f", {answers:,} answers to queries" if found.of_condition else ""  # an evaluation asks none
    return f"{n} {kind}{mixed}{told}."


def _correction(found: Findings) -> str:
    return found.items[0].test.correction if found.items else "uncorrected"


def _agreements(found: Findings) -> str:
    return ", ".join(
        f"{_pair(pair)} {_percent(of.share.mean)} (SD {_percent(of.share.sd)})" for pair, of in found.between.items()
    )


def _people(found: Findings) -> Section:
    flow = found.flow
    rows = [["joined", str(flow.joined)], ["withdrew", str(flow.withdrawn)]]
    rows += [[f"excluded: {reason}", str(count)] for reason, count in flow.excluded.items()]
    rows += [[f"session {state}, not analysed", str(count)] for state, count in flow.unfinished.items()]
    rows.append(["analysed", str(flow.analysed)])
    tables = [Table("From joining to the analysis.", ["", "people"], rows)]
    if len(found.conditions) > 1:
        orders = [[order.replace("_", " "), str(count)] for order, count in found.orders.items()]
        tables.append(Table("Orders of the conditions among those analysed.", ["order", "people"], orders))
    if found.demographics:
        rows = [
            [
                one.item.text,
                str(one.n),
                f"{one.numbers.mean:.1f} ({_number(one.numbers.sd, '{:.1f}')})"
                if one.numbers
                else ", ".join(f"{label} {count}" for label, count in one.counts.items() if count),
            ]
            for one in found.demographics
        ]
        tables.append(Table("What was asked once: mean (SD), or how many.", ["question", "answers", ""], rows))
    return Section("Who took part", [EVALUATED_SENTENCE] if set(found.conditions) == EVALUATED else [], tables)


def _items(found: Findings) -> Section:
    if not found.items:
        return Section("Ratings after each block")
    heads = ["item", *(name.replace("_", " ") for name in found.conditions), "χ²", "df", "p", "p, corrected", "W", "n"]
    rows = [
        [
            f"{one.item.text}{' (as answered: low is good)' if one.item.reversed else ''}",
            *(f"{one.means[name].mean:.2f} ± {one.means[name].se:.2f}" for name in found.conditions),
            *_test_cells(one.test),
        ]
        for one in found.items
    ]
    sentences = [
        f"Friedman's test per item over the people who answered it under every condition, p corrected over the "
        f"{len(found.items)} items ({_correction(found)}). {_which_pairs(found)} "
        "Wilcoxon's signed-rank tests of its pairs of conditions, Bonferroni over these pairs and not over the items; "
        "people without a difference are left out (used: how many remain), p is exact where it can be, z is the normal "
        "approximation.",
        *(test.sentence(found.plan.alpha) for one in found.items for test in _told(one.test, one.pairs, found)),
    ]
    tables = [Table("Mean ± standard error.", heads, rows)]
    pairs = [[test.about, *_pair_cells(test)] for one in found.items for test in one.pairs]
    if pairs:
        heads = ["pair", "W", "z", "p", "p, corrected", "rank-biserial r", "n", "used"]
        tables.append(Table("Pairs of conditions; r above 0: the first is rated higher.", heads, pairs))
    return Section("Ratings after each block", sentences[:1], tables, sentences[1:])


def _which_pairs(found: Findings) -> str:
    if found.plan.pairs == "always":
        return "For every item, whatever Friedman's test says:"
    return f"Where the corrected p is at most {found.plan.alpha:g}:"


def _told(test: Tested, pairs: Sequence[Tested], found: Findings) -> list[Tested]:
    """A significant test and its significant pairs; one that found nothing is in the table."""
    significant = [one for one in pairs if one.significant(found.plan.alpha)]
    return [*([test] if test.significant(found.plan.alpha) else []), *significant]


def _test_cells(test: Tested) -> list[str]:
    df = NONE if test.df is None else f"{test.df:g}"
    return [f"{test.statistic:.2f}", df, *_p_cells(test), f"{test.effect:.2f}", str(test.n)]


def _pair_cells(test: Tested) -> list[str]:
    z = NONE if test.z is None else f"{test.z:.2f}"
    return [f"{test.statistic:.2f}", z, *_p_cells(test), f"{test.effect:.2f}", str(test.n), str(test.used)]


def _p_cells(test: Tested) -> list[str]:
    """p as it is and corrected, the latter with its stars."""
    stars = f" {test.stars}" if test.stars else ""
    p = [told_p(test.p).removeprefix("p "), told_p(test.p_corrected).removeprefix("p ") + stars]
    return [one.removeprefix("= ") for one in p]


def _rankings(found: Findings) -> Section:
    if not found.rankings:
        return Section("Ranking of the conditions")
    options = list(dict.fromkeys(name for one in found.rankings for name in one.places))
    rows = [
        [
            one.item.text,
            *("/".join(map(str, one.places.get(name, ()))) or NONE for name in options),
            *_test_cells(one.test),
        ]
        for one in found.rankings
    ]
    heads = ["question", *(name.replace("_", " ") for name in options), "χ²", "df", "p", "p, corrected", "V", "n"]
    sentences = [
        f"Chi-square test of first choices against equal shares, p corrected over the {len(found.rankings)} rankings "
        f"({found.rankings[0].test.correction}); where significant, z-tests of the pairs, Bonferroni. The choices of "
        "one question exclude each other, so z = (a - b) / √(a + b).",
    ]
    points = [t.sentence(found.plan.alpha) for one in found.rankings for t in _told(one.test, one.pairs, found)]
    return Section(
        "Ranking of the conditions", sentences, [Table("How many put each first/second/third.", heads, rows)], points
    )


def _scales(found: Findings) -> Section:
    """Scores over people, per condition where a scale was asked after blocks."""
    sentences, rows = [], []
    for one in found.scales:
        scale = one.scale
        sentences.append(
            f"{scale.names[-1]}, {scale.lowest:g} to {scale.highest:g}; {scale.scoring}. Source: {scale.source}."
        )
        for name, of in one.means.items():
            interval = NONE if math.isnan(of.low) else f"{of.low:.1f} to {of.high:.1f}"
            told = [_number(value, "{:.1f}") for value in (of.mean, of.sd)]
            rows.append([scale.names[0], name.replace("_", " ") or "asked once", *told, interval, str(of.n)])
        if one.incomplete:
            sentences.append(f"{one.incomplete} answers to {scale.names[0]} were not complete and have no score.")
    heads = ["scale", "about", "mean", "SD", "95 % interval", "people"]
    caption = "Scores by the scales' own scoring, over people; each person's in scales.csv."
    return Section("Validated scales", sentences, [Table(caption, heads, rows)] if rows else [])


def _agreement(found: Findings) -> Section:
    if not found.of_condition:
        return Section("Agreement")
    tables = []
    if found.between:
        rows = [[_pair(pair), *_agreement_cells(of)] for pair, of in found.between.items()]
        tables.append(Table("Between conditions, the same person and query.", _AGREEMENT_HEADS, rows))
    again = [
        [f"{name.replace('_', ' ')}, {words}", *_agreement_cells(of)]
        for name, one in found.of_condition.items()
        for words, of in (("asked again", one.repeat), ("sides exchanged", one.swap))
        if of.share.n
    ]
    if again:
        caption = (
            "Within a condition: a person's second answer against the first. People with fewer than "
            f"{found.plan.min_probes} repeated queries are left out."
        )
        tables.append(Table(caption, _AGREEMENT_HEADS, again))
    rows = [
        [
            name.replace("_", " "),
            f"{one.answers:,}",
            _share(one.second_shown),
            _number(one.decision_s.mean, "{:.1f}"),
        ]
        for name, one in found.of_condition.items()
    ]
    position = "Position: an answer that follows the order of showing looks like agreement."
    if found.triads:
        told = [
            [name.replace("_", " "), str(of.triads), str(of.circular), _share(of.share), str(of.share.n)]
            for name, of in found.triads.items()
        ]
        caption = (
            "Circular triads: of three trajectories compared in all three pairs, A was chosen over B, B over C and C "
            f"over A. Choosing by coin makes {CHANCE_CIRCULAR:.0%} of them circular, an order of preference none."
        )
        shares = "share of a person's, mean, 95 % interval"
        tables.append(Table(caption, ["condition", "triads", "circular", shares, "people"], told))
    heads = ["condition", "answers", "P(second shown), 95 % interval", "decision (s, mean of medians)"]
    tables.append(Table(position, heads, rows))
    sentence = (
        "Shares of equal answers per person, then mean and SD over people. Cohen's kappa is that of the places chosen "
        "(first or second shown): it is near 0 where people agree only because they like one place. It is not defined "
        "for who always chose the same place."
    )
    return Section("Agreement", [sentence], tables)


_AGREEMENT_HEADS = ["", "agreement", "SD", "95 % interval", "kappa", "people", "kappa not defined"]


def _agreement_cells(of: Agreement) -> list[str]:
    interval = NONE if math.isnan(of.share.low) else f"{_percent(of.share.low)} to {_percent(of.share.high)}"
    return [
        _percent(of.share.mean),
        _percent(of.share.sd),
        interval,
        _number(of.kappa.mean, "{:.2f}"),
        str(of.share.n),
        str(of.no_kappa),
    ]


def _disagreement(found: Findings) -> Section:
    rows = [
        [_pair(pair, " → "), *(_with_se(metrics[name]) for name in found.plan.metrics)]
        for pair, metrics in found.disagreement.items()
        if any(of.n for of in metrics.values())
    ]
    heads = ["from → to", *(METRICS[name][0] for name in found.plan.metrics)]
    caption = "Change in z, mean ± standard error over the people who chose differently at least once."
    return Section("What changes where choices differ", [], [Table(caption, heads, rows)] if rows else [])


def _with_se(mean: Mean) -> str:
    return f"{mean.mean:+.2f} ± {mean.se:.2f} (n = {mean.n})" if mean.n > 1 else NONE


def _personalised_sentence(found: Findings, k: int) -> str:
    one = found.personalised[k]
    sentence = one.test.sentence(found.plan.alpha)
    return f"{sentence} Share of choices for the own policy: {_share(one.share)} over people."


def _personalised(found: Findings) -> Section:
    if not found.personalised:
        return Section("Does it personalise?")
    told = [_personalised_sentence(found, k) for k in range(len(found.personalised))]
    against = {one.against: one for one in found.personalised}
    if {"base", "other"} <= against.keys():
        over_base, over_other = (against[name].test.significant(found.plan.alpha) for name in ("base", "other"))
        own_wins = against["other"].share.mean > 0.5
        if over_base and not (over_other and own_wins):
            told.append(
                "The own policy differs from the base policy, but was not shown to be preferred to one that another "
                "participant's answers made: this does not show that it is personal."
            )
        elif over_other and own_wins:
            told.append("The own policy is preferred to one that another participant's answers made: it is personal.")
    alike = sum(one.look_alike for one in found.personalised)
    if alike:
        told.append(f"{alike} of the comparisons showed rollouts that look alike; they are counted.")
    told.append(
        "Sign tests over people: a person counts once, for the policy chosen more often; answers of one person depend "
        "on each other."
    )
    return Section("Does it personalise?", told)


def _devices(found: Findings) -> Section:
    rows = [[view.replace("_", " "), device, f"{n:,}"] for (view, device), n in found.devices.items()]
    caption = "Regular answers by view and device. Immersive is a desktop's camera unless the device is a headset."
    return Section("Views and devices", [], [Table(caption, ["view", "device", "answers"], rows)] if rows else [])


def every_test(found: Findings) -> list[Section]:
    """All tests in one table, at the end; none without tests."""
    rows = [
        [
            test.test,
            test.about,
            *_test_cells(test)[:4],
            test.correction,
            f"{test.effect_name} {test.effect:.2f}",
            str(test.n),
        ]
        for test in found.tests
    ]
    heads = ["test", "of", "statistic", "df", "p", "p, corrected", "by", "effect", "n"]
    return (
        [Section("Every test", [], [Table("As in tests.csv, which holds a sentence for each, too.", heads, rows)])]
        if rows
        else []
    )


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


def _pair(pair: tuple[str, str], between: str = " – ") -> str:
    return between.join(name.replace("_", " ") for name in pair)


def _percent(value: float) -> str:
    return NONE if math.isnan(value) else f"{100 * value:.1f} %"


def _share(mean: Mean) -> str:
    """A share with its interval, where there is one: one person has none."""
    if math.isnan(mean.low):
        return _percent(mean.mean)
    return f"{_percent(mean.mean)} ({_percent(mean.low)} to {_percent(mean.high)})"


def _number(value: float, form: str) -> str:
    return NONE if math.isnan(value) else form.format(value)

"""What was chosen, in sentences and tables: agreement, what changes where choices differ, own policy against others.

Numbers are `choice_findings.py`'s; the report's other parts `report_text.py`'s.
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

from desirepath.analysis.tested import Mean
from desirepath.analysis.triads import CHANCE_CIRCULAR
from desirepath.explain.printed import Section, Table
from desirepath.report.analysis_plan import METRICS
from desirepath.report.choice_findings import Agreement
from desirepath.report.findings import Findings
from desirepath.report.own_findings import ARMS, Personalised
from desirepath.report.report_cells import (
    NONE,
    interval_cell,
    name_in_words,
    number_words,
    pair_words,
    percent,
    share_words,
    table_section,
)

ASKED = {"order": "the order", "best": "the best", "groups": "piles"}


def agreement_section(findings: Findings) -> Section:
    """Agreement between and within conditions, circular triads, position."""
    if not (findings.of_condition or findings.degrees or findings.several):
        return Section("Agreement")
    between = [[pair_words(pair), *_agreement_cells(of)] for pair, of in findings.between.items()]
    again = [
        [f"{name_in_words(name)}, {words}", *_agreement_cells(agreement)]
        for name, of in findings.of_condition.items()
        for words, agreement in (("asked again", of.repeat), ("sides exchanged", of.swap))
        if agreement.share.n
    ]
    triads = [
        [name_in_words(name), str(of.triads), str(of.circular), share_words(of.share), str(of.share.n)]
        for name, of in findings.triads.items()
    ]
    position = [
        [
            name_in_words(name),
            f"{of.answers:,}",
            share_words(of.second_shown),
            number_words(of.decision_s.mean, "{:.1f}"),
        ]
        for name, of in findings.of_condition.items()
    ]
    heads = ["", "agreement", "SD", "95 % interval", "kappa", "people", "kappa not defined"]
    degrees = [
        [name_in_words(name), f"{of.answers:,}", share_words(of.no_difference), share_words(of.clear)]
        for name, of in findings.degrees.items()
    ]
    several = [
        [
            name_in_words(of.condition),
            f"{ASKED[of.ask]} of {of.of}",
            f"{of.answers:,}",
            share_words(of.first_best),
            f"{1 / of.of:.0%}",
            number_words(of.decision_s.mean, "{:.0f}"),
        ]
        for of in findings.several
    ]
    tables = [
        Table("Between conditions, the same person and query.", heads, between),
        Table(
            "Within a condition: a person's second answer against the first. People with fewer than "
            f"{findings.plan.min_probes} repeated queries are left out.",
            heads,
            again,
        ),
        Table(
            "Circular triads: of three trajectories compared in all three pairs, A was chosen over B, B over C and C "
            f"over A. Choosing by coin makes {CHANCE_CIRCULAR:.0%} of them circular, an order of preference none.",
            ["condition", "triads", "circular", "share of a person's, mean, 95 % interval", "people"],
            triads,
        ),
        Table(
            "Position bias: choosing by the order of presentation looks like agreement.",
            ["condition", "answers", "P(second shown), 95 % interval", "decision (s, mean of medians)"],
            position,
        ),
        Table(
            "How clear the answers were, where people could say so. Where somebody saw no difference, neither was "
            "chosen: such answers are in no other table.",
            ["condition", "answers", "no difference, 95 % interval", "of the others clear or sure, 95 % interval"],
            degrees,
        ),
        Table(
            "Several trajectories at once. Liking the one that is shown first more often than chance is position bias. "
            "Seconds count from coming to the scene, so they include the watching.",
            ["condition", "asked", "answers", "P(first shown is the best), 95 % interval", "by chance", "seconds"],
            several,
        ),
    ]
    sentence = (
        "Shares of equal answers per person, then mean and SD over people; intervals over people (Wilson's, of as many "
        "independent answers as people's shares vary like). Cohen's kappa is that of the trajectories chosen, by the "
        "place (first or second shown) that each had at first: it is near 0 where people agree only because they like "
        "one place. It is not defined for who always chose the same place."
    )
    return Section("Agreement", [sentence], [table for table in tables if table.rows])


def _agreement_cells(of: Agreement) -> list[str]:
    return [
        percent(of.share.mean),
        percent(of.share.sd),
        interval_cell(100 * of.share.low, 100 * of.share.high, "{:.1f} %"),
        number_words(of.kappa.mean),
        str(of.share.n),
        str(of.no_kappa),
    ]


def disagreement_section(findings: Findings) -> Section:
    """What changes in the preferred trajectory where a choice flips."""
    return table_section(
        "What changes where choices differ",
        "Change in z, mean ± standard error over the people who chose differently at least once.",
        ["from → to", *(METRICS[name][0] for name in findings.plan.metrics)],
        [
            [pair_words(pair, " → "), *(_with_se(metrics[name]) for name in findings.plan.metrics)]
            for pair, metrics in findings.disagreement.items()
            if any(of.n for of in metrics.values())
        ],
    )


def _with_se(mean: Mean) -> str:
    return f"{mean.mean:+.2f} ± {mean.se:.2f} (n = {mean.n})" if mean.n > 1 else NONE


def personalised_sentence(findings: Findings, k: int) -> str:
    """One of these comparisons in a sentence."""
    comparison = findings.personalised[k]
    sentence = comparison.test.sentence(findings.plan.alpha)
    return f"{sentence} Share of choices for the own policy: {share_words(comparison.share)} over {_units(comparison)}."


def _units(comparison: Personalised) -> str:
    lent = comparison.against == "other" and comparison.clusters < comparison.people
    return f"{comparison.clusters} lent policies" if lent else "people"


def personalised_section(findings: Findings) -> Section:
    """The own policy against the base policy and against another person's."""
    if not findings.personalised:
        refusals = [describe_who_compared(findings)] if _count_refusals(findings) else []
        return Section("Does it personalise?", [*refusals, *describe_who_was_asked_on(findings)])
    alpha = findings.plan.alpha
    paragraphs = [personalised_sentence(findings, k) for k in range(len(findings.personalised))]
    paragraphs += [describe_who_compared(findings)] if findings.own_policies else []
    paragraphs += describe_who_was_asked_on(findings)
    against = {comparison.against: comparison for comparison in findings.personalised}
    if "other" in against:
        paragraphs.append(_verdict(against, alpha))
    else:
        paragraphs.append(
            "Whether it is the person's own answers that make the difference this does not show: nobody compared it "
            "with a policy that another participant's answers made."
        )
    alike = sum(comparison.look_alike for comparison in findings.personalised)
    if alike:
        paragraphs.append(f"{alike} of the comparisons showed rollouts that look alike; they are counted.")
    lent = sum(comparison.stand_ins for comparison in findings.personalised)
    if lent:
        paragraphs.append(
            f"{lent} of the people who were lent another's policy were lent one made from a simulated person's answers "
            "(a stand-in), because no other participant's was ready that nobody had been lent."
        )
    shared = next((comparison for comparison in findings.personalised if comparison.clusters < comparison.people), None)
    if shared is not None:
        paragraphs.append(
            f"{shared.people} people were lent {shared.clusters} different policies of other participants; people who "
            "were lent the same one count as one, since what is good or bad about it they share."
        )
    if "population" in against:
        paragraphs.append(_who_stood_behind(against["population"]))
    if findings.guessed is not None:
        paragraphs.append(
            f"{findings.guessed.right} of {findings.guessed.people} guessed which of the last pair came from their own "
            f"answers. {findings.guessed.test.sentence(alpha)}"
        )
    first, second = (
        ("Sign tests", "signed ranks") if findings.plan.own == "sign" else ("Signed ranks of shares", "sign test")
    )
    beside = "; ".join(
        f"against {ARMS[comparison.against]} {comparison.beside.numbers()}" for comparison in findings.personalised
    )
    declared = ", as declared" if findings.declared_hash else ""
    paragraphs.append(
        f"{first} over people{declared}, {findings.personalised[0].test.correction} over the comparisons: a person "
        f"counts once, answers of one person depend on each other. For reading only, {second}: {beside}."
    )
    return Section("Does it personalise?", paragraphs)


def _who_stood_behind(comparison: Personalised) -> str:
    """How many people a population's policy was made from, and what that means for the test of it."""
    known = comparison.earlier
    missing = "" if len(known) == comparison.people else f" (known of {len(known)} of {comparison.people} people)"
    told = "The data do not say how many people stood behind it"
    if known:
        told = f"Behind it stood, per participant, a median of {median(known):g} earlier people ({min(known)} to "
        told += f"{max(known)}){missing}"
    return (
        f"The policy by what earlier participants want is made anew for each participant. {told}. They are mostly the "
        "same people from one participant to the next, so that successive ones meet nearly the same opponent. The test "
        "counts participants as independent all the same; what is good or bad about it by chance, they share."
    )


_REFUSED = {
    "not_surely_better": "it was not surely better for that very person",
    "gate_not_passed": "it did not pass the gate",
    "too_few_answers": "there were too few answers",
    "job_failed": "its training failed",
    "late": "it was not ready in time",
    "no_consent": "learning from the answers was not consented to",
    "no_scenes": "there was no scene to compare it in",
}
"""Why somebody was not shown a policy as theirs, in the report's order."""


def _count_refusals(findings: Findings) -> dict[str, int]:
    return {why: people for why, people in findings.own_policies.items() if why != "shown"}


def describe_who_compared(findings: Findings) -> str:
    """How many were shown a policy as theirs, how many were not and why: the comparisons are of the first alone."""
    shown, refused = findings.own_policies.get("shown", 0), _count_refusals(findings)
    people = shown + sum(refused.values())
    if not refused:
        whom = f"All {people} people for whom a policy was to be made were" if people > 1 else "The only person was"
        return f"{whom} shown one as theirs; nobody is left out."
    why = [f"{refused[name]} because {words}" for name, words in _REFUSED.items() if name in refused]
    why += [f"{count} for another reason ({name})" for name, count in refused.items() if name not in _REFUSED]
    return (
        f"{shown} of {people} people for whom a policy was to be made were shown it as theirs, and only they compare; "
        f"{sum(refused.values())} were not: {', '.join(why)}. What is found here is about those who were shown one, "
        "not about everybody."
    )


def describe_who_was_asked_on(findings: Findings) -> list[str]:
    """Who answered further pairs, and how many: a sentence, or none where nobody did."""
    if not findings.asked_on:
        return []
    by_answers: dict[int, list[str]] = {}
    for code, further in sorted(findings.asked_on.items()):
        by_answers.setdefault(further, []).append(code)
    each = "; ".join(
        f"{further} further answer{'s' * (further > 1)}: {', '.join(codes)}"
        for further, codes in sorted(by_answers.items())
    )
    count, total = len(findings.asked_on), sum(findings.asked_on.values())
    return [
        f"{count} of {findings.flow.analysed} people {'was' if count == 1 else 'were'} asked on, since what was "
        f"learned was not surely better for that very person ({total} further answers in all; {each}). These answers "
        "taught their robot and are in no other number here."
    ]


def _verdict(against: Mapping[str, Personalised], alpha: float) -> str:
    """What the comparison with another person's policy shows, no more than its test."""
    other = against["other"]
    if other.preferred(alpha) and other.stand_ins == other.people:
        return (
            "People preferred the policy made from their own answers to one made from a simulated person's. "
            "Nobody compared it with a policy that another participant's answers made, so this does not show that "
            "it is personal."
        )
    if other.preferred(alpha):
        return (
            "People preferred the policy made from their own answers to one made from another participant's: what they "
            "like about it is not only what everybody likes."
        )
    if other.test.significant(alpha):
        return "People preferred the policy that another participant's answers made to their own one."
    better = [ARMS[name] for name, comparison in against.items() if name != "other" and comparison.preferred(alpha)]
    begun = f"The own policy is preferred to {' and to '.join(better)}, but" if better else "The own policy"
    return (
        f"{begun} was not shown to be preferred to one that another participant's answers made: this does not show "
        "that it is personal."
    )

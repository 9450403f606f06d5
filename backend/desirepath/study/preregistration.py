"""A study's preregistration in Markdown, as far as its protocol says it: hypotheses that follow from its tests, design,
sample, measures, analysis. What only the people who plan it can say stands as TO FILL IN. Nothing is sent anywhere."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from desirepath.analysis.scales import frozen_scale
from desirepath.grammar.conditions import Ordered
from desirepath.grammar.texts import local
from desirepath.report.analysis_plan import METRICS, AnalysisPlan
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.plan.counterbalancing import design_of
from desirepath.study.protocol.freezing import FrozenProtocol
from desirepath.study.protocol.outline import describe_stages, estimate_minutes
from desirepath.study.protocol.schema import text_numbers

TO_FILL_IN = "**TO FILL IN**"
AGAINST = {
    "base": "the usual robot",
    "dwa": "the dynamic window approach",
    "neutral": "the conditioned robot without preferences",
    "population": "the robot that learned from up to 30 earlier participants who agreed",
    "other": "the robot that learned from another participant",
}
_SCHEMES = {
    "random": "in an order drawn by lot",
    "all_orders": "in all orders, filled evenly",
    "williams": "in orders of a Williams design, filled evenly",
    "latin_square": "in orders of a Latin square, filled evenly",
}


def preregistration(frozen: FrozenProtocol, *, now: str, answers: int | None = None) -> str:
    """The text. now: ISO date; answers: how many there are already, None of a protocol without a study."""
    protocol = frozen.protocol
    when = "No study was opened from it yet." if answers is None else f"Answers that were there: {answers}."
    parts: dict[str, list[str]] = {
        "Study": [
            f"- Title: {frozen.title('en')}",
            f"- Protocol: {protocol.protocol}, version {protocol.version}, sha256 `{frozen.hash}` (with every text and "
            "questionnaire that it names)",
            f"- Written on {now}. {when}",
            f"- Authors and affiliations: {TO_FILL_IN}",
            f"- Research question: {TO_FILL_IN}",
        ],
        "Hypotheses": [*_hypotheses(frozen), f"- Direction and reasons of each: {TO_FILL_IN}"],
        "Design": list(_design(frozen)),
        "Sample": list(_sample(frozen)),
        "Measures": list(_measures(frozen)),
        "Analysis": list(_analysis(protocol.analysis)),
        "What participants do": [
            f"{number}. {stage.key}: {_settings(stage.facts, protocol.languages)}"
            for number, stage in enumerate(describe_stages(frozen.data, frozen.files), 1)
        ],
    }
    body = "\n".join(f"\n## {title}\n\n" + "\n".join(lines) for title, lines in parts.items())
    return f"# Preregistration: {frozen.title('en')}\n{body}\n"


def _settings(facts: Iterable[tuple[str, str]], languages: Sequence[str]) -> str:
    """A stage's settings without the texts that participants read."""
    told = [f"{name} {value}" for name, value in facts if name.rpartition(" ")[2] not in languages]
    return "; ".join(told) or "a page"


def _stages(frozen: FrozenProtocol) -> Iterator[tuple[str, Ordered]]:
    return ((key, stage) for key, stage in frozen.protocol.keyed_stages if isinstance(stage, Ordered))


def _hypotheses(frozen: FrozenProtocol) -> Iterator[str]:
    for key, stage in _stages(frozen):
        names = {condition.name for group in range(len(stage.groups)) for condition in stage.conditions(group)}
        if len(names) > 1:
            yield f"- Answers and ratings in `{key}` differ between {', '.join(sorted(names))} (two-sided)."
    for comparison in frozen.protocol.stages_of(ComparisonStage):
        for opponent in comparison.opponents:
            yield (
                "- Blind, participants choose the robot that learned from their own answers more often than not over "
                f"{AGAINST[opponent]}."
            )


def _design(frozen: FrozenProtocol) -> Iterator[str]:
    protocol = frozen.protocol
    for key, stage in _stages(frozen):
        within = [f"{name} ({', '.join(levels)})" for name, levels in (stage.each or {}).items()]
        between = [f"{name} ({', '.join(levels)})" for name, levels in (stage.one_of or {}).items()]
        told = [f"within participants: {'; '.join(within)}"] if within else []
        told += [f"between participants: {'; '.join(between)}"] if between else []
        yield f"- `{key}`: {', '.join(told) or 'one condition'}"
    orders = len(design_of(protocol).rows)
    yield f"- Conditions are met {_SCHEMES[protocol.assignment.scheme]}{f' ({orders} orders)' if orders else ''}."
    yield "- Queries, their order and which trajectory is A are drawn by lot for each participant, from a stored seed."
    for comparison in protocol.stages_of(ComparisonStage):
        yield (
            f"- The comparison is blind: {comparison.pairs} pairs in new scenes, sides by lot, against "
            f"{', '.join(AGAINST[opponent] for opponent in comparison.opponents)}."
        )


def _sample(frozen: FrozenProtocol) -> Iterator[str]:
    protocol = frozen.protocol
    most = "as many as come" if protocol.participants is None else str(protocol.participants)
    yield f"- Participants who are taken in: {most}. Planned number, why, and when you stop: {TO_FILL_IN}"
    yield "  (`desirepath studies power` says what a number of participants finds.)"
    usual, longest = estimate_minutes(protocol)
    longer = f" (up to {longest:g} with further pairs)" if longest > usual else ""
    yield f"- A session takes about {usual:g} minutes{longer}; participants are told {protocol.told_minutes}."
    for quota in protocol.quotas:
        yield f"- At most {quota.most} with the answer {quota.is_} to {quota.questionnaire}.{quota.item}."
    asked = protocol.asked_of_devices
    size = f"a window of at least {asked.min_width} x {asked.min_height} pixels"
    yield (
        f"- Device: {size}, pointers: {', '.join(asked.pointers)}{', WebGL' if asked.webgl else ''}"
        f"{f', a headset ({asked.headset})' if asked.headset else ''}"
        f"{', whose pose on the head is stored' if asked.head_pose else ''}."
    )
    yield (
        "- Not analysed: practice trials, pilot participants, who withdrew, who was excluded by hand (with a reason, "
        f"counted in the flow of participants). Rules for excluding by hand: {TO_FILL_IN}"
    )
    yield f"- Recruiting and payment: {local(protocol.payment, 'en') if protocol.payment else TO_FILL_IN}"


def _measures(frozen: FrozenProtocol) -> Iterator[str]:
    numbers = text_numbers(frozen.protocol)
    if pairs := numbers.get("pairs"):
        yield f"- Choices: {pairs} pairs of trajectories; which was chosen, decision time."
    for name, asked in frozen.questionnaires.items():
        scales = [
            frozen_scale(copy)
            for file, copy in frozen.files.items()
            if file.startswith("scales/") and {i.key for i in asked.items} >= {i.key for i in frozen_scale(copy).items}
        ]
        known = "; ".join(
            f"{part.names[0]} ({part.lowest:g} to {part.highest:g}: {part.scoring}; {part.source})"
            for scale in scales
            for part in scale.scored
        )
        yield f"- Questionnaire `{name}`: {len(asked.items)} items ({', '.join(item.key for item in asked.items)})"
        if known:
            yield f"  - scored as {known}"


def _analysis(plan: AnalysisPlan | None) -> Iterator[str]:
    if plan is None:
        yield f"- The protocol declares none (`analysis:`): the defaults below, all of it exploratory. {TO_FILL_IN}"
        plan = AnalysisPlan()
    yield f"- Hash of the plan (sha256): `{plan.digest()}`; deviations are reported as such."
    yield f"- Alpha {plan.alpha:g}; p corrected by {plan.correction}: over items, rankings, opponents."
    yield (
        "- Ratings: two conditions by Wilcoxon's signed ranks, more by Friedman's test, groups by Mann and Whitney or "
        "Kruskal and Wallis, several factors by each person's contrasts or aligned ranks; pairs "
        f"{'always' if plan.pairs == 'always' else 'where the test over all conditions is significant'}, corrected "
        f"over the pairs of {'all items together' if plan.pairs_over == 'items' else 'one item'}."
    )
    yield f"- Own robot against others: {'sign tests' if plan.own == 'sign' else 'signed ranks of shares'} over people."
    yield f"- Sessions that count: {plan.sessions}."
    metrics = ", ".join(METRICS[name][0] for name in plan.metrics)
    yield f"- Of trajectories, where choices differ: {metrics} (descriptive)."
    if plan.equivalence is not None:
        yield f"- Equivalence by two one-sided tests, margins: {plan.equivalence.model_dump(exclude_none=True)}."
    beside = [("Bayes factors", plan.bayes_factors), ("mixed models", plan.models)]
    if extra := [name for name, wanted in beside if wanted]:
        yield f"- Beside them: {', '.join(extra)}."
    yield f"- Who did not answer an item under every condition is left out of its test. More: {TO_FILL_IN}"

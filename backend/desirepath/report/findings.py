"""Everything a study's report says, as numbers: from tidy rows and an analysis plan to tested results. Pure.

Ratings are `rating_findings.py`'s, choices `choice_findings.py`'s; the tests live in `analysis`, words and
figures beside.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

from desirepath.analysis.tested import Mean, Tested
from desirepath.report.analysis_plan import AnalysisPlan, Metric, deviations, find_declared_plan
from desirepath.report.choice_findings import (
    Agreement,
    OfCondition,
    OfDegrees,
    OfSeveral,
    Pair,
    Triads,
    compare_conditions,
    count_triads,
    describe_condition,
    describe_degrees,
    describe_several,
    disagreement,
)
from desirepath.report.explanation_findings import Explained, analyse_rankings
from desirepath.report.further_findings import Further, analyse_further
from desirepath.report.item_tests import ItemResult, item_results
from desirepath.report.marked_moments import Marked, describe_marks
from desirepath.report.meeting import Met, summarise_meetings
from desirepath.report.method_findings import Methods, analyse_methods
from desirepath.report.own_findings import Guessed, Personalised, compare_own, count_guesses
from desirepath.report.rating_findings import (
    Described,
    RankingResult,
    ScaleResult,
    demographics,
    measures,
    ranking_results,
    scale_results,
)
from desirepath.report.study_data import Choice, Load, ParticipantRow, StudyData
from desirepath.report.study_design import StudyDesign, designs_of
from desirepath.report.told_rules import OfRules, summarise_rules
from desirepath.store.who_counts import FINISHED, is_asked_for, left_out

Who = Literal["people", "simulated", "all"]


class NothingToReport(ValueError):
    """A study without answers of those who were asked for; says whose there are."""


@dataclass(frozen=True)
class OfDevice:
    """Who answered with a device, and what is known of these answers."""

    people: int
    of: OfCondition


@dataclass(frozen=True)
class Flow:
    """How many there are at each stage. excluded: reason -> people. unfinished: state -> people."""

    joined: int
    withdrawn: int
    excluded: Mapping[str, int]
    unfinished: Mapping[str, int]
    analysed: int


@dataclass(frozen=True)
class Findings:
    """All of it, of the kind of participants named in `who`. analysed: their codes. own_policies: what became of the
    policies made from their answers -> people. asked_on: who was asked further pairs since what was learned was not
    surely theirs -> further answers."""

    who: Who
    analysed: Sequence[str]
    simulated: int
    plan: AnalysisPlan
    plan_hash: str
    declared_hash: str | None
    deviations: Sequence[str]
    conditions: Sequence[str]
    designs: Sequence[StudyDesign]
    flow: Flow
    orders: Mapping[str, int]
    demographics: Sequence[Described]
    items: Sequence[ItemResult]
    rankings: Sequence[RankingResult]
    scales: Sequence[ScaleResult]
    of_condition: Mapping[str, OfCondition]
    between: Mapping[Pair, Agreement]
    triads: Mapping[str, Triads]
    disagreement: Mapping[Pair, Mapping[Metric, Mean]]
    personalised: Sequence[Personalised]
    own_policies: Mapping[str, int]
    asked_on: Mapping[str, int]
    guessed: Guessed | None
    met: Met | None
    ways: Methods | None
    further: Further | None
    explained: Explained | None
    devices: Mapping[tuple[str, str], OfDevice]
    degrees: Mapping[str, OfDegrees]
    ruled: OfRules | None
    several: Sequence[OfSeveral]
    marked: Marked | None

    @property
    def tests(self) -> list[Tested]:
        """Every tested result, in the report's order."""
        families = [[*item.tests, *item.pairs] for item in self.items] + [
            [ranking.test, *ranking.pairs] for ranking in self.rankings
        ]
        own = [comparison.test for comparison in self.personalised] + ([self.guessed.test] if self.guessed else [])
        own += self.ways.tests if self.ways else []
        return [
            *(test for family in families for test in family), *(self.explained.tests if self.explained else ()), *own
        ]  # fmt: skip


def analyse(
    data: StudyData,
    load: Load,
    who: Who = "people",
    plan: AnalysisPlan | None = None,
    *,
    intervals: bool = True,
    beside: bool | None = None,
) -> Findings:
    """The study's numbers. load: of trajectories, for the disagreement metrics. plan: another than the declared one.
    Declared is what the study began with; a plan that came with a later version is used and reported as deviations.
    intervals: of effects; beside: all that stands beside the declared tests (default as intervals). Both take most of
    the time.

    Practice trials never count, nor do people who were excluded or withdrew. Raises NothingToReport.
    """
    declared = find_declared_plan(dict(data.protocol))
    revised = find_declared_plan(dict(data.newest)) if data.newest is not None else declared
    used = plan or revised or AnalysisPlan()
    everyone = [row for row in data.people if is_asked_for(who, simulated=row.simulated)]
    analysed = [row for row in everyone if _counts(row, used)]
    if not analysed:
        kinds = Counter("simulated participants" if row.simulated else "people" for row in data.people)
        counted = ", ".join(f"{count} {kind}" for kind, count in kinds.items()) or "nobody"
        raise NothingToReport(
            f"who = {who!r}: none of them has a {'completed ' if used.sessions == 'completed' else ''}session that "
            f"counts (joined: {counted}; excluded or withdrawn: {sum(map(_left_out, data.people))}); choose people, "
            "simulated or all"
        )
    own = data.of({row.code for row in analysed})
    conditions = own.conditions
    regular = [choice for choice in own.choices if choice.role == "regular"]
    answered = {choice.condition for choice in regular} | {ranking.condition for ranking in own.importance}
    queried = (
        tuple(name for name in conditions if name in answered) if regular else ()
    )  # otherwise they were rated only
    designs, scales = designs_of(own), scale_results(own)
    every_rated = measures(own, used, scales)
    ranked = analyse_rankings(own.importance, every_rated, used, intervals=intervals)
    of_explanations = set(ranked.items) if ranked else set()
    rated = [of for of in every_rated if (of.item.questionnaire, of.item.key) not in of_explanations]
    return Findings(
        who=who,
        analysed=tuple(row.code for row in analysed),
        simulated=sum(row.simulated for row in analysed),
        plan=used,
        plan_hash=used.digest(),
        declared_hash=declared.digest() if declared else None,
        deviations=deviations(declared, used),
        conditions=conditions,
        designs=designs,
        flow=_flow(everyone, analysed, used),
        orders=dict(sorted(Counter(", ".join(c for c in row.order if c in conditions) for row in analysed).items())),
        demographics=demographics(own),
        items=item_results(rated, designs, used, intervals=intervals),
        rankings=ranking_results(own.ratings, used, own, intervals=intervals),
        scales=scales,
        of_condition={name: describe_condition(own.choices, name, used) for name in queried},
        between={pair: compare_conditions(regular, pair) for pair in combinations(queried, 2)},
        triads={name: of for name in queried if (of := count_triads(own.choices, name))},
        disagreement=disagreement(regular, queried, used.metrics, load),
        personalised=compare_own(own.comparisons, used),
        own_policies=dict(Counter(row.own_policy for row in analysed if row.own_policy is not None)),
        asked_on={row.code: row.further for row in analysed if row.further},
        guessed=count_guesses(own.guesses),
        met=summarise_meetings(own.meetings),
        ways=analyse_methods(own.method_choices, own.taught, used),
        further=analyse_further(own, rated, designs, used, list(combinations(queried, 2)))
        if (intervals if beside is None else beside)
        else None,
        explained=ranked,
        devices=_devices(own.choices, {row.code: row for row in analysed}, used)
        if (intervals if beside is None else beside)
        else {},
        ruled=summarise_rules(own.told_rules),
        degrees={name: said for name in conditions if (said := describe_degrees(own.degrees, name)) is not None},
        several=describe_several(own.several),
        marked=describe_marks(own.marked, load),
    )


def _left_out(person: ParticipantRow) -> bool:
    return left_out(excluded=person.excluded is not None, withdrawn=person.withdrawn) is not None


def _counts(person: ParticipantRow, plan: AnalysisPlan) -> bool:
    return not _left_out(person) and (plan.sessions == "all" or person.state == FINISHED)


def _flow(everyone: Sequence[ParticipantRow], analysed: Sequence[ParticipantRow], plan: AnalysisPlan) -> Flow:
    open_ones = [row for row in everyone if not _left_out(row) and not _counts(row, plan)]
    return Flow(
        joined=len(everyone),
        withdrawn=sum(row.withdrawn for row in everyone),
        excluded=dict(Counter(row.excluded for row in everyone if row.excluded and not row.withdrawn)),
        unfinished=dict(Counter(row.state for row in open_ones)),
        analysed=len(analysed),
    )


def _devices(
    choices: Sequence[Choice], people: Mapping[str, ParticipantRow], plan: AnalysisPlan
) -> dict[tuple[str, str], OfDevice]:
    """By (what it was seen as, device), so that nobody takes a window for a headset."""
    seen: dict[tuple[str, str], list[Choice]] = defaultdict(list)
    for choice in choices:
        device = device_words(choice, people[choice.person])
        in_window = ", in the window" if choice.view == "immersive" and not choice.device.get("headset") else ""
        seen[choice.view + in_window, device].append(replace(choice, condition=device))
    return {
        key: OfDevice(
            len({choice.person for choice in mine if choice.role == "regular"}), describe_condition(mine, key[1], plan)
        )
        for key, mine in sorted(seen.items())
    }


def device_words(choice: Choice, person: ParticipantRow) -> str:
    """What an answer was given on, as far as its page reported."""
    device = choice.device
    worn = {"all": "headset", "partly": "headset and window"}.get(str(device.get("headset")))
    if person.simulated and "pointer" not in device:
        return f"{worn or 'none'} (simulated)"
    if not device:
        return "not told"
    if worn:
        return worn
    return {"fine": "mouse or touchpad", "coarse": "touch"}.get(str(device.get("pointer")), "another pointer")

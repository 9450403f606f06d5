"""Everything a study's report says, as numbers: from tidy rows and an analysis plan to tested results. Pure.

Each kind of question has its function here; the tests themselves live in `analysis`, words and figures beside.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from backend.analysis.choices import (
    agreement,
    cohens_kappa,
    equal_first_choices,
    first_choice_pairs,
    mostly,
    share_over_people,
)
from backend.analysis.metrics import measure
from backend.analysis.repeated import friedman, pairs_of
from backend.analysis.tested import Mean, Tested, corrected, mean_of
from backend.report.data import PROBES, Choice, Comparison, ItemText, Load, Person, Rating, StudyData
from backend.report.plan import METRICS, AnalysisPlan, Metric, declared_plan, deviations

Who = Literal["people", "simulated", "all"]
Pair = tuple[str, str]


class NothingToReport(ValueError):
    """A study without answers of those who were asked for; says whose there are."""


@dataclass(frozen=True)
class Flow:
    """How many there are at each stage. excluded: reason -> people. unfinished: state -> people."""

    joined: int
    withdrawn: int
    excluded: Mapping[str, int]
    unfinished: Mapping[str, int]
    analysed: int


@dataclass(frozen=True)
class Described:
    """An item that was asked once, outside blocks. counts: answer -> people; numbers: where answers are numbers."""

    item: ItemText
    n: int
    counts: Mapping[str, int]
    numbers: Mean | None


@dataclass(frozen=True)
class ItemResult:
    """One item under each condition. people: who answered it under all of them; pairs: where Friedman's was
    significant, or where the plan wants them always."""

    item: ItemText
    means: Mapping[str, Mean]
    test: Tested
    pairs: Sequence[Tested]


@dataclass(frozen=True)
class RankingResult:
    """One forced ranking. places: condition -> people who put it first, second, ..."""

    item: ItemText
    places: Mapping[str, Sequence[int]]
    test: Tested
    pairs: Sequence[Tested]


@dataclass(frozen=True)
class Agreement:
    """How often the same people chose alike, over people. kappa: of the places chosen (first or second shown).

    no_kappa: people whose kappa is not defined, because they always chose the same place.
    """

    share: Mean
    kappa: Mean
    no_kappa: int


@dataclass(frozen=True)
class OfCondition:
    """What is known of each condition beside the tests. repeat, swap: agreement with the own first answer."""

    answers: int
    second_shown: Mean
    decision_s: Mean
    repeat: Agreement
    swap: Agreement


@dataclass(frozen=True)
class Personalised:
    """Own policy against another arm, over people. share: of a person's choices; look_alike: left out of nothing."""

    against: str
    share: Mean
    test: Tested
    answers: int
    look_alike: int


@dataclass(frozen=True)
class Findings:
    """All of it, of the kind of participants named in `who`."""

    who: Who
    simulated: int
    plan: AnalysisPlan
    plan_hash: str
    declared_hash: str | None
    deviations: Sequence[str]
    conditions: Sequence[str]
    flow: Flow
    orders: Mapping[str, int]
    demographics: Sequence[Described]
    items: Sequence[ItemResult]
    rankings: Sequence[RankingResult]
    of_condition: Mapping[str, OfCondition]
    between: Mapping[Pair, Agreement]
    disagreement: Mapping[Pair, Mapping[Metric, Mean]]
    personalised: Sequence[Personalised]
    devices: Mapping[tuple[str, str], int]

    @property
    def tests(self) -> list[Tested]:
        """Every tested result, in the report's order."""
        families = [[one.test, *one.pairs] for one in self.items] + [[one.test, *one.pairs] for one in self.rankings]
        return [test for family in families for test in family] + [one.test for one in self.personalised]


def analyse(data: StudyData, load: Load, who: Who = "people", plan: AnalysisPlan | None = None) -> Findings:
    """The study's numbers. load: of trajectories, for the disagreement metrics. plan: another than the declared one.
    Declared is what the study began with; a plan that came with a later version is used and told as deviations.

    Learning trials never count, nor do people who were excluded or withdrew. Raises NothingToReport.
    """
    declared = declared_plan(dict(data.protocol))
    revised = declared_plan(dict(data.newest)) if data.newest is not None else declared
    used = plan or revised or AnalysisPlan()
    everyone = [one for one in data.people if who == "all" or one.simulated == (who == "simulated")]
    kept = [one for one in everyone if _counts(one, used)]
    if not kept:
        there = Counter("simulated participants" if one.simulated else "people" for one in data.people)
        told = ", ".join(f"{count} {kind}" for kind, count in there.items()) or "nobody"
        raise NothingToReport(
            f"who = {who!r}: none of them has a {'completed ' if used.sessions == 'completed' else ''}session that "
            f"counts (joined: {told}; excluded or withdrawn: {sum(map(_left_out, data.people))}); choose people, "
            "simulated or all"
        )
    own = data.of({one.code for one in kept})
    conditions = own.conditions
    regular = [one for one in own.choices if one.role == "regular"]
    queried = conditions if regular else ()  # otherwise they were rated only
    return Findings(
        who=who,
        simulated=sum(one.simulated for one in kept),
        plan=used,
        plan_hash=used.digest(),
        declared_hash=declared.digest() if declared else None,
        deviations=deviations(declared, used),
        conditions=conditions,
        flow=_flow(everyone, kept, used),
        orders=dict(sorted(Counter(", ".join(c for c in one.order if c in conditions) for one in kept).items())),
        demographics=_demographics(own),
        items=item_results(own.ratings, conditions, used, own),
        rankings=ranking_results(own.ratings, used, own),
        of_condition={name: _of_condition(own.choices, name, used) for name in queried},
        between={pair: _between(regular, pair) for pair in combinations(queried, 2)},
        disagreement=_disagreement(regular, queried, used.metrics, load),
        personalised=personalised(own.comparisons, used),
        devices=_devices(own.choices, {one.code: one for one in kept}),
    )


def _left_out(person: Person) -> bool:
    return person.withdrawn or person.excluded is not None


def _counts(person: Person, plan: AnalysisPlan) -> bool:
    return not _left_out(person) and (plan.sessions == "all" or person.state == "completed")


def _flow(everyone: Sequence[Person], kept: Sequence[Person], plan: AnalysisPlan) -> Flow:
    open_ones = [one for one in everyone if not _left_out(one) and not _counts(one, plan)]
    return Flow(
        joined=len(everyone),
        withdrawn=sum(one.withdrawn for one in everyone),
        excluded=dict(Counter(one.excluded for one in everyone if one.excluded and not one.withdrawn)),
        unfinished=dict(Counter(one.state for one in open_ones)),
        analysed=len(kept),
    )


def _devices(choices: Sequence[Choice], people: Mapping[str, Person]) -> dict[tuple[str, str], int]:
    """(view, device) -> regular answers, so that nobody takes a desktop's camera for a headset."""
    counted = Counter((one.view, device_words(people[one.person].device)) for one in choices if one.role == "regular")
    return dict(sorted(counted.items()))


def device_words(device: Mapping[str, Any]) -> str:
    """What a session's device was, as far as its page told."""
    if not device:
        return "not told"
    if device.get("headset"):
        return "headset"
    return {"fine": "mouse or touchpad", "coarse": "touch"}.get(str(device.get("pointer")), "another pointer")


# ---- questionnaires --------------------------------------------------------------------------------------------------


def _demographics(data: StudyData) -> list[Described]:
    """Items outside blocks that are no rankings."""
    answers: dict[tuple[str, str], list[Any]] = defaultdict(list)
    for one in data.ratings:
        if one.condition is None and not isinstance(one.value, list):
            answers[one.questionnaire, one.item].append(one.value)
    found = []
    for (questionnaire, key), values in sorted(answers.items(), key=lambda one: data.place(*one[0])):
        item = data.item(questionnaire, key)
        if item.type == "text":
            continue  # free text is read by people, not counted
        numbers = item.type in ("scale", "number")
        counts = {} if numbers else {label: values.count(value) for value, label in item.options.items()}
        found.append(Described(item, len(values), counts, mean_of(values) if numbers else None))
    return found


def item_results(
    ratings: Sequence[Rating], conditions: Sequence[str], plan: AnalysisPlan, data: StudyData
) -> list[ItemResult]:
    """Friedman per item over the people who rated it under every condition, p corrected over the items; Wilcoxon in
    pairs (Bonferroni) where significant or always, as the plan says. Whoever rated a condition more than once, as a
    controller in each environment, counts with the mean. Fewer than three conditions, or two people, cannot be tested.
    """
    table: dict[tuple[str, str], dict[str, dict[str, list[float]]]] = defaultdict(dict)
    for one in ratings:
        asked = plan.items is None or one.questionnaire == plan.items
        if asked and one.condition is not None and one.condition in conditions and isinstance(one.value, int | float):
            rated_by = table[one.questionnaire, one.item].setdefault(one.person, {})
            rated_by.setdefault(one.condition, []).append(float(one.value))
    complete: dict[tuple[str, str], NDArray[np.float64]] = {}
    for key, rated in sorted(table.items(), key=lambda one: data.place(*one[0])):
        rows = [
            [float(np.mean(of[name])) for name in conditions] for of in rated.values() if len(of) == len(conditions)
        ]
        if len(rows) >= 2 and len(conditions) >= 3:
            complete[key] = np.array(rows)
    tests = corrected([friedman(rows, about=_rating_of(key[1])) for key, rows in complete.items()], plan.correction)
    return [
        ItemResult(
            item=data.item(*key),
            means={name: mean_of(rows[:, k]) for k, name in enumerate(conditions)},
            test=test,
            pairs=(
                corrected(pairs_of(rows, [_named(c) for c in conditions], about=test.about), "bonferroni")
                if plan.pairs == "always" or test.significant(plan.alpha)
                else ()
            ),
        )
        for (key, rows), test in zip(complete.items(), tests, strict=True)
    ]


def _rating_of(item: str) -> str:
    return f"rating of {_named(item)}"


def _named(name: str) -> str:
    return name.replace("_", " ")


def ranking_results(ratings: Sequence[Rating], plan: AnalysisPlan, data: StudyData) -> list[RankingResult]:
    """Chi-square of first choices per ranking, p corrected over the rankings; z in pairs (Bonferroni) where
    significant."""
    orders: dict[tuple[str, str], list[list[str]]] = defaultdict(list)
    for one in ratings:
        if isinstance(one.value, list) and (plan.ranking is None or one.questionnaire == plan.ranking):
            orders[one.questionnaire, one.item].append([str(option) for option in one.value])
    places: dict[tuple[str, str], dict[str, list[int]]] = {}
    for key, given in sorted(orders.items(), key=lambda one: data.place(*one[0])):
        names = sorted({name for order in given for name in order})
        places[key] = {name: [sum(o[k] == name for o in given) for k in range(len(names))] for name in names}
    tests = corrected(
        [
            equal_first_choices([of[0] for of in found.values()], about=f"first choices for {_named(key[1])}")
            for key, found in places.items()
        ],
        plan.correction,
    )
    return [
        RankingResult(
            item=data.item(*key),
            places=found,
            test=test,
            pairs=(
                corrected(
                    first_choice_pairs(
                        [of[0] for of in found.values()], [_named(name) for name in found], about=test.about
                    ),
                    "bonferroni",
                )
                if test.significant(plan.alpha)
                else ()
            ),
        )
        for (key, found), test in zip(places.items(), tests, strict=True)
    ]


# ---- choices ---------------------------------------------------------------------------------------------------------


def _of_condition(choices: Sequence[Choice], condition: str, plan: AnalysisPlan) -> OfCondition:
    own = [one for one in choices if one.condition == condition]
    regular = [one for one in own if one.role == "regular"]
    by_person = _by_person(regular)
    first_answers = {(one.person, one.query): one for one in regular}
    again = {
        role: _over_people(
            {
                person: [
                    (first_answers[person, one.query], one) for one in given if (person, one.query) in first_answers
                ]
                for person, given in _by_person([one for one in own if one.role == role]).items()
            },
            fewest=plan.min_probes,
        )
        for role in PROBES
    }
    seconds = [[one.decision_s for one in given if one.decision_s is not None] for given in by_person.values()]
    return OfCondition(
        answers=len(regular),
        second_shown=mean_of([float(np.mean([o.second_chosen for o in given])) for given in by_person.values()]),
        decision_s=mean_of([float(np.median(one)) for one in seconds if one]),
        repeat=again["repeat"],
        swap=again["swap"],
    )


def _by_person(choices: Sequence[Choice]) -> dict[str, list[Choice]]:
    found: dict[str, list[Choice]] = defaultdict(list)
    for one in choices:
        found[one.person].append(one)
    return found


def _between(regular: Sequence[Choice], pair: Pair) -> Agreement:
    """Agreement of the same person's answers to the same queries under two conditions."""
    return _over_people({person: _both(given, pair) for person, given in _by_person(regular).items()})


def _both(given: Sequence[Choice], pair: Pair) -> list[tuple[Choice, Choice]]:
    """One person's answers to the queries that were asked under both conditions."""
    first, second = ({one.query: one for one in given if one.condition == name} for name in pair)
    return [(first[query], second[query]) for query in sorted(first.keys() & second.keys())]


def _over_people(pairs: Mapping[str, Sequence[tuple[Choice, Choice]]], fewest: int = 1) -> Agreement:
    shares, kappas = [], []
    for given in pairs.values():
        if len(given) < fewest:
            continue
        shares.append(agreement([a.chosen for a, _ in given], [b.chosen for _, b in given]))
        kappas.append(cohens_kappa([a.second_chosen for a, _ in given], [b.second_chosen for _, b in given]))
    return Agreement(mean_of(shares), mean_of(kappas), sum(math.isnan(kappa) for kappa in kappas))


def _disagreement(
    regular: Sequence[Choice], conditions: Sequence[str], metrics: Sequence[Metric], load: Load
) -> dict[Pair, dict[Metric, Mean]]:
    """Where a choice flips from one condition to another: the preferred trajectory there minus the one here.

    z-scored over all trajectories that the person was shown, averaged within people, then over them (thesis 7.4.4.2).
    Descriptive: what the two drives of a query differ in was made, not observed.
    """
    transitions = list(combinations(conditions, 2))
    shown = sorted({trajectory for one in regular for trajectory in (one.first, one.second)})
    if not (shown and transitions and metrics):
        return {}
    measured = measure([load(trajectory) for trajectory in shown])
    values = np.stack([np.asarray(getattr(measured, name), dtype=float) for name in metrics], axis=1)
    row_of = {trajectory: k for k, trajectory in enumerate(shown)}
    per_person: dict[Pair, list[NDArray[np.float64]]] = {pair: [] for pair in transitions}
    for given in _by_person(regular).values():
        seen = {row_of[t] for one in given for t in (one.first, one.second)}
        of_person = values[sorted(seen)]
        deviation = of_person.std(axis=0, ddof=1) if len(of_person) > 1 else np.zeros(len(metrics))
        scored = values / np.where(deviation > 0, deviation, math.nan)  # the mean cancels in a difference
        for pair in transitions:
            flips = [
                scored[row_of[there.chosen]] - scored[row_of[here.chosen]]
                for here, there in _both(given, pair)
                if here.chosen != there.chosen
            ]
            if flips:
                per_person[pair].append(np.mean(flips, axis=0))
    return {
        pair: {name: mean_of([float(row[k]) for row in rows]) for k, name in enumerate(metrics)}
        for pair, rows in per_person.items()
    }


def personalised(comparisons: Sequence[Comparison], plan: AnalysisPlan) -> list[Personalised]:
    """The own policy against the base's and against another participant's, p corrected over the two. People are the
    units: answers of one person depend on each other."""
    words = {"base": "the base policy", "other": "another participant's policy"}
    counted: dict[str, dict[str, Counter[str]]] = {}
    for against in words:
        asked = [one for one in comparisons if {one.chosen, one.rejected} == {"own", against}]
        if asked:
            counted[against] = defaultdict(Counter)
            for one in asked:
                counted[against][one.person][one.chosen] += 1
    pairs = {
        against: ([of["own"] for of in people.values()], [of[against] for of in people.values()])
        for against, people in counted.items()
    }
    tests = corrected(
        [
            mostly(*pair, about=f"own policy against {words[against]}", names=("the own policy", words[against]))
            for against, pair in pairs.items()
        ],
        plan.correction,
    )
    return [
        Personalised(
            against=against,
            share=share_over_people(*pair),
            test=test,
            answers=sum(map(sum, pair)),
            look_alike=sum(one.look_alike and against in (one.chosen, one.rejected) for one in comparisons),
        )
        for (against, pair), test in zip(pairs.items(), tests, strict=True)
    ]


METRIC_WORDS = {name: f"{words} ({unit})" for name, (words, unit) in METRICS.items()}

"""What was chosen: agreement between and within conditions, circular triads, what changes where choices differ. Pure.

The own policy against others is `own_findings.py`'s, what was rated `rating_findings.py`'s, everything together
`findings.py`'s.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.choices import agreement, cohens_kappa
from desirepath.analysis.intervals import clustered_share, end_at_scale
from desirepath.analysis.metrics import measure
from desirepath.analysis.tested import Mean, has_spread, mean_of
from desirepath.analysis.triads import is_circular, whole_triads
from desirepath.report.analysis_plan import AnalysisPlan, Metric
from desirepath.report.study_data import PROBES, TRIAD, Choice, Degree, Load, SeveralAnswer

Pair = tuple[str, str]


@dataclass(frozen=True)
class Agreement:
    """How often the same people chose alike, over people. kappa: of the trajectories chosen, called by the place (first
    or second shown) that they had when they were first shown.

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
class Triads:
    """Scenes of which three trajectories were compared in all three pairs. circular: A over B over C over A, which no
    order of preference allows. share: circular ones of a person's, over people."""

    triads: int
    circular: int
    share: Mean


@dataclass(frozen=True)
class OfDegrees:
    """How clear the answers under one condition were, shares over people. no_difference: of all; clear: of those in
    which one was better, nobody's where that was not asked."""

    answers: int
    no_difference: Mean
    clear: Mean


def describe_degrees(degrees: Sequence[Degree], condition: str) -> OfDegrees | None:
    """None where only A or B could be answered."""
    own: dict[str, list[str | None]] = defaultdict(list)
    for said in degrees:
        if said.condition == condition:
            own[said.person].append(said.degree)
    if not own:
        return None
    graded = {person: kept for person, of in own.items() if (kept := [d for d in of if d in ("slight", "clear")])}
    return OfDegrees(sum(map(len, own.values())), _share(own, "no_difference"), _share(graded, "clear"))


@dataclass(frozen=True)
class OfSeveral:
    """What was said of several trajectories at once under one condition: how many answers; share of people's answers in
    which the first one shown was liked best, of those that name one, and by chance; seconds until the answer, the
    watching included, mean of people's medians."""

    condition: str
    ask: str
    of: int
    answers: int
    first_best: Mean
    decision_s: Mean


def describe_several(answers: Sequence[SeveralAnswer]) -> list[OfSeveral]:
    """By condition, what was asked for and of how many."""
    alike: dict[tuple[str, str, int], dict[str, list[SeveralAnswer]]] = defaultdict(lambda: defaultdict(list))
    for said in answers:
        alike[said.condition, said.ask, said.of][said.person].append(said)
    found = []
    for (condition, ask, of), own in sorted(alike.items()):
        named = [[said.best == 1 for said in said_by if said.best] for said_by in own.values()]
        shares = [(sum(firsts) / len(firsts), len(firsts)) for firsts in named if firsts]
        first = clustered_share(*zip(*shares, strict=True)) if shares else mean_of([])
        times = [[said.decision_s for said in said_by if said.decision_s is not None] for said_by in own.values()]
        took = mean_of([float(np.median(of_one)) for of_one in times if of_one])
        found.append(OfSeveral(condition, ask, of, sum(map(len, own.values())), first, took))
    return found


def _share(own: Mapping[str, Sequence[str | None]], degree: str) -> Mean:
    """Of everybody's answers, over people."""
    shares = [sum(said == degree for said in of) / len(of) for of in own.values()]
    return clustered_share(shares, [len(of) for of in own.values()]) if shares else mean_of([])


def describe_condition(choices: Sequence[Choice], condition: str, plan: AnalysisPlan) -> OfCondition:
    own = [choice for choice in choices if choice.condition == condition]
    regular = [choice for choice in own if choice.role == "regular"]
    by_person = _by_person(regular)
    first_answers = {(choice.person, choice.query): choice for choice in regular}
    again = {
        role: _over_people(
            {
                person: [
                    (first_answers[person, choice.query], choice)
                    for choice in of_person
                    if (person, choice.query) in first_answers
                ]
                for person, of_person in _by_person([choice for choice in own if choice.role == role]).items()
            },
            fewest=plan.min_probes,
        )
        for role in PROBES
    }
    seconds = [
        [choice.decision_s for choice in of_person if choice.decision_s is not None] for of_person in by_person.values()
    ]
    return OfCondition(
        answers=len(regular),
        second_shown=clustered_share(
            [float(np.mean([choice.second_chosen for choice in of_person])) for of_person in by_person.values()],
            [len(of_person) for of_person in by_person.values()],
        ),
        decision_s=mean_of([float(np.median(times)) for times in seconds if times]),
        repeat=again["repeat"],
        swap=again["swap"],
    )


def _by_person(choices: Sequence[Choice]) -> dict[str, list[Choice]]:
    by_person: dict[str, list[Choice]] = defaultdict(list)
    for choice in choices:
        by_person[choice.person].append(choice)
    return by_person


def compare_conditions(regular: Sequence[Choice], pair: Pair) -> Agreement:
    """Agreement of the same person's answers to the same queries under two conditions."""
    return _over_people({person: _both(of_person, pair) for person, of_person in _by_person(regular).items()})


def _both(of_person: Sequence[Choice], pair: Pair) -> list[tuple[Choice, Choice]]:
    """One person's answers to the queries that were asked under both conditions."""
    first, second = ({choice.query: choice for choice in of_person if choice.condition == name} for name in pair)
    return [(first[query], second[query]) for query in sorted(first.keys() & second.keys())]


def _over_people(pairs: Mapping[str, Sequence[tuple[Choice, Choice]]], fewest: int = 1) -> Agreement:
    shares, sizes, kappas = [], [], []
    for both in pairs.values():
        if len(both) < fewest:
            continue
        sizes.append(len(both))
        shares.append(agreement([a.chosen for a, _ in both], [b.chosen for _, b in both]))
        # places are those of the first answer: with the sides swapped whoever is steady takes the other place
        kappas.append(cohens_kappa([a.second_chosen for a, _ in both], [b.chosen == a.second for a, b in both]))
    kappa = end_at_scale(mean_of(kappas), -1.0, 1.0)
    return Agreement(clustered_share(shares, sizes), kappa, sum(math.isnan(kappa) for kappa in kappas))


def agree_per_person(
    choices: Sequence[Choice], pairs: Sequence[Pair], plan: AnalysisPlan
) -> tuple[dict[str, float], dict[str, float]]:
    """Each person's mean agreement between conditions, and with the own first answer within them (asked again as it
    was; where there are enough, `min_probes`)."""
    by_person = _by_person(choices)
    between_all: dict[str, float] = {}
    within_all: dict[str, float] = {}
    for person, of_person in by_person.items():
        regular = [choice for choice in of_person if choice.role == "regular"]
        shares = [
            agreement([a.chosen for a, _ in both], [b.chosen for _, b in both])
            for pair in pairs
            if (both := _both(regular, pair))
        ]
        again = []
        for condition in {name for pair in pairs for name in pair}:
            first = {choice.query: choice for choice in regular if choice.condition == condition}
            repeats = [
                choice
                for choice in of_person
                if choice.role == "repeat" and choice.condition == condition and choice.query in first
            ]
            if len(repeats) >= plan.min_probes:
                again.append(
                    agreement([first[repeat.query].chosen for repeat in repeats], [repeat.chosen for repeat in repeats])
                )
        if shares:
            between_all[person] = float(np.mean(shares))
        if again:
            within_all[person] = float(np.mean(again))
    return between_all, within_all


def count_triads(choices: Sequence[Choice], condition: str) -> Triads | None:
    """The condition's triads that were answered whole; None where there are none."""
    triad_choices = [choice for choice in choices if choice.role == TRIAD and choice.condition == condition]
    shares: list[float] = []
    sizes: list[int] = []
    count = circular = 0
    for of_person in _by_person(triad_choices).values():
        whole = whole_triads({frozenset({choice.first, choice.second}): choice for choice in of_person})
        ways = sum(is_circular([(choice.chosen, choice.rejected) for choice in three]) for three in whole)
        count, circular = count + len(whole), circular + ways
        if whole:
            shares.append(ways / len(whole))
            sizes.append(len(whole))
    return Triads(count, circular, clustered_share(shares, sizes)) if count else None


def disagreement(
    regular: Sequence[Choice], conditions: Sequence[str], metrics: Sequence[Metric], load: Load
) -> dict[Pair, dict[Metric, Mean]]:
    """Where a choice flips from one condition to another: the preferred trajectory there minus the one here.

    z-scored over all trajectories that the person was shown, averaged within people, then over them (thesis 7.4.4.2).
    Descriptive: what the two trajectories of a query differ in was made, not observed.
    """
    transitions = list(combinations(conditions, 2))
    shown = sorted({trajectory for choice in regular for trajectory in (choice.first, choice.second)})
    if not (shown and transitions and metrics):
        return {}
    measured = measure([load(trajectory) for trajectory in shown])
    values = np.stack([np.asarray(getattr(measured, name), dtype=float) for name in metrics], axis=1)
    row_of = {trajectory: k for k, trajectory in enumerate(shown)}
    per_person: dict[Pair, list[NDArray[np.float64]]] = {pair: [] for pair in transitions}
    for choices in _by_person(regular).values():
        seen = {row_of[t] for choice in choices for t in (choice.first, choice.second)}
        of_person = values[sorted(seen)]
        deviation = [float(of.std(ddof=1)) if has_spread(of) else math.nan for of in of_person.T]
        scored = values / np.array(deviation)  # the mean cancels in a difference
        for pair in transitions:
            flips = [
                scored[row_of[after.chosen]] - scored[row_of[before.chosen]]
                for before, after in _both(choices, pair)
                if before.chosen != after.chosen
            ]
            if flips:
                per_person[pair].append(np.mean(flips, axis=0))
    return {
        pair: {name: mean_of([float(row[k]) for row in rows]) for k, name in enumerate(metrics)}
        for pair, rows in per_person.items()
    }

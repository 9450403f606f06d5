"""What stands beside the declared tests: order effects, consistency as a yardstick, equivalence, Bayes factors,
reliability of scales, worths of arms, mixed models. Pure; none of it is in the tests' families.

What was declared to be tested is in `rating_findings.py`, `choice_findings.py` and `own_findings.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.between_groups import mann_whitney
from desirepath.analysis.bradley_terry import Worth, bradley_terry, count_wins
from desirepath.analysis.equivalence import bayes_factor, bayes_factor_of_choices, equivalence
from desirepath.analysis.mixed_models import NoFit, RatioTest, chance_of_the_higher, cumulative_logit, ratio_test
from desirepath.analysis.reliability import Reliability, reliability
from desirepath.analysis.repeated_measures import friedman, wilcoxon
from desirepath.analysis.tested import Tested, correct_tests
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.choice_findings import Pair, agree_per_person
from desirepath.report.own_findings import ARMS, own_against, own_shares
from desirepath.report.rating_findings import Measure
from desirepath.report.report_cells import name_in_words
from desirepath.report.study_data import Choice, StudyData, find_askings, find_topic
from desirepath.report.study_design import StudyDesign

UNBOUNDED = 30.0  # log odds: likelier than a million millions to one


@dataclass(frozen=True)
class Weighed:
    """A Bayes factor: how much likelier the data are with a difference than without one."""

    about: str
    factor: float


@dataclass(frozen=True)
class ScaleReliability:
    """Of a scale's items about one condition, or of one asking outside blocks ("": asked once)."""

    scale: str
    condition: str
    of: Reliability


@dataclass(frozen=True)
class Modelled:
    """A mixed model. effects: what differs from the first condition, as odds ratios with 95 % intervals, or a chance;
    test: of all conditions together; problem: why there are no effects."""

    about: str
    effects: Sequence[tuple[str, float, float, float]]
    person_sd: float | None
    test: RatioTest | None
    problem: str | None = None


@dataclass(frozen=True)
class Further:
    """Everything beside the declared tests."""

    order_effects: Sequence[Tested]
    against_retest: Tested | None
    equivalent: Sequence[Tested]
    weighed: Sequence[Weighed]
    reliabilities: Sequence[ScaleReliability]
    worths: Sequence[Worth]
    models: Sequence[Modelled]


def analyse_further(
    data: StudyData, rated: Sequence[Measure], designs: Sequence[StudyDesign], plan: AnalysisPlan, pairs: Sequence[Pair]
) -> Further:
    """All of it, of the people in `data` who count. pairs: of conditions whose answers agree or not."""
    regular = [choice for choice in data.choices if choice.role == "regular"]
    return Further(
        order_effects=_order_effects(data, rated, designs),
        against_retest=_against_retest(data.choices, pairs, plan),
        equivalent=_equivalent(data, rated, designs, plan),
        weighed=_weigh(data, rated, designs) if plan.bayes_factors else (),
        reliabilities=_reliabilities(data),
        worths=_worths(data),
        models=_models(data, rated, designs, regular) if plan.models else (),
    )


def _order_effects(data: StudyData, rated: Sequence[Measure], designs: Sequence[StudyDesign]) -> list[Tested]:
    """Period: whether ratings change from the first condition met to the last, whichever they were. Carry-over, of two
    conditions: whether the sum of both depends on which came first (Grizzle 1965)."""
    order = {row.code: row.order for row in data.people}
    tests: list[Tested] = []
    for design, measure, people, table in _within_people(rated, designs):
        cells, item = list(design.cells), name_in_words(measure.item.key)
        met = [[name for name in order[person] if name in cells] for person in people]
        known = [k for k, names in enumerate(met) if sorted(names) == sorted(cells)]
        if len(known) < 2 or len({tuple(met[k]) for k in known}) < 2:
            continue
        by_period = np.array([[table[k, cells.index(name)] for name in met[k]] for k in known])
        about = f"{item}, first to last condition met"
        if len(cells) > 2:
            test = friedman(by_period, about=about)
            tests.append(replace(test, direction="ratings change from period to period"))
            continue
        tests.append(wilcoxon(*by_period.T, about=about, names=("the first period", "the second period")))
        first = np.array([met[k][0] == cells[0] for k in known])
        sums, names = by_period.sum(axis=1), (f"{cells[0]} first", f"{cells[1]} first")
        tests.append(mann_whitney(sums[first], sums[~first], about=f"{item}, carry-over", names=names))
    return tests


def _against_retest(choices: Sequence[Choice], pairs: Sequence[Pair], plan: AnalysisPlan) -> Tested | None:
    """Whether people agree less between conditions than with themselves within one: over people, the mean of either."""
    between, within = agree_per_person(choices, pairs, plan)
    both = sorted(between.keys() & within.keys())
    if len(both) < 2:
        return None
    return wilcoxon(
        [between[person] for person in both], [within[person] for person in both],
        about="agreement between conditions against that with the own first answer",
        names=("agreement between conditions", "agreement with the own first answer"),
    )  # fmt: skip


def _within_people(
    rated: Sequence[Measure], designs: Sequence[StudyDesign]
) -> Iterator[tuple[StudyDesign, Measure, list[str], NDArray[np.float64]]]:
    """Every measure of every comparison of one factor that everybody meets: who rated all, ratings (people, cells)."""
    for design in designs:
        if design.within and not design.factorial:
            for measure in rated:
                people, rows = design.values(measure.rated)
                yield design, measure, people, np.array(rows, dtype=float).reshape(len(rows), len(design.cells))


def _differences(rated: Sequence[Measure], designs: Sequence[StudyDesign]) -> list[tuple[str, NDArray[np.float64]]]:
    """Of every measure and every two conditions that everybody met: what it is, each person's difference."""
    return [
        (name_in_words(f"{measure.item.key}, {design.cells[i]} against {design.cells[j]}"), table[:, i] - table[:, j])
        for design, measure, people, table in _within_people(rated, designs)
        if len(people) > 1
        for i, j in combinations(range(len(design.cells)), 2)
    ]


def _equivalent(
    data: StudyData, rated: Sequence[Measure], designs: Sequence[StudyDesign], plan: AnalysisPlan
) -> list[Tested]:
    margins = plan.equivalence
    tests = []
    if margins is not None and margins.rating is not None:
        tests += [
            equivalence(differences, margins.rating, about=about) for about, differences in _differences(rated, designs)
        ]
    if margins is not None and margins.share is not None:
        for against in ARMS:
            shares = own_shares(data.comparisons, against)
            if len(shares) > 1:
                about = f"share of choices for the own policy against {ARMS[against]}, about one half"
                tests.append(equivalence(shares - 0.5, margins.share, about=about))
    return correct_tests(tests, plan.correction)


def _weigh(data: StudyData, rated: Sequence[Measure], designs: Sequence[StudyDesign]) -> list[Weighed]:
    weighed = [Weighed(about, bayes_factor(of)) for about, of in _differences(rated, designs)]
    for against in ARMS:
        shares = own_shares(data.comparisons, against)
        if len(shares):
            more, fewer = int((shares > 0.5).sum()), int((shares < 0.5).sum())
            about = f"people who mostly chose the own policy over {ARMS[against]}"
            weighed.append(Weighed(about, bayes_factor_of_choices(more, fewer)))
    return weighed


def _reliabilities(data: StudyData) -> list[ScaleReliability]:
    reliabilities = []
    topics = find_askings(data.ratings)
    for questionnaire, scale in data.scales:
        keys = [item.key for item in scale.items]
        answers: dict[str, dict[str, dict[str, int]]] = {}
        for rating in data.ratings:
            if rating.questionnaire == questionnaire and rating.item in keys:
                about = find_topic(rating, topics)
                answers.setdefault(about, {}).setdefault(rating.person, {})[rating.item] = rating.value
        for condition, by_person in sorted(answers.items()):
            turned = [
                [scale.points + 1 - of[item.key] if item.reversed else of[item.key] for item in scale.items]
                for of in by_person.values()
                if len(of) == len(keys)
            ]
            if len(turned) > 2 and len(keys) > 1:
                reliabilities.append(ScaleReliability(scale.names[0], condition, reliability(turned)))
    return reliabilities


def _worths(data: StudyData) -> list[Worth]:
    """Of all policies that were compared, where they are three or more: two have a share."""
    compared = {arm for of in data.comparisons for arm in (of.chosen, of.rejected)}
    arms = [arm for arm in ("own", *ARMS) if arm in compared]
    if len(arms) < 3:
        return []
    wins = count_wins(((of.person, of.chosen, of.rejected) for of in data.comparisons), arms)
    return bradley_terry(wins, [{"own": "the own policy", **ARMS}[arm] for arm in arms])


def _models(
    data: StudyData, rated: Sequence[Measure], designs: Sequence[StudyDesign], regular: Sequence[Choice]
) -> list[Modelled]:
    models = []
    for design in designs:
        for measure in rated:
            if measure.item.type != "score" and len(design.cells) > 1 and not design.factorial:
                rows = [
                    (person, design.cells.index(name), value)
                    for person, of in measure.rated.items()
                    for name, value in of.items()
                    if name in design.cells
                ]
                models.append(_model(f"rating of {name_in_words(measure.item.key)}", rows, design.cells))
    conditions = list(data.conditions)
    if len(conditions) > 1 and regular:
        rows = [(choice.person, conditions.index(choice.condition), float(choice.second_chosen)) for choice in regular]
        models.append(_model("choosing the second shown", rows, conditions))
    for against in ARMS:
        if comparisons := own_against(data.comparisons, against):
            rows = [(comparison.person, 0, float(comparison.chosen == "own")) for comparison in comparisons]
            models.append(_model(f"choosing the own policy over {ARMS[against]}", rows, ["all"]))
    return models


def _model(about: str, rows: Sequence[tuple[str, int, float]], conditions: Sequence[str]) -> Modelled:
    """Conditions against the first, with an intercept of each person's; without several conditions a chance."""
    people, where, answers = (list(column) for column in zip(*rows, strict=True))
    dummies = np.array([[float(at == k) for k in range(1, len(conditions))] for at in where]).reshape(len(rows), -1)
    names = [name_in_words(f"{name} against {conditions[0]}") for name in conditions[1:]]
    try:
        alone = cumulative_logit(answers, np.zeros((len(rows), 0)), people, [])
        if not names:
            return Modelled(about, [("chance", *chance_of_the_higher(alone))], alone.person_sd, None)
        fit = cumulative_logit(answers, dummies, people, names)
    except NoFit as wrong:
        return Modelled(about, (), None, None, str(wrong))
    ends = [(fit.coefficients[k], *fit.interval(k)) for k in range(len(names))]
    if not all(math.isfinite(end) and abs(end) < UNBOUNDED for of in ends for end in of):
        why = "answers separate the conditions, so that no odds ratio is finite"
        return Modelled(about, (), None, ratio_test(fit, alone), why)
    effects = [
        (name, math.exp(at), math.exp(low), math.exp(high)) for name, (at, low, high) in zip(names, ends, strict=True)
    ]
    return Modelled(about, effects, fit.person_sd, ratio_test(fit, alone))

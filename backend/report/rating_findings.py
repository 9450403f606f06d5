"""What was rated, ranked and asked once: tests per item and ranking, scores of validated scales, demographics. Pure.

What was chosen is `choice_findings.py`'s, everything together `findings.py`'s.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.analysis.between_groups import group_pairs, kruskal_wallis, mann_whitney
from backend.analysis.choices import equal_first_choices, first_choice_pairs
from backend.analysis.factorial import Factorial, factorial_tests
from backend.analysis.intervals import within
from backend.analysis.repeated_measures import friedman, pairs_of, wilcoxon
from backend.analysis.scales import Scale
from backend.analysis.tested import Mean, Tested, corrected, corrected_pairs, mean_of
from backend.report.analysis_plan import AnalysisPlan
from backend.report.study_data import ItemText, Rating, StudyData
from backend.report.study_design import StudyDesign


@dataclass(frozen=True)
class Described:
    """An item that was asked once, outside blocks. counts: answer -> people; numbers: where answers are numbers."""

    item: ItemText
    n: int
    counts: Mapping[str, int]
    numbers: Mean | None


@dataclass(frozen=True)
class ItemResult:
    """One item, or the score of a validated scale, in one of the study's comparisons.

    means: condition -> over the people who rated every condition that they met; of a design between people, and of one
    that is both, by group, "condition, group". tests: over all conditions, or one per effect of several factors. pairs:
    of conditions or levels, where the test over all was significant, or where the plan wants them always.
    """

    item: ItemText
    design: StudyDesign
    means: Mapping[str, Mean]
    tests: Sequence[Tested]
    pairs: Sequence[Tested]

    @property
    def test(self) -> Tested:
        """The test over all conditions; of several factors that of the first one."""
        return self.tests[0]

    def significant(self, alpha: float) -> bool:
        """Whether any of its tests over all conditions is."""
        return any(test.significant(alpha) for test in self.tests)


@dataclass(frozen=True)
class RankingResult:
    """One forced ranking. places: condition -> people who put it first, second, ..."""

    item: ItemText
    places: Mapping[str, Sequence[int]]
    test: Tested
    pairs: Sequence[Tested]


@dataclass(frozen=True)
class Score:
    """One person's score of a validated scale; condition: the block that it was about, None outside blocks."""

    person: str
    condition: str | None
    score: float


@dataclass(frozen=True)
class ScaleResult:
    """A validated scale's scores by its own scoring. means: condition -> over people ("": asked outside blocks);
    incomplete: askings that cannot be scored, because an item was not answered."""

    questionnaire: str
    scale: Scale
    scores: Sequence[Score]
    means: Mapping[str, Mean]
    incomplete: int


def demographics(data: StudyData) -> list[Described]:
    """Items outside blocks that are neither rankings nor of a validated scale, whose score counts."""
    scored = {(questionnaire, item.key) for questionnaire, scale in data.scales for item in scale.items}
    answers: dict[tuple[str, str], list[Any]] = defaultdict(list)
    for one in data.ratings:
        told = one.condition is None and not isinstance(one.value, list)
        if told and (one.questionnaire, one.item) not in scored:
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


@dataclass(frozen=True)
class Measure:
    """What people rated: person -> condition -> rating. Whoever rated a condition more than once, as a controller in
    each environment, counts with the mean."""

    item: ItemText
    rated: Mapping[str, Mapping[str, float]]


def measures(data: StudyData, plan: AnalysisPlan, scales: Sequence[ScaleResult]) -> list[Measure]:
    """All that was rated about conditions: single items, and of a validated scale its score instead of its items."""
    scored = {(of.questionnaire, item.key) for of in scales for item in of.scale.items}
    found: dict[tuple[str, str], dict[str, dict[str, list[float]]]] = defaultdict(dict)
    for one in data.ratings:
        asked = plan.items is None or one.questionnaire == plan.items
        if not asked or one.condition is None or not isinstance(one.value, int | float):
            continue
        if (one.questionnaire, one.item) not in scored:
            rated_by = found[one.questionnaire, one.item].setdefault(one.person, {})
            rated_by.setdefault(one.condition, []).append(float(one.value))
    told = [
        Measure(data.item(*key), {who: {name: float(np.mean(v)) for name, v in of.items()} for who, of in by.items()})
        for key, by in sorted(found.items(), key=lambda one: data.place(*one[0]))
    ]
    for of in scales:
        rated: dict[str, dict[str, float]] = defaultdict(dict)
        for score in of.scores:
            if score.condition is not None and plan.items in (None, of.questionnaire):
                rated[score.person][score.condition] = score.score
        if rated:
            told.append(Measure(_score(of), rated))
    return told


def _score(of: ScaleResult) -> ItemText:
    highest = round(of.scale.highest)
    return ItemText(of.questionnaire, of.scale.name, "score", of.scale.names[-1], highest, {}, lowest=of.scale.lowest)


def item_results(
    rated: Sequence[Measure], designs: Sequence[StudyDesign], plan: AnalysisPlan, *, intervals: bool = True
) -> list[ItemResult]:
    """Every measure tested as the design asks, p corrected over all of a design's tests; then its pairs (`_pairs`).

    One factor that everybody meets: Wilcoxon of two conditions, Friedman of more. One factor between people:
    Mann-Whitney, Kruskal-Wallis. Several factors: each effect (`analysis.factorial`). Fewer than two people, in all or
    in a group, cannot be tested.
    """
    return [result for design in designs for result in _of_design(rated, design, plan, intervals)]


def _of_design(rated: Sequence[Measure], design: StudyDesign, plan: AnalysisPlan, intervals: bool) -> list[ItemResult]:
    tables = [(measure.item, table) for measure in rated if (table := _table(measure, design)) is not None]
    raw = [_tests(item, table, design, intervals) for item, table in tables]
    flat = iter(corrected([test for tests in raw for test in tests], plan.correction))
    tests = [[next(flat) for _ in family] for family in raw]
    over = sum(_has_pairs(design, effect) for effect in _effects(design)) * len(tables)
    return [
        ItemResult(
            item=item,
            design=design,
            means=_means(item, table, design),
            tests=found,
            pairs=[
                pair
                for effect, test in zip(_effects(design), found, strict=True)
                if _has_pairs(design, effect) and (plan.pairs == "always" or test.significant(plan.alpha))
                for pair in corrected_pairs(
                    _pairs(table, design, effect[0], about=test.about, intervals=intervals),
                    over if plan.pairs_over == "items" else 1,
                    None if plan.pairs == "always" else test,
                )
            ],
        )
        for (item, table), found in zip(tables, tests, strict=True)
    ]


def _table(measure: Measure, design: StudyDesign) -> Factorial | None:
    """The measure's ratings, people in rows; None where there are too few to test."""
    people, rows = design.values(measure.rated)
    groups = np.array([design.groups[person] if design.between else 0 for person in people], dtype=int)
    within_people, between_people = (
        {_named(factor): [_named(level) for level in levels] for factor, levels in factors.items()}
        for factors in (design.within, design.between)
    )
    try:
        return Factorial(np.array(rows, dtype=float), groups, within_people, between_people) if len(rows) > 1 else None
    except ValueError:  # a group of fewer than two
        return None


def _effects(design: StudyDesign) -> list[tuple[str, ...]]:
    names = [*design.within, *design.between]
    return [effect for size in range(1, len(names) + 1) for effect in combinations(names, size)]


def _has_pairs(design: StudyDesign, effect: tuple[str, ...]) -> bool:
    """Whether an effect leaves open which of more than two levels differ."""
    return len(effect) == 1 and len({**design.within, **design.between}[effect[0]]) > 2


def _tests(item: ItemText, table: Factorial, design: StudyDesign, intervals: bool) -> list[Tested]:
    about = _rating_of(item)
    if design.factorial:
        return factorial_tests(table, about=about, intervals=intervals)
    levels = [_named(level) for level in next(iter({**design.within, **design.between}.values()))]
    if design.within:
        if len(levels) == 2:
            first, second = table.values.T
            pair = f"{about}, {levels[0]} against {levels[1]}"
            return [wilcoxon(first, second, about=pair, names=(levels[0], levels[1]), intervals=intervals)]
        return [friedman(table.values, about=about, intervals=intervals)]
    groups = [table.values[table.groups == k, 0] for k in range(len(levels))]
    if len(levels) == 2:
        pair = f"{about}, {levels[0]} against {levels[1]}"
        return [mann_whitney(*groups, about=pair, names=(levels[0], levels[1]), intervals=intervals)]
    return [kruskal_wallis(groups, about=about, intervals=intervals)]


def _pairs(table: Factorial, design: StudyDesign, factor: str, *, about: str, intervals: bool) -> list[Tested]:
    """The tests of every two levels of a factor, of each person's means over the other factors."""
    if factor in design.within:
        names = [_named(level) for level in design.within[factor]]
        means = _margins(table.values, [len(levels) for levels in design.within.values()], [*design.within], factor)
        return pairs_of(means, names, about=about, intervals=intervals)
    names = [_named(level) for level in design.between[factor]]
    places = np.array(np.unravel_index(table.groups, [len(levels) for levels in design.between.values()]))
    level = places[[*design.between].index(factor)]
    own = table.values.mean(axis=1)
    return group_pairs([own[level == k] for k in range(len(names))], names, about=about, intervals=intervals)


def _margins(
    values: NDArray[np.float64], sizes: Sequence[int], factors: Sequence[str], factor: str
) -> NDArray[np.float64]:
    others = tuple(k + 1 for k, name in enumerate(factors) if name != factor)
    return np.asarray(values.reshape(len(values), *sizes).mean(axis=others))


def _means(item: ItemText, table: Factorial, design: StudyDesign) -> dict[str, Mean]:
    found = {}
    for group, of_group in enumerate(design.group_names):
        for cell, of_cell in enumerate(design.cells if design.within else [""]):
            name = ", ".join(word for word in (of_cell, of_group) if word)
            found[name] = within(mean_of(table.values[table.groups == group, cell]), item.lowest, item.points)
    return found


def _rating_of(item: ItemText) -> str:
    return f"score of {item.text}" if item.type == "score" else f"rating of {_named(item.key)}"


def _named(name: str) -> str:
    return name.replace("_", " ")


def ranking_results(
    ratings: Sequence[Rating], plan: AnalysisPlan, data: StudyData, *, intervals: bool = True
) -> list[RankingResult]:
    """Chi-square of first choices per ranking, p corrected over the rankings; its pairs where significant, corrected
    over pairs and rankings."""
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
            equal_first_choices(
                [of[0] for of in found.values()], about=f"first choices for {_named(key[1])}", intervals=intervals
            )
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
                corrected_pairs(
                    first_choice_pairs(
                        [of[0] for of in found.values()], [_named(name) for name in found], about=test.about
                    ),
                    len(places) if plan.pairs_over == "items" else 1,
                    test,
                )
                if test.significant(plan.alpha)
                else ()
            ),
        )
        for (key, found), test in zip(places.items(), tests, strict=True)
    ]


def scale_results(data: StudyData) -> list[ScaleResult]:
    """Every validated scale that was asked. Whoever answered it about a condition more than once counts with the mean
    of the scores."""
    found = []
    for questionnaire, scale in data.scales:
        keys = {item.key for item in scale.items}
        given: dict[tuple[str, str | None], dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
        for one in data.ratings:
            if one.questionnaire == questionnaire and one.item in keys:
                given[one.person, one.condition][one.item].append(one.value)
        scores, incomplete = [], 0
        for (person, condition), answers in given.items():
            askings = max(map(len, answers.values()))
            if any(len(answers[key]) < askings for key in keys):
                incomplete += askings  # whose answer is missing is not known
                continue
            scored = [scale.score({key: answers[key][k] for key in keys}) for k in range(askings)]
            scores.append(Score(person, condition, float(np.mean(scored))))
        of_condition: dict[str, list[float]] = defaultdict(list)
        for score in scores:
            of_condition[score.condition or ""].append(score.score)
        means = {
            name: within(mean_of(values), scale.lowest, scale.highest) for name, values in sorted(of_condition.items())
        }
        if given:
            found.append(ScaleResult(questionnaire, scale, scores, means, incomplete))
    return found

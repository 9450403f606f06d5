"""What was rated, ranked and asked once: tests per item and ranking, scores of validated scales, demographics. Pure.

What was chosen is `choice_findings.py`'s, everything together `findings.py`'s.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from desirepath.analysis.choices import equal_first_choices, first_choice_pairs
from desirepath.analysis.intervals import end_at_scale
from desirepath.analysis.scales import Scale
from desirepath.analysis.tested import Mean, Tested, correct_pairs, correct_tests, mean_of
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.report_cells import name_in_words
from desirepath.report.study_data import ItemText, Rating, StudyData, find_askings, find_topic


@dataclass(frozen=True)
class Described:
    """An item that was asked outside blocks. n: people. counts: answer -> people; numbers: where answers are numbers.
    asking: the stage, where several asked the same (before and after), else ""."""

    item: ItemText
    n: int
    counts: Mapping[str, int]
    numbers: Mean | None
    asking: str = ""


@dataclass(frozen=True)
class RankingResult:
    """One forced ranking. places: condition -> people who put it first, second, ... about: as in `find_topic`."""

    item: ItemText
    places: Mapping[str, Sequence[int]]
    test: Tested
    pairs: Sequence[Tested]
    about: str = ""


@dataclass(frozen=True)
class Score:
    """One person's score of a validated scale; condition: the block that it was about, None outside blocks; asking: the
    stage, where several outside blocks asked it."""

    person: str
    condition: str | None
    score: float
    asking: str = ""


@dataclass(frozen=True)
class ScaleResult:
    """A validated scale's scores by its own scoring. means: condition or asking -> over people ("": asked
    once, outside blocks); incomplete: askings that cannot be scored, because an item was not answered."""

    questionnaire: str
    scale: Scale
    scores: Sequence[Score]
    means: Mapping[str, Mean]
    incomplete: int


def demographics(data: StudyData) -> list[Described]:
    """Items outside blocks that are neither rankings nor of a validated scale, whose score counts."""
    scored = {(questionnaire, item.key) for questionnaire, scale in data.scales for item in scale.items}
    answers: dict[tuple[str, str, str], list[Any]] = defaultdict(list)
    topics = find_askings(data.ratings)
    for rating in data.ratings:
        single = rating.condition is None and not isinstance(rating.value, list)
        if single and (rating.questionnaire, rating.item) not in scored:
            answers[rating.questionnaire, rating.item, find_topic(rating, topics)].append(rating.value)
    described = []
    for (questionnaire, key, asking), values in sorted(answers.items(), key=lambda entry: data.place(*entry[0][:2])):
        item = data.item(questionnaire, key)
        if item.type == "text":
            continue  # free text is read by people, not counted
        numbers = item.type in ("scale", "number")
        counts = {} if numbers else {label: values.count(value) for value, label in item.options.items()}
        described.append(Described(item, len(values), counts, mean_of(values) if numbers else None, asking))
    return described


@dataclass(frozen=True)
class Measure:
    """What people rated: person -> condition -> rating. Whoever rated a condition more than once, as a controller in
    each environment, counts with the mean."""

    item: ItemText
    rated: Mapping[str, Mapping[str, float]]


def measures(data: StudyData, plan: AnalysisPlan, scales: Sequence[ScaleResult]) -> list[Measure]:
    """All that was rated about conditions: single items, and of a validated scale its score instead of its items."""
    scored = {(of.questionnaire, item.key) for of in scales for item in of.scale.items}
    answers: dict[tuple[str, str], dict[str, dict[str, list[float]]]] = defaultdict(dict)
    for rating in data.ratings:
        wanted = plan.items is None or rating.questionnaire == plan.items
        if not wanted or rating.condition is None or not isinstance(rating.value, int | float):
            continue
        if (rating.questionnaire, rating.item) not in scored:
            rated_by = answers[rating.questionnaire, rating.item].setdefault(rating.person, {})
            rated_by.setdefault(rating.condition, []).append(float(rating.value))
    measures = [
        Measure(data.item(*key), {who: {name: float(np.mean(v)) for name, v in of.items()} for who, of in by.items()})
        for key, by in sorted(answers.items(), key=lambda entry: data.place(*entry[0]))
    ]
    for of in scales:
        rated: dict[str, dict[str, float]] = defaultdict(dict)
        for score in of.scores:
            if score.condition is not None and plan.items in (None, of.questionnaire):
                rated[score.person][score.condition] = score.score
        if rated:
            measures.append(Measure(_score(of), rated))
    return measures


def _score(of: ScaleResult) -> ItemText:
    highest = round(of.scale.highest)
    return ItemText(of.questionnaire, of.scale.name, "score", of.scale.names[-1], highest, {}, lowest=of.scale.lowest)


def ranking_results(
    ratings: Sequence[Rating], plan: AnalysisPlan, data: StudyData, *, intervals: bool = True
) -> list[RankingResult]:
    """Chi-square of first choices per ranking, p corrected over the rankings; its pairs where significant, corrected
    over pairs and rankings. Each asking is a ranking of its own; whoever ranked the same again counts with the last."""
    orders: dict[tuple[str, str, str], dict[str, list[str]]] = defaultdict(dict)
    topics = find_askings(ratings)
    for rating in ratings:
        if isinstance(rating.value, list) and (plan.ranking is None or rating.questionnaire == plan.ranking):
            key = rating.questionnaire, rating.item, find_topic(rating, topics)
            orders[key][rating.person] = [str(option) for option in rating.value]
    places: dict[tuple[str, str, str], dict[str, list[int]]] = {}
    for key, of_person in sorted(orders.items(), key=lambda entry: data.place(*entry[0][:2])):
        rankings = list(of_person.values())
        names = sorted({name for order in rankings for name in order})
        places[key] = {name: [sum(o[k] == name for o in rankings) for k in range(len(names))] for name in names}
    tests = correct_tests(
        [
            equal_first_choices(
                [of[0] for of in first_places.values()],
                about=f"first choices for {name_in_words(item)}{f' ({name_in_words(about)})' if about else ''}",
                intervals=intervals,
            )
            for (_, item, about), first_places in places.items()
        ],
        plan.correction,
    )
    return [
        RankingResult(
            item=data.item(questionnaire, key),
            places=first_places,
            test=test,
            about=about,
            pairs=(
                correct_pairs(
                    first_choice_pairs(
                        [of[0] for of in first_places.values()],
                        [name_in_words(name) for name in first_places],
                        about=test.about,
                    ),
                    len(places) if plan.pairs_over == "items" else None,
                    test,
                )
                if test.significant(plan.alpha)
                else ()
            ),
        )
        for ((questionnaire, key, about), first_places), test in zip(places.items(), tests, strict=True)
    ]


def scale_results(data: StudyData) -> list[ScaleResult]:
    """Every validated scale that was asked. Whoever answered it about a condition more than once counts with the mean
    of the scores; outside blocks every asking (before, after) has a score of its own."""
    results = []
    topics = find_askings(data.ratings)
    for questionnaire, scale in data.scales:
        keys = {item.key for item in scale.items}
        by_asking: dict[tuple[str, str | None, str], dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
        for rating in data.ratings:
            if rating.questionnaire == questionnaire and rating.item in keys:
                asking = find_topic(rating, topics) if rating.condition is None else ""
                by_asking[rating.person, rating.condition, asking][rating.item].append(rating.value)
        scores, incomplete = [], 0
        for (person, condition, asking), answers in by_asking.items():
            times = max(map(len, answers.values()))
            if any(len(answers[key]) < times for key in keys):
                incomplete += times  # whose answer is missing is not known
                continue
            scored = [scale.score({key: answers[key][k] for key in keys}) for k in range(times)]
            scores.append(Score(person, condition, float(np.mean(scored)), asking))
        of_condition: dict[str, list[float]] = defaultdict(list)
        for score in scores:
            of_condition[score.condition or score.asking].append(score.score)
        means = {
            name: end_at_scale(mean_of(values), scale.lowest, scale.highest)
            for name, values in sorted(of_condition.items())
        }
        if by_asking:
            results.append(ScaleResult(questionnaire, scale, scores, means, incomplete))
    return results

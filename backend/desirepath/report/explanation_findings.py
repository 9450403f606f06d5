"""Importance rankings (chapter 8): how well people's orders agree with what moved the robot, what they said of it, and
what either depends on. Pure.

Rows are `study_data.py`'s, F and tau `desirepath.analysis`'s, words and figures beside.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from desirepath.analysis.anova import Assumptions, assumptions, rm_anova
from desirepath.analysis.estimates import kendall_tau_b
from desirepath.analysis.factorial import Factorial
from desirepath.analysis.intervals import end_at_scale
from desirepath.analysis.tested import Mean, Tested, correct_tests, mean_of
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.rating_findings import Measure
from desirepath.report.report_cells import name_in_words
from desirepath.report.study_data import AWARENESS, ImportanceRanking, ItemText

SHOWN = ("outline", "attention", "lidar")
"""What may be shown: outlines of chapter 8's things, or a policy's attention to people, and the lidar of either."""
LEVELS = ("without", "with")
Rated = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Trial:
    """One ranking. tau: Kendall's tau-b with the scores, nan where these say no order. tied: pairs of objects with the
    same score, of all pairs; unseen: objects that scored 0."""

    of: ImportanceRanking
    tau: float
    tied: int
    unseen: int

    def row(self) -> dict[str, object]:
        """For a table: one row per trial."""
        ranking = self.of
        return {
            "participant": ranking.person, "condition": ranking.condition, "outline": ranking.outline,
            "lidar": ranking.lidar, "attention": ranking.attention, "query": ranking.query,
            "ranking": " > ".join(ranking.ranking),
            "by_score": " > ".join(sorted(ranking.scores, key=lambda thing: -ranking.scores[thing])),
            "tau_b": None if math.isnan(self.tau) else round(self.tau, 6), "tied_pairs": self.tied,
            "objects_without_score": self.unseen, "decision_s": ranking.decision_s,
        }  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What was measured under every condition. means: condition in words -> over people who met all; tests, checks: of
    every effect, in the same order, empty where fewer than three people met all. lowest, highest: ends of its scale."""

    key: str
    text: str
    lowest: float
    highest: float
    means: Mapping[str, Mean]
    tests: Sequence[Tested]
    checks: Sequence[Assumptions]


@dataclass(frozen=True)
class Explained:
    """A study's importance rankings. factors: those that vary. agreement: of the rankings; rated: the awareness score
    and every other item of the questionnaires after the blocks. items: all items that these are made of."""

    factors: Sequence[str]
    trials: Sequence[Trial]
    agreement: Outcome
    rated: Sequence[Outcome]
    items: Sequence[tuple[str, str]]

    @property
    def outcomes(self) -> list[Outcome]:
        """All that was measured, in the report's order."""
        return [self.agreement, *self.rated]

    @property
    def tests(self) -> list[Tested]:
        """Every test, in the report's order."""
        return [test for outcome in self.outcomes for test in outcome.tests]

    @property
    def undefined(self) -> int:
        """Trials whose scores say no order."""
        return sum(math.isnan(trial.tau) for trial in self.trials)


def analyse_rankings(
    rankings: Sequence[ImportanceRanking], rated: Sequence[Measure], plan: AnalysisPlan, *, intervals: bool = True
) -> Explained | None:
    """The analysis of chapter 8 of everybody's rankings; None where nobody ranked. rated: what was rated of conditions.

    Tau-b per trial, its mean per person and condition, an analysis of variance with its factors, p corrected over its
    effects; the awareness score and the other items alike, p corrected over all of their effects together.
    """
    regular = [ranking for ranking in rankings if ranking.role == "regular"]
    if not regular:
        return None
    factors = [name for name in SHOWN if len({getattr(ranking, name) for ranking in regular}) > 1]
    cells = list(product((False, True), repeat=len(factors)))
    cell_of = {ranking.condition: tuple(getattr(ranking, name) for name in factors) for ranking in regular}
    trials = trials_of(regular)
    taus: dict[str, dict[tuple[bool, ...], list[float]]] = defaultdict(lambda: defaultdict(list))
    for trial in trials:
        if not math.isnan(trial.tau):
            taus[trial.of.person][cell_of[trial.of.condition]].append(trial.tau)
    own = {who: {cell: float(np.mean(values)) for cell, values in of.items()} for who, of in taus.items()}
    agreement = _outcome("tau", "Kendall's tau-b with the scores", -1.0, 1.0, own, factors, cells, intervals)
    about = [
        measure
        for measure in rated
        if set().union(*measure.rated.values()) <= set(cell_of) and measure.item.type != "score"
    ]
    scored = [
        _outcome(key, text, low, high, _by_cell(of, cell_of), factors, cells, intervals)
        for key, text, low, high, of in _scores(about)
    ]
    agreement, scored = _correct([agreement], plan)[0], _correct(scored, plan)
    return Explained(
        factors, trials, agreement, scored, [(measure.item.questionnaire, measure.item.key) for measure in about]
    )


def trials_of(rankings: Sequence[ImportanceRanking]) -> list[Trial]:
    """Each ranking with its agreement, in order."""
    sizes: dict[int, list[int]] = defaultdict(list)
    for k, ranking in enumerate(rankings):
        sizes[len(ranking.scores)].append(k)
    by_place: dict[int, Trial] = {}
    for size, which in sizes.items():
        some = [(rankings[k], sorted(rankings[k].scores)) for k in which]
        scores = np.array([[ranking.scores[thing] for thing in things] for ranking, things in some])
        places = np.array([[ranking.ranking.index(thing) for thing in things] for ranking, things in some])
        i, j = np.triu_indices(size, 1)
        taus = kendall_tau_b(-places, scores)  # the first is the most important
        tied, unseen = (scores[:, i] == scores[:, j]).sum(axis=1), (scores == 0).sum(axis=1)
        for k, tau, ties, hidden in zip(which, taus, tied, unseen, strict=True):
            by_place[k] = Trial(rankings[k], float(tau), int(ties), int(hidden))
    return [by_place[k] for k in range(len(rankings))]


def is_awareness(key: str) -> bool:
    """Whether an item is one of the awareness score's."""
    return key.startswith(AWARENESS)


def _scores(about: Sequence[Measure]) -> Iterator[tuple[str, str, float, float, Rated]]:
    """(key, text, lowest, highest, person -> condition -> score): awareness, then every other item."""
    parts = [measure for measure in about if is_awareness(measure.item.key)]
    if parts:
        people = dict.fromkeys(person for part in parts for person in part.rated)
        awareness: dict[str, dict[str, float]] = {}
        for person in people:
            complete = set.intersection(*(set(part.rated.get(person, {})) for part in parts))
            awareness[person] = {
                name: float(np.mean([turn_reversed(part.item, part.rated[person][name]) for part in parts]))
                for name in complete
            }
        text = f"awareness of the robot's information processing (mean of {len(parts)} items)"
        yield "awareness", text, 1.0, float(parts[0].item.points), awareness
    for measure in about:
        if measure not in parts:
            turned_of = {
                who: {name: turn_reversed(measure.item, v) for name, v in of.items()}
                for who, of in measure.rated.items()
            }
            yield measure.item.key, measure.item.text, measure.item.lowest, float(measure.item.points), turned_of


def turn_reversed(item: ItemText, value: float) -> float:
    """The answer with reversed items inverted: more is more."""
    return item.lowest + item.points - value if item.reversed else value


def _by_cell(rated: Rated, cell_of: Mapping[str, tuple[bool, ...]]) -> dict[str, dict[tuple[bool, ...], float]]:
    return {who: {cell_of[name]: value for name, value in of.items()} for who, of in rated.items()}


def _outcome(
    key: str,
    text: str,
    lowest: float,
    highest: float,
    own: Mapping[str, Mapping[tuple[bool, ...], float]],
    factors: Sequence[str],
    cells: Sequence[tuple[bool, ...]],
    intervals: bool,
) -> Outcome:
    rows = np.array([[of[cell] for cell in cells] for of in own.values() if all(cell in of for cell in cells)])
    values = rows.reshape(-1, len(cells))
    means = {
        condition_in_words(factors, cell): end_at_scale(mean_of(values[:, k]), lowest, highest)
        for k, cell in enumerate(cells)
    }
    if not factors or len(values) < 3:
        return Outcome(key, text, lowest, highest, means, (), ())
    design = Factorial(values, np.zeros(len(values), dtype=np.int64), dict.fromkeys(factors, LEVELS), {})
    about = name_in_words(key)
    tests = rm_anova(design, about=about, intervals=intervals)
    checks = [assumptions(design, effect, about=about, intervals=intervals) for effect in design.effects]
    return Outcome(key, text, lowest, highest, means, tests, checks)


def condition_in_words(factors: Sequence[str], cell: Sequence[bool]) -> str:
    """A condition in words: what was shown of the factors that vary."""
    return " and ".join(name for name, on in zip(factors, cell, strict=True) if on) or "neither"


def _correct(outcomes: Sequence[Outcome], plan: AnalysisPlan) -> list[Outcome]:
    tests = iter(correct_tests([test for outcome in outcomes for test in outcome.tests], plan.correction))
    return [replace(outcome, tests=[next(tests) for _ in outcome.tests]) for outcome in outcomes]

"""Ways of telling a robot how to drive, compared: whose robots were chosen, the weights that each way resulted in, and
how long it took. Pure; which task load each had is tested as any questionnaire (`item_tests.py`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from desirepath.analysis.bradley_terry import Worth, bradley_terry, count_wins
from desirepath.analysis.intervals import clustered_share, end_at_scale
from desirepath.analysis.repeated_measures import friedman, pairs_of, wilcoxon
from desirepath.analysis.tested import Mean, Tested, correct_pairs, correct_tests, mean_of
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.study_data import FARTHEST, MethodChoice, Taught

ABOUT = "share of comparisons that the method's robot won"
Pair = tuple[str, str]


@dataclass(frozen=True)
class Methods:
    """methods: by name. won: of its comparisons, the share in which a method's robot was chosen, over people. pairs: of
    two methods' robots the share in which the first one's was chosen; look_alike: of all comparisons, how many a person
    can hardly tell apart (they count); unfinished: people with fewer comparisons than others, who broke off or have not
    come to the end yet (they count with what they answered). test: over the shares of all methods; between: of their
    pairs. worths: Bradley and Terry's. minutes: that a way took, pauses and all, with its median; apart: distance of
    the weights that two ways resulted in; weights: method -> objective -> mean weight. nothing: method -> people whom
    it taught nothing.
    """

    methods: Sequence[str]
    comparisons: int
    look_alike: int
    unfinished: int
    won: Mapping[str, Mean]
    pairs: Mapping[Pair, Mean]
    test: Tested | None
    between: Sequence[Tested]
    worths: Sequence[Worth]
    minutes: Mapping[str, tuple[Mean, float]]
    apart: Mapping[Pair, Mean]
    weights: Mapping[str, Mapping[str, float]]
    nothing: Mapping[str, int]

    @property
    def tests(self) -> list[Tested]:
        return [*([self.test] if self.test else []), *self.between]


def analyse_methods(choices: Sequence[MethodChoice], taught: Sequence[Taught], plan: AnalysisPlan) -> Methods | None:
    """None where no robots of methods were compared."""
    if not choices:
        return None
    names = sorted({name for choice in choices for name in (choice.chosen, choice.rejected)})
    wins = count_wins(((choice.person, choice.chosen, choice.rejected) for choice in choices), names)
    counts = wins + wins.transpose(0, 2, 1)
    each = counts.sum(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        shares = wins.sum(axis=2) / counts.sum(axis=2)
        of_pair = wins / counts
    whole = shares[np.isfinite(shares).all(axis=1)]
    test, between = _tests(whole, names, plan)
    weights = {name: {lesson.person: lesson.weights for lesson in taught if lesson.method == name} for name in names}
    return Methods(
        methods=names,
        comparisons=len(choices),
        look_alike=sum(choice.look_alike for choice in choices),
        unfinished=int((each < each.max()).sum()),
        won={name: clustered_share(shares[:, k], counts.sum(axis=2)[:, k]) for k, name in enumerate(names)},
        pairs={
            (names[i], names[j]): clustered_share(of_pair[:, i, j], counts[:, i, j])
            for i, j in combinations(range(len(names)), 2)
        },
        test=test,
        between=between,
        worths=bradley_terry(wins, names),
        minutes={name: _minutes([lesson for lesson in taught if lesson.method == name]) for name in names},
        apart={pair: _apart(weights[pair[0]], weights[pair[1]]) for pair in combinations(names, 2)},
        weights={name: _means(list(of.values())) for name, of in weights.items()},
        nothing={name: sum(not learned for learned in of.values()) for name, of in weights.items()},
    )


def _tests(shares: np.ndarray, names: Sequence[str], plan: AnalysisPlan) -> tuple[Tested | None, list[Tested]]:
    """Over all methods, then of their pairs where that was significant, or where the plan wants them always."""
    if len(shares) < 2:
        return None, []
    if len(names) == 2:
        pair = wilcoxon(shares[:, 0], shares[:, 1], about=ABOUT, names=(names[0], names[1]))
        return correct_tests([pair], plan.correction)[0], []
    (test,) = correct_tests([friedman(shares, about=ABOUT)], plan.correction)
    if plan.pairs != "always" and not test.significant(plan.alpha):
        return test, []
    return test, correct_pairs(pairs_of(shares, names, about=ABOUT), 1, None if plan.pairs == "always" else test)


def _minutes(taught: Sequence[Taught]) -> tuple[Mean, float]:
    took = [lesson.seconds / 60 for lesson in taught if lesson.seconds is not None]
    return end_at_scale(mean_of(took), 0.0, math.inf), float(np.median(took)) if took else math.nan


def _apart(first: Mapping[str, Mapping[str, float]], second: Mapping[str, Mapping[str, float]]) -> Mean:
    return end_at_scale(mean_of([_distance(first[who], second[who]) for who in first if who in second]), 0.0, FARTHEST)


def _distance(first: Mapping[str, float], second: Mapping[str, float]) -> float:
    return math.sqrt(sum((first.get(name, 0.0) - second.get(name, 0.0)) ** 2 for name in {*first, *second}))


def _means(weights: Sequence[Mapping[str, float]]) -> dict[str, float]:
    names = sorted({name for of in weights for name in of})
    return {name: float(np.mean([of.get(name, 0.0) for of in weights])) for name in names}

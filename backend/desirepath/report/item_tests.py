"""Each rated item, or scale's score, tested as the study's design asks, then its pairs. Pure.

What was rated is gathered by `rating_findings.py`; the tests themselves live in `analysis`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.between_groups import group_pairs, kruskal_wallis
from desirepath.analysis.factorial import Factorial, effects_of, factorial_tests
from desirepath.analysis.intervals import end_at_scale
from desirepath.analysis.repeated_measures import friedman, pairs_of
from desirepath.analysis.tested import Mean, Tested, correct_pairs, correct_tests, mean_of
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.rating_findings import Measure
from desirepath.report.report_cells import name_in_words
from desirepath.report.study_data import ItemText
from desirepath.report.study_design import StudyDesign


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
    flat = iter(correct_tests([test for tests in raw for test in tests], plan.correction))
    tests = [[next(flat) for _ in family] for family in raw]
    over = sum(_has_pairs(design, effect) for effect in effects_of(design.within, design.between)) * len(tables)
    return [
        ItemResult(
            item=item,
            design=design,
            means=_means(item, table, design),
            tests=corrected,
            pairs=[
                pair
                for effect, test in zip(effects_of(design.within, design.between), corrected, strict=True)
                if _has_pairs(design, effect) and (plan.pairs == "always" or test.significant(plan.alpha))
                for pair in correct_pairs(
                    _pairs(table, design, effect[0], about=test.about, intervals=intervals),
                    over if plan.pairs_over == "items" else None,
                    None if plan.pairs == "always" else test,
                )
            ],
        )
        for (item, table), corrected in zip(tables, tests, strict=True)
    ]


def _table(measure: Measure, design: StudyDesign) -> Factorial | None:
    """The measure's ratings, people in rows; None where there are too few to test."""
    people, rows = design.values(measure.rated)
    groups = np.array([design.groups[person] if design.between else 0 for person in people], dtype=int)
    within_people, between_people = (
        {name_in_words(factor): [name_in_words(level) for level in levels] for factor, levels in factors.items()}
        for factors in (design.within, design.between)
    )
    try:
        return Factorial(np.array(rows, dtype=float), groups, within_people, between_people) if len(rows) > 1 else None
    except ValueError:  # a group of fewer than two
        return None


def _has_pairs(design: StudyDesign, effect: tuple[str, ...]) -> bool:
    """Whether an effect leaves open which of more than two levels differ."""
    return len(effect) == 1 and len({**design.within, **design.between}[effect[0]]) > 2


def _tests(item: ItemText, table: Factorial, design: StudyDesign, intervals: bool) -> list[Tested]:
    about = _rating_of(item)
    if design.factorial:
        return factorial_tests(table, about=about, intervals=intervals)
    levels = [name_in_words(level) for level in next(iter({**design.within, **design.between}.values()))]
    if design.within:
        if len(levels) == 2:
            return pairs_of(table.values, levels, about=about, intervals=intervals)
        return [friedman(table.values, about=about, intervals=intervals)]
    groups = [table.values[table.groups == k, 0] for k in range(len(levels))]
    if len(levels) == 2:
        return group_pairs(groups, levels, about=about, intervals=intervals)
    return [kruskal_wallis(groups, about=about, intervals=intervals)]


def _pairs(table: Factorial, design: StudyDesign, factor: str, *, about: str, intervals: bool) -> list[Tested]:
    """The tests of every two levels of a factor, of each person's means over the other factors."""
    if factor in design.within:
        names = [name_in_words(level) for level in design.within[factor]]
        means = _margins(table.values, [len(levels) for levels in design.within.values()], [*design.within], factor)
        return pairs_of(means, names, about=about, intervals=intervals)
    names = [name_in_words(level) for level in design.between[factor]]
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
    means = {}
    for group, of_group in enumerate(design.group_names):
        for cell, of_cell in enumerate(design.cells if design.within else [""]):
            name = ", ".join(word for word in (of_cell, of_group) if word)
            means[name] = end_at_scale(mean_of(table.values[table.groups == group, cell]), item.lowest, item.points)
    return means


def _rating_of(item: ItemText) -> str:
    return f"score of {item.text}" if item.type == "score" else f"rating of {name_in_words(item.key)}"

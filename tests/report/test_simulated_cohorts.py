"""What is put into a simulated cohort is found, and nothing else."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings
from desirepath.report.planned_design import Assumed, PlannedDesign
from desirepath.report.simulated_cohorts import (
    CONDITIONS,
    ITEMS,
    RANKINGS,
    Cohort,
    CohortError,
    read_cohort,
    simulate_data,
)
from desirepath.report.simulated_power import COMPARISONS, analyse_simulated, enough, power, rate
from desirepath_experiments.cohorts.design_cohorts import DESIGNS, DesignConfig, benchmark_design_cohorts
from desirepath_experiments.cohorts.further_cohorts import CASES, FurtherConfig, benchmark_further_cohorts
from desirepath_experiments.cohorts.interface_cohorts import (
    OTHER_ITEM,
    OTHER_PAIR,
    OTHER_RANKING,
    NullConfig,
    benchmark_null_cohorts,
    known_cohorts,
)

DIFFERENT = Cohort(
    ratings={"fun": {"immersive": 1.5}, "boredom": {"first_person": 1.5}},
    first_choice={"usefulness": {"immersive": 0.8}},
    consistency={"top_down": 1.0, "immersive": 0.7},
    steady=0.8,
    own=0.8,
    seed=4,  # one seed in twenty finds something else as well: that is alpha, see the null cohorts
)


@pytest.fixture(scope="module")
def found() -> Findings:
    return analyse_simulated(simulate_data(DIFFERENT, 60, repeats=10, comparisons=COMPARISONS), AnalysisPlan())


def test_the_items_that_differ_are_found_and_no_others(found: Findings) -> None:
    assert {one.item.key for one in found.items} == set(ITEMS)
    assert {one.item.key for one in found.items if one.test.significant()} == {"fun", "boredom"}
    fun = next(one for one in found.items if one.item.key == "fun")
    assert [test.significant() for test in fun.pairs] == [True, False, True]
    assert fun.pairs[0].direction == "higher for immersive than for first person"
    assert fun.pairs[2].direction == "higher for immersive than for top down"
    boredom = next(one for one in found.items if one.item.key == "boredom")
    assert [test.significant() for test in boredom.pairs] == [True, True, False]


def test_the_ranking_that_differs_is_found_and_no_other(found: Findings) -> None:
    assert [one.item.key for one in found.rankings if one.test.significant()] == ["usefulness"]
    first = {name: counts[0] for name, counts in found.rankings[RANKINGS.index("usefulness")].places.items()}
    assert first["immersive"] == pytest.approx(0.8 * 60, abs=8)
    assert all(sum(counts) == 60 for counts in found.rankings[0].places.values())


def test_people_agree_with_themselves_as_often_as_was_stated(found: Findings) -> None:
    again = {name: of.repeat.share.mean for name, of in found.of_condition.items()}
    assert again["top_down"] == 1.0
    assert again["first_person"] == pytest.approx(0.8, abs=0.05)
    assert again["immersive"] == pytest.approx(0.7, abs=0.05)


def test_agreement_between_conditions_follows_from_the_consistencies(found: Findings) -> None:
    """Answers stray with chance e = (1 - sqrt(2 c - 1)) / 2; two agree if neither or both do."""
    stray = {name: DIFFERENT.lapse_rate(name) for name in CONDITIONS}
    for (first, second), of in found.between.items():
        a, b = stray[first], stray[second]
        assert of.share.mean == pytest.approx((1 - a) * (1 - b) + a * b, abs=0.03)
        assert of.kappa.mean == pytest.approx(2 * of.share.mean - 1, abs=0.05)  # no place is liked better


def test_the_own_policy_is_found_to_be_preferred(found: Findings) -> None:
    assert [one.test.significant() for one in found.personalised] == [True, True]
    assert found.personalised[0].share.mean == pytest.approx(0.8, abs=0.08)


def test_a_habit_of_taking_the_second_trajectory_shows_in_kappa_not_in_agreement() -> None:
    habit = analyse_simulated(simulate_data(Cohort(second_shown=0.9, steady=0.5), 20), AnalysisPlan())
    of = habit.between["first_person", "immersive"]
    assert of.share.mean > 0.8
    assert abs(of.kappa.mean) < 0.15
    assert habit.of_condition["immersive"].second_shown.mean > 0.85


def test_null_cohorts_are_rejected_no_more_often_than_alpha() -> None:
    """A small version of `benchmark null-cohorts`: the interval of every rate must reach down to alpha."""
    rates = {one["test"]: one for one in benchmark_null_cohorts(NullConfig(40, seed=1))["rates"]}
    assert rates["Friedman, any item, corrected"]["low"] <= 0.05
    assert all(one["low"] <= 0.05 for one in rates.values())
    assert rates["Wilcoxon, immersive/top_down"]["n"] == 400
    assert 0.02 < rates["Wilcoxon, immersive/top_down"]["rate"] < 0.08


def test_what_is_put_in_is_found_over_many_cohorts_and_nothing_else() -> None:
    """A small version of `benchmark known-cohorts`."""
    plan = AnalysisPlan()
    rates = {one["test"]: one for one in known_cohorts(DIFFERENT, 12, 31, plan)["rates"]}
    assert all(rates[key]["rate"] > 0.8 for key in ("fun", "boredom", "usefulness"))
    assert all(rates[other]["low"] <= 0.05 for other in (OTHER_ITEM, OTHER_RANKING, OTHER_PAIR))
    blind = known_cohorts(replace(DIFFERENT, ratings={"fun": {"immersive": 0.01}}), 8, 31, plan)["rates"][0]
    assert blind["test"] == "fun"
    assert blind["rate"] < 0.5
    with pytest.raises(ValueError, match=r"ratings\.joy: known are"):
        known_cohorts(replace(DIFFERENT, ratings={"joy": {}}), 1, 31, plan)


def test_people_lent_the_same_policy_find_too_much_unless_they_count_as_one() -> None:
    """Groups of ten who finish together: as people they find a difference that is none far too often; clustered, or
    lent different policies, they do not."""
    found: Counter[str] = Counter()
    for k in range(150):
        found.update(name for name, hit in CASES["nobody prefers the own policy"](31, k) if hit)
    rates = {name: rate(name, count, 150) for name, count in found.items()}
    signed = "Wilcoxon signed-rank, own against other's"
    assert rates[f"{signed}, the same policy for a group, counted by people"].low > 0.08
    for words in ("the same policy for a group", "different policies"):
        assert found[f"{signed}, {words}, counted by lent policies"] <= 15


def test_what_stands_beside_the_tests_is_said_where_something_differs_and_seldom_elsewhere() -> None:
    """A small version of `benchmark further-cohorts`."""
    rates = benchmark_further_cohorts(FurtherConfig(8, (20,), seed=1))["rates"]
    rows = {(row["truth"], row["statement"]): row for row in rates}
    said = {truth: {s for t, s in rows if t == truth} for truth, _ in rows}
    assert said["nothing differs"] == said["something differs"]
    assert {"Period", "Carry-over", "Guess", "Mixed model, rating of fun"} <= said["nothing differs"]
    for statement in said["nothing differs"]:
        assert rows["nothing differs", statement]["low"] <= 0.05, statement
    agreeing = "Agreement between conditions is below consistency"
    for statement in ("Period", "Guess", "Mixed model, rating of fun", agreeing):
        assert rows["something differs", statement]["rate"] > 0.5, statement
    margin = rows["the difference is the margin", "Equivalence within the margin"]
    assert margin["low"] <= 0.05
    assert rows["no difference", "Equivalence within the margin"]["rate"] > 0.7
    assert all(row["high"] > 0.9 for (truth, _), row in rows.items() if truth == "intervals")


def test_more_people_more_power() -> None:
    design = PlannedDesign(CONDITIONS, ("ease", "fun"), ("usefulness",), queries=5, comparisons=3)
    few, many = power(design, Assumed("immersive", "fun", "usefulness", effect=0.8), (8, 40), cohorts=20)
    assert [one.test for one in few.rates] == [
        "Friedman, fun (over 2 items)", "Wilcoxon, against both others", "Chi-square, usefulness (over 1 ranking)",
        "Sign test, own against base", "Sign test, own against other",
        "Signed ranks, own against base", "Signed ranks, own against other",
    ]  # fmt: skip
    assert few.rates[0].rate + 0.3 < many.rates[0].rate
    assert enough([many, few])["Friedman, fun (over 2 items)"] == 40
    assert enough([few])["Friedman, fun (over 2 items)"] is None
    assert few.agreement_half_width is not None
    assert many.agreement_half_width is not None
    assert many.agreement_half_width < few.agreement_half_width / 1.8  # about the root of five


def test_a_condition_whose_name_holds_another_is_not_taken_for_it() -> None:
    """`view` differs from both others, which do not differ; the names of all three pairs hold the word `view`."""
    design = PlannedDesign(("view", "view_2", "view_3"), ("fun",), (), queries=1, comparisons=0)
    (found,) = power(design, Assumed("view", "fun", "", effect=2.0), (40,), cohorts=5)
    assert {one.test: one.rate for one in found.rates}["Wilcoxon, against both others"] == 1.0


def test_simulated_answers_do_not_depend_on_the_order_of_asking() -> None:
    person, again = DIFFERENT.person(5), DIFFERENT.person(5)
    first = [person.rate(item, "immersive") for item in ITEMS]
    assert [again.rate(item, "immersive") for item in reversed(ITEMS)] == first[::-1]
    assert first != [DIFFERENT.person(6).rate(item, "immersive") for item in ITEMS]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("steady: 0.3", "steady = 0.3"),
        ("first_choice: {fun: {immersive: 1.2}}", "first_choice.fun"),
        ("first_choice: {fun: {immersive: 0.0}}", "first_choice.fun"),
        ("first_choice: {fun: {immersive: 0.5, top_down: 0.5}}", "first_choice.fun"),
        ("drop_out: 1.5", "drop_out = 1.5"),
        ("own_against_other: -0.1", "own_against_other = -0.1"),
        ("mood: good", "mapping with some of the keys ratings"),
        ("[1", "cannot be read"),
        ('own: "0.8"', "own: Input should be a valid number"),
        ("ratings: {fun: {immersive: yes}}", "ratings.fun.immersive"),
    ],
)
def test_a_cohort_that_cannot_be_is_refused(tmp_path: Path, text: str, named: str) -> None:
    file = tmp_path / "cohort.yaml"
    file.write_text(text)
    with pytest.raises(CohortError, match=named):
        read_cohort(file)


def test_every_design_s_tests_are_counted_over_cohorts() -> None:
    """A small version of `benchmark design-cohorts`: nothing where nothing is, Friedman where something is."""
    rates = benchmark_design_cohorts(DesignConfig(6, (12,)))["rates"]
    rows = {(row["design"], row["test"]): row for row in rates}
    assert {design for design, _ in rows} == set(DESIGNS)
    assert sum(row["rate"] > 0.5 for row in rows.values()) == 0
    assert ("2 x 2 within", "Wilcoxon signed-rank, view × speed") in rows
    assert ("three conditions", "Chi-square of first choices") in rows
    rates = benchmark_design_cohorts(DesignConfig(6, (24,), effect=2.5))["rates"]
    found = {(row["design"], row["test"]): row["rate"] for row in rates}
    assert found["three conditions", "Friedman, rating of fun"] == 1.0
    assert found["two groups", "Mann-Whitney, immersive against top down"] > 0.6
    assert found["2 x 2 within", "Wilcoxon signed-rank, speed"] < 0.6

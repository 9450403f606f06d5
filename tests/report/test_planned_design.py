"""Power for every design: the tests that a study will have, and that more effect is found more often."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.analysis.scale_wordings import SCALES
from desirepath.report.analysis_plan import AnalysisPlan, Equivalence
from desirepath.report.findings import analyse
from desirepath.report.planned_design import Assumed, PlannedDesign, plan_factors
from desirepath.report.simulated_cohorts import CONDITIONS, Cohort, CohortError, simulate_data
from desirepath.report.simulated_power import Power, power
from desirepath.report.study_design import StudyDesign

VIEWS = {"view": ("immersive", "top_down")}
SPEEDS = {"speed": ("fast", "slow")}


def rates(of: Power) -> dict[str, float]:
    return {one.test: one.rate for one in of.rates}


def design(**factors: dict) -> PlannedDesign:
    return PlannedDesign(("immersive", "top_down"), ("ease", "fun"), (), 1, 0, **factors)


@pytest.mark.parametrize(
    ("planned", "names"),
    [
        (design(), ["Wilcoxon, fun (over 2 items)"]),
        (design(within=VIEWS), ["Wilcoxon, fun (over 2 items)"]),
        (design(between=VIEWS), ["Mann-Whitney, fun (over 2 items)"]),
        (
            PlannedDesign(CONDITIONS, ("fun",), (), 1, 0, between={"view": CONDITIONS}),
            ["Kruskal-Wallis, fun (over 1 item)", "Mann-Whitney, against both others"],
        ),
    ],
)
def test_one_factor_of_two_or_three(planned: PlannedDesign, names: list[str]) -> None:
    (found,) = power(planned, Assumed("immersive", "fun", "", effect=2.5), (36,), cohorts=6)
    assert list(rates(found)) == names
    assert min(rates(found).values()) > 0.5
    (nothing,) = power(planned, Assumed("immersive", "fun", "", effect=0.0), (36,), cohorts=6)
    assert max(rates(nothing).values()) < 0.5


@pytest.mark.parametrize(
    "where", [{"within": {**VIEWS, **SPEEDS}}, {"within": VIEWS, "between": SPEEDS}, {"between": {**VIEWS, **SPEEDS}}]
)
def test_two_by_two_tells_each_effect(where: dict) -> None:
    """A level's effect is a main effect: the interaction is found no more often than alpha."""
    cells = [f"{view}-{speed}" for view in VIEWS["view"] for speed in SPEEDS["speed"]]
    planned = PlannedDesign(tuple(cells), ("fun",), (), 1, 0, **where)
    (found,) = power(planned, Assumed("immersive", "fun", "", effect=2.0), (40,), cohorts=10)
    names = ["view, fun (over 3 tests)", "speed, fun (over 3 tests)", "view × speed, fun (over 3 tests)"]
    assert list(rates(found)) == names
    assert rates(found)[names[0]] > 0.8
    assert max(rates(found)[name] for name in names[1:]) <= 0.3
    assert "immersive" in planned.places
    assert "immersive-slow" in planned.places


def test_a_scale_is_found_by_its_score() -> None:
    planned = replace(design(), items=("fun", "sus"), scales=(SCALES["sus"],))
    (found,) = power(planned, Assumed("immersive", "sus", "", effect=0.7), (20,), cohorts=6)
    assert rates(found) == {"Wilcoxon, sus (over 2 items)": 1.0}
    data = planned.study(Cohort(ratings={"sus": {"immersive": 3.0}}), 10, 0)
    high = [one.value for one in data.ratings if one.item == "sus_1" and one.condition == "immersive"]
    turned = [one.value for one in data.ratings if one.item == "sus_2" and one.condition == "immersive"]
    assert min(high) >= 4
    assert max(turned) <= 2


def test_who_drops_out_is_not_analysed() -> None:
    data = simulate_data(Cohort(drop_out=0.4, seed=2), 200)
    gone = sum(one.state == "expired" for one in data.people)
    assert 60 <= gone <= 100
    few, none = (
        rates(power(design(), Assumed("immersive", "fun", "", effect=1.0, drop_out=share), (24,), cohorts=30)[0])
        for share in (0.6, 0.0)
    )
    assert few["Wilcoxon, fun (over 2 items)"] < none["Wilcoxon, fun (over 2 items)"]
    assert rates(power(design(), Assumed("immersive", "fun", "", drop_out=1.0), (4,), cohorts=2)[0]) == {
        "Wilcoxon, fun (over 2 items)": 0.0
    }


def test_own_against_base_and_against_other_apart() -> None:
    planned = PlannedDesign(("immersive",), (), (), 1, 5)
    assumed = Assumed("immersive", "", "", own=0.95, own_against_other=0.5)
    (found,) = power(planned, assumed, (20,), cohorts=8, plan=AnalysisPlan(own="signed_ranks"))
    assert rates(found)["Sign test, own against base"] == 1.0
    assert rates(found)["Signed ranks, own against base"] == 1.0
    assert rates(found)["Sign test, own against other"] <= 0.25
    assert rates(found)["Signed ranks, own against other"] <= 0.25


def test_who_is_shown_no_policy_as_theirs_compares_nothing() -> None:
    """With drop-out: of a hundred, a fifth is gone, and of those who finish half compare."""
    cohort = Cohort(shown=0.5, drop_out=0.2, seed=4)
    data = simulate_data(cohort, 100, conditions=("x",), items=(), rankings=(), queries=1, comparisons=2)
    compared = {one.person for one in data.comparisons}
    assert compared == {one.code for one in data.people if one.own_policy == "shown"}
    assert 35 <= len(compared) <= 65
    of = analyse(data, lambda _: pytest.fail("no trajectory"), "all", AnalysisPlan(metrics=()), intervals=False)
    finished = {one.code for one in data.people if one.state == "completed"}
    assert of.personalised[0].people == of.own_policies["shown"] == len(compared & finished)
    assert of.own_policies["not_surely_better"] == len(finished) - len(compared & finished)
    planned = PlannedDesign(("immersive",), (), (), 1, 5)
    few, all_of_them = (
        rates(power(planned, Assumed("immersive", "", "", own=0.8, shown=share), (16,), cohorts=12)[0])
        for share in (0.3, 1.0)
    )
    assert few["Sign test, own against base"] < all_of_them["Sign test, own against base"]
    with pytest.raises(CohortError, match="shown"):
        Cohort(shown=1.2)


def test_items_can_be_correlated() -> None:
    def correlation(alike: float) -> float:
        data = simulate_data(
            Cohort(items_alike=alike), 300, items=("a", "b"), conditions=("x",), rankings=(), queries=1
        )
        a, b = ([one.value for one in data.ratings if one.item == item] for item in ("a", "b"))
        return float(np.corrcoef(a, b)[0, 1])

    assert abs(correlation(0.0)) < 0.15
    assert correlation(0.7) == pytest.approx(0.68, abs=0.1)


def test_of_two_factors_with_three_levels_each_pair_is_of_its_own_factor() -> None:
    """Only the second factor has an effect, at one level; the first one's pairs must not be taken for it."""
    factors = {"view": CONDITIONS, "speed": ("fast", "middle", "slow")}
    cells = tuple(f"{view}-{speed}" for view in factors["view"] for speed in factors["speed"])
    planned = PlannedDesign(cells, ("fun",), (), 1, 0, within=factors)
    plan = AnalysisPlan(pairs="always")
    (found,) = power(planned, Assumed("fast", "fun", "", effect=2.5), (20,), cohorts=3, plan=plan)
    assert rates(found)["Wilcoxon, speed, against both others"] == 1.0
    assert "Wilcoxon, view, against both others" not in rates(found)


def test_what_a_plan_declares_beside_the_tests_has_a_power_of_its_own() -> None:
    """Of three conditions one is rated higher: evidence of that, no difference of the other two."""
    planned = PlannedDesign(CONDITIONS, ("fun",), (), 1, 3, opponents=("base", "other"))
    plan = AnalysisPlan(equivalence=Equivalence(rating=1.0, share=0.2), bayes_factors=True, models=True)
    assumed = Assumed("immersive", "fun", "", effect=2.0, own=0.8, own_against_other=0.5)
    few, many = power(planned, assumed, (6, 60), cohorts=4, plan=plan)
    assert [one.test for one in many.rates][-5:] == [
        "Bayes factor of at least 3, fun, first person against immersive",
        "Equivalence, fun, first person against top down",
        "Bayes factor of at least 3, fun, immersive against top down",
        "Mixed model, fun (uncorrected)",
        "Equivalence, own against other",
    ]
    assert rates(many)["Equivalence, fun, first person against top down"] > 0.8
    assert rates(few)["Equivalence, fun, first person against top down"] < 0.6
    assert rates(many)["Equivalence, own against other"] > 0.8
    assert rates(many)["Mixed model, fun (uncorrected)"] == 1.0
    assert rates(many)["Bayes factor of at least 3, fun, immersive against top down"] == 1.0
    (nothing,) = power(planned, replace(assumed, effect=0.0), (20,), cohorts=4, plan=AnalysisPlan(bayes_factors=True))
    assert not any("Bayes" in one.test for one in nothing.rates)  # there is nothing to find evidence of


def test_drop_out_takes_people_from_what_is_declared_too() -> None:
    planned = PlannedDesign(CONDITIONS[:2], ("fun",), (), 1, 0)
    plan = AnalysisPlan(equivalence=Equivalence(rating=1.0))
    assumed = Assumed(CONDITIONS[0], "fun", "", effect=0.0)
    (everybody,) = power(planned, assumed, (16,), cohorts=40, plan=plan)
    (half,) = power(planned, replace(assumed, drop_out=0.5), (16,), cohorts=40, plan=plan)
    (name,) = [one.test for one in half.rates if "Equivalence" in one.test]
    assert rates(half)[name] < rates(everybody)[name]


def test_a_level_that_everybody_meets_alone_is_part_of_the_conditions_names() -> None:
    """One view and two speeds are two conditions; a fixed level between or around two factors stays in their names."""
    two = StudyDesign({"speed": ("slow", "fast")}, {}, ("top_down-slow", "top_down-fast"))
    assert plan_factors(two) == {"within": {}, "between": {}}
    speeds, sizes = ("slow", "fast"), ("small", "large")
    factors = {"speed": speeds, "size": sizes}
    for pattern in ("{0}-{1}", "top_down-{0}-{1}", "{0}-top_down-{1}", "{0}-{1}-top_down", "a-{0}-b-{1}-c"):
        cells = [pattern.format(speed, size) for speed in speeds for size in sizes]
        planned = PlannedDesign(tuple(cells), ("fun",), (), 1, 0, **plan_factors(StudyDesign(factors, {}, cells)))
        made = planned.study(Cohort(), 2, 0)
        assert list(dict.fromkeys(one.condition for one in made.choices)) == cells
        assert planned.effects == [("speed",), ("size",), ("speed", "size")]
    groups = StudyDesign({}, {"robot": sizes}, ("top_down", "top_down"))
    assert plan_factors(groups) == {"within": {}, "between": {"robot": sizes}}
    assert plan_factors(StudyDesign({"condition": speeds}, {}, speeds)) == {"within": {}, "between": {}}
    assert plan_factors(StudyDesign({"speed": speeds}, {}, speeds))["within"] == {"speed": speeds}

"""What stands beside the declared tests, from studies small enough to work out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from desirepath.analysis.equivalence import bayes_factor, bayes_factor_of_choices
from desirepath.analysis.mixed_models import chance_of_the_higher, cumulative_logit
from desirepath.analysis.reliability import reliability
from desirepath.analysis.scale_wordings import SCALES
from desirepath.report.analysis_plan import AnalysisPlan, Equivalence
from desirepath.report.findings import Findings, analyse
from desirepath.report.further_findings import Further
from desirepath.report.report_text import sections
from desirepath.report.simulated_cohorts import Cohort, simulate_data
from desirepath.report.study_data import Choice, Comparison, ParticipantRow, Rating, StudyData

PLAN = AnalysisPlan(metrics=())
X, Y = "immersive", "top_down"


def nothing(trajectory: str) -> None:
    raise LookupError(trajectory)


def found(data: StudyData, plan: AnalysisPlan = PLAN) -> tuple[Findings, Further]:
    of = analyse(data, nothing, "all", plan)
    assert of.further is not None
    return of, of.further


def said(of: Findings, title: str) -> str:
    (part,) = (part for part in sections(of, [], Path()) if part.title == title)
    return " ".join([*part.sentences, *(cell for table in part.tables for row in table.rows for cell in row)])


def crossover(values: list[tuple[int, int]], orders: list[tuple[str, str]]) -> StudyData:
    """values: of X and Y."""
    people = [ParticipantRow(f"P-{k}", False, None, False, "completed", order) for k, order in enumerate(orders)]
    ratings = [
        Rating(f"P-{k}", name, "q", "fun", value)
        for k, pair in enumerate(values)
        for name, value in zip((X, Y), pair, strict=True)
    ]
    return StudyData("By hand", "1", {}, "", [], people, [], ratings, [])


def test_period_and_carry_over_of_two_conditions() -> None:
    """The second condition met is rated higher, whichever it is; who begins with X rates both higher."""
    values = [(4, 6), (5, 7), (4, 7), (5, 6), (3, 1), (2, 1), (4, 1), (3, 2)]
    orders = [(X, Y)] * 4 + [(Y, X)] * 4
    of, beside = found(crossover(values, orders))
    period, carried = beside.order_effects
    by_period = np.array([pair if order[0] == X else pair[::-1] for pair, order in zip(values, orders, strict=True)])
    assert period.p == pytest.approx(stats.wilcoxon(*by_period.T).pvalue, abs=0.005)
    assert period.effect == -1.0
    sums = by_period.sum(axis=1)
    assert carried.statistic == stats.mannwhitneyu(sums[:4], sums[4:]).statistic
    assert carried.direction == f"higher for {X} first than for {Y} first"
    assert "Grizzle" in said(of, "Order effects")
    assert period not in of.tests
    same, nobody = found(crossover(values, [(X, Y)] * 8))  # everybody in one order: nothing to tell apart
    assert nobody.order_effects == []
    assert "Order effects" not in [part.title for part in sections(same, [], Path())]


def test_period_of_three_conditions_is_friedmans() -> None:
    names = ("a", "b", "c")
    orders = [("a", "b", "c"), ("b", "c", "a"), ("c", "a", "b")] * 3
    people = [ParticipantRow(f"P-{k}", False, None, False, "completed", order) for k, order in enumerate(orders)]
    ratings = [Rating(one.code, name, "q", "fun", 2 + place) for one in people for place, name in enumerate(one.order)]
    _, beside = found(StudyData("By hand", "1", {}, "", [], people, [], ratings, []))
    (period,) = beside.order_effects
    assert period.statistic == pytest.approx(18.0)
    assert period.direction == "ratings change from period to period"
    assert set(names) == set(people[0].order)


def test_agreement_between_views_is_tested_against_agreement_with_oneself() -> None:
    data = simulate_data(Cohort(steady=0.95, consistency={"top_down": 0.6}), 24, repeats=10)
    of, beside = found(data)
    test = beside.against_retest
    assert test is not None
    within, between = [], []
    for one in data.people:
        mine = [c for c in data.choices if c.person == one.code]
        views = sorted({c.condition for c in mine})
        first = {(c.condition, c.query): c.chosen for c in mine if c.role == "regular"}
        again = [
            [c.chosen == first[v, c.query] for c in mine if c.role == "repeat" and c.condition == v] for v in views
        ]
        within.append(np.mean([np.mean(hits) for hits in again]))
        pairs = [(a, b) for k, a in enumerate(views) for b in views[k + 1 :]]
        queries = sorted({q for _, q in first})
        between.append(np.mean([np.mean([first[a, q] == first[b, q] for q in queries]) for a, b in pairs]))
    differences = np.round(np.subtract(between, within), 12)
    assert test.n == 24
    assert test.p == pytest.approx(stats.wilcoxon(differences[differences != 0]).pvalue, abs=0.01)
    assert "own first answer" in said(of, "Agreement between conditions against consistency")
    few, none = found(data, AnalysisPlan(metrics=(), min_probes=11))
    assert none.against_retest is None
    assert few.between


def test_equivalence_and_bayes_factors_only_where_declared() -> None:
    values = [(4, 4), (5, 5), (4, 5), (5, 4), (3, 3), (2, 2), (4, 4), (3, 3)]
    data = crossover(values, [(X, Y), (Y, X)] * 4)
    compared = [Comparison(f"P-{k}", "own", "base", False) for k in range(8)] * 2
    data = replace(data, comparisons=compared)
    assert found(data)[1].equivalent == []
    assert found(data)[1].weighed == ()
    plan = AnalysisPlan(metrics=(), bayes_factors=True, equivalence=Equivalence(rating=1.0, share=0.2))
    of, beside = found(data, plan)
    same, own = beside.equivalent
    assert same.significant()
    assert same.correction == "Holm"
    assert same.about == "fun, immersive against top down, within ±1"
    assert not own.significant()
    assert own.effect == 0.5
    rating, choice = beside.weighed
    assert rating.factor < 1 < choice.factor
    assert "speak for none" in said(of, "Evidence for no difference")


def test_reliability_of_a_scale_counts_turned_items() -> None:
    sus = SCALES["sus"]
    data = simulate_data(Cohort(items_alike=0.6), 40, items=(), rankings=(), scales=[sus], conditions=("x", "y"))
    of, beside = found(data)
    assert [(one.scale, one.condition, one.of.items) for one in beside.reliabilities] == [
        ("SUS", "x", 10),
        ("SUS", "y", 10),
    ]
    assert all(one.of.alpha > 0.85 for one in beside.reliabilities)
    assert "SUS" in said(of, "Reliability of scales")
    for people, counted in ((3, ["SUS"]), (2, [])):
        few = simulate_data(Cohort(), people, items=(), rankings=(), scales=[sus], conditions=("x",), queries=0)
        assert [one.scale for one in found(few)[1].reliabilities] == counted


def test_three_policies_have_worths() -> None:
    def study(arms: tuple[str, ...]) -> StudyData:
        people = [ParticipantRow(f"P-{k}", False, None, False, "completed", ()) for k in range(8)]
        answers = [
            Comparison(one.code, *pair, False)
            for k, one in enumerate(people)
            for arm in arms
            for pair in ((("own", arm),) * 3 + (((arm, "own"),) if k % 2 else ()))
        ]
        asked = [Choice(one.code, "v", "v", "1", "regular", "a", "b", "a", 1.0) for one in people]
        return StudyData("By hand", "1", {}, "", [], people, asked, [], answers)

    of, beside = found(study(("base", "other")))
    assert [one.name for one in beside.worths] == ["the own policy", "the base policy", "another participant's policy"]
    assert beside.worths[0].low > beside.worths[1].high
    assert "Bradley and Terry" in said(of, "Worths of the policies compared")
    assert found(study(("base",)))[1].worths == []


def test_answers_that_separate_the_conditions_have_a_test_but_no_odds_ratio() -> None:
    """Everybody rates one condition with the lowest and the other with the highest: there is no finite estimate."""
    of, beside = found(crossover([(1, 7)] * 6, [(X, Y)] * 3 + [(Y, X)] * 3), AnalysisPlan(metrics=(), models=True))
    (model,) = beside.models
    assert model.effects == ()
    assert model.problem is not None
    assert model.test is not None
    assert model.test.p < 0.01
    assert "separate the conditions" in said(of, "Mixed models")


def test_mixed_models_beside_the_tests() -> None:
    data = simulate_data(
        Cohort(ratings={"fun": {"immersive": 1.5}}, second_shown=0.0), 24, items=("fun",), comparisons=4
    )
    of, beside = found(data, AnalysisPlan(metrics=(), models=True))
    fun = beside.models[0]
    assert fun.about == "rating of fun"
    (immersive, at, low, high), (top, *_) = fun.effects
    assert immersive == "immersive against first person"
    assert top == "top down against first person"
    assert 1 < low < at < high
    assert fun.test is not None
    assert fun.test.p < 0.001
    assert [one.about for one in beside.models[1:]] == [
        "choosing the second shown",
        "choosing the own policy over the base policy",
        "choosing the own policy over another participant's policy",
    ]
    chance = beside.models[2].effects[0]
    assert chance[0] == "chance"
    assert 0.2 < chance[2] < 0.5 < chance[3] < 0.8
    assert "odds ratio" in said(of, "Mixed models")
    alike = replace(data, ratings=[replace(one, value=4) for one in data.ratings if one.condition])
    assert found(alike, AnalysisPlan(metrics=(), models=True))[1].models[0].problem is not None
    assert found(data)[1].models == ()


def test_two_people_in_either_order_are_enough_to_look_at_periods() -> None:
    _, beside = found(crossover([(4, 6), (3, 1)], [(X, Y), (Y, X)]))
    assert [one.n for one in beside.order_effects] == [2, 2]
    assert found(crossover([(4, 6), (3, 1)], [(X, Y), (X, Y)]))[1].order_effects == []


def test_every_two_of_three_conditions_are_weighed_and_bounded_over_who_met_all() -> None:
    random = np.random.default_rng(3)
    names = ("a", "b", "c")
    values = random.integers(1, 8, (6, 3))
    people = [ParticipantRow(f"P-{k}", False, None, False, "completed", names) for k in range(6)]
    ratings = [
        Rating(f"P-{k}", name, "q", "fun", int(v))
        for k, row in enumerate(values)
        for name, v in zip(names, row, strict=True)
    ]
    shares = [("own",) * 4, ("own",) * 3 + ("base",), ("own", "own", "base", "base"), ("base",) * 4]
    compared = [
        Comparison(f"P-{k}", one, "base" if one == "own" else "own", False) for k, of in enumerate(shares) for one in of
    ]
    plan = AnalysisPlan(metrics=(), bayes_factors=True, equivalence=Equivalence(rating=1.5, share=0.3))
    data = StudyData("By hand", "1", {}, "", [], people, [], ratings[:-1], compared)  # P-5 did not rate the last
    _, beside = found(data, plan)
    pairs = [(0, 1), (0, 2), (1, 2)]
    assert [one.about for one in beside.equivalent[:3]] == [
        f"fun, {names[i]} against {names[j]}, within ±1.5" for i, j in pairs
    ]
    assert [one.n for one in beside.equivalent] == [5, 5, 5, 4]
    assert [one.effect for one in beside.equivalent[:3]] == pytest.approx(
        [np.mean(values[:5, i] - values[:5, j]) for i, j in pairs]
    )
    assert beside.equivalent[3].effect == pytest.approx(np.mean([1, 0.75, 0.5, 0]) - 0.5)
    assert [one.factor for one in beside.weighed[:3]] == pytest.approx(
        [bayes_factor(values[:5, i] - values[:5, j]) for i, j in pairs]
    )
    assert beside.weighed[3].factor == pytest.approx(bayes_factor_of_choices(2, 1)), "one half is for neither"
    alone = replace(data, comparisons=compared[:4], ratings=ratings[:3])
    _, few = found(alone, plan)
    assert (list(few.equivalent), [one.about for one in few.weighed]) == (
        [], ["people who mostly chose the own policy over the base policy"],
    )  # fmt: skip


def test_a_scale_s_answers_are_turned_and_only_whole_ones_count() -> None:
    sus = SCALES["sus"]
    random = np.random.default_rng(2)
    answers = random.integers(1, 6, (5, 10))
    people = [ParticipantRow(f"P-{k}", False, None, False, "completed", ("x",)) for k in range(5)]
    ratings = [
        Rating(f"P-{k}", "x", "sus", item.key, int(v))
        for k, row in enumerate(answers)
        for item, v in zip(sus.items, row, strict=True)
    ]
    data = StudyData("By hand", "1", {}, "", [], people, [], ratings[:-1], [], scales=[("sus", sus)])
    _, beside = found(data)
    turned = np.array(
        [[6 - v if item.reversed else v for item, v in zip(sus.items, row, strict=True)] for row in answers]
    )
    (one,) = beside.reliabilities
    assert (one.condition, one.of) == ("x", reliability(turned[:4]))


def test_a_model_of_choices_is_of_the_second_shown_by_condition_and_of_own_choices_a_chance() -> None:
    data = simulate_data(
        Cohort(second_shown=0.3), 12, items=(), rankings=(), queries=8, comparisons=5, opponents=("base",)
    )
    _, beside = found(data, AnalysisPlan(metrics=(), models=True))
    second, own = beside.models
    conditions = list(data.conditions)
    regular = [one for one in data.choices if one.role == "regular"]
    dummies = [[float(one.condition == name) for name in conditions[1:]] for one in regular]
    fit = cumulative_logit(
        [one.chosen == one.second for one in regular], dummies, [one.person for one in regular], conditions[1:]
    )
    for k, (name, at, low, high) in enumerate(second.effects):
        assert name == f"{conditions[k + 1]} against {conditions[0]}".replace("_", " ")
        assert (at, low, high) == pytest.approx(np.exp([fit.coefficients[k], *fit.interval(k)]), rel=1e-4)
    assert second.test is not None
    assert second.test.df == len(conditions) - 1
    chance = chance_of_the_higher(
        cumulative_logit(
            [one.chosen == "own" for one in data.comparisons],
            np.zeros((60, 0)),
            [c.person for c in data.comparisons],
            [],
        )
    )
    assert own.effects[0] == ("chance", *chance)
    assert own.test is None

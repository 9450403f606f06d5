"""Simulated people of a seed answer as they did when numbers about them were published."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.analysis.scales import Scale, ScaleItem
from desirepath.report.simulated_cohorts import CONDITIONS, Cohort, CohortError, rate_opinions, simulate_data
from desirepath.report.simulated_rankers import (
    ITEMS,
    OBJECTS,
    PUBLISHED,
    RankerCohort,
    condition_name,
    draw_scores,
    item_texts,
    noise_for,
    simulate_rankings,
)

COHORT = Cohort(
    ratings={"fun": {"immersive": 1.0, "fast": 0.5}},
    first_choice={"usefulness": {"immersive": 0.6}},
    consistency={"immersive": 0.7},
    second_shown=0.2,
    own=0.7,
    own_against_other=0.6,
    items_alike=0.3,
    drop_out=0.3,
    shown=0.6,
    seed=4,
)
RATED = [[6, 4, 3, 3], [6, 3, 4, 5], [7, 5, 3, 6], [7, 7, 6, 3]]  # people's fun, ease; immersive, top-down

SEEN_RANKED = [
    ("plain-bare", [0, 4, 2, 3, 1]),
    ("plain-bare", [3, 4, 2, 0, 1]),
    ("plain-lidar", [4, 0, 3, 1, 2]),
    ("plain-lidar", [0, 1, 4, 2, 3]),
    ("outline-bare", [3, 0, 2, 4, 1]),
]
SAID = [1, 6, 2, 7, 2, 7, 4, 6, 4, 5, 4, 4, 3, 6, 1, 7, 4, 6, 4, 5, 3, 3, 2, 6, 4, 4, 3, 7, 3, 4, 3, 5]
ITEMS_OF_AWARENESS = ("perception", "intelligibility", "prediction")


def bits(answers: object) -> str:
    return "".join(str(int(one)) for one in answers)  # type: ignore[attr-defined]


def test_a_seed_s_people_rate_and_rank_as_they_did() -> None:
    people = [COHORT.person(number) for number in range(6)]
    of = [("fun", "immersive", ()), ("fun", "top_down", ("fast",)), ("ease", "immersive", ()), ("ease", "top_down", ())]
    assert [[one.rate(item, view, levels=levels) for item, view, levels in of] for one in people[:4]] == RATED
    ranked = ["".join(view[0] for view in one.rank("usefulness", CONDITIONS)) for one in people]
    assert ranked == ["ift", "ift", "itf", "itf", "ift", "ift"]


def test_a_seed_s_people_choose_as_they_did() -> None:
    people = [COHORT.person(number) for number in range(20)]
    queries = [str(number) for number in range(16)]
    assert [bits(one.slips("immersive", q, "regular") for q in queries) for one in people[:3]] == [
        "0101000110000010",
        "0000001000001010",
        "0010100010000000",
    ]
    assert [bits(one.takes_second("immersive", q, "repeat") for q in queries) for one in people[:3]] == [
        "0010000000101000",
        "0000000000111010",
        "0001000001000010",
    ]
    assert [bits(one.usual(q) for q in queries) for one in people[:3]] == [
        "0111011101001010",
        "0101000101001011",
        "1100101100011110",
    ]
    own = [bits(one.prefers_own(q, a) for q in queries[:8]) for one in people[:3] for a in ("base", "other")]
    assert own == ["01111011", "10000101", "11101111", "00000111", "11101011", "00111111"]
    assert bits(one.drops_out for one in people) == "00000000000101000000"
    assert bits(one.is_shown_own for one in people) == "00111010011011110110"


def test_the_chance_of_a_slip_makes_the_consistency() -> None:
    """Two answers agree if both slip or neither does."""
    for steady in (0.5, 0.7, 0.8, 1.0):
        slip = Cohort(steady=steady).lapse_rate("any")
        assert (1 - slip) ** 2 + slip**2 == pytest.approx(steady)
    assert COHORT.lapse_rate("immersive") == Cohort(steady=0.7).lapse_rate("any")


def test_an_opinion_of_one_deviation_is_a_quarter_of_the_scale() -> None:
    assert rate_opinions([0, 1, -1, 2, -2, 9, -9], 7).tolist() == [4, 6, 3, 7, 1, 7, 1]
    assert rate_opinions([0.0, 0.49, 0.51, -0.49, -0.51], 5).tolist() == [3, 3, 4, 3, 2]


@pytest.mark.parametrize("field", ["second_shown", "own", "items_alike", "drop_out", "shown"])
def test_chances_of_0_and_1_can_be_and_nothing_beyond(field: str) -> None:
    for chance in (0.0, 1.0):
        assert getattr(Cohort(**{field: chance}), field) == chance
    for chance in (-0.01, 1.01):
        with pytest.raises(CohortError, match=f"{field} = {chance}"):
            Cohort(**{field: chance})


def test_a_simulated_data_set_has_what_was_asked_of_everybody() -> None:
    scale = Scale(
        "two",
        ("Two",),
        5,
        (ScaleItem("up", {}, {}, {}), ScaleItem("down", {}, {}, {}, reversed=True)),
        1,
        5,
        "",
        "",
        "",
    )
    data = simulate_data(
        Cohort(ratings={"two": {"fast": 9.0}}, own=1.0), 5, first=2, items=("fun",), rankings=("best",), queries=3,
        repeats=2, comparisons=2, within={"speed": ("slow", "fast")}, between={"robot": ("small", "large")},
        scales=(scale,),
    )  # fmt: skip
    assert [one.code for one in data.people] == ["S003", "S004", "S005", "S006", "S007"]
    assert [one.groups for one in data.people] == [{"block": g} for g in ("small", "large", "small", "large", "small")]
    assert len(data.choices) == 5 * 2 * (3 + 2)
    assert [one.role for one in data.choices[:5]] == ["regular"] * 3 + ["repeat"] * 2
    assert len(data.ratings) == 5 * (2 * (1 + 2) + 1)
    fast = {(one.item, one.value) for one in data.ratings if one.condition == "fast" and one.item in ("up", "down")}
    assert fast == {("up", 5), ("down", 1)}, "agreeing with a reversed item lowers the score"
    assert len(data.comparisons) == 5 * 2 * 2
    assert all(one.chosen == "own" and one.rejected in ("base", "other") for one in data.comparisons)
    assert not any(one.look_alike for one in data.comparisons)


def test_a_seed_s_rankers_rank_as_they_did() -> None:
    data = simulate_rankings(PUBLISHED, 2, trials=2)
    seen = [(one.condition, [OBJECTS.index(name) for name in one.ranking]) for one in data.importance[:5]]
    assert seen == SEEN_RANKED
    assert list(data.importance[0].scores.values()) == [1.0, 0.6779, 0.9778, 0.799, 0.7903]
    assert [one.value for one in data.ratings if one.person == "S002"] == SAID
    assert [one.code for one in simulate_rankings(PUBLISHED, 1, first=3, trials=1).people] == ["S004"]
    assert (data.people[0].state, len(data.importance)) == ("completed", 2 * 4 * 2)


def test_the_noise_of_an_agreement_is_what_it_was_and_ends_at_both_ends() -> None:
    assert [noise_for(tau) for tau in (0.1, 0.42, 0.8)] == pytest.approx([11.239, 2.439, 0.863], abs=0.001)
    assert noise_for(0.0) == noise_for(-1) == noise_for(0.01) == pytest.approx(89.569, abs=0.001)
    assert noise_for(1.0) == noise_for(0.98) == pytest.approx(0.354, abs=0.001)


def test_scores_are_of_at_most_two_hidden_objects_and_the_greatest_is_one() -> None:
    """None hidden in 65 %, one in 25 %, two in 10 % of trials."""
    scores = draw_scores(np.random.default_rng(1), 4_000)
    assert (scores.max(axis=1) == 1).all()
    assert scores.min() == 0.0
    hidden = np.bincount((scores == 0).sum(axis=1), minlength=3) / 4_000
    assert hidden == pytest.approx([0.65, 0.25, 0.10], abs=0.025)
    assert (scores == 0).mean(axis=0) == pytest.approx(np.full(5, 0.09), abs=0.015)  # whichever object


def test_what_conditions_and_items_are_called() -> None:
    names = [condition_name(outline=outline, lidar=lidar) for outline in (False, True) for lidar in (False, True)]
    assert names == ["plain-bare", "plain-lidar", "outline-bare", "outline-lidar"]
    assert [one.key for one in item_texts()] == list(ITEMS)
    assert [one.key for one in item_texts() if one.reversed] == [f"{part}_2" for part in ITEMS_OF_AWARENESS]
    assert {one.points for one in item_texts()} == {7}


def test_agreement_that_no_cohort_can_have_is_refused_in_any_condition() -> None:
    for gain in ((0.54, 0.0, 0.0), (0.0, 0.54, 0.0), (0.3, 0.2, 0.04), (-0.43, 0.0, 0.0), (0.0, 0.0, -0.43)):
        with pytest.raises(CohortError, match=r"between 0 and 0\.95"):
            RankerCohort(gain=gain)
    assert RankerCohort(tau=0.95).tau == 0.95
    assert RankerCohort(tau=0.0).tau == 0.0


def test_ratings_of_rankers_shift_by_what_is_shown() -> None:
    """Without shifts means of conditions are alike; reversed items go the other way."""
    shifted = simulate_rankings(
        RankerCohort(ratings={"trust": (2.0, 0.0, 0.0), "awareness": (0.0, 2.0, 0.0)}), 40, trials=1
    )

    def mean(item: str, condition: str) -> float:
        return float(np.mean([one.value for one in shifted.ratings if (one.item, one.condition) == (item, condition)]))

    assert mean("trust", "outline-bare") - mean("trust", "plain-bare") > 1.5
    assert abs(mean("trust", "plain-lidar") - mean("trust", "plain-bare")) < 0.7
    assert abs(mean("plausibility", "outline-lidar") - mean("plausibility", "plain-bare")) < 0.7
    first, second = (f"{ITEMS_OF_AWARENESS[0]}_{k}" for k in (1, 2))
    assert mean(first, "plain-lidar") - mean(first, "plain-bare") > 1.5
    assert mean(second, "plain-lidar") - mean(second, "plain-bare") < -1.5


def test_a_factor_that_does_not_vary_is_not_shown() -> None:
    data = simulate_rankings(PUBLISHED, 1, trials=1, factors=("outline",))
    assert [(one.condition, one.outline, one.lidar) for one in data.importance] == [
        ("plain-bare", False, False),
        ("outline-bare", True, False),
    ]

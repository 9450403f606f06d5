"""Every design of a protocol is tested as it asks: two conditions, groups, several factors, scores of scales."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from desirepath.analysis.repeated_measures import wilcoxon
from desirepath.analysis.scale_wordings import SCALES
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings, analyse
from desirepath.report.report_text import brief, sections
from desirepath.report.study_data import Choice, ParticipantRow, Rating, StudyData
from desirepath.report.study_design import designs_of

PLAN = AnalysisPlan(metrics=())


def nothing(trajectory: str) -> None:
    raise LookupError(trajectory)


def person(code: str, **groups: str) -> ParticipantRow:
    return ParticipantRow(code, False, None, False, "completed", (), groups)


def study(
    block: dict, rated: dict[str, dict[str, list[float]]], groups: dict[str, str] | None = None, item: str = "fun"
) -> StudyData:
    """rated: person -> condition -> ratings of one item."""
    people = [person(code, **({"block": groups[code]} if groups else {})) for code in rated]
    ratings = [
        Rating(code, condition, "q", item, value)
        for code, of in rated.items()
        for condition, v in of.items()
        for value in v
    ]
    asked = [
        Choice(code, condition, "top_down", "1", "regular", "a", "b", "a", 1.0)
        for code, of in rated.items()
        for condition in of
    ]
    protocol = {"stages": [{"consent": {"text": "x"}}, {"block": block}]}
    return StudyData("By hand", "1", protocol, "", [], people, asked, ratings, [])


def analysed(data: StudyData, plan: AnalysisPlan = PLAN) -> Findings:
    return analyse(data, nothing, plan=plan)


RANDOM = np.random.default_rng(7)
TWO = RANDOM.integers(1, 8, (12, 2)) + np.array([2, 0])
FOUR = RANDOM.integers(1, 8, (12, 4)) + np.array([2, 2, 0, 0])


def test_two_conditions_are_tested_by_wilcoxon() -> None:
    rated = {f"P-{k}": {"top_down": [row[0]], "immersive": [row[1]]} for k, row in enumerate(TWO.tolist())}
    found = analysed(study({"each": ["top_down", "immersive"]}, rated))
    (fun,) = found.items
    assert fun.test.test == "Wilcoxon signed-rank"
    assert fun.test.about == "rating of fun, top down against immersive"
    assert fun.test.effect > 0
    assert {name: of.mean for name, of in fun.means.items()} == {
        "top_down": TWO[:, 0].mean(),
        "immersive": TWO[:, 1].mean(),
    }
    assert not fun.pairs
    assert found.designs[0].words == "2 conditions (view within people)"
    told = " ".join(brief(found))
    assert "(Wilcoxon signed-rank, Holm)" in told
    (part,) = (part for part in sections(found, [], Path()) if part.title == "Ratings after each block")
    assert part.tables[0].rows[0][1] == f"{TWO[:, 0].mean():.2f} ± {stats.sem(TWO[:, 0]):.2f}"
    assert "exact" in part.tables[1].rows[0]


def test_groups_are_tested_by_mann_whitney_or_kruskal_wallis() -> None:
    """`one_of`: everybody meets one view only."""
    values = RANDOM.integers(1, 8, 15)
    views = ("top_down", "immersive", "first_person")
    for names in (views[:2], views):
        rated = {f"P-{k}": {names[k % len(names)]: [int(value)]} for k, value in enumerate(values)}
        found = analysed(study({"one_of": {"view": list(names)}}, rated))
        groups = [values[k :: len(names)] for k in range(len(names))]
        (fun,) = found.items
        theirs = stats.kruskal(*groups) if len(names) > 2 else stats.mannwhitneyu(*groups)
        assert fun.test.test == ("Kruskal-Wallis" if len(names) > 2 else "Mann-Whitney")
        assert fun.test.statistic == pytest.approx(theirs.statistic)
        assert [of.mean for of in fun.means.values()] == [pytest.approx(group.mean()) for group in groups]
        assert [of.n for of in fun.means.values()] == list(map(len, groups))
        assert found.between == {} or all(of.share.n == 0 for of in found.between.values())
    always = analysed(study({"one_of": {"view": list(views)}}, rated), AnalysisPlan(metrics=(), pairs="always"))
    assert [pair.test for pair in always.items[0].pairs] == ["Mann-Whitney"] * 3


def test_two_by_two_is_no_list_of_four_conditions() -> None:
    """The first factor adds 2, the second nothing; cells are called by both levels."""
    names = ("top_down-slow", "top_down-fast", "immersive-slow", "immersive-fast")
    rated = {f"P-{k}": dict(zip(names, [[v] for v in row], strict=True)) for k, row in enumerate(FOUR.tolist())}
    found = analysed(study({"each": {"view": ["top_down", "immersive"], "speed": ["slow", "fast"]}}, rated))
    (fun,) = found.items
    assert [test.about for test in fun.tests] == [
        "rating of fun, view", "rating of fun, speed", "rating of fun, view × speed",
    ]  # fmt: skip
    own = FOUR @ np.array([1, 1, -1, -1]) / 2
    assert fun.tests[0].p == pytest.approx(stats.wilcoxon(own, method="exact").pvalue, abs=0.02)
    assert fun.tests[0].direction == "higher for top down than for immersive"
    assert tuple(fun.means) == names
    assert found.designs[0].words == "2 × 2 conditions (view, speed within people)"
    assert sum(test.correction == "Holm" for test in fun.tests) == 3


def test_one_factor_within_and_one_between() -> None:
    """Which group a person is in stands in their session's assignment."""
    rated = {f"P-{k}": {"top_down": [row[0]], "immersive": [row[1]]} for k, row in enumerate(TWO.tolist())}
    groups = {code: ("small", "large")[k % 2] for k, code in enumerate(rated)}
    block = {"each": ["top_down", "immersive"], "one_of": {"robot": ["small", "large"]}}
    found = analysed(study(block, rated, groups))
    (fun,) = found.items
    assert [(test.test, test.about) for test in fun.tests] == [
        ("Aligned ranks", "rating of fun, view"),
        ("Mann-Whitney", "rating of fun, robot"),
        ("Mann-Whitney", "rating of fun, view × robot"),
    ]
    own = TWO[:, 0] - TWO[:, 1]
    assert fun.tests[2].statistic == stats.mannwhitneyu(own[::2], own[1::2]).statistic
    assert fun.means["top_down, large"].mean == TWO[1::2, 0].mean()
    unknown = study(block, rated, {**groups, "P-0": "nowhere"})
    assert analysed(unknown).items[0].test.n == 11


def test_levels_are_compared_over_the_other_factor() -> None:
    views, speeds = ("top_down", "first_person", "immersive"), ("slow", "fast")
    values = np.random.default_rng(1).integers(1, 4, (14, 6)) + np.array([0, 0, 0, 0, 3, 3])
    cells = [f"{view}-{speed}" for view in views for speed in speeds]
    rated = {f"P-{k}": dict(zip(cells, [[v] for v in row], strict=True)) for k, row in enumerate(values.tolist())}
    found = analysed(study({"each": {"view": list(views), "speed": list(speeds)}}, rated))
    (fun,) = found.items
    assert fun.tests[0].test == "Aligned ranks"
    assert fun.tests[0].significant()
    assert [pair.significant() for pair in fun.pairs] == [False, True, True]
    margins = values.reshape(14, 3, 2).mean(axis=2)
    assert fun.pairs[0].n == 14
    assert fun.pairs[1].effect == pytest.approx(-1.0)
    assert (margins[:, 2] > margins[:, 0]).all()


def test_a_scale_of_several_items_is_tested_by_its_score_alone() -> None:
    sus = SCALES["sus"]
    views = ("first_person", "immersive", "top_down")
    people = [person(f"P-{k}") for k in range(10)]
    random = np.random.default_rng(3)
    ratings = [
        Rating(one.code, view, "usability", item.key, int(random.integers(1, 6)))
        for one in people
        for view in views
        for item in sus.items
    ]
    ratings += [Rating(one.code, view, "q", "fun", int(random.integers(1, 8))) for one in people for view in views]
    data = StudyData("By hand", "1", {}, "", [], people, [], ratings, [], scales=[("usability", sus)])
    found = analysed(data)
    assert [one.item.key for one in found.items] == ["fun", "sus"]
    score = found.items[1]
    assert (score.item.lowest, score.item.points) == (0, 100)
    table = [
        [s.score for s in found.scales[0].scores if (s.person, s.condition) == (one.code, view)]
        for one in people
        for view in views
    ]
    theirs = stats.friedmanchisquare(*np.array(table).reshape(10, 3).T)
    assert score.test.statistic == pytest.approx(theirs.statistic)
    assert score.test.about == "score of System Usability Scale (SUS)" or "score of" in score.test.about
    assert all(0 <= of.low <= of.high <= 100 for of in score.means.values())


def test_swapped_probes_of_steady_people_agree_and_place_lovers_do_not() -> None:
    """With the sides swapped a steady person takes the other place; who always takes the same place chose another
    trajectory each time."""

    def asked(chooses: str) -> StudyData:
        answers = []
        for k in range(8):
            first, second = f"{k}-x", f"{k}-y"
            liked = first if k % 3 else second
            chosen = {"steady": (liked, liked), "place": (second, first)}[chooses]
            answers.append(Choice("P-1", "v", "v", str(k), "regular", first, second, chosen[0], 1.0))
            answers.append(Choice("P-1", "v", "v", str(k), "swap", second, first, chosen[1], 1.0))
        return StudyData("By hand", "1", {}, "", [], [person("P-1")], answers, [], [])

    steady = analysed(asked("steady")).of_condition["v"].swap
    assert (steady.share.mean, steady.kappa.mean) == (1.0, 1.0)
    place = analysed(asked("place")).of_condition["v"].swap
    assert (place.share.mean, place.kappa.mean) == (0.0, 0.0)


def test_pairs_are_corrected_over_all_items_or_as_the_plan_says() -> None:
    names = ("a", "b", "c")
    values = np.arange(1, 4) + np.random.default_rng(0).integers(0, 2, (9, 3))
    data = study(
        {"view": "top_down"},
        {f"P-{k}": dict(zip(names, [[v] for v in row], strict=True)) for k, row in enumerate(values.tolist())},
    )
    both = replace(data, ratings=[*data.ratings, *(replace(one, item="ease") for one in data.ratings)])
    over_items = analysed(both)
    assert [one.significant(0.05) for one in over_items.items] == [True, True]
    raw = over_items.items[0].pairs[1]
    gate = over_items.items[0].test
    assert raw.p_corrected == pytest.approx(2 * max(gate.p, raw.p))
    of_item = analysed(both, AnalysisPlan(metrics=(), pairs_over="item"))
    assert of_item.items[0].pairs[1].p_corrected == pytest.approx(3 * raw.p)


def test_so_few_people_that_nothing_can_be_found_are_told_so() -> None:
    """Four people, two conditions: no p below 2 / 2^4."""
    rated = {f"P-{k}": {"top_down": [7], "immersive": [1 + k]} for k in range(4)}
    found = analysed(study({"each": ["top_down", "immersive"]}, rated))
    assert found.items[0].test.p == pytest.approx(0.125)
    assert any("no rating can be significant" in sentence for sentence in brief(found))
    (part,) = (part for part in sections(found, [], Path()) if part.title == "Ratings after each block")
    assert any("none could be with so few people" in point for point in part.points)


def test_blocks_without_factors_are_compared_as_they_were_met() -> None:
    data = StudyData("By hand", "1", {}, "", [], [person("P-1")], [], [Rating("P-1", "x", "q", "fun", 3)], [])
    assert designs_of(data) == []
    apart = StudyData(
        "By hand", "1", {}, "", [], [person("P-1"), person("P-2")], [],
        [Rating("P-1", "x", "q", "fun", 3), Rating("P-2", "y", "q", "fun", 4)], [],
    )  # fmt: skip
    (design,) = designs_of(apart)
    assert (design.within, design.groups) == ({}, {"P-1": 0, "P-2": 1})


@pytest.mark.parametrize(
    ("block", "rated", "why"),
    [
        ({"view": "x"}, {"P-0": {"x": []}, "P-1": {"x": []}}, "compares no conditions"),
        ({"each": ["x", "y"]}, {"P-0": {"x": [], "y": []}, "P-1": {"x": [], "y": []}}, "in what was shown only"),
        ({"each": ["x", "y"]}, {"P-0": {"x": [3], "y": [4]}}, "one person is too few"),
    ],
)
def test_a_report_without_a_test_says_why(block: dict, rated: dict, why: str) -> None:
    found = analysed(study(block, rated))
    assert found.tests == []
    assert any(why in sentence for sentence in brief(found))


def test_pairs_are_of_effects_with_more_than_two_levels_alone() -> None:
    """2 x 3, pairs asked for whatever the test says: the three speeds' three pairs, corrected over three."""
    random = np.random.default_rng(3)
    cells = [f"{view}-{speed}" for view in ("top_down", "immersive") for speed in ("slow", "usual", "fast")]
    values = random.integers(1, 8, (8, 6)).tolist()
    rated = {f"P-{k}": dict(zip(cells, [[v] for v in row], strict=True)) for k, row in enumerate(values)}
    block = {"each": {"view": ["top_down", "immersive"], "speed": ["slow", "usual", "fast"]}}
    (fun,) = analysed(study(block, rated), AnalysisPlan(metrics=(), pairs="always")).items
    assert [test.about.removeprefix("rating of fun, ") for test in fun.tests] == ["view", "speed", "view × speed"]
    assert [pair.about.removeprefix("rating of fun, ") for pair in fun.pairs] == [
        "speed, slow against usual", "speed, slow against fast", "speed, usual against fast",
    ]  # fmt: skip
    assert [pair.p_corrected for pair in fun.pairs] == pytest.approx([min(1, 3 * pair.p) for pair in fun.pairs])


def test_a_factor_with_a_single_level_is_no_factor() -> None:
    """Two speeds under one view are two conditions; two robots under one view are two groups; one alone is nothing."""
    random = np.random.default_rng(3)
    one_view = {"view": ["top_down"]}
    two = {f"P-{k}": {f"top_down-{s}": [int(random.integers(1, 8))] for s in ("slow", "fast")} for k in range(8)}
    found = analysed(
        study({"each": {**one_view, "speed": ["slow", "fast"]}}, two), AnalysisPlan(metrics=(), pairs="always")
    )
    assert found.designs[0].words == "2 conditions (speed within people)"
    slow, fast = np.array([[of["top_down-slow"][0], of["top_down-fast"][0]] for of in two.values()], dtype=float).T
    assert found.items[0].test.test == "Wilcoxon signed-rank"
    assert found.items[0].test.p == pytest.approx(wilcoxon(slow, fast, about="", names=("a", "b")).p)
    assert found.items[0].pairs == []
    robots = {f"P-{k}": ("small", "large")[k % 2] for k in range(8)}
    rated = {who: {"top_down": [int(random.integers(1, 8))]} for who in robots}
    found = analysed(study({"each": one_view, "one_of": {"robot": ["small", "large"]}}, rated, robots))
    assert found.designs[0].words == "2 conditions (robot between people)"
    sides = [[of["top_down"][0] for who, of in rated.items() if robots[who] == robot] for robot in ("small", "large")]
    assert found.items[0].test.statistic == stats.mannwhitneyu(*sides).statistic
    alone = study({"each": one_view}, rated)
    assert designs_of(alone) == []


def test_groups_of_three_have_pairs_between_people() -> None:
    rated = {f"P-{k}": {"-".join(("abc"[k % 3],)): [1 + (k * 5) % 7]} for k in range(15)}
    groups = {person: next(iter(of)) for person, of in rated.items()}
    data = study({"one_of": {"robot": ["a", "b", "c"]}}, rated, groups)
    (fun,) = analysed(data, AnalysisPlan(metrics=(), pairs="always")).items
    by = {name: [of[name][0] for of in rated.values() if name in of] for name in "abc"}
    assert fun.test.test == "Kruskal-Wallis"
    assert fun.test.statistic == pytest.approx(stats.kruskal(*by.values()).statistic)
    assert [pair.statistic for pair in fun.pairs] == [
        stats.mannwhitneyu(by[one], by[other]).statistic for one, other in ("ab", "ac", "bc")
    ]
    assert {name: mean.mean for name, mean in fun.means.items()} == {
        k: pytest.approx(np.mean(v)) for k, v in by.items()
    }

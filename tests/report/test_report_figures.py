"""The report's figures show the numbers that stand beside them: read back from what is drawn."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from desirepath.analysis.scale_wordings import SCALES
from desirepath.analysis.tested import Mean
from desirepath.explain.pictures import Picture
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings, analyse
from desirepath.report.planned_design import Assumed
from desirepath.report.report_figures import (
    PLACES,
    agreement_picture,
    disagreement_picture,
    items_picture,
    personalised_picture,
    pictures,
    power_picture,
    ranking_picture,
)
from desirepath.report.simulated_cohorts import CONDITIONS, ITEMS, Cohort, simulate_data
from desirepath.report.simulated_power import Power, rate

DIFFERENT = Cohort(
    ratings={"fun": {"immersive": 2.0}, "ease": {"top_down": 1.2, "immersive": 2.5}},
    first_choice={"usefulness": {"top_down": 0.7}},
    own=0.85,
    seed=3,
)
SEVEN = ("fun", "ease", *ITEMS[3:8])


@pytest.fixture(scope="module")
def found() -> Findings:
    data = simulate_data(
        DIFFERENT, 24, items=SEVEN, rankings=("usefulness", "ease_of_use"), queries=6, repeats=5, comparisons=3
    )  # fmt: skip
    return analyse(data, lambda _: None, "simulated", AnalysisPlan(metrics=()))


def bars(ax: Axes) -> list[tuple[float, float, float, str]]:
    """Middle, bottom, top and colour of every bar."""
    return [
        (p.get_x() + p.get_width() / 2, p.get_y(), p.get_y() + p.get_height(), to_hex(p.get_facecolor()))
        for p in ax.patches
    ]


def lines_over(ax: Axes) -> list[np.ndarray]:
    """Ends of every error bar, as points. They are thin lines."""
    assert all(0 < width < 1.6 for drawn in ax.collections for width in drawn.get_linewidths())
    return [segment for drawn in ax.collections for segment in drawn.get_segments()]


def words(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.texts]


def shown(picture: Picture) -> list[Axes]:
    visible = [ax for ax in picture.figure.axes if ax.get_visible()]
    for ax in visible:  # marks and guides do not drown what is compared
        assert all(line.get_linewidth() < 2 and line.get_markersize() < 7 for line in ax.lines)
        assert all(text.get_fontsize() < 8 for text in ax.texts)
        assert not any(ax.spines[side].get_visible() for side in ("top", "right"))
    return visible


def legend(picture: Picture) -> list[str]:
    (one,) = picture.figure.legends
    assert not one.get_frame_on()  # nor is there a box around it
    return [text.get_text() for text in one.get_texts()]


def formatted(axis: object, value: float) -> str:
    return str(axis.get_major_formatter()(value, None))  # type: ignore[attr-defined]


def test_all_that_the_data_allow_is_drawn_in_the_reports_order(found: Findings) -> None:
    assert [one.name for one in pictures(found)] == ["items", "rankings", "agreement", "personalised"]
    changed = {("first_person", "immersive"): {"time": Mean(3, 0.5, 0.1, 0.1, 0.3, 0.7)}}
    flips = replace(found, disagreement=changed, plan=AnalysisPlan(metrics=("time",)))
    assert [one.name for one in pictures(flips)][3] == "disagreement"
    nobody = {("first_person", "immersive"): {"time": Mean(0, *[float("nan")] * 5)}}
    assert "disagreement" not in [one.name for one in pictures(replace(flips, disagreement=nobody))]
    none = replace(found, items=(), rankings=(), between={}, personalised=())
    assert pictures(none) == []


def test_bars_of_items_are_their_means_with_standard_errors(found: Findings) -> None:
    picture = items_picture(found)
    axes = shown(picture)
    assert len(axes) == 7
    assert len(picture.figure.axes) == 10  # two lines of five; what is empty is hidden
    assert [ax.get_ylabel() for ax in axes] == ["mean rating" if k in (0, 5) else "" for k in range(7)]
    width, height = picture.figure.get_size_inches()
    assert 7.5 < width < 9
    assert 4 < height < 5.5
    for ax, item in zip(axes, found.items, strict=True):
        assert ax.get_title() == item.item.key.replace("_", " ")
        means = list(item.means.values())
        assert [bar[0] for bar in bars(ax)] == pytest.approx([0, 1, 2])
        assert {bar[1] for bar in bars(ax)} == {1.0}
        assert [bar[2] for bar in bars(ax)] == pytest.approx([mean.mean for mean in means])
        assert len({bar[3] for bar in bars(ax)}) == 3
        for segment, mean, place in zip(lines_over(ax), means, range(3), strict=True):
            assert segment[:, 0] == pytest.approx([place, place])
            assert sorted(segment[:, 1]) == pytest.approx([mean.mean - mean.se, mean.mean + mean.se])
        assert list(ax.get_yticks()) == [1, 2, 3, 4, 5, 6, 7]
        assert list(ax.get_xticks()) == []
        assert ax.get_ylim() == axes[0].get_ylim()
        assert all(patch.get_width() < 1 for patch in ax.patches)  # bars do not touch
    assert axes[0].get_ylim()[0] == 1.0
    assert 7 < axes[0].get_ylim()[1] < 10
    assert legend(picture) == [name.replace("_", " ") for name in CONDITIONS]
    assert "* p ≤ 0.05, ** p ≤ 0.01, *** p ≤ 0.001" in picture.caption
    assert "corrected over all items, in items where the conditions differ" in picture.caption


def test_brackets_stand_over_the_pairs_that_differ_and_no_others(found: Findings) -> None:
    for ax, item in zip(shown(items_picture(found)), found.items, strict=True):
        pairs = zip(combinations(range(3), 2), item.pairs, strict=False)
        wanted = [(pair, test.stars()) for pair, test in pairs if test.significant()]
        brackets = [line for line in ax.lines if len(line.get_xdata()) == 4]
        assert [(line.get_xdata()[0], line.get_xdata()[-1]) for line in brackets] == [pair for pair, _ in wanted]
        assert words(ax) == [stars for _, stars in wanted]
        levels = [line.get_ydata() for line in brackets]
        highest = max(mean.mean + mean.se for mean in item.means.values())
        for k, y in enumerate(levels):
            assert y[0] == y[3] < y[1] == y[2]  # up, along, down
            assert min(y) >= max(7, highest)
            assert k == 0 or min(y) > max(levels[k - 1])
            assert max(y) < ax.get_ylim()[1]
        for text, (first, second) in zip(ax.texts, [pair for pair, _ in wanted], strict=True):
            assert text.get_position()[0] == (first + second) / 2
    assert any(one.pairs for one in found.items)
    ease = next(one for one in found.items if one.item.key == "ease")
    assert sum(test.significant() for test in ease.pairs) > 1


def test_two_conditions_have_one_bracket_and_factors_none() -> None:
    cohort = Cohort(ratings={"fun": {"immersive": 2.5}}, seed=1)
    two = analyse(
        simulate_data(cohort, 20, items=("fun",), rankings=(), conditions=("immersive", "top_down"), queries=2),
        lambda _: None, "simulated", AnalysisPlan(metrics=(), pairs="always", pairs_over="item"),
    )  # fmt: skip
    picture = items_picture(two)
    (ax,) = shown(picture)
    assert words(ax) == [two.items[0].test.stars()]
    assert "an item's pairs; *" in picture.caption
    factors = {"view": ("immersive", "top_down"), "speed": ("slow", "quick")}
    crossed = analyse(
        simulate_data(cohort, 20, items=("fun",), rankings=(), within=factors, queries=2),
        lambda _: None, "simulated", AnalysisPlan(metrics=()),
    )  # fmt: skip
    (ax,) = shown(items_picture(crossed))
    assert len(bars(ax)) == 4
    assert words(ax) == []


def test_scores_have_a_panel_with_the_scales_own_ends() -> None:
    data = simulate_data(DIFFERENT, 8, items=("fun",), rankings=(), queries=2, scales=[SCALES["sus"]])
    found = analyse(data, lambda _: None, "simulated", AnalysisPlan(metrics=()))
    fun, sus = shown(items_picture(found))
    assert {bar[1] for bar in bars(sus)} == {0.0}
    assert [bar[2] for bar in bars(sus)] == pytest.approx([mean.mean for mean in found.items[1].means.values()])
    assert sus.get_ylim()[0] == 0.0
    assert sus.get_ylim()[1] >= 100
    assert fun.get_ylim()[1] < 20
    assert list(sus.get_yticks()) != list(range(101))


def test_places_of_a_ranking_add_up_to_everybody(found: Findings) -> None:
    picture = ranking_picture(found)
    assert len(shown(picture)) == 2
    for ax, ranking in zip(shown(picture), found.rankings, strict=True):
        assert ax.get_title() == ranking.item.key.replace("_", " ")
        people = np.array(list(ranking.places.values()))
        drawn = bars(ax)
        for place in range(3):
            of_place = drawn[3 * place : 3 * place + 3]
            assert [bar[0] for bar in of_place] == pytest.approx([0, 1, 2])
            below = people[:, :place].sum(axis=1) / 24
            assert [bar[1] for bar in of_place] == pytest.approx(below.tolist())
            assert [bar[2] for bar in of_place] == pytest.approx((below + people[:, place] / 24).tolist())
            assert {bar[3] for bar in of_place} == {PLACES[place]}
        assert [text.get_text() for text in ax.get_xticklabels()] == [name.replace("_", "\n") for name in CONDITIONS]
        assert ax.get_ylim() == (0, 1)
        assert formatted(ax.yaxis, 0.5) == "50%"
        assert all(patch.get_width() < 1 for patch in ax.patches)
    assert [ax.get_ylabel() for ax in shown(picture)] == ["share of people", ""]
    assert legend(picture) == ["place 1", "place 2", "place 3"]
    assert {(row["place"], row["share"] * 24 == row["people"]) for row in picture.rows} == {
        (1, True),
        (2, True),
        (3, True),
    }
    width, height = picture.figure.get_size_inches()
    assert 4.5 < width < 6
    assert 2 < height < 3


def test_agreement_is_drawn_with_its_interval_between_and_within(found: Findings) -> None:
    picture = agreement_picture(found)
    (ax,) = shown(picture)
    between = [one.share for one in found.between.values()]
    within = [found.of_condition[name].repeat.share for name in CONDITIONS]
    means = [*between, *within]
    segments = lines_over(ax)
    assert len(segments) == len(means) == 6
    for k, (segment, mean) in enumerate(zip(segments, means, strict=True)):
        assert sorted(segment[:, 0]) == pytest.approx([mean.low, mean.high])
        assert segment[:, 1].tolist() == [-k, -k]
    points = [line for line in ax.lines if line.get_marker() == "o"]
    assert [line.get_xdata()[0] for line in points] == pytest.approx([mean.mean for mean in means])
    colours = [to_hex(line.get_color()) for line in points]
    assert len(set(colours[:3])) == len(set(colours[3:])) == 1
    assert colours[0] != colours[3]
    told = [text.get_text() for text in ax.get_yticklabels()]
    assert told[0] == "first person – immersive"
    assert told[3:] == [f"{name.replace('_', ' ')}, asked again" for name in CONDITIONS]
    assert list(ax.get_yticks()) == [0, -1, -2, -3, -4, -5]
    low, high = ax.get_xlim()
    assert low <= min(0.4, *(mean.low for mean in means))
    assert high == 1.0
    assert formatted(ax.xaxis, 0.5) == "50%"
    (guessing,) = [line for line in ax.lines if list(line.get_ydata()) == [0, 1]]
    assert list(guessing.get_xdata()) == [0.5, 0.5]
    assert [row["kind"] for row in picture.rows] == ["between"] * 3 + ["within"] * 3
    few = replace(found, between=dict(list(found.between.items())[:1]), of_condition={})
    higher, lower = (one.figure.get_size_inches()[1] for one in (picture, agreement_picture(few)))
    assert 0.2 < (higher - lower) / 5 < 0.4
    assert 0.8 < lower < 1.3


def test_changes_are_drawn_per_metric_in_the_plans_order(found: Findings) -> None:
    metrics = ("time", "path_length", "mean_speed", "path_area")
    pairs = [("first_person", "immersive"), ("immersive", "top_down")]
    of = {
        pair: {name: Mean(5, (k + 1) * (-1) ** p, 0.4, 0.2, 0, 1) for k, name in enumerate(metrics)}
        for p, pair in enumerate(pairs)
    }
    picture = disagreement_picture(replace(found, disagreement=of, plan=AnalysisPlan(metrics=metrics)))
    axes = shown(picture)
    assert [ax.get_title() for ax in axes] == ["a  time", "b  length", "c  mean speed", "d  area under the path"]
    assert len(picture.figure.axes) == 6
    assert [ax.get_ylabel() for ax in axes] == ["change (z)", "", "", "change (z)"]
    for k, ax in enumerate(axes):
        ends = [bar[2] if bar[2] else bar[1] for bar in bars(ax)]
        assert ends == pytest.approx([k + 1, -(k + 1)])
        assert [bar[0] for bar in bars(ax)] == pytest.approx([0, 1])
        assert len({bar[3] for bar in bars(ax)}) == 2
        heights = [sorted(segment[:, 1]) for segment in lines_over(ax)]
        assert heights == [pytest.approx([k + 0.8, k + 1.2]), pytest.approx([-k - 1.2, -k - 0.8])]
        assert [segment[0, 0] for segment in lines_over(ax)] == [0, 1]
        assert ax.get_ylim() == axes[0].get_ylim()
        assert [line for line in ax.lines if list(line.get_ydata()) == [0, 0]]
        assert list(ax.get_xticks()) == []
        assert all(patch.get_width() < 1 for patch in ax.patches)
    assert axes[0].get_ylim()[0] < -4.2 < 4.2 < axes[0].get_ylim()[1]
    assert legend(picture) == ["first person → immersive", "immersive → top down"]
    assert [(row["from"], row["metric"], row["mean"]) for row in picture.rows][4] == ("immersive", "time", -1)
    width, height = picture.figure.get_size_inches()
    assert 6.5 < width < 8
    assert 3.5 < height < 5


def test_the_own_policys_shares_are_drawn_against_one_half(found: Findings) -> None:
    picture = personalised_picture(found)
    (ax,) = shown(picture)
    for k, (segment, one) in enumerate(zip(lines_over(ax), found.personalised, strict=True)):
        assert sorted(segment[:, 0]) == pytest.approx([one.share.low, one.share.high])
        assert segment[:, 1].tolist() == [-k, -k]
    points = [line for line in ax.lines if line.get_marker() == "o"]
    assert [line.get_xdata()[0] for line in points] == pytest.approx([one.share.mean for one in found.personalised])
    assert [text.get_text() for text in ax.get_yticklabels()] == [
        "own, not base policy",
        "own, not another participant's",
    ]
    assert list(ax.get_yticks()) == [0, -1]
    assert (ax.get_xlim(), ax.get_ylim()) == ((0, 1), (-1.5, 0.5))
    assert formatted(ax.xaxis, 0.25) == "25%"
    (half,) = [line for line in ax.lines if list(line.get_ydata()) == [0, 1]]
    assert list(half.get_xdata()) == [0.5, 0.5]
    assert [row["own_against"] for row in picture.rows] == ["base", "other"]
    assert 1.2 < picture.figure.get_size_inches()[1] < 1.6
    assert 4 < picture.figure.get_size_inches()[0] < 5


def test_power_is_drawn_over_participants_with_its_intervals() -> None:
    assumed = Assumed("a", "fun", "usefulness", effect=0.5, own=0.65)
    names = ("Wilcoxon, fun", "Sign test, own against base")
    power = [Power(n, [rate(name, k + n, 100) for k, name in enumerate(names)], None) for n in (12, 31)]
    picture = power_picture(power, assumed)
    (ax,) = shown(picture)
    curves = {line.get_label(): line for line in ax.lines if line.get_label() in names}
    assert list(curves["Wilcoxon, fun"].get_xdata()) == [12, 31]
    assert list(curves["Wilcoxon, fun"].get_ydata()) == [0.12, 0.31]
    assert list(curves["Sign test, own against base"].get_ydata()) == [0.13, 0.32]
    assert len({line.get_color() for line in curves.values()}) == 2
    for band, k in zip(ax.collections, range(2), strict=True):
        corners = band.get_paths()[0].vertices
        assert corners[:, 1].min() == pytest.approx(power[0].rates[k].low)
        assert corners[:, 1].max() == pytest.approx(power[1].rates[k].high)
        assert band.get_alpha() < 0.5
    (wanted,) = [line for line in ax.lines if list(line.get_ydata()) == [0.8, 0.8]]
    assert list(wanted.get_xdata()) == [0, 1]
    assert ax.get_ylim()[0] == 0
    assert 1 < ax.get_ylim()[1] < 1.1
    assert formatted(ax.yaxis, 0.8) == "80%"
    assert ax.get_title(loc="left") == "Simulated: 100 made-up studies of each number"
    assert legend(picture) == list(names)
    assert "the own policy is preferred in 65 %" in picture.caption
    assert "50 % rank it first for usefulness" in picture.caption
    assert "same query gets the same answer in 80 %" in picture.caption
    assert "Dotted line: 80 %." in picture.caption
    assert "own policy" not in power_picture([Power(12, [rate(names[0], 3, 100)], None)], assumed).caption
    bare = power_picture(power, replace(assumed, item="", ranking="", condition=""), queried=False).caption
    assert "Assumed: the own policy is preferred in 65 %. Dotted line" in bare
    assert len(picture.rows) == 4
    assert power_picture([Power(12, [], None)], assumed).rows == []


def test_brackets_are_as_high_as_the_scale_is_long() -> None:
    """Of a scale of 0 to 100 a sixth is what a point is of 1 to 7."""
    cohort = Cohort(ratings={"sus": {"immersive": 2.5, "top_down": 1.2}}, seed=2)
    data = simulate_data(cohort, 20, items=(), rankings=(), queries=2, scales=[SCALES["sus"]])
    found = analyse(data, lambda _: None, "simulated", AnalysisPlan(metrics=()))
    (ax,) = shown(items_picture(found))
    highest = max(mean.mean + mean.se for mean in found.items[0].means.values())
    feet = [line.get_ydata() for line in ax.lines if len(line.get_xdata()) == 4]
    assert len(feet) == sum(test.significant() for test in found.items[0].pairs) > 1
    unit = 100 / 6
    assert feet[0][0] == pytest.approx(max(100, highest + 0.3 * unit))
    for k, y in enumerate(feet):
        assert y[1] - y[0] == pytest.approx(0.12 * unit)
        assert y[0] - feet[0][0] == pytest.approx(0.6 * unit * k)
        assert ax.texts[k].get_position()[1] == pytest.approx(y[0] + 0.1 * unit)
    assert ax.get_ylim()[1] == pytest.approx(feet[-1][0] + 0.8 * unit)


def test_an_agreement_below_forty_percent_is_still_in_the_picture(found: Findings) -> None:
    """The axis begins at 40 %, or a fiftieth below the lowest interval; one that is not known moves nothing."""
    (ax,) = shown(agreement_picture(found))
    lows = [of.share.low for of in found.between.values()]
    lows += [of.repeat.share.low for of in found.of_condition.values()]
    assert ax.get_xlim()[0] == pytest.approx(min(0.4, min(lows) - 0.02))
    pair, of = next(iter(found.between.items()))
    for low, begins in ((0.7, 0.4), (0.1, 0.08), (float("nan"), 0.4)):
        one = replace(of, share=Mean(9, 0.8, 0.1, 0.1, low, 0.9))
        (ax,) = shown(agreement_picture(replace(found, between={pair: one}, of_condition={})))
        assert ax.get_xlim()[0] == pytest.approx(begins)


def test_the_caption_says_who_is_shown_a_policy() -> None:
    assumed = Assumed("a", "fun", "usefulness", effect=0.5, own=0.65)
    own, other = "Sign test, own against base", "Wilcoxon, fun"
    for test, shown_to, said in ((own, 0.6, True), (own, 1.0, False), (other, 0.6, False)):
        caption = power_picture([Power(12, [rate(test, 9, 20)], None)], replace(assumed, shown=shown_to)).caption
        assert ("by the 60 % who are shown one" in caption) == said
        assert ("the own policy is preferred in 65 %" in caption) == (test == own)

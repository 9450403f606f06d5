"""Importance rankings as chapter 8 analyses them: found what was put in, nothing where nothing was, ties said."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.explanation_findings import Explained, analyse_rankings, trials_of
from desirepath.report.explanation_text import explanation_brief, explanation_sections
from desirepath.report.findings import analyse
from desirepath.report.report_figures import explanation_pictures
from desirepath.report.simulated_cohorts import CohortError
from desirepath.report.simulated_rankers import PUBLISHED, RankerCohort, draw_ranking, noise_for, simulate_rankings
from desirepath.report.study_data import ImportanceRanking, StudyData
from desirepath.report.study_report import write_study_report

PLAN = AnalysisPlan(metrics=())
OBJECTS = ("a", "b", "c", "d", "e")


def nothing(trajectory: str) -> None:
    raise LookupError(trajectory)


def found(data: StudyData) -> Explained:
    of = analyse(data, nothing, "simulated", PLAN).explained
    assert of is not None
    return of


@pytest.fixture(scope="module")
def published() -> StudyData:
    return simulate_rankings(replace(PUBLISHED, seed=4), 24)


def ranking(order: str, scores: dict[str, float], role: str = "regular") -> ImportanceRanking:
    return ImportanceRanking("P-1", "outline-lidar", "q", role, True, True, tuple(order), scores)


def test_a_ranking_is_compared_with_the_scores_ties_corrected_and_said() -> None:
    scores = dict(zip(OBJECTS, (1.0, 0.8, 0.5, 0.0, 0.0), strict=True))
    best, worst, none = trials_of(
        [ranking("abcde", scores), ranking("edcba", scores), ranking("abcde", dict.fromkeys(OBJECTS, 0.0))]
    )
    assert best.tau == pytest.approx(stats.kendalltau([5, 4, 3, 2, 1], list(scores.values())).statistic)
    assert best.tau == pytest.approx(9 / math.sqrt(90))  # of ten pairs one is tied
    assert worst.tau == -best.tau
    assert (best.tied, best.unseen) == (1, 2)
    assert math.isnan(none.tau)
    assert none.row()["tau_b"] is None


def test_the_published_study_is_found_in_a_cohort_with_its_effects(published: StudyData) -> None:
    of = found(published)
    assert (len(of.trials), of.undefined) == (24 * 48, 0)
    assert set(of.agreement.means) == {"neither", "lidar", "outline", "outline and lidar"}
    outline, lidar, both = of.agreement.tests
    assert outline.significant()
    assert outline.direction == "higher with than without"
    assert not lidar.significant()
    assert not both.significant()
    assert (outline.test, outline.df, outline.df_error) == ("Repeated-measures ANOVA", 1, 23)
    assert 0 < outline.effect_low < outline.effect < outline.effect_high < 1
    assert [one.key for one in of.rated] == ["awareness", "trust", "plausibility"]


def test_awareness_is_the_mean_of_six_items_with_every_second_inverted(published: StudyData) -> None:
    of = found(published).rated[0]
    values = {
        (one.person, one.condition, one.item): 8 - one.value if one.item.endswith("_2") else one.value
        for one in published.ratings
        if one.item.startswith(("perception", "intelligibility", "prediction"))
    }
    own = [v for (_, condition, _), v in values.items() if condition == "outline-lidar"]
    assert len(own) == 24 * 6
    assert of.means["outline and lidar"].mean == pytest.approx(np.mean(own))
    assert of.text.endswith("(mean of 6 items)")
    assert (of.lowest, of.highest) == (1, 7)


def test_an_item_that_was_not_answered_leaves_its_person_out(published: StudyData) -> None:
    less = [one for one in published.ratings if (one.person, one.item) != ("S001", "perception_2")]
    assert found(replace(published, ratings=less)).rated[0].tests[0].n == 23


def test_practice_is_never_counted_and_nobody_is_explained_without_rankings(published: StudyData) -> None:
    practised = [replace(one, role="practice", ranking=one.ranking[::-1]) for one in published.importance]
    both = replace(published, importance=[*published.importance, *practised])
    assert found(both).agreement == found(published).agreement
    assert analyse_rankings(practised, [], PLAN) is None


def test_two_people_are_described_and_not_tested(published: StudyData) -> None:
    of = found(published.of({"S001", "S002"}))
    assert (list(of.agreement.tests), of.agreement.means["lidar"].n) == ([], 2)


def test_a_study_with_outlines_alone_has_one_effect() -> None:
    of = found(simulate_rankings(replace(PUBLISHED, seed=1), 12, factors=("outline",)))
    assert list(of.agreement.means) == ["neither", "outline"]
    assert [test.about for test in of.agreement.tests] == ["tau, outline"]


@pytest.mark.parametrize("tau", [0.1, 0.42, 0.8])
def test_simulated_people_agree_as_well_as_stated(tau: float) -> None:
    random = np.random.default_rng(0)
    scores = random.random((20_000, 5))
    places = draw_ranking(scores, tau, random)
    assert np.mean([stats.kendalltau(-p, s).statistic for p, s in zip(places[:3000], scores, strict=False)]) == (
        pytest.approx(tau, abs=0.02)
    )
    assert noise_for(0.1) > noise_for(0.8)
    with pytest.raises(CohortError, match=r"between 0 and 0\.95"):
        RankerCohort(tau=0.5, gain=(0.5, 0, 0))


def test_the_report_has_sections_figures_and_every_trial(published: StudyData, tmp_path: Path) -> None:
    told = write_study_report(published, nothing, tmp_path, who="simulated", plan=PLAN)
    assert "tau, outline" in told["significant"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in (
        "Importance rankings",
        "What was said of the explanations",
        "sphericity cannot be violated",
        "aligned",
    ):
        assert words in page
    with (tmp_path / "importance_rankings.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 24 * 48
    assert set(rows[0]) >= {"participant", "outline", "lidar", "ranking", "by_score", "tau_b"}
    for name in ("ranking_agreement", "explanation_ratings"):
        assert (tmp_path / "figures" / f"{name}.svg").is_file()
    with (tmp_path / "figures" / "ranking_agreement.csv").open(encoding="utf-8") as file:
        means = {row["shown"]: float(row["mean"]) for row in csv.DictReader(file)}
    assert means["outline"] > means["neither"]


def test_the_text_counts_ties_and_objects_that_were_not_seen(published: StudyData) -> None:
    of = found(published)
    tied = sum(len(set(one.scores.values())) < 5 for one in published.importance)
    unseen = sum(list(one.scores.values()).count(0.0) >= 2 for one in published.importance)
    section, rated = explanation_sections(analyse(published, nothing, "simulated", PLAN))
    words = section.sentences[0]
    assert words.startswith("1,152 rankings.")
    assert f"tied in {tied:,} trials ({100 * tied / 1152:.1f} %), in {unseen:,} because several objects" in words
    assert 0 < unseen < tied
    assert (of.agreement.lowest, of.agreement.highest) == (-1, 1)
    outcomes = ([of.agreement], of.rated)
    for part, some in zip((section, rated), outcomes, strict=True):
        fail = [t.about for one in some for t, c in zip(one.tests, one.checks, strict=True) if c.shapiro_p < 0.05]
        how = part.sentences[-1]
        assert (f"are not normal (Shapiro and Wilk's test) in {', '.join(fail)}: read" in how) == bool(fail)
        assert ("Nothing speaks against normal contrasts" in how) != bool(fail)
        assert f"p corrected over these {3 * len(some)} tests (Holm)" in how
        assert "Every effect has one degree of freedom" in how
        means, effects = part.tables
        assert [row[-1] for row in means.rows] == ["24"] * len(some)
        assert [row[0] for row in effects.rows] == [test.about for one in some for test in one.tests]
        assert [row[-1] for row in effects.rows] == ["24"] * 3 * len(some)
    first = of.agreement.means["neither"]
    assert section.tables[0].rows[0][1] == f"{first.mean:.2f} ({first.sd:.2f})"
    brief = explanation_brief(analyse(published, nothing, "simulated", PLAN))
    assert f"neither {first.mean:.2f}" in brief[0]
    assert len(brief) == 4


def test_two_people_s_report_says_that_nothing_is_tested(published: StudyData) -> None:
    few = analyse(published.of({"S001", "S002"}), nothing, "simulated", PLAN)
    section, _ = explanation_sections(few)
    assert section.sentences[-1].startswith("Nothing is tested: fewer than three people")
    assert len(section.tables) == 1
    assert explanation_sections(replace(few, explained=None)) == explanation_brief(replace(few, explained=None)) == []


def test_figures_show_means_with_their_bars(published: StudyData) -> None:
    of = found(published)
    agreement, rated = explanation_pictures(of)
    (ax,) = agreement.figure.axes
    means = list(of.agreement.means.values())
    assert [p.get_height() for p in ax.patches] == pytest.approx([mean.mean for mean in means])
    assert [p.get_x() + p.get_width() / 2 for p in ax.patches] == pytest.approx([0, 1, 2, 3])
    ends = [sorted(segment[:, 1]) for drawn in ax.collections for segment in drawn.get_segments()]
    assert ends == [pytest.approx([mean.mean - mean.sd, mean.mean + mean.sd]) for mean in means]
    assert [line for line in ax.lines if list(line.get_ydata()) == [0, 0]]
    assert [label.get_text() for label in ax.get_xticklabels()][-1] == "outline and\nlidar"
    assert 4 < agreement.figure.get_size_inches()[0] < 6
    assert [ax.get_title() for ax in rated.figure.axes] == ["awareness", "trust", "plausibility"]
    for ax, one in zip(rated.figure.axes, of.rated, strict=True):
        assert [p.get_y() + p.get_height() for p in ax.patches] == pytest.approx([m.mean for m in one.means.values()])
        assert {p.get_y() for p in ax.patches} == {1.0}
        ends = [sorted(segment[:, 1]) for drawn in ax.collections for segment in drawn.get_segments()]
        assert ends == [pytest.approx([m.mean - m.se, m.mean + m.se]) for m in one.means.values()]
        assert ax.get_ylim() == (1, 7)
        assert len({tuple(p.get_facecolor()) for p in ax.patches}) == 4
        assert list(ax.get_xticks()) == []
    assert 5 < rated.figure.get_size_inches()[0] < 6.5
    assert [text.get_text() for text in rated.figure.legends[0].get_texts()] == list(of.rated[0].means)
    assert [(row["shown"], row["n"]) for row in agreement.rows] == [(name, 24) for name in of.agreement.means]
    without = explanation_pictures(replace(of, rated=()))
    assert [one.name for one in without] == [agreement.name]

"""Importance rankings as chapter 8 analyses them: found what was put in, nothing where nothing was, ties said."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from backend.report.analysis_plan import AnalysisPlan
from backend.report.explanation_findings import Explained, explained, trials_of
from backend.report.findings import analyse
from backend.report.made_up_cohorts import CohortError
from backend.report.made_up_rankers import PUBLISHED, RankerCohort, made_up_rankings, noise_for, ranked
from backend.report.study_data import ImportanceRanking, StudyData
from backend.report.study_report import write_study_report

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
    return made_up_rankings(replace(PUBLISHED, seed=4), 24)


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
    assert explained(practised, [], PLAN) is None


def test_two_people_are_described_and_not_tested(published: StudyData) -> None:
    of = found(published.of({"S001", "S002"}))
    assert (list(of.agreement.tests), of.agreement.means["lidar"].n) == ([], 2)


def test_a_study_with_outlines_alone_has_one_effect() -> None:
    of = found(made_up_rankings(replace(PUBLISHED, seed=1), 12, factors=("outline",)))
    assert list(of.agreement.means) == ["neither", "outline"]
    assert [test.about for test in of.agreement.tests] == ["tau, outline"]


@pytest.mark.parametrize("tau", [0.1, 0.42, 0.8])
def test_made_up_people_agree_as_well_as_stated(tau: float) -> None:
    random = np.random.default_rng(0)
    scores = random.random((20_000, 5))
    places = ranked(scores, tau, random)
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

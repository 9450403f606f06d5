"""The simulated study of asking: honest curves of what is known after some answers."""

from __future__ import annotations

import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.queries.queries import QuerySet
from desirepath_experiments.asking import AskingConfig, asking_study, summarise

QUICK = PosteriorConfig(particles=4_000)


def test_the_study_of_asking_reports_what_it_simulated(study_queries: QuerySet) -> None:
    some = QuerySet(study_queries.setup, study_queries.queries[:60], {})
    config = AskingConfig(
        oracles=("min-human-distance", "seconds-to-person"),
        response_models=("right", "mistakes"),
        strategies=("random", "information"),
        answers=6,
        repetitions=3,
        posterior=PosteriorConfig(particles=1_500),
    )
    result = asking_study(some, config)
    assert result["simulated"] is True
    assert asking_study(some, config) == result
    assert len(result["curves"]) == 8
    for curve in result["curves"]:
        assert len(curve["accuracy"]) == 6
        assert all(
            low <= mean <= high for low, mean, high in zip(curve["low"], curve["accuracy"], curve["high"], strict=True)
        )
        assert curve["held_out"] == (curve["oracle"] == "seconds-to-person")
        assert (curve["dominant"] is None) == (curve["oracle"] == "seconds-to-person")
    distance = next(
        c for c in result["curves"] if c["oracle"] == "min-human-distance" and c["strategy"] == "information"
    )
    assert distance["accuracy"][-1] > 0.8
    rows = summarise(result)["rows"]
    assert {row["strategy"] for row in rows} == {"random", "information"}
    for row in rows:
        assert row["accuracy_6_low"] <= row["accuracy_6"] <= row["accuracy_6_high"]
        assert (row["dominant_6"] is None) == (row["oracles"] == "held_out")
        assert row["dominant_6"] is None or row["dominant_6_low"] <= row["dominant_6"] <= row["dominant_6_high"]


def test_another_set_asked_at_random_is_tested_on_the_same_queries(study_queries: QuerySet) -> None:
    config = AskingConfig(
        oracles=("clearance",),
        response_models=("right",),
        strategies=("random",),
        answers=3,
        repetitions=2,
        posterior=QUICK,
    )
    curves = asking_study(study_queries, config, plain=study_queries)["curves"]
    assert [curve["strategy"] for curve in curves] == ["random", "random_plain"]
    assert all(0 <= value <= 1 for curve in curves for value in curve["accuracy"])


def test_a_study_with_too_few_queries_is_refused(study_queries: QuerySet) -> None:
    with pytest.raises(LearningError, match="too few"):
        asking_study(QuerySet(study_queries.setup, study_queries.queries[:10], {}))

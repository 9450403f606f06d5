"""What each way of answering tells, by a run of a few simulated people."""

from __future__ import annotations

import pytest

from desirepath.learning.errors import LearningError
from desirepath_experiments.benchmarks.feedback import FeedbackConfig, benchmark_feedback
from desirepath_experiments.benchmarks.results import Progress


def test_who_also_says_how_clearly_tells_more_in_the_same_time() -> None:
    kinds = "choice,all_of_a_pair,three_piles_of_five"
    asked = FeedbackConfig(family="nine", people=2, kinds=kinds, minutes=(1, 6), scenes=30, particles=1000)
    found = benchmark_feedback(asked, Progress())
    assert found["simulated"]
    rows = {row["kind"]: row for row in found["rows"] if row["family"] == "all"}
    assert rows["all_of_a_pair"]["bits_per_minute"][0] > rows["choice"]["bits_per_minute"][0]
    for row in rows.values():
        assert row["predicted"]["6"][0] > 0.7
        assert 1 < row["answers_per_minute"][0] < 5


def test_unknown_names_are_told_with_those_that_there_are() -> None:
    for wrong in ({"kinds": "shouting"}, {"family": "martians"}):
        with pytest.raises(LearningError, match="known are"):
            benchmark_feedback(FeedbackConfig(**wrong), Progress())

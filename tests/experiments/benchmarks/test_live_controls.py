"""From the hand on a weight to the picture: an input is over when its own way is seen, whatever else is under way."""

from __future__ import annotations

from desirepath_experiments.benchmarks.live_controls import time_pictures


def test_a_picture_of_an_older_way_that_comes_after_the_answer_does_not_count() -> None:
    clock = {"inputs": [0.0, 20.0], "asked": [1.0, 21.0], "answered": [50.0, 52.0]}
    late = time_pictures(
        clock, [(55.0, 60.0, 0), (80.0, 90.0, 1)]
    )  # the second's answer was there when the first was painted
    assert (late["inputs"], late["pictures"], late["max_ms"]) == (2, 2, 70.0)
    newer = time_pictures(clock, [(55.0, 60.0, 1)])  # the first's was overtaken
    assert (newer["inputs"], newer["max_ms"]) == (2, 60.0)


def test_an_input_that_asked_for_nothing_is_left_out() -> None:
    found = time_pictures({"inputs": [0.0, 30.0], "asked": [1.0], "answered": [10.0]}, [(12.0, 20.0, 0)])
    assert (found["inputs"], found["p50_ms"]) == (1, 20.0)

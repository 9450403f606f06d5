"""The alignment benchmark runs whole, in each mode, and says what others rely on. No timing is asserted."""

from __future__ import annotations

import pytest

from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig
from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.gate import GateRule
from desirepath_experiments.benchmarks.alignment import AlignConfig, benchmark_align

TINY = {
    "instant": None,
    "conditioning_search": ConditioningSearchConfig(
        tried=8, copies=4, survivors=2, selection_scenes=20, gate=GateRule(scenes=20)
    ),
    "fine_tuning": FineTuningConfig(
        updates=64,
        checkpoints=1,
        replay_transitions=2_000,
        selection_scenes=20,
        gate=GateRule(scenes=20),
        weighing_scenes=20,
    ),
}


@pytest.mark.parametrize("mode", sorted(TINY))
def test_align_benchmark_reports_the_keys_others_rely_on(mode: str) -> None:
    result = benchmark_align(AlignConfig(setup="study_room", mode=mode, queries=6, seed=1, n=60), training=TINY[mode])
    assert result["seconds"] > 0
    for side in ("base", "neutral", "aligned"):
        assert {"setup", "n", "success_rate", "min_human_distance_m", "path_length_m", "time_s"} <= set(result[side])
    for name in ("paired_gain", "share_of_the_way"):
        assert result[name]["low"] <= result[name]["value"] <= result[name]["high"]
    assert result["base"]["ceiling_m"] == result["ceiling_m"]
    assert result["self_intersections_per_episode"] == result["aligned"]["self_intersections"]
    assert result["objective"] == "farther"
    if mode == "conditioning_search":
        assert result["against_instant"]["paired"]["path_length_m"]
    if mode == "instant":
        assert result["preference_weights"]
        assert result["aligned"]["min_human_distance_m"] != result["base"]["min_human_distance_m"]


def test_an_oracle_outside_the_vocabulary_has_no_way_to_share() -> None:
    result = benchmark_align(AlignConfig(setup="study_room", mode="instant", oracle="random", queries=4, seed=1, n=20))
    assert result["objective"] is result["share_of_the_way"] is None


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="'instant', 'conditioning_search', 'fine_tuning' or 'thesis'"):
        AlignConfig(mode="telepathy")

"""Time-to-success curves hold every look, and say null where a training never got there."""

from __future__ import annotations

import pytest

from desirepath.learning.td3.base import BaseConfig
from desirepath_experiments.benchmarks import success_curves
from desirepath_experiments.benchmarks.success_curves import CurvesConfig, Target, benchmark_curves

TINY = CurvesConfig(seeds=1, every_s=0.05, max_seconds=0.3, look_scenes=10)


def test_every_look_is_a_row_and_what_is_not_reached_is_null(tiny_config: BaseConfig) -> None:
    result = benchmark_curves(TINY, base=tiny_config)
    assert result["seconds_to_94"] == result["seconds_to_99"] == [None]
    assert result["median"] == result["worst"] == {"94": None, "99": None}
    seconds = [point["seconds"] for point in result["curves"]]
    assert seconds == sorted(seconds)
    assert seconds[-1] > 0
    assert all(point["confirmed"] is None for point in result["curves"])


def test_what_seems_reached_counts_once_fresh_scenes_confirm_it(
    tiny_config: BaseConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(success_curves, "TARGETS", {"94": Target(0.0), "99": Target(0.0, 0.999)})
    monkeypatch.setattr(success_curves, "CONFIRM_SCENES", 20)
    result = benchmark_curves(TINY, base=tiny_config)
    first = result["curves"][0]
    assert result["seconds_to_94"] == [first["seconds"]]
    assert result["seconds_to_99"] == [None]  # its interval begins too low, however often it is tried
    assert all(point["confirmed"] is not None for point in result["curves"])

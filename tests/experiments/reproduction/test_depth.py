"""Chapter 3 with the smallest budget: everything runs, is stored, told, and goes on where it stopped."""

from __future__ import annotations

import json
from functools import partial

import pytest

from desirepath.demonstrations.depth.states import CONFIGURATIONS
from desirepath.demonstrations.depth.training import DepthTrainingConfig
from desirepath_experiments.reproduction.depth import computing
from desirepath_experiments.reproduction.depth.chapter import CHAPTER, DepthBudget, make_plan
from desirepath_experiments.reproduction.driver import reproduce

TINY = DepthBudget("tiny", (0,), 30, 4, 30, 8, 8, 4, 1, 1, 32, 1, 1)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("chapter3")
    with pytest.MonkeyPatch.context() as patch:
        few = partial(DepthTrainingConfig, n_envs=16, random_transitions=256)
        patch.setattr(computing, "DepthTrainingConfig", few)
        return out, reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce depth")


def test_every_configuration_is_measured_by_mode_and_with_things_taken_away(made) -> None:
    out, _ = made
    found = json.loads((out / "results.json").read_text())
    assert found["simulated"] is True
    assert set(found["configurations"]) == set(CONFIGURATIONS) == {
        "VAE-HA", "VAE-HU", "VAE-ND", "LSTM-HP", "VAE-FOV-120", "VAE-NG",
    }  # fmt: skip
    for of in found["configurations"].values():
        assert set(of["unseen"]) == {"opposite", "random", "static", "absent", "all"}
        for rates in of["unseen"].values():
            assert sum(rates.values()) == pytest.approx(1.0)
        assert set(of["demonstrated"]) == {"nothing", "person", "furniture", "both"}
        for one in of["demonstrated"].values():
            assert 0 <= one["t_star"] <= 1
            assert one["f_m"] >= 0
    assert found["perception"]["reconstruction"]["all"]["mean_m"] > 0


def test_the_report_holds_the_tables_and_the_picture_is_drawn(made) -> None:
    out, _ = made
    page = (out / "report.html").read_text()
    for words in ("VAE-FOV-120", "Simulated throughout", "without furniture"):
        assert words in page
    assert (out / "figures" / "reconstruction.png").stat().st_size > 10_000


def test_a_second_run_computes_nothing(made) -> None:
    out, first = made
    again = reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce depth")
    assert first["computed"] == 3 + 5 + 6  # VAE-HU is VAE-HA, judged blind
    assert again["computed"] == 0
    assert again["bars"] == first["bars"]


def test_human_unaware_is_the_human_aware_controller() -> None:
    plan = make_plan(TINY)
    assert plan.trained["VAE-HU", 0] == plan.trained["VAE-HA", 0]
    assert plan.judged["VAE-HU", 0] != plan.judged["VAE-HA", 0]

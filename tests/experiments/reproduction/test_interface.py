"""Chapter 7 with the smallest budget: everybody answers in all views, every view has its policy, tables stand beside
the published ones, and it goes on where it stopped."""

from __future__ import annotations

import json

import pytest

from desirepath_experiments.reproduction.driver import reproduce
from desirepath_experiments.reproduction.interface.chapter import CHAPTER, InterfaceBudget
from desirepath_experiments.reproduction.interface.computing import RANKINGS, VIEWS
from desirepath_experiments.reproduction.published import published

TINY = InterfaceBudget("tiny", participants=3, epochs=2, updates=20, transitions=1_000, scenes=20)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("chapter7")
    return out, reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce interface")


def test_every_table_stands_beside_the_published_one(made) -> None:
    out, summary = made
    told = json.loads((out / "results.json").read_text())
    assert told["simulated"] is True
    assert len({name.partition(":")[0] for name in told["people"]}) == 3
    assert set(told["table_7_1"]) == set(RANKINGS)
    assert all(sum(shares.values()) == pytest.approx(100, abs=0.01) for shares in told["table_7_1"].values())
    assert all(50 <= of["asked_again"] <= 100 for of in told["table_7_2"].values())
    assert set(told["table_7_3"]) == {*VIEWS, "baseline"}
    assert all(
        set(of["values"]) == set(published("interface")["table_7_3"]["baseline"]) for of in told["table_7_3"].values()
    )
    html = (out / "report.html").read_text(encoding="utf-8")
    for printed in ("(81.2)", "69.2", "(1.33)", "Simulated throughout"):
        assert printed in html
    assert summary["table_7_3"]["baseline"]["success_percent"] > 80


def test_what_is_there_is_not_computed_again(made) -> None:
    out, _ = made
    assert reproduce(CHAPTER, out, TINY, processes=1)["computed"] == 0


def test_an_option_of_another_chapter_and_a_seed_without_people_are_refused(tmp_path) -> None:
    with pytest.raises(LookupError, match="device: not of chapter interface, whose options are: seed"):
        reproduce(CHAPTER, tmp_path, TINY, device="cpu")
    with pytest.raises(ValueError, match="seed = 10: between 0 and 9"):
        reproduce(CHAPTER, tmp_path, TINY, seed=10)

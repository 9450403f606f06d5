"""Chapter 8 with few simulated rankers: those with access to the outlines agree more, tables stand beside the printed
ones, and it goes on where it stopped."""

from __future__ import annotations

import json

import pytest

from desirepath_experiments.reproduction.driver import reproduce
from desirepath_experiments.reproduction.explanations.chapter import CHAPTER, ExplanationsBudget

TINY = ExplanationsBudget("tiny", scenes=60, participants=24, studies=2)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("chapter8")
    return out, reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce explanations")


def test_both_tables_stand_beside_the_published_ones_and_are_marked_as_simulated(made) -> None:
    out, summary = made
    told = json.loads((out / "results.json").read_text())
    assert told["simulated"] is True
    assert told["rankings"] == 24 * 48
    assert told["policy"]["success"] > 0.9
    assert told["scenarios"]["scenarios"] == 48
    with_outlines, without = told["tau"]["True"][0], told["tau"]["False"][0]
    assert with_outlines > without + 0.03
    assert told["table_8_1"]["outline"]["p"] < 0.05
    assert set(told["table_8_2"]) == {"awareness", "trust", "plausibility"}
    html = (out / "report.html").read_text(encoding="utf-8")
    for printed in (
        "(15.20)",
        "(22.77)",
        "(6.90)",
        "&lt;\u00a0.001)",
        "0.52 (0.11)",
        "Simulated throughout",
        "F(1, 23)",
    ):
        assert printed in html, printed
    assert summary["found"]["tau, outline"] > 0.4


def test_what_is_there_is_not_computed_again(made) -> None:
    out, _ = made
    assert reproduce(CHAPTER, out, TINY, processes=1)["computed"] == 0

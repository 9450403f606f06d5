"""Chapter 2 with the smallest budget: everything runs, is stored, drawn, told, and goes on where it stopped."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import pytest

from desirepath_experiments.reproduction.demonstrations.chapter import BARS, CHAPTER
from desirepath_experiments.reproduction.demonstrations.computing import config_of
from desirepath_experiments.reproduction.demonstrations.plan import BUDGETS, OURS, VARIANTS, make_plan
from desirepath_experiments.reproduction.driver import reproduce

TINY = replace(
    BUDGETS["small"],
    name="tiny",
    styles=("slow_near_person",),
    ablated="slow_near_person",
    updates=40,
    unseen=3,
    per_pair=1,
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("chapter2")
    return out, reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce demonstrations")


def test_every_controller_and_variant_is_measured_against_every_bar(made) -> None:
    out, _ = made
    told = json.loads((out / "results.json").read_text())
    assert told["simulated"] is True
    assert {row["controller"] for row in told["rows"]} == {*VARIANTS, "dwa", "social_cost"}
    for row in told["rows"]:
        assert set(BARS) <= set(row["values"])
        assert (row["cpu_s"] is not None) == (row["controller"] in VARIANTS)
    dwa = next(row for row in told["rows"] if row["controller"] == "dwa")["values"]
    assert dwa["success_rate"] == 1.0
    assert dwa["min_human_distance_m"] < 0.8  # it knows of no person
    assert len(told["brief"]) == len(BARS) + 3


def test_figures_have_their_data_and_the_report_holds_them(made) -> None:
    out, summary = made
    names = {path.rpartition("/")[2] for path in summary["figures"]}
    for name in ("paths_room", "measures_room", "unseen_room", "speeds_room", "curves_room_slow_near_person"):
        assert {f"{name}.png", f"{name}.svg", f"{name}.csv"} <= names
    with (out / "figures" / "measures_room.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["controller"] for row in rows} == {"demonstrations", "ours", "dwa", "social_cost"}
    page = (out / "report.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == 5
    assert "not people" in page
    card = json.loads((out / "results.card.json").read_text())
    assert card["config"]["training"]["updates"] == 40


def test_a_second_run_computes_nothing_and_says_the_same(made) -> None:
    out, first = made
    again = reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce demonstrations")
    assert (again["computed"], first["computed"]) == (0, 5 + 7 + 7)
    assert again["brief"] == first["brief"]


def test_a_bar_can_be_missed() -> None:
    assert BARS["frechet_m"].met(0.3) is False
    assert BARS["success_rate"].met(0.94) is False
    assert BARS["t_star"].met(0.8) is True
    assert BARS["speed_correlation"].met(None) is None


def test_variants_differ_from_ours_in_what_they_say() -> None:
    plan = make_plan(TINY)
    configs = {cell.controller: config_of(task.params) for cell, task in plan.trained.items()}
    assert configs["no_cloning"].bc_weight == (0.0, 0.0)
    assert configs["no_boost"].goal_boost == configs[OURS].explored_goal
    assert configs["neither"] == replace(configs["no_boost"], bc_weight=(0.0, 0.0))
    assert configs["no_demonstrations"].demonstrations is False
    assert replace(configs["no_cloning"], bc_weight=configs[OURS].bc_weight) == configs[OURS]

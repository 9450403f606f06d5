"""What is put into simulated rankers is found in their studies, and little else."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.report.planned_design import Assumed, PlannedDesign, RankedDesign
from desirepath.report.simulated_power import count_found_rankings, power
from desirepath.report.simulated_rankers import PUBLISHED, RankerCohort
from desirepath_experiments.cohorts.ranking_cohorts import ANY, ranking_cohorts


def test_effects_put_in_are_found_and_nulls_are_not() -> None:
    strong = RankerCohort(tau=0.3, gain=(0.4, 0.0, 0.0), ratings={"plausibility": (0.0, 2.0, 0.0)}, seed=3)
    rates, taus = ranking_cohorts(strong, 6, 12)
    of = {one.test: one for one in rates}
    assert (of["tau, outline"].rate, of["plausibility, lidar"].rate) == (1, 1)
    assert of["tau, lidar"].found + of["tau, outline × lidar"].found <= 3
    assert of["tau, outline, aligned ranks"].n == 6
    assert taus["outline"] - taus["neither"] == pytest.approx(0.4, abs=0.06)
    nothing = {one.test: one for one in ranking_cohorts(RankerCohort(seed=3), 10, 12)[0]}
    assert nothing[ANY].found <= 3


def test_power_grows_with_people_and_falls_with_who_leaves() -> None:
    design = RankedDesign(("outline", "lidar"))
    outline, lidar, both = design.tests
    few, many = (count_found_rankings(design, PUBLISHED, size, 8) for size in (6, 30))
    assert few[outline] < many[outline]
    assert many[lidar] + many[both] <= 2
    assert count_found_rankings(design, PUBLISHED, 30, 8, drop_out=0.9)[outline] < many[outline]


def test_a_planned_study_of_rankings_is_told_the_power_of_each_of_their_tests() -> None:
    planned = PlannedDesign((), (), (), 0, 0, ranked=RankedDesign(("lidar",), trials=6))
    assert planned.ranked.tests == ["tau, lidar (over 1 test)"]
    found = power(planned, Assumed("", "", "", tau=0.3, tau_gain=0.4), (12,), cohorts=4)
    assert [(one.test, one.n) for one in found[0].rates] == [("tau, lidar (over 1 test)", 4)]
    assert found[0].rates[0].found == 4


def test_the_command_says_that_it_is_simulated() -> None:
    made = CliRunner().invoke(app, ["benchmark", "ranking-cohorts", "--cohorts", "2", "--published", "--json"])
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    assert (told["simulated"], told["cohorts"], told["participants"]) == (True, 2, 24)
    assert told["cohort"]["gain"] == [0.1, 0.0, 0.0]

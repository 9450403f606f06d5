"""What is put into made-up rankers is found in their studies, and little else."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from backend.cli import app
from backend.experiments.cohorts.ranking_cohorts import ANY, ranking_cohorts, ranking_power
from backend.report.made_up_rankers import PUBLISHED, RankerCohort


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


def test_power_grows_with_people() -> None:
    few, many = ranking_power(PUBLISHED, (6, 30), 8)[::3]
    assert (few["test"], many["test"]) == ("tau, outline", "tau, outline")
    assert float(str(few["power"])) < float(str(many["power"]))


def test_the_command_says_that_it_is_simulated() -> None:
    made = CliRunner().invoke(app, ["benchmark", "ranking-cohorts", "--cohorts", "2", "--published", "--json"])
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    assert (told["simulated"], told["cohorts"], told["participants"]) == (True, 2, 24)
    assert told["cohort"]["gain"] == [0.1, 0.0, 0.0]

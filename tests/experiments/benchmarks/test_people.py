"""How people are asked and predicted (`asked_people.py`), small: its keys, that it repeats itself; and `benchmark
people`, which also shows them robots."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.learning.alignment.gate import CLEARLY, SURE
from desirepath.learning.errors import LearningError
from desirepath.learning.people.asked_people import PeopleConfig, benchmark_people
from desirepath.learning.people.rows import bins_of, calibration_error
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks import people
from desirepath_experiments.benchmarks.people import NOTHING
from desirepath_experiments.benchmarks.people_ways import NEEDED
from desirepath_experiments.benchmarks.results import Progress

STUDY_ROOM = get_setup("study_room")

SMALL = PeopleConfig(
    families=("thresholds",), people=2, answers=(4, 8), shown_after=8, pool=30, test=20, scenes=(6, 6, 8)
)


def test_people_are_measured_and_marked_as_simulated() -> None:
    result = benchmark_people("study_room", SMALL)
    assert result == benchmark_people("study_room", SMALL)
    assert result["simulated"]
    assert (result["people"], result["answers"]) == (2, [4, 8])
    for key in ("family", "accuracy", "claimed", "calibration_error"):
        assert key in result
    assert 0 <= result["harmed_rate_low"] <= result["harmed_rate"] <= result["harmed_rate_high"] <= 1
    assert [row["held_out"] for row in result["rows"]] == [False]
    assert {one["person"] for one in result["persons"]} == {"thresholds:0", "thresholds:1"}
    json.dumps(result)


def test_questions_may_be_of_many_manners_and_chosen_and_people_within_the_list() -> None:
    config = replace(
        SMALL, families=("nine",), people=2, answers=(6,), choose="information", queries="manners", pool=12
    )
    with pytest.raises(LearningError, match="policies, manners or both"):
        benchmark_people("study_room", replace(config, queries="others"))
    result = benchmark_people("study_room", config)
    assert {one["person"] for one in result["persons"]} == {"nine:0", "nine:1"}
    assert result["choosing_p95_ms"] > 0
    assert "shown_rate" not in result, "six answers are fewer than the eight after which a policy is made"


def test_unknown_names_are_refused() -> None:
    with pytest.raises(LearningError, match="family"):
        benchmark_people("study_room", PeopleConfig(families=("nobody",)))
    with pytest.raises(LearningError, match="response model"):
        benchmark_people("study_room", PeopleConfig(families=(), response_model="asleep"))


def test_claims_that_come_true_have_no_error() -> None:
    sure, everybody = np.full(100, 0.75), np.arange(100)
    assert calibration_error([bins_of(sure, everybody < 75)]) == pytest.approx(0.0)
    assert calibration_error([bins_of(sure, everybody < 50)]) == pytest.approx(0.25)
    both = [bins_of(sure, everybody < 100), bins_of(sure, everybody < 50)]
    assert calibration_error(both) == pytest.approx(0.0), "of all answers together"


def test_one_table_says_who_is_predicted_shown_and_harmed_and_a_stopped_run_goes_on(tmp_path: Path) -> None:
    config = people.PeopleConfig(
        family="thresholds,nine", people=1, answers=(4, 8), seeds=(0, 1), ways="each_scene,instant", test=20, scenes=10
    )
    heard: list[str] = []
    result = people.benchmark_people(config, Progress(heard.append, tmp_path / "people.json"))
    assert result["simulated"]
    assert heard == ["0 thresholds:0", "0 nine:0", "1 thresholds:1", "1 nine:1"]
    told = [(row["family"], row["answers"]) for row in result["predicted"]]
    assert told == [(family, n) for family in ("all", "thresholds", "nine") for n in (4, 8)]
    for one in result["persons"]:
        chosen, best, instant = (one[way] for way in ("each_scene", "best_in_each", "instant"))
        assert chosen["shown"] == (chosen["wins"] >= NEEDED)
        assert best["gain"] >= max(chosen["gain"], 0.0)
        surely, clearly = instant["probability_better"] >= SURE, instant["probability_clearly_better"] >= CLEARLY
        assert instant["shown"] == (surely and clearly)
    for row in result["ways"]:
        of = [one[row["way"]] for one in result["persons"] if row["family"] in ("all", one["family"])]
        assert row["people"] == len(of)
        if "shown" in row:
            assert row["shown"][0] == np.mean([one["shown"] for one in of])
            assert row["harmed"][0] == np.mean([one["shown"] and one["gain"] < -NOTHING for one in of])
    again = Progress(pytest.fail, tmp_path / "people.json")
    assert people.benchmark_people(config, again) == result
    assert again.kept_persons("study_room", replace(config, answers=(8,))) == []
    for field, unknown in {"family": "nobody", "choose": "luck", "ways": "magic"}.items():
        with pytest.raises(LearningError, match=f"{field} = '{unknown}': known are"):
            people.benchmark_people(replace(config, **{field: unknown}), Progress())


def test_a_reward_file_is_asked_like_anybody(tmp_path: Path) -> None:
    torch.manual_seed(1)
    torch.save(nn.Linear(STUDY_ROOM.observation_size + 2, 1).state_dict(), tmp_path / "net.pt")
    inputs = [{"of": "observation", "form": "export"}, {"of": "action", "form": "export"}]
    said = {"format": "desirepath-reward-2", "setup": "study_room", "file": "net.pt", "inputs": inputs}
    (tmp_path / "somebody.json").write_text(json.dumps(said))
    given = ["--family", "none", "--reward", str(tmp_path / "somebody.json"), "--answers", "4", "--test", "10"]
    told = CliRunner().invoke(app, ["benchmark", "people", *given, "--scenes", "6", "--json"])
    assert told.exit_code == 0, told.output
    result = json.loads(told.stdout.splitlines()[-1])
    assert [one["person"] for one in result["persons"]] == ["somebody"]
    assert {row["family"] for row in result["ways"]} == {"all", "file"}

"""`benchmark people`, small: its keys, that it repeats itself, that a reward file is a person."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.learning.alignment.gate import CLEARLY, SURE
from desirepath.learning.errors import LearningError
from desirepath.learning.people.asked_people import PeopleConfig, benchmark_people, known_people, result_of
from desirepath.learning.people.rows import bins_of, calibration_error
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.people_harm import PeopleHarmConfig, benchmark_people_harm, clopper_pearson
from desirepath_experiments.benchmarks.people_policies import PeoplePoliciesConfig, with_shares
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
    assert not [key for key in result if key.startswith("share_")], "only where policies are made: `--policies`"
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


def test_who_is_harmed_is_counted_as_an_alignment_job_decides_and_a_stopped_run_goes_on(tmp_path: Path) -> None:
    config = PeopleHarmConfig(
        family="thresholds,nine", people=2, answers=9, seeds=(0,), pool=30, manners=8, test=20, scenes=10, particles=500
    )
    heard: list[str] = []
    result = benchmark_people_harm(config, Progress(heard.append, tmp_path / "harm.json"))
    assert (result["people"], set(result["families"])) == (4, {"thresholds", "nine"})
    assert heard == ["0 thresholds:200", "0 nine:200", "0 thresholds:201", "0 nine:201"]
    for one in result["persons"]:
        assert one["probability_clearly_better"] <= one["probability_better"]
        surely, clearly = one["probability_better"] >= SURE, one["probability_clearly_better"] >= CLEARLY
        assert one["shown"] == (surely and clearly)
    low, high = result["harmed_rate_interval"]
    assert low <= result["harmed_rate"] <= high
    again = Progress(pytest.fail, tmp_path / "harm.json")
    assert benchmark_people_harm(config, again) == result
    assert again.kept_persons("study_room", replace(config, answers=8)) == []


def test_the_exact_interval_of_a_share() -> None:
    assert clopper_pearson(0, 400) == [0.0, 0.0092]
    assert clopper_pearson(4, 200) == [0.0055, 0.0504]


def test_a_reward_file_is_asked_like_anybody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(1)
    torch.save(nn.Linear(STUDY_ROOM.observation_size + 2, 1).state_dict(), tmp_path / "net.pt")
    inputs = [{"of": "observation", "form": "export"}, {"of": "action", "form": "export"}]
    said = {"format": "desirepath-reward-2", "setup": "study_room", "file": "net.pt", "inputs": inputs}
    (tmp_path / "somebody.json").write_text(json.dumps(said))
    small = {"pool": 30, "test": 20, "scenes": (6, 6, 8)}
    monkeypatch.setattr(
        "desirepath.learning.people.asked_people.PeopleConfig", lambda **given: PeopleConfig(**{**given, **small})
    )
    told = CliRunner().invoke(
        app, ["benchmark", "people", "--reward", str(tmp_path / "somebody.json"), "--answers", "4", "--json"]
    )
    assert told.exit_code == 0, told.output
    result = json.loads(told.stdout.splitlines()[-1])
    assert (result["family"], result["people"]) == ("file", 1)


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


def test_a_stopped_measurement_of_people_goes_on_where_it_was(tmp_path: Path) -> None:
    config = replace(SMALL, families=("thresholds", "nine"))
    whole = benchmark_people("study_room", config)
    assert [one["person"] for one in whole["persons"]] == ["thresholds:0", "nine:0", "thresholds:1", "nine:1"]
    (tmp_path / "people.json").write_text(json.dumps(result_of("study_room", config, whole["persons"][:3])))
    known = known_people(tmp_path / "people.json", "study_room", config)
    heard: list[dict[str, Any]] = []
    assert benchmark_people("study_room", config, known=known, on_person=heard.append) == whole
    assert [one["person"] for one in heard] == ["nine:1"]
    assert known_people(tmp_path / "people.json", "study_room", SMALL) == []
    assert known_people(tmp_path / "none.json", "study_room", config) == []


def test_shares_of_the_librarys_best_stand_in_every_family_s_row() -> None:
    config = replace(SMALL, people=1, answers=(8,))
    policies = PeoplePoliciesConfig(family="thresholds", people=1, answers=8, pool=12, test=10, scenes=6)
    result = with_shares(benchmark_people("study_room", config), policies, {})
    for row in (result, *result["rows"]):
        assert 0 <= row["success_at_once"] <= 1
        assert row["share_at_once"] is None or row["share_at_once"] <= 1 + 1e-9, "of the library's best"
    assert result["rows"][0]["gain_at_once"] == result["gain_at_once"], "one family is everybody"

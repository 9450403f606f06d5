"""The table of oracles runs whole and says what each one's answers moved, and what they did not."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.preferences.spans import seen_in
from desirepath.learning.queries.choosing import STRATEGIES, Candidates
from desirepath_experiments.benchmarks.preference_learning import (
    PreferencesConfig,
    answers_to,
    benchmark_preferences,
    queries_of,
)


def test_every_oracle_gets_a_line_per_pre_training_and_noise() -> None:
    config = PreferencesConfig(
        oracles=("min-human-distance", "right-and-far", "faces-person"),
        noises=(0.0, 0.2),
        query_seeds=(3,),
        answers=6,
        scenes=60,
    )
    shipped = load_conditioned("study_room/conditioned")
    result = benchmark_preferences("study_room", {"one": shipped, "other": shipped}, config)
    assert result["simulated"]
    assert len(result["rows"]) == 3 * 2 * 2
    assert len(result["summary"]) == 3 * 2 * 2
    lines = {(line["oracle"], line["noise"], line["pretraining"]): line for line in result["summary"]}
    far = lines["min-human-distance", 0.0, "one"]
    assert far["share_lowest"] <= far["share"] <= far["share_highest"]
    assert far["preferred"] > 0.5
    assert far == lines["min-human-distance", 0.0, "other"] | {"pretraining": "one"}
    assert lines["faces-person", 0.0, "one"]["share"] is None
    assert {"person_on_right", "farther"} == {want for row in result["rows"][4:8] for want in row["moved"]}


def test_the_ensembles_queries_can_be_asked_instead() -> None:
    config = PreferencesConfig(oracles=("clearance",), query_seeds=(5,), queries="ensemble", answers=4, scenes=20)
    assert benchmark_preferences("study_room", config=config)["rows"][0]["preference_weights"]


def test_the_next_query_can_be_chosen_by_what_it_would_tell() -> None:
    config = PreferencesConfig(
        oracles=("smoothest",), query_seeds=(5,), choose="information", pool=8, answers=3, scenes=20
    )
    row = benchmark_preferences("study_room", config=config)["rows"][0]
    assert (row["oracle"], row["query_seed"]) == ("smoothest", 5)
    queries = queries_of("study_room", config, 5)
    given = answers_to(make_oracle("smoothest", seed=5), queries, config)
    prior, asked = Posterior.prior("study_room"), Candidates(seen_in(queries), range(len(queries)))
    first = STRATEGIES["information"].ask_next(prior, asked, np.random.default_rng(0))
    best = queries[first.index]
    assert {id(given[0].chosen), id(given[0].rejected)} == {id(best.trajectory_a), id(best.trajectory_b)}
    assert len({id(one.chosen) for one in given}) == 3


def test_unknown_oracles_and_ways_of_choosing_are_refused() -> None:
    with pytest.raises(LearningError, match="telepath"):
        benchmark_preferences("study_room", config=PreferencesConfig(oracles=("telepath",)))
    with pytest.raises(LearningError, match="by_dice"):
        benchmark_preferences("study_room", config=PreferencesConfig(choose="by_dice"))


@pytest.mark.parametrize("name", ["preferences", "wants"])
def test_the_command_goes_by_its_name_and_by_its_first_one(name: str) -> None:
    ran = CliRunner().invoke(app, ["benchmark", name, "--queries", "none"])
    assert ran.exit_code != 0
    assert "ensemble or varied" in ran.output


def test_response_models_go_by_their_first_option_too() -> None:
    for option in ("--response-models", "--habits"):
        ran = CliRunner().invoke(app, ["benchmark", "asking", option, "telepathy"])
        assert "telepathy" in ran.output, ran.output

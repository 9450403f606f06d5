"""What jobs may be asked: defaults that are the algorithms' own, errors that name the field, words for every field."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
from pydantic import ValidationError

from desirepath.jobs.alignments import fine_tuning, thesis
from desirepath.jobs.alignments.conditioning_search import ConditioningSearchParams, search_config
from desirepath.jobs.alignments.fine_tuning import FineTuningParams
from desirepath.jobs.alignments.thesis import ThesisParams
from desirepath.jobs.kept_artefacts import command_of
from desirepath.jobs.kinds import ALIGNMENTS, KINDS, JobParamsError, get_kind
from desirepath.jobs.policy_training import config_of
from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig
from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.thesis import thesis_config
from desirepath.learning.queries.queries import QueryConfig
from desirepath.learning.td3.base import BaseConfig, base_config
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig
from desirepath.store.job_results import RESULTS, EvaluateResult, JobResult, Learned
from desirepath.store.models import Job
from desirepath.web.core.catalogues import Texts

LOCALES = Path(__file__).resolve().parents[2] / "frontend" / "locales"
REQUIRED = {
    "setup": "our_room",
    "snapshot": "a" * 64,
    "reward": "c" * 64,
    "policy": "study_room/base",
    "policy_a": "study_room/base",
    "policy_b": "b" * 64,
}


@pytest.fixture
def own_setup(tmp_path, monkeypatch):
    """One that a lab brought: only such are made ready by a job."""
    folder = tmp_path / "setups" / "our_room"
    folder.mkdir(parents=True)
    (folder / "setup.yaml").write_text("robot: turtlebot2\nworld: {name: study_room}\n")
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path))


def valid_params(kind: str) -> dict[str, object]:
    """The least that a kind wants."""
    return {name: REQUIRED[name] for name, info in KINDS[kind].params.model_fields.items() if info.is_required()}


@pytest.mark.parametrize(
    ("kind", "config"),
    [("train_base", BaseConfig("study_room")), ("ensemble", PolicyEnsembleConfig()), ("queries", QueryConfig())],
)
def test_defaults_are_those_of_the_algorithm(kind, config):
    params = (
        KINDS[kind].parse({}).model_dump(exclude={"base", "members" if kind == "queries" else ""}, exclude_none=True)
    )
    assert params == {name: getattr(config, name) for name in params}


@pytest.mark.parametrize("setup", ["study_room", "open_field", "explained_room"])
def test_a_base_policy_is_trained_as_the_shipped_one_of_its_setup(setup):
    assert config_of(KINDS["train_base"].parse({"setup": setup, "seed": 3})) == base_config(setup, 3)


def test_alignment_without_settings_is_the_algorithm_as_learning_defines_it():
    assert fine_tuning.training_config(FineTuningParams(snapshot="s")) == FineTuningConfig()
    assert thesis.training_config(ThesisParams(snapshot="s", seed=3)) == thesis_config(seed=3)
    assert search_config(ConditioningSearchParams(snapshot="s")) == ConditioningSearchConfig()
    changed = fine_tuning.training_config(FineTuningParams(snapshot="s", updates=2, reward_weight=0.5, gate_scenes=60))
    assert (changed.updates, changed.checkpoints, changed.reward_weight, changed.gate.scenes) == (2, 2, 0.5, 60)


def test_an_alignment_that_names_no_algorithm_is_fine_tuning():
    assert KINDS["align"].parse({"snapshot": "s"}) == FineTuningParams(snapshot="s")
    with pytest.raises(JobParamsError, match="updates"):
        KINDS["align"].parse({"snapshot": "s", "recipe": "instant", "updates": 8_000})


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_field_source_and_choice_has_words(kind, language):
    t = Texts(LOCALES).get(language)
    for name in ("name", "action", "what"):
        assert t(f"analyst.kinds.{kind}.{name}")
    for algorithm, params in KINDS[kind].variants.items():
        if algorithm:
            assert t(f"analyst.algorithms.{algorithm}")
            assert t(f"analyst.choices.{algorithm}")
        for name, info in params.model_fields.items():
            assert t(f"analyst.kinds.{kind}.fields.{name}.label")
            assert t(f"analyst.sources.{info.json_schema_extra['source']}")
        for field in params.model_json_schema()["properties"].values():
            for choice in [*field.get("enum", []), *(c for one in field.get("anyOf", []) for c in one.get("enum", []))]:
                assert t(f"analyst.choices.{choice}")


@pytest.mark.parametrize(
    ("kind", "given", "field", "says"),
    [
        ("align", {}, "snapshot", "has to be given"),
        (
            "align",
            {"snapshot": "s", "recipe": "magic"},
            "recipe",
            "'conditioning_search', 'each_scene', 'each_scene_trained', 'instant', 'thesis'",
        ),
        ("align", {"snapshot": "s", "gate_min_success": 1.2}, "gate_min_success", "less than or equal to 1"),
        (
            "align",
            {"snapshot": "s", "recipe": "thesis", "reward_weight": 1.5},
            "reward_weight",
            "less than or equal to 1",
        ),
        ("align", {"snapshot": "s", "recipe": "instant", "model": "linear"}, "model", "'weights'"),
        ("align", {"snapshot": "s", "recipe": "instant", "updates": 5}, "updates", "is no parameter here"),
        (
            "align",
            {"snapshot": "s", "recipe": "conditioning_search", "reward_weight": 0.5},
            "reward_weight",
            "is no parameter here",
        ),
        ("evaluate", {"policy": "p", "scenes": "many"}, "scenes", "integer"),
        ("evaluate", {"policy": "p", "scenes": 10**9}, "scenes", "10000"),
        ("queries", {"members": ["one"]}, "members", "at least 2"),
        ("train_base", {"setup": "kitchen"}, "setup", "study_room"),
        ("train_base", {"colour": "green"}, "colour", "is no parameter here"),
    ],
)
def test_wrong_parameters_are_named_with_what_would_work(kind, given, field, says):
    with pytest.raises(JobParamsError) as caught:
        get_kind(kind).parse(given)
    problem = next(one for one in caught.value.problems if one["field"] == field)
    assert says in problem["message"]
    assert field in str(caught.value)


def test_unknown_kind_lists_the_known_ones():
    with pytest.raises(JobParamsError, match="train_base"):
        get_kind("bake")


@pytest.mark.parametrize(
    ("kind", "more"),
    [(kind, {}) for kind in KINDS] + [("align", {"recipe": recipe}) for recipe in ALIGNMENTS],
)
@pytest.mark.usefixtures("own_setup")
def test_command_on_a_card_starts_the_same_job(kind, more):
    params = KINDS[kind].parse(
        {**valid_params(kind), **({"seed": 7} if kind != "queries" else {"members": ["a", "b"]}), **more}
    )
    words = shlex.split(command_of(kind, params))
    assert words[:4] == ["desirepath", "jobs", "start", kind]
    given = dict(word.split("=", 1) for word in words[5::2])
    again = {name: json.loads(value) if value[0] in "[0123456789" and name != "snapshot" else value
             for name, value in given.items()}  # fmt: skip
    assert KINDS[kind].parse(again) == params


def test_every_kind_of_job_says_what_it_results_in():
    assert set(RESULTS) == set(KINDS)
    job = Job(kind="evaluate")
    with pytest.raises(ValidationError, match="speed"):
        job.keep_result({"evaluation": "e", "measured": {}, "speed": 3})
    job.keep_result({"evaluation": "e", "measured": {"n": 20}})
    assert job.result_as(EvaluateResult).measured == {"n": 20}
    assert job.result_as(Learned) is None, "what becomes of somebody's answers"
    assert Job(kind="align").result_as(Learned) is None, "which has not ended"
    aligned = Job(kind="align")
    aligned.keep_result({"policy": "p", "passed": False, "why": "not_surely_better"})
    assert aligned.result_as(Learned).why == "not_surely_better"
    assert aligned.result_as(JobResult).made == ["p"]

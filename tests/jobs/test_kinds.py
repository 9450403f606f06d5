"""What jobs may be asked: defaults that are the algorithms' own, errors that name the field, words for every field."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

from backend.api.core.texts import Texts
from backend.jobs.aligning import align_config
from backend.jobs.kept_artefacts import command_of
from backend.jobs.kinds import KINDS, AlignParams, JobParamsError, get_kind
from backend.learning.alignment.align import AlignConfig, thesis_config
from backend.learning.errors import LearningError
from backend.learning.queries.queries import QueryConfig
from backend.learning.td3.base import BaseConfig
from backend.learning.td3.ensemble import EnsembleConfig

LOCALES = Path(__file__).resolve().parents[2] / "frontend" / "locales"
REQUIRED = {"snapshot": "a" * 64, "policy": "study_room/base", "policy_a": "study_room/base", "policy_b": "b" * 64}


def valid_params(kind: str) -> dict[str, object]:
    """The least that a kind wants."""
    return {name: REQUIRED[name] for name, info in KINDS[kind].params.model_fields.items() if info.is_required()}


@pytest.mark.parametrize(
    ("kind", "config"),
    [("train_base", BaseConfig("study_room")), ("ensemble", EnsembleConfig()), ("queries", QueryConfig())],
)
def test_defaults_are_those_of_the_algorithm(kind, config):
    params = KINDS[kind].parse({}).model_dump(exclude={"base", "members" if kind == "queries" else ""})
    assert params == {name: getattr(config, name) for name in params}


def test_alignment_without_settings_is_the_recipe_as_learning_defines_it():
    assert align_config(AlignParams(snapshot="s")) == AlignConfig()
    assert align_config(AlignParams(snapshot="s", recipe="thesis", seed=3)) == thesis_config(seed=3)
    changed = align_config(AlignParams(snapshot="s", updates=2, reward_weight=0.5, gate_scenes=60))
    assert (changed.updates, changed.checkpoints, changed.preference_weight, changed.gate_scenes) == (2, 2, 0.5, 60)


def test_thesis_recipe_refuses_a_weight_that_is_no_share():
    with pytest.raises(LearningError, match=r"reward_weight = 1\.5"):
        align_config(AlignParams(snapshot="s", recipe="thesis", reward_weight=1.5))


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_field_source_and_choice_has_words(kind, language):
    t = Texts(LOCALES).get(language)
    for name in ("name", "action", "what"):
        assert t(f"analyst.kinds.{kind}.{name}")
    for name, info in KINDS[kind].params.model_fields.items():
        assert t(f"analyst.kinds.{kind}.fields.{name}.label")
        assert t(f"analyst.sources.{info.json_schema_extra['source']}")
    for field in KINDS[kind].params.model_json_schema()["properties"].values():
        for choice in [*field.get("enum", []), *(c for one in field.get("anyOf", []) for c in one.get("enum", []))]:
            assert t(f"analyst.choices.{choice}")


@pytest.mark.parametrize(
    ("kind", "given", "field", "says"),
    [
        ("align", {}, "snapshot", "required"),
        ("align", {"snapshot": "s", "recipe": "magic"}, "recipe", "'refine' or 'thesis'"),
        ("align", {"snapshot": "s", "gate_least_success": 1.2}, "gate_least_success", "less than or equal to 1"),
        ("evaluate", {"policy": "p", "scenes": "many"}, "scenes", "integer"),
        ("evaluate", {"policy": "p", "scenes": 10**9}, "scenes", "10000"),
        ("queries", {"members": ["one"]}, "members", "at least 2"),
        ("train_base", {"setup": "kitchen"}, "setup", "study_room"),
        ("train_base", {"colour": "green"}, "colour", "not permitted"),
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


@pytest.mark.parametrize("kind", list(KINDS))
def test_command_on_a_card_starts_the_same_job(kind):
    params = KINDS[kind].parse(
        {**valid_params(kind), **({"seed": 7} if kind != "queries" else {"members": ["a", "b"]})}
    )
    words = shlex.split(command_of(kind, params))
    assert words[:4] == ["desirepath", "jobs", "start", kind]
    given = dict(word.split("=", 1) for word in words[5::2])
    again = {name: json.loads(value) if value[0] in "[0123456789" and name != "snapshot" else value
             for name, value in given.items()}  # fmt: skip
    assert KINDS[kind].parse(again) == params

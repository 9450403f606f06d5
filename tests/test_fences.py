"""No code fence of README and docs is only read: commands are parsed, data is read, code runs here or elsewhere."""

from __future__ import annotations

import re
import shlex
from itertools import dropwhile
from pathlib import Path

import pytest
import typer
import yaml

from desirepath.cli.main import app
from desirepath.deploy.ros.__main__ import parser
from desirepath.grammar.error_words import example_of
from desirepath.grammar.questionnaires import Questionnaire
from desirepath.grammar.source import Source
from desirepath.installed import PROTOCOLS, ROOT
from desirepath.learning.people.reward_manifest import read_manifest
from desirepath.recordings.mapping import read_mapping
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.protocol.stages import STAGES
from tests import test_own_setup, test_recipes
from tests.fences import DOCUMENTS, Fence, fences_of

EXTENDING, REFERENCE = "docs/extending.md", "docs/protocol-reference.md"
RUN_BY = {
    ("README.md", "In a notebook"): "test_notebook.py",
    ("docs/python.md", "In a notebook"): "test_notebook.py",  # of the README, as `experiments/test_manual.py` says
    ("docs/architecture.md", "States"): "study/test_states.py",
    **{(EXTENDING, section): "test_recipes.py" for section in (*test_recipes.PLUG_INS, *test_recipes.IN_THE_SOURCE)},
    **{(EXTENDING, section): "test_own_setup.py" for section in test_own_setup.SECTIONS},
    (EXTENDING, "A building"): "simulation/test_ground_maps.py",
    ("docs/your-recordings.md", "Formats"): "here",
    ("docs/your-policies.md", "A policy on a robot"): "deploy/test_bundle.py",
    ("docs/your-policies.md", "Inputs of a reward network"): "here",
    ("docs/your-robot.md", "With your own stack"): "deploy/test_node.py",
    (REFERENCE, "Blocks"): "here",
    (REFERENCE, "Every stage, worked"): "here",
    (REFERENCE, "Questionnaires"): "here",
}
COMMANDS = fences_of(language="bash")
OF_OTHERS = {"git", "docker", "pip"}


def named(fence: Fence) -> str:
    return f"{fence.document}-{fence.section}"


def test_every_fence_is_run_by_a_test() -> None:
    """Commands are parsed here, wherever they stand; a drawing says that it is `text`."""
    every = fences_of()
    assert len(every) == sum(path.read_text().count("```") for path in DOCUMENTS) / 2, "one is not read as a fence"
    run = [fence for fence in every if fence.language in ("bash", "text") or (fence.document, fence.section) in RUN_BY]
    assert [named(fence) for fence in every if fence not in run] == []


def commands_of(fence: Fence) -> list[list[str]]:
    """Words of every command, without comments, variables and what is only continued on the next line."""
    lines = fence.text.replace("\\\n", " ").splitlines()
    split = [shlex.split(part, comments=True) for line in lines for part in line.split(" && ")]
    return [words for part in split if (words := [*dropwhile(re.compile("[A-Z_]+=").match, part)])]


def parse(words: list[str]) -> None:
    """Have the command line read the words as it would: unknown commands and options, what is missing, wrong values."""
    command, context = typer.main.get_command(app), None
    while True:
        context = command.make_context(words[0], words[1:], parent=context)
        if not hasattr(command, "commands"):
            return
        words = [*context._protected_args, *context.args]
        command = command.commands[words[0]]


@pytest.mark.parametrize("fence", COMMANDS, ids=named)
def test_every_command_in_a_fence_is_one_that_there_is(fence: Fence) -> None:
    for program, *words in commands_of(fence):
        if "porter_room" in words:
            continue  # a setup of the recipe's own: `test_own_setup.py` runs it
        match Path(program).name:
            case "desirepath":
                if words != ["--help"]:
                    parse([program, *words])
            case "make":
                assert re.search(rf"^{words[0]}:", (ROOT / "Makefile").read_text(), re.MULTILINE), words
            case "python" if words[:2] == ["-m", "desirepath.deploy.ros"]:
                assert parser("drive").parse_args(words[2:]).policy
            case "python":
                assert words[:2] == ["-m", "pytest"]
                assert all((ROOT / word).exists() for word in words[2:] if not word.startswith("-")), words
            case "export":
                assert words[0].startswith("DESIREPATH_")
            case other:
                assert other in OF_OTHERS, program


def test_the_block_of_the_reference_is_one_that_a_study_may_have() -> None:
    (fence,) = fences_of(REFERENCE, "Blocks")
    study = yaml.safe_load((PROTOCOLS / "interface_study.yaml").read_text())
    (place,) = [k for k, stage in enumerate(study["stages"]) if "block" in stage]
    (study["stages"][place],) = yaml.safe_load(fence.text)
    assert freeze_text(yaml.safe_dump(study)).hash


WORKED = fences_of(REFERENCE, "Every stage, worked")
AROUND = {"protocol": "worked", "version": 1, "title": {"en": "Worked", "de": "Ausgeführt"}, "languages": ["en", "de"]}


@pytest.mark.parametrize("fence", WORKED, ids=lambda fence: fence.text.split("- ")[1].split(":")[0])
def test_every_worked_stage_of_the_reference_makes_a_study(fence: Fence) -> None:
    written = Source("reference.yaml", fence.text).data
    given = [next(iter(stage)) for stage in written["stages"]]
    before = [{kind: example_of(STAGES[kind])} for kind in ("information", "consent") if kind not in given]
    after = [{"debriefing": example_of(STAGES["debriefing"])}] if "debriefing" not in given else []
    asks = any(STAGES[kind].teaches or STAGES[kind].measures for kind in given)
    block = [] if asks else [{"block": example_of(STAGES["block"])}]
    stages = [*before, *written["stages"][: len(written["stages"]) - ("debriefing" in given)], *block]
    stages += after or written["stages"][-1:]
    query_set = written.get("query_set", "study_room/queries_varied_200")
    assert freeze_text(yaml.safe_dump(AROUND | {"query_set": query_set, "stages": stages})).hash


def test_the_reference_works_every_stage_as_the_editor_adds_it() -> None:
    worked = [stage for fence in WORKED for stage in Source("reference.yaml", fence.text).data["stages"]]
    for kind, stage in STAGES.items():
        assert {kind: example_of(stage)} in [{kind: given.get(kind)} for given in worked], kind


def test_the_questionnaire_of_the_reference_is_one() -> None:
    (fence,) = fences_of(REFERENCE, "Questionnaires")
    read = Questionnaire.model_validate(Source("questionnaire.yaml", fence.text).data)
    assert read.blocks[0].items[0].key == "ease"


def test_the_manifest_of_a_reward_is_read() -> None:
    (fence,) = fences_of("docs/your-policies.md", language="json")
    assert read_manifest(fence.text.encode(), "weights.json").width > 60


def test_the_mapping_of_recordings_is_read(tmp_path: Path) -> None:
    (fence,) = fences_of("docs/your-recordings.md", language="yaml")
    (tmp_path / "mapping.yaml").write_text(fence.text)
    assert read_mapping(tmp_path / "mapping.yaml")

"""What the command line says: its version, every kind of job, an export in a few lines, what is unknown at once."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from desirepath.cli.jobs import JOB_KINDS
from desirepath.cli.main import app
from desirepath.cli.study import open_store
from desirepath.installed import PROTOCOLS
from desirepath.jobs.kinds import ALIGNMENTS, KINDS
from desirepath.settings import get_settings
from desirepath.store.models import Participant

RUN = CliRunner()


@pytest.fixture(autouse=True)
def own_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path / "data"))
    get_settings.cache_clear()
    open_store(makes=True)[0].close()
    yield
    get_settings.cache_clear()


def test_the_version_is_said():
    told = RUN.invoke(app, ["--version"])
    assert told.exit_code == 0
    assert re.fullmatch(r"desirepath \d+\.\d+.*\n", told.stdout)


def test_every_kind_of_job_is_named():
    assert set(JOB_KINDS) == set(KINDS)
    told = RUN.invoke(app, ["jobs", "start", "--help"], env={"COLUMNS": "200"})
    assert all(kind in told.stdout for kind in KINDS)


def test_an_unknown_policy_is_refused_before_a_job_is_made():
    told = RUN.invoke(app, ["jobs", "start", "evaluate", "--set", "policy=nonsense"])
    assert told.exit_code == 1
    assert "nonsense" in told.stderr
    assert RUN.invoke(app, ["jobs", "list", "--json"]).stdout == '{"jobs": []}\n'


def test_a_study_begins_as_a_pilot_until_it_is_said_to_be_live():
    protocol = str(PROTOCOLS / "quick_demonstration_study.yaml")
    piloted = RUN.invoke(app, ["studies", "create", protocol, "--json"])
    study = json.loads(piloted.stdout)
    assert study["pilot"] is True
    assert f"desirepath studies live {study['study']}" in piloted.stderr
    assert json.loads(RUN.invoke(app, ["studies", "create", protocol, "--live", "--json"]).stdout)["pilot"] is False
    assert RUN.invoke(app, ["studies", "live", study["study"]]).exit_code == 0
    listed = json.loads(RUN.invoke(app, ["studies", "list", "--json"]).stdout)["studies"]
    assert {one["pilot"] for one in listed} == {False}
    assert "no study with id 'nope'" in RUN.invoke(app, ["studies", "live", "nope"]).stderr


def test_an_export_is_told_in_a_few_lines(tmp_path: Path):
    protocol = Path(__file__).resolve().parents[2] / "study_protocols" / "quick_demonstration_study.yaml"
    made = RUN.invoke(app, ["studies", "create", str(protocol), "--json"])
    study = re.search(r'"study": "([0-9a-f]+)"', made.stdout)[1]
    told = RUN.invoke(app, ["studies", "export", study, "--out", str(tmp_path / "out")])
    assert told.exit_code == 0, told.stderr
    assert "participants" in told.stdout
    assert not re.search(r"[0-9a-f]{64}", told.stdout), "hashes are in the folder, not on the screen"
    assert len(told.stdout.splitlines()) < 40


def test_whom_a_pilot_leaves_out_is_said_where_numbers_are_told(tmp_path: Path):
    protocol = Path(__file__).resolve().parents[2] / "study_protocols" / "quick_demonstration_study.yaml"
    study = json.loads(RUN.invoke(app, ["studies", "create", str(protocol), "--json"]).stdout)["study"]
    database, _ = open_store()
    with database.transaction() as s:
        s.add(Participant(study_id=study, code="P1", pilot=True))
    exported = RUN.invoke(app, ["studies", "export", study, "--out", str(tmp_path / "out")])
    assert "1 of the pilot left out" in exported.stderr
    assert "--pilots" in exported.stderr
    assert (
        "left out"
        not in RUN.invoke(app, ["studies", "export", study, "--pilots", "--out", str(tmp_path / "all")]).stderr
    )
    assert (
        "1 of the pilot left out"
        in RUN.invoke(app, ["studies", "report", study, "--out", str(tmp_path / "report")]).stderr
    )


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("evaluate nonsense", "no policy 'nonsense': neither an id, a file nor shipped"),
        ("jobs start nonsense", "unknown; known: align, reward_model"),
        ("jobs start evaluate", "policy = None: has to be given"),
        (
            "jobs start evaluate --set policy=study_room/base --set scenes=many",
            "scenes = 'many': must be a valid integer",
        ),
        (
            "jobs start evaluate --set policy=study_room/base --set speed=2",
            "speed = 2: is no parameter here; there are",
        ),
        ("train align --study nope", "no study with id 'nope'"),
        ("train align --snapshot nope", "no snapshot 'nope'"),
        ("train align --snapshot nope --recipe bogus", "recipe = 'bogus': must be one of 'fine_tuning'"),
        ("train align", "give either --study or --snapshot"),
        ("jobs show nope", "no job with id 'nope'"),
        ("jobs export nope --out x", "no job with id 'nope'"),
        ("export nope --out x", "nope"),
    ],
)
def test_what_cannot_be_done_is_refused_at_once_in_words(command: str, said: str):
    told = RUN.invoke(app, command.split())
    assert told.exit_code == 1
    assert said in told.stderr
    assert "Traceback" not in told.stderr
    assert RUN.invoke(app, ["jobs", "list", "--json"]).stdout == '{"jobs": []}\n'


def test_every_recipe_is_named_and_no_help_sends_to_a_specification():
    told = RUN.invoke(app, ["train", "align", "--help"], env={"COLUMNS": "200"}).stdout
    assert all(recipe in told for recipe in ALIGNMENTS)
    for group in ([], ["train"], ["jobs"], ["study"], ["queries"], ["benchmark"], ["reproduce"], ["train", "align"]):
        told = RUN.invoke(app, [*group, "--help"], env={"COLUMNS": "200"}).stdout
        assert not re.search(r"\bspec(ification)?\b|spec[_ /]?0\d", told), group


def test_what_is_understood_of_a_wish_is_told_as_json():
    told = RUN.invoke(app, ["words", "read", "Stay well away from me, and be careful", "--json"])
    assert told.exit_code == 0, told.stderr
    found = json.loads(told.stdout)
    assert found.keys() == {"understood", "not_understood", "contradictions"}
    (wish,) = found["understood"]
    assert wish == {"objective": "farther", "direction": "+", "weight": 1.0, "words": "away"}
    (asked,) = found["not_understood"]
    assert asked.keys() == {"words", "offered"}
    assert found["contradictions"] == []
    near = json.loads(RUN.invoke(app, ["words", "read", "Nah, aber weit weg", "--language", "de", "--json"]).stdout)
    assert near["understood"] == []
    assert near["contradictions"] == [{"words": "Nah, aber weit weg", "offered": ["closer", "farther"]}]


@pytest.mark.parametrize("chapter", ["enquery", "demonstrations", "depth", "adaptable", "interface", "pedestrians"])
def test_the_help_of_a_chapter_names_every_budget_that_it_has(chapter: str, tmp_path: Path):
    refused = RUN.invoke(app, ["reproduce", chapter, "--out", str(tmp_path), "--budget", "none"]).stderr
    budgets = re.findall(r"\w+", refused.partition("known are")[2])
    told = RUN.invoke(app, ["reproduce", chapter, "--help"], env={"COLUMNS": "200"}).stdout
    assert {"small", "full"} <= set(budgets)
    assert all(re.search(rf"\b{budget}\b", told) for budget in budgets), (budgets, told)

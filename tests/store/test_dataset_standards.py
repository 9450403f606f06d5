"""Data sets are opened by the tools for which they are described, each of them really run."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from sqlalchemy import text

from desirepath.installed import PROTOCOLS
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Participant, Study, utc_now
from desirepath.study.deposit import Author, write_deposit
from desirepath.study.protocol.freezing import freeze
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from tests.store.small_study import SmallStudy

STUDIES = {"Quick": "quick_preference_study", "Interface": "interface_study", "Drawing": "quick_demonstration_study"}
AS_PEOPLE = (
    'DROP TRIGGER "participant_simulated_fixed"',
    'DROP TRIGGER "session_simulated_fixed"',
    "UPDATE participant SET simulated = 0",
    "UPDATE session SET simulated = 0",
)
"""Data sets for learning hold answers of people alone: in this database, which only these tests see, bots are some."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("standards")


@pytest.fixture(scope="module")
def data_sets(folder: Path) -> Path:
    """Three shipped studies with two participants each, as they are exported, and a deposit of the first, before bots
    were made people."""
    database = Database(f"sqlite:///{folder / 'desirepath.sqlite'}")
    database.migrate()
    files = ArtefactStore((folder / "artefacts").as_uri())
    studies: dict[str, Study] = {}
    for name, protocol in STUDIES.items():
        with database.transaction() as s:
            frozen = freeze(PROTOCOLS / f"{protocol}.yaml")
            studies[name] = create_study(s, files, frozen, name=name, created_by=None)
        walk_in_process(database, files, studies[name], 2, without_jobs=True)
    authors = [Author.read("Doe, Jo; Somewhere; 0000-0002-1825-0097")]
    write_deposit(database, files, studies["Quick"].id, folder / "deposit", authors=authors)
    with database.engine.begin() as connection:
        for statement in AS_PEOPLE:
            connection.execute(text(statement))
    for name, study in studies.items():
        export_study(database, files, study.id, folder / "exported" / name, pilots=True)
    return folder / "exported"


@pytest.mark.parametrize("name", STUDIES)
def test_frictionless_finds_its_package_valid(data_sets: Path, name: str):
    """Types of every cell, keys, references between tables, sizes and hashes."""
    import frictionless

    report = frictionless.validate(str(data_sets / name / "datapackage.json"))
    assert report.valid, report.flatten(["title", "rowNumber", "fieldName", "note"])[:5]
    assert report.stats["tasks"] == 15
    assert sum(task.stats.get("rows", 0) for task in report.tasks) > 20


def test_frictionless_notices_a_changed_cell(data_sets: Path, tmp_path: Path):
    import shutil

    import frictionless

    copied = shutil.copytree(data_sets / "Quick", tmp_path / "copied")
    trials = copied / "trials.csv"
    trials.write_text(trials.read_text().replace("true", "perhaps", 1))
    assert not frictionless.validate(str(copied / "datapackage.json")).valid


@pytest.mark.parametrize("name", STUDIES)
def test_croissant_is_read_by_its_library(data_sets: Path, name: str):
    import mlcroissant

    read = mlcroissant.Dataset(jsonld=data_sets / name / "croissant.json")
    assert not read.metadata.ctx.issues.errors
    for table in ("trials", "participants", "trajectory_metrics"):
        rows = pq.read_table(data_sets / name / f"{table}.parquet")
        records = list(read.records(table))
        assert len(records) == len(rows)
        assert all({key.partition("/")[2] for key in record} == set(rows.column_names) for record in records)


OPENED = Path(__file__).parent / "opened"


def opened_by(script: str, *told: str, folder: Path, **environment: str) -> dict[str, Any]:
    """What a script saw that runs in the tools' environment, which has what `.venv` has not, and from a folder of its
    own: our `datasets` must not be taken for theirs."""
    python = Path(sys.prefix).resolve().with_name(".venv-tools") / "bin" / "python"
    assert python.exists(), "the tools that open data sets are not there; `make setup-test` installs them"
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    ran = subprocess.run(
        [python, "-P", OPENED / script, *told],
        cwd=folder,
        env=kept | {"HF_HUB_OFFLINE": "1", "HOME": str(folder), "CUDA_VISIBLE_DEVICES": ""} | environment,
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr[-3000:]
    return dict(json.loads((folder / "told.json").read_text()))


def test_the_pairs_open_as_they_are_and_trl_learns_from_them(data_sets: Path, tmp_path: Path):
    """`datasets.load_dataset` of the folder; on its split `train`, unchanged, TRL's DPO trainer takes a step."""
    pairs = data_sets / "Interface" / "preference_pairs"
    told = opened_by("with_trl.py", str(pairs), folder=tmp_path)
    assert set(told["splits"]) == {"train", "practice", "probes"}
    for split, of in told["splits"].items():
        assert of["rows"] == len(lines(pairs.parent, split))
        assert {"prompt", "chosen", "rejected"} <= set(of["columns"])
    first = lines(pairs.parent, "train")[0]
    assert told["first"] == {name: first[name] for name in ("prompt", "chosen", "rejected")}
    assert told["rows"] == told["splits"]["train"]["rows"]  # none was dropped
    assert told["decoded"].removesuffix("<end>") == first["chosen"]  # nor cut
    assert 0 < told["loss"] < 2


@pytest.mark.parametrize("name", ["Interface", "Quick"])
def test_minari_opens_the_trajectories_as_episodes(data_sets: Path, tmp_path: Path, name: str):
    """With spaces of observations and actions, per setup; their numbers are those of the stored trajectories."""
    folder = data_sets / name
    rows = {row["trajectory"]: row for row in pq.read_table(folder / "trajectories.parquet").to_pylist()}
    setups = sorted({row["setup"] for row in rows.values()})
    ids = [f"desirepath/{setup}-v0" for setup in setups]
    told = opened_by("with_minari.py", *ids, folder=tmp_path, MINARI_DATASETS_PATH=str(folder / "minari"))
    for setup, of in zip(setups, told.values(), strict=True):
        here = {key for key, row in rows.items() if row["setup"] == setup}
        assert (set(of["trajectories"]), of["episodes"]) == (here, len(here))
        assert of["steps"] == sum(rows[key]["steps"] for key in here)
        assert of["observation_space"] == [get_setup(setup).observation_size]
        assert of["within"]
        assert of["sampled"] == 1
        assert not any(of["early"])
        assert all(ended != cut for ended, cut in of["ends"])
        first = of["first"]
        stored = Trajectory.from_bytes((folder / "trajectories" / f"{first['trajectory']}.npz").read_bytes())
        np.testing.assert_array_equal(np.array(first["pose"], dtype=np.float32), stored.poses)
        np.testing.assert_array_equal(np.array(first["actions"], dtype=np.float32), stored.actions)
        np.testing.assert_array_equal(np.array(first["rewards"], dtype=np.float32), stored.rewards)
        seen = np.array(first["observations"], dtype=np.float32)
        np.testing.assert_array_equal(seen[:-1], stored.observations)
        np.testing.assert_array_equal(seen[1:], stored.next_observations)


def lines(folder: Path, split: str) -> list[dict[str, object]]:
    path = folder / "preference_pairs" / f"{split}.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


@pytest.mark.parametrize("name", ["Quick", "Interface"])
def test_pairs_are_preferences_as_trl_documents_them(data_sets: Path, name: str):
    """Strings `prompt`, `chosen`, `rejected` per line; practice and what was asked again are files of their own."""
    folder = data_sets / name
    card = (folder / "preference_pairs" / "README.md").read_text().split("---\n")[1]
    splits = {one["split"]: one["path"] for one in yaml.safe_load(card)["configs"][0]["data_files"]}
    assert set(splits.values()) == {path.name for path in (folder / "preference_pairs").glob("*.jsonl")}
    table = {row["response"]: row for row in pq.read_table(folder / "pairs.parquet").to_pylist()}
    for split, roles in {"train": {"regular"}, "practice": {"practice"}, "probes": {"repeat"}}.items():
        for row in lines(folder, split):
            assert all(isinstance(row[one], str) for one in ("prompt", "chosen", "rejected"))
            assert row["role"] in roles
            assert table[row["response"]]["chosen"] == row["chosen_trajectory"]
            stored = Trajectory.from_bytes((folder / "trajectories" / f"{row['chosen_trajectory']}.npz").read_bytes())
            told = np.array(json.loads(row["chosen"]))
            np.testing.assert_allclose(told[:, 1:], stored.poses, atol=0.006)
            assert json.loads(row["prompt"])["scene"]["setup"] == row["setup"]
    assert lines(folder, "train")


def test_pairs_hold_nobody_who_must_not_be_learned_from(study: SmallStudy, tmp_path: Path):
    people = {code: study.participant(code, drives=100 * k)[0] for k, code in enumerate(("P1", "P2", "P3"))}
    study.participant("P4", drives=400, pilot=True)
    with study.database.transaction() as s:
        s.get_one(Participant, people["P2"]).excluded_at = utc_now()
        s.get_one(Participant, people["P3"]).consents = {"training": False}
    export_study(study.database, study.files, study.id, tmp_path / "out", pilots=True)
    assert {row["participant"] for row in lines(tmp_path / "out", "train")} == {"P1"}
    assert {row["participant"] for row in pq.read_table(tmp_path / "out" / "pairs.parquet").to_pylist()} == {
        *("P1", "P2", "P3", "P4")
    }


def test_ratings_carry_their_questionnaire_and_condition(data_sets: Path):
    rows = pq.read_table(data_sets / "Interface" / "questionnaire_items.parquet").to_pylist()
    rated = {(row["questionnaire"], row["condition"]) for row in rows}
    assert {("interface_items", view) for view in ("top_down", "first_person", "immersive")} <= rated
    assert ("demographics", None) in rated


def test_clearance_can_be_computed_from_the_tables_alone(data_sets: Path):
    folder = data_sets / "Interface"
    shown = pq.read_table(folder / "trajectories.parquet").to_pylist()
    metrics = {row["trajectory"]: row for row in pq.read_table(folder / "trajectory_metrics.parquet").to_pylist()}
    steps = pq.read_table(folder / "trajectory_steps.parquet").to_pandas()
    assert {row["robot_radius_m"] for row in shown} == {0.18}
    for row in shown:
        person = json.loads(row["scene"])["person"]["pose"]
        path = steps[steps.trajectory == row["trajectory"]]
        xs, ys = ([*path[name], path[f"next_{name}"].iloc[-1]] for name in ("x_m", "y_m"))
        nearest = np.hypot(np.array(xs) - person["x"], np.array(ys) - person["y"]).min()
        assert metrics[row["trajectory"]]["min_human_distance_m"] == pytest.approx(nearest, abs=1e-6)


def test_no_cell_is_longer_than_a_spreadsheets(data_sets: Path):
    import csv

    for path in data_sets.rglob("*.csv"):
        with path.open(encoding="utf-8", newline="") as file:
            assert max(len(cell) for row in csv.reader(file) for cell in row) < 32_767, path


def test_the_plan_of_a_session_is_its_steps(data_sets: Path):
    folder = data_sets / "Interface"
    steps = pq.read_table(folder / "planned_steps.parquet").to_pylist()
    answered = {(row["session"], row["step"]) for row in pq.read_table(folder / "responses.parquet").to_pylist()}
    assert answered <= {(row["session"], row["step"]) for row in steps}
    assert {row["role"] for row in steps if row["kind"] == "trial"} == {"practice", "regular", "repeat"}


def test_how_to_cite_and_what_may_be_done_is_said(data_sets: Path, study: SmallStudy, tmp_path: Path):
    folder = data_sets / "Quick"
    cited = yaml.safe_load((folder / "CITATION.cff").read_text())
    assert (cited["cff-version"], cited["type"], cited["license"]) == ("1.2.0", "dataset", "CC-BY-4.0")
    assert "creativecommons.org/licenses/by/4.0" in (folder / "LICENSE.txt").read_text()
    told = json.loads((folder / "dataset_description.json").read_text())
    assert (told["@type"], told["name"]) == ("Dataset", "Quick")
    assert {"trial", "practice", "sides_swapped"} <= {one["name"] for one in told["variableMeasured"]}
    with study.database.transaction() as s:
        row = s.get_one(Study, study.id)
        row.protocol = {**row.protocol, "licence": None}
    export_study(study.database, study.files, study.id, tmp_path / "out")
    assert "ask the study's experimenter" in (tmp_path / "out" / "LICENSE.txt").read_text()
    assert "license" not in yaml.safe_load((tmp_path / "out" / "CITATION.cff").read_text())
    assert "licenses" not in json.loads((tmp_path / "out" / "datapackage.json").read_text())


def test_a_study_without_answers_has_no_pairs(database: Database, files: ArtefactStore, tmp_path: Path):
    export_study(database, files, SmallStudy(database, files).id, tmp_path / "out")
    assert not (tmp_path / "out" / "preference_pairs").exists()


def test_a_deposit_is_whole_checked_and_marked_as_simulated(data_sets: Path, folder: Path):
    deposit = folder / "deposit"
    summed = dict(reversed(line.split("  ")) for line in (deposit / "checksums.sha256").read_text().splitlines())
    lying = {path.relative_to(deposit).as_posix() for path in deposit.rglob("*") if path.is_file()}
    assert lying - {"checksums.sha256"} == summed.keys()
    assert {"README.md", "LICENSE", "CITATION.cff", "data/data-dictionary.md", "data/codebook.csv"} <= lying
    assert {"data/protocol/protocol.yaml", "report/report.html", "report/findings.json"} <= lying
    assert hashlib.sha256((deposit / "README.md").read_bytes()).hexdigest() == summed["README.md"]
    assert "no people" in (deposit / "README.md").read_text()
    zenodo = json.loads((deposit / ".zenodo.json").read_text())
    assert (zenodo["title"], zenodo["license"]) == ("Quick (simulated participants)", "cc-by-4.0")
    assert zenodo["creators"] == [{"name": "Doe, Jo", "affiliation": "Somewhere", "orcid": "0000-0002-1825-0097"}]
    datacite = json.loads((deposit / "datacite.json").read_text())
    assert "simulated data" in [subject["subject"] for subject in datacite["subjects"]]
    assert "no people" in datacite["descriptions"][0]["description"]
    registered = (deposit / "preregistration.md").read_text()
    assert "choose the robot that learned from their own answers more often than not over the usual robot" in registered
    assert "**TO FILL IN**" in registered


@pytest.mark.parametrize("written", ["", "; MIT", "A; B; C; D", "Doe, Jo; ; 123", "Doe\n, Jo", "x" * 201])
def test_an_author_is_named_as_catalogues_want_it(written: str):
    with pytest.raises(ValueError, match="author = "):
        Author.read(written)

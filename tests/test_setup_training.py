"""`desirepath setups train` makes what a study needs into a lab's own folder, and goes on where it was killed. Tiny:
the policies have hardly learned."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import select

from desirepath.installed import DATASETS
from desirepath.jobs.context import JobContext, Progress
from desirepath.jobs.kinds import get_kind
from desirepath.jobs.runners import run_kind
from desirepath.learning.cards import Card
from desirepath.learning.errors import LearningError
from desirepath.learning.shipped_files import load_card, shipped_names
from desirepath.learning.shipping import query_sets
from desirepath.learning.shipping.brought_back import bring_back, split
from desirepath.learning.shipping.own_setup import DEFINITION, SetupTrainingConfig, description_sha256, stages_done
from desirepath.settings import Settings
from desirepath.simulation import setups
from desirepath.simulation.setup_intake import remove, take_in, take_out, unpack
from desirepath.store.artefacts import lineage
from desirepath.store.job_results import RESULTS
from desirepath.store.models import Artefact
from desirepath.store.outbox import enqueue_job
from desirepath.store.shipped_policies import shipped_name
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from tests.study.small_protocol import small_protocol

SETUP = """\
robot: turtlebot2
world:
  name: building
  building:
    walls: [[0, 0, 7, 0], [7, 0, 7, 6], [7, 6, 0, 6], [0, 6, 0, 0]]
    way_m: [2.5, 4.5]
preferences: {longest_shown_s: 60}  # what has hardly learned is slow
"""
EFFORT = 0.05
ASKED = ("--effort", f"{EFFORT}", "--queries", "10", "--json")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object], str]:
    """The folder, what the command said at last, and what it said on stderr when it went on."""
    folder = tmp_path_factory.mktemp("setups") / "our_hall"
    folder.mkdir()
    (folder / "setup.yaml").write_text(SETUP)
    command = [sys.executable, "-m", "desirepath", "setups", "train", str(folder), *ASKED]
    environment = os.environ | {"DESIREPATH_DATA": str(folder.parent / "data"), "DESIREPATH_SETUPS": ""}
    first = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    patience = time.monotonic() + 300
    while not (folder / "base.card.json").is_file() and first.poll() is None and time.monotonic() < patience:
        time.sleep(0.2)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    made_first = (folder / "base.npz").read_bytes()
    again = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900)
    assert again.returncode == 0, again.stderr[-3000:]
    assert (folder / "base.npz").read_bytes() == made_first
    return folder, json.loads(again.stdout), again.stderr


@pytest.fixture
def known(trained, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(setups, "_included", [])
    setups.include(trained[0])
    return trained[0]


def test_killed_and_asked_again_it_goes_on_where_it_was(trained):
    _, told, said = trained
    assert "base" not in told["seconds_by_stage"]
    assert set(told["seconds_by_stage"]) == {"conditioned", "varied_queries", "ensemble", "queries"}
    assert told["seconds"] == pytest.approx(sum(told["seconds_by_stage"].values()), abs=0.1)
    assert 0 <= told["success_rate"] <= 1
    assert "conditioned: about" in said
    assert "left" in said


def test_what_was_made_is_found_like_what_is_shipped(known, trained):
    made = [*trained[1]["policies"], *trained[1]["query_sets"]]
    assert set(made) <= set(shipped_names())
    assert "our_hall" in setups.preference_setups()
    card = load_card("our_hall/conditioned")
    assert "our_hall/base" in card.parents
    assert DEFINITION in card.parents
    assert card.command == f"desirepath setups train our_hall --seed 0 --effort {EFFORT}"
    assert all(done for _, done in stages_done(known, SetupTrainingConfig(queries=10, effort=EFFORT)))


def test_another_description_is_trained_anew(known, tmp_path):
    copy = tmp_path / "our_hall"
    shutil.copytree(known, copy)
    config = SetupTrainingConfig(queries=10, effort=EFFORT)
    assert [done for _, done in stages_done(copy, config)] == [True] * 5
    (copy / "setup.yaml").write_text(SETUP.replace("4.5", "4.4"))
    assert [done for _, done in stages_done(copy, config)] == [False] * 5
    (copy / "setup.yaml").write_text(SETUP)
    assert [done for _, done in stages_done(copy, SetupTrainingConfig(queries=10))] == [False] * 5  # a rehearsal's
    disturbed = replace(config, randomise=True)
    assert [done for _, done in stages_done(copy, disturbed)] == [False] * 5
    assert disturbed.command("our_hall") == f"desirepath setups train our_hall --seed 0 --effort {EFFORT} --randomise"
    damaged = (copy / "conditioned.npz").read_bytes()[:-1]
    (copy / "conditioned.npz").write_bytes(damaged)
    assert [done for _, done in stages_done(copy, config)] == [True, False, False, True, True]


def test_as_a_job_it_lists_what_it_made_with_its_lineage_and_a_study_asks_there(
    trained, tmp_path, monkeypatch, database, files
):
    """A setup that was brought to the installation; everything is made already, so the job has only to keep it."""
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path / "data"))
    shutil.copytree(trained[0], tmp_path / "data/setups/our_hall")
    settings = Settings(data=tmp_path / "data", _env_file=None)
    params = get_kind("train_setup").parse({"setup": "our_hall", "queries": 10, "effort": EFFORT})
    with database.transaction() as s:
        job = enqueue_job(s, "train_setup", params.asked())
        job.state = "running"
    queries = tmp_path / "data/setups/our_hall/queries_10.npz"
    aside = queries.rename(tmp_path / "queries_10.npz")
    context = JobContext(settings, database, files, job, Progress(database, job.id))
    monkeypatch.setattr(query_sets, "ship_queries", stop)
    with pytest.raises(LearningError, match="stopped"):
        run_kind(context, params)
    with database.session() as s:  # what lay there when it was stopped is kept
        kept = s.scalars(select(Artefact.name).where(Artefact.kind.in_(("policy", "conditioned_policy", "query_set"))))
        assert set(kept) == {*trained[1]["policies"], "our_hall/queries_varied_10"}
    aside.rename(queries)
    made = run_kind(context, params)
    assert made["seconds"] == {}
    assert RESULTS["train_setup"](**made).made == [*made["policies"], *made["query_sets"]]
    with database.session() as s:
        first, second = (lineage(s, one) for one in made["query_sets"])
        assert [parent.artefact.name for parent in first.parents] == ["our_hall/conditioned"]
        assert {parent.artefact.name for parent in second.parents} == {f"our_hall/ensemble/{k}" for k in range(4)}
        assert {s.get_one(Artefact, one).job_id for one in made["policies"]} == {job.id}
    assert shipped_name(made["policies"][0]) == "our_hall/base"

    block = {"block": {"view": "top_down", "trials": [{"queries": {"count": 4}}]}}
    robot = {"tuning": {"setup": "our_hall", "scenes": 2}}
    (tmp_path / "protocol").mkdir()
    frozen = small_protocol(tmp_path / "protocol", [block, robot], query_set="our_hall/queries_varied_10")
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Our hall", created_by=None)
    assert walk_in_process(database, files, study, 1)["completed"] == 1


def stop(*_: object) -> None:
    raise LearningError("stopped")


def test_all_of_it_comes_back_from_its_zip(trained, tmp_path, monkeypatch):
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path / "data"))
    root = tmp_path / "data/setups"
    shutil.copytree(trained[0], root / "our_hall")
    out, left = split(unpack("x.zip", io.BytesIO(take_out("our_hall"))))
    remove("our_hall", root)
    take_in("our_hall", left, root)
    kept, left_out = bring_back(root / "our_hall", out)
    assert (sorted(kept), left_out) == (sorted([*trained[1]["policies"], *trained[1]["query_sets"]]), [])
    assert all(done for _, done in stages_done(root / "our_hall", SetupTrainingConfig(queries=10, effort=EFFORT)))


@pytest.mark.parametrize("name", ["map.bmp", "map.pgm", "robot.urdf"])
def test_another_map_or_robot_is_another_description(tmp_path, name):
    (tmp_path / name).write_bytes(b"one")
    before = description_sha256(tmp_path)
    (tmp_path / name).write_bytes(b"two")
    assert description_sha256(tmp_path) != before


def test_nothing_is_trained_into_a_shipped_setup():
    command = [sys.executable, "-m", "desirepath", "setups", "train", str(DATASETS / "study_room"), "--json"]
    refused = subprocess.run(command, capture_output=True, text=True)
    assert refused.returncode == 1
    assert "comes with the product" in json.loads(refused.stdout)["error"]
    assert Card.load(DATASETS / "study_room/base.card.json").setup == "study_room"

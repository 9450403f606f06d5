"""My own participants answered pairs of my recordings elsewhere; I want to learn from that."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.jobs.context import JobContext, Progress
from desirepath.jobs.kinds import RewardModelParams
from desirepath.jobs.runners import learn_reward_model
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.settings import Settings
from desirepath.simulation.recorded import NotRecordedError
from desirepath.store.artefacts import ArtefactStore, lineage, load_artefact
from desirepath.store.database import Database
from desirepath.store.outbox import enqueue_job
from desirepath.store.snapshots import load_snapshot
from tests.recordings.walks import csv_of, robot_at, times

ASIDE = [k * 0.4 - 1.6 for k in range(10)]
"""How far (m) to the left ten runs swerve; anna stands at 0.9 m to the left."""


@pytest.fixture
def told(tmp_path: Path) -> dict:
    """What the import of ten runs and two people's answers said; both like it far from anna."""
    lines = [(f"r{k}", who, t, *at) for k, aside in enumerate(ASIDE) for t in map(float, times())
             for who, at in (("robot", robot_at(t, aside)), ("anna", (3.0, 0.9, 3.14)))]  # fmt: skip
    (tmp_path / "hall.csv").write_text(csv_of("run,who,time_s,x_m,y_m,yaw_rad", lines))
    answers = [
        (f"r{a}", f"r{b}", "a" if a < b else f"r{b}", person)
        for person in ("p1", "p2") for a, b in ((0, 5), (6, 1), (2, 6), (5, 3), (0, 6), (6, 4), (1, 5), (5, 2))
    ]  # fmt: skip
    (tmp_path / "answers.csv").write_text(csv_of("a,b,choice,person", answers))
    return run(tmp_path, "--answers", str(tmp_path / "answers.csv"))


def run(folder: Path, *more: str) -> dict:
    said = CliRunner().invoke(
        app,
        ["queries", "import", str(folder / "hall.csv"), "--setup", "study_room", "--data", str(folder / "data"),
         "--json", *more],
    )  # fmt: skip
    return json.loads(said.stdout)


@pytest.fixture
def installation(tmp_path: Path):
    settings = Settings(data=tmp_path / "data", _env_file=None)
    database = Database(settings.database)
    yield settings, database, ArtefactStore(settings.artefacts)
    database.close()


def test_they_become_a_snapshot_that_says_it_is_imported(told: dict, installation) -> None:
    assert (told["answers"], told["queries"]) == (16, 8)
    _, database, files = installation
    with database.session() as s:
        artefact, _ = load_artefact(s, files, told["snapshot"], kind="snapshot")
        assert (artefact.card["whose"], artefact.card["imported"]["file"]) == ("imported", "answers.csv")
        assert not artefact.simulated
        assert [one.artefact.id for one in lineage(s, artefact.id).parents] == [told["query_set"]]
        snapshot = load_snapshot(s, files, artefact.id)
    assert {one.participant for one in snapshot.answers} == {"p1", "p2"}
    assert {one.source for one in snapshot.answers} == {"human"}


def test_a_model_of_measures_learns_from_them_and_one_of_steps_says_why_not(told: dict, installation) -> None:
    settings, database, files = installation

    def learn(model: str) -> dict:
        params = RewardModelParams(snapshot=told["snapshot"], model=model)
        with database.transaction() as s:
            job = enqueue_job(s, "reward_model", params.model_dump())
            job.state = "running"
        return learn_reward_model(JobContext(settings, database, files, job, Progress(database, job.id)), params)

    result = learn("weights")
    assert result["training_accuracy"] == 1.0
    assert max(result["importance"], key=result["importance"].get) == "farther"
    with database.session() as s:
        content = load_artefact(s, files, result["reward_model"], kind="reward_model")[1]
    assert RewardModel.from_bytes(content).kind == "weights"
    assert learn("auto")["kind"] == "weights"
    with pytest.raises(NotRecordedError, match=r"hall\.csv: observations and actions were not recorded"):
        learn("mlp")


WRONG = {
    "an unknown run": ("a,b,choice\nr0,r99,a\n", "answers.csv, pair 1, b = 'r99': no run of that name"),
    "neither": ("a,b,choice\nr0,r1,both\n", "answers.csv, line 2, column choice = 'both': must be a, b, r0 or r1"),
    "either": ("a,b,choice\nb,a,a\n", "column choice = 'a': must be a, b, b or a, and may mean either here"),
    "no choice": ("a,b\nr0,r1\n", "column 'choice' is missing; answers need a, b, choice"),
    "one answer": ("a,b,choice\nr0,r5,a\n", "only 1 usable answers of people, at least 2 are needed"),
    "nothing": ("a,b,choice\n", "answers.csv: holds no answer"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_with_them_is_said(told: dict, tmp_path: Path, wrong: str) -> None:
    text, message = WRONG[wrong]
    (tmp_path / "answers.csv").write_text(text)
    assert message in run(tmp_path, "--answers", str(tmp_path / "answers.csv"))["error"]

"""Which installation a command speaks of, what it leaves behind when it refuses, and what it says while it works."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from sqlalchemy import select
from typer.testing import CliRunner

from desirepath.cli import output
from desirepath.cli.data import _summary
from desirepath.cli.main import app
from desirepath.cli.output import working
from desirepath.settings import Settings, get_settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Artefact, Job
from desirepath.web.replicas.only_server import only_server
from tests.answered_study import add_answered_study

ROOT = Path(__file__).resolve().parents[2]
PROTOCOL = ROOT / "study_protocols" / "quick_preference_study.yaml"


def desirepath(*words: str) -> tuple[int, str, str]:
    """A command's exit code, and what it said on stdout and on stderr."""
    ended = CliRunner().invoke(app, list(words))
    return ended.exit_code, ended.stdout, ended.stderr


@pytest.mark.parametrize("words", [("studies", "list"), ("jobs", "list"), ("train", "align", "--study", "some")])
def test_a_folder_without_an_installation_is_named_and_not_made(tmp_path: Path, words: tuple[str, ...]) -> None:
    missing = tmp_path / "nowhere"
    code, said, told = desirepath(*words, "--data", str(missing))
    assert (code, said) == (1, "")
    assert f"no installation in {missing}" in told.replace("\n", "")
    assert not missing.exists()


def test_a_refused_protocol_makes_no_installation(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("protocol: 1")
    assert desirepath("studies", "create", str(wrong), "--data", str(tmp_path / "new"))[0] == 1
    assert not (tmp_path / "new").exists()


def test_a_new_studys_link_is_that_of_the_server_that_runs_on_its_folder(tmp_path: Path) -> None:
    def link() -> str:
        code, said, told = desirepath("studies", "create", str(PROTOCOL), "--data", str(tmp_path), "--json")
        assert code == 0, told
        return str(json.loads(said)["link"])

    assert link().startswith(f"http://127.0.0.1:{get_settings().port}/join/")
    with only_server(Settings(data=tmp_path, port=8345, _env_file=None)):
        assert link().startswith("http://127.0.0.1:8345/join/")
    assert link().startswith(f"http://127.0.0.1:{get_settings().port}/join/"), "it runs no more"


@pytest.mark.parametrize("refused", ["bogus=1", "updates=-1", "base=kitchen/base"])
@pytest.mark.parametrize("kind", ["align", "demonstrations"])
def test_a_refused_training_leaves_nothing_behind(tmp_path: Path, kind: str, refused: str) -> None:
    settings = Settings(data=tmp_path, _env_file=None)
    database, files = Database(settings.database), ArtefactStore(settings.artefacts)
    database.migrate()
    of = ["--study", add_answered_study(database, files), "--answers", "simulated"]
    of = of if kind == "align" else ["--style", "field_of_view"]
    stored = sorted((tmp_path / "artefacts").rglob("*.npz"))
    code, _, told = desirepath("train", kind, *of, "--set", refused, "--data", str(tmp_path))
    assert (code, "error:" in told) == (1, True)
    with database.session() as s:
        assert not s.scalars(select(Artefact).where(Artefact.kind.in_(("snapshot", "demonstrations")))).all()
        assert not s.scalars(select(Job)).all()
    assert sorted((tmp_path / "artefacts").rglob("*.npz")) == stored
    database.close()


def test_export_says_its_tables_and_counts_parts() -> None:
    files = [{"path": f"demonstrations/{n}/part-0.parquet", "rows": None, "sha256": ""} for n in range(526)]
    files += [{"path": "trials.parquet", "rows": 31, "sha256": ""}, {"path": "trials.csv", "rows": 31, "sha256": ""}]
    assert _summary("study", files, "out") == {
        "study": "study",
        "folder": "out",
        "files": 528,
        "demonstrations": 526,
        "tables": [{"table": "trials", "rows": 31}],
    }


def test_what_takes_long_is_said_at_once_and_again_without_a_terminal(capsys, monkeypatch) -> None:
    monkeypatch.setattr(output, "TOLD_EVERY_S", 0.02)
    with working("writing the data set") as tell:
        assert capsys.readouterr().err == "writing the data set\n"
        tell("writing trajectories")
        told = ""
        while "writing trajectories, 0 s" not in told:
            told += capsys.readouterr().err


def test_ctrl_c_ends_the_command_and_says_that_the_job_goes_on(tmp_path: Path) -> None:
    words = ["jobs", "start", "evaluate", "--set", "policy=study_room/base", "--data", str(tmp_path)]
    command = subprocess.Popen(
        [sys.executable, "-m", "desirepath", *words], cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert command.stderr is not None
    lines = iter(command.stderr.readline, b"")
    begun = next(line for line in lines if b"waiting for a worker" in line)
    job = begun.split()[1].rstrip(b":").decode()
    command.send_signal(signal.SIGINT)
    out, told = command.communicate(timeout=60)
    assert (command.returncode, out) == (130, b"")
    assert f"job {job} goes on" in told.decode()
    assert f"desirepath jobs cancel {job}" in told.decode()
    with Database(Settings(data=tmp_path, _env_file=None).database).session() as s:
        assert s.get_one(Job, job).state == "queued"


def test_ctrl_c_while_a_command_is_loading_says_nothing() -> None:
    interrupting = """
import os, signal, sys
wanted = sys.argv.pop(1)
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == wanted:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
from desirepath.cli.main import main
sys.argv.append("worker")
main()
"""
    for module in ("typer", "desirepath.cli.serve", "desirepath.jobs.worker"):
        ended = subprocess.run([sys.executable, "-c", interrupting, module], cwd=ROOT, capture_output=True, check=False)
        assert ended.returncode in (-signal.SIGINT, 130), module
        assert ended.stderr == b"", module

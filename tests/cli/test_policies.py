"""A lab's own policy by command: in, listed, shown, evaluated, asked about, out again."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.learning.policies.policy import read_policy
from desirepath.settings import get_settings
from tests.learning.test_importing import saved, sb3

RUN = CliRunner()


def told(*words: str) -> dict:
    result = RUN.invoke(app, [*words, "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path / "data"))
    get_settings.cache_clear()
    return tmp_path / "data"


def test_a_zip_comes_in_is_listed_shown_evaluated_and_goes_out(tmp_path: Path) -> None:
    content = saved(sb3())
    (tmp_path / "model.zip").write_bytes(content)
    kept = told("policies", "import", str(tmp_path / "model.zip"), "--setup", "study_room", "--name", "our SAC")
    assert (kept["setup"], kept["name"], kept["new"]) == ("study_room", "our SAC", True)
    assert told("policies", "import", str(tmp_path / "model.zip"), "--setup", "study_room")["new"] is False
    rows = {row["name"]: row for row in told("policies", "list")["policies"]}
    assert (rows["our SAC"]["from"], rows["study_room/base"]["from"]) == ("imported", "shipped")
    shown = told("policies", "show", kept["policy"])
    assert shown["imported"]["files"] == [{"name": "model.zip", "sha256": hashlib.sha256(content).hexdigest()}]
    assert shown["imported"]["by"] == "command line"
    assert told("policies", "evaluate", kept["policy"], "--scenes", "5")["setup"] == "study_room"
    out = told("policies", "export", kept["policy"], "--out", str(tmp_path / "out"))
    own = [Path(file).name for file in out["files"] if Path(file).suffix != ".py"]
    assert own == ["policy.npz", "manifest.json", "policy.onnx", "policy.zip", "test_vectors.json", "world.yaml"]
    assert out["left_out"] == {}
    again = told("policies", "import", str(tmp_path / "out" / "policy.zip"))
    assert (again["policy"], again["new"]) == (kept["policy"], False)


def test_what_a_policy_cannot_be_exported_as_is_said(tmp_path: Path) -> None:
    out = told("policies", "export", "crowd_corridor/attention", "--out", str(tmp_path))
    assert set(out["left_out"]) == {"policy.onnx", "policy.zip", "test_vectors.json"}
    assert "a robot's scan does not tell" in out["left_out"]["test_vectors.json"]
    assert "its lidar and its descriptors" in out["left_out"]["policy.onnx"]
    assert read_policy((tmp_path / "policy.npz").read_bytes()).setup == "crowd_corridor"


def test_the_exported_copy_of_a_policy_is_made_from_it(tmp_path: Path) -> None:
    """So whoever's answers are behind it can be erased with both."""
    told("policies", "export", "study_room/base", "--out", str(tmp_path))
    copy = told("policies", "import", str(tmp_path / "policy.onnx"), "--name", "copy")
    assert list(told("policies", "show", copy["policy"])["parents"]) == ["exported: study_room/base"]


def test_what_cannot_come_in_says_why_and_nothing_is_kept(tmp_path: Path) -> None:
    (tmp_path / "model.zip").write_bytes(b"no zip")
    refused = RUN.invoke(app, ["policies", "import", str(tmp_path / "model.zip"), "--setup", "study_room", "--json"])
    assert refused.exit_code == 1
    assert "no zip that can be read" in json.loads(refused.stdout)["error"]
    missing = RUN.invoke(app, ["policies", "import", str(tmp_path / "none.onnx"), "--json"])
    assert missing.exit_code == 1
    assert "none.onnx" in json.loads(missing.stdout)["error"]


def test_the_manifest_to_compare_with_is_written_whole() -> None:
    written = json.loads(RUN.invoke(app, ["setups", "show", "study_room", "--json"]).stdout)
    assert written["setup"] == "study_room"
    assert written["lidar"]["order"] == "from straight ahead, counter-clockwise"

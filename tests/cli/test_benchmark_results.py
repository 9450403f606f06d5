"""A benchmark's result as a file that `datasets/` can hold: its command, no folder of anybody's machine."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from desirepath_experiments.benchmarks.results import write_result


def test_the_command_is_kept_without_the_folders_of_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "results" / "people.json"
    given = ["benchmark", "people", "--out", str(out), "--conditioned", f"sharpened={tmp_path}/policy.npz", "--n", "3"]
    monkeypatch.setattr(sys, "argv", ["desirepath", *given])
    write_result(out, {"share": 0.123456789})
    kept = json.loads(out.read_text(encoding="utf-8"))
    assert kept["command"] == "desirepath benchmark people --out people.json --conditioned sharpened=policy.npz --n 3"
    assert kept["share"] == 0.12346


def test_many_rows_are_a_table_beside_the_result(tmp_path: Path) -> None:
    rows = [{"person": f"p{k}", "gain": {"mean": k / 4, "low": None}, "seeds": [k, k + 1]} for k in range(12)]
    out = tmp_path / "people.json"
    write_result(out, {"setup": "study_room", "rows": rows, "bars": rows[:2]})
    kept = json.loads(out.read_text(encoding="utf-8"))
    assert kept["rows"] == "people.rows.csv"
    assert kept["bars"] == rows[:2]
    lines = (tmp_path / "people.rows.csv").read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["person,gain.mean,gain.low,seeds", 'p0,0.0,null,"[0, 1]"']
    assert len(lines) == 13

"""What a report's folder holds: a page, every test, scores, answers, findings, figures; no file of what is missing."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest

from desirepath.analysis.scale_wordings import SCALES
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import NothingToReport
from desirepath.report.simulated_cohorts import Cohort, simulate_data
from desirepath.report.study_data import StudyData
from desirepath.report.study_report import write_study_report

PLAN = AnalysisPlan(metrics=())


def nothing(trajectory: str) -> None:
    raise LookupError(trajectory)


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


@pytest.fixture(scope="module")
def data() -> StudyData:
    cohort = Cohort(ratings={"fun": {"immersive": 2.0}}, own=0.9, seed=1)
    made = simulate_data(
        cohort, 12, items=("fun",), rankings=("usefulness",), queries=3, comparisons=3, scales=[SCALES["sus"]]
    )
    return replace(made, protocol={"protocol": "views", "version": 3}, protocol_hash="abc")


def test_everything_stands_in_the_folder(data: StudyData, tmp_path: Path) -> None:
    told = write_study_report(
        data, nothing, tmp_path / "new" / "report", who="simulated", plan=PLAN, command="desirepath studies report X"
    )
    out = tmp_path / "new" / "report"
    assert {path.name for path in out.iterdir()} == {
        "report.html", "tests.csv", "scales.csv", "answers.csv", "findings.json", "figures",
    }  # fmt: skip
    assert (told["participants"], told["simulated"], told["answers"]) == (12, 12, 12 * 3 * 3)
    assert told["tests"] == len(rows(out / "tests.csv"))
    assert "rating of fun" in told["significant"]
    assert told["deviations"] == ["No analysis plan was declared in the protocol; everything here is exploratory."]
    assert {Path(file).suffix for file in told["figures"]} == {".png", ".svg", ".csv"}
    assert all(Path(file).is_file() for file in told["figures"])
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "views, version 3" in page
    assert "desirepath studies report X" in page
    fun = next(row for row in rows(out / "tests.csv") if row["about"] == "rating of fun")
    assert (fun["test"], fun["significant"], fun["method"]) == ("Friedman", "True", "exact")
    assert fun["shift"] == fun["z"] == ""
    assert "nan" not in (out / "tests.csv").read_text()
    assert len(rows(out / "scales.csv")) == 12 * 3
    assert len(rows(out / "answers.csv")) == 12 * 3 * 3
    found = json.loads((out / "findings.json").read_text())
    assert (found["who"], found["items"][0]["item"]["key"]) == ("simulated", "fun")
    assert found["scales"][0]["scale"] == "sus"


def test_what_there_is_not_has_no_file(data: StudyData, tmp_path: Path) -> None:
    bare = replace(data, ratings=[], comparisons=[], scales=(), choices=[])
    told = write_study_report(bare, nothing, tmp_path, who="all", plan=PLAN)
    assert {path.name for path in tmp_path.iterdir()} == {"report.html", "findings.json"}
    assert (told["tests"], told["figures"], told["significant"]) == (0, [], [])
    with pytest.raises(NothingToReport):
        write_study_report(data, nothing, tmp_path, plan=PLAN)

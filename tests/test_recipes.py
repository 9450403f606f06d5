"""The recipes of docs/extending.md, followed: their files in a package of their own, installed beside Desire Path."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from desirepath.installed import ROOT
from tests.fences import fences_of, install

PLUG_INS = ("A kind of step", "A query strategy", "A reward model", "An alignment", "A policy")
IN_THE_SOURCE = ("An objective", "A job")
COPIED, LINKED = ("backend", "app", "frontend", "tests"), ("docs", "datasets", "study_protocols", "experiments")
TABLES = {"(_one": "KINDS = {", "(Objective": "OBJECTIVES = (", "(#amongpedestrians": "CROWD_OBJECTIVES = ("}
"""By how their lines begin."""


def write_package(folder: Path, heading: str) -> list[str]:
    """Install the recipe's files in the folder; returns what is left to run."""
    fences = fences_of("docs/extending.md", heading)
    install(fences, folder)
    return [fence.text for fence in fences if fence.language == "python" and not fence.file]


def run(code: str, *, beside: Path) -> subprocess.CompletedProcess[str]:
    """In a process of its own, with what lies in that folder installed."""
    paths = os.pathsep.join([str(beside), *filter(None, sys.path)])
    asked = [sys.executable, "-c", code]
    return subprocess.run(
        asked, env={**os.environ, "PYTHONPATH": paths}, cwd=beside, capture_output=True, text=True, timeout=250
    )


@pytest.mark.parametrize("heading", PLUG_INS)
def test_a_plug_in_of_another_package_does_what_its_recipe_says(heading: str, tmp_path: Path) -> None:
    to_run = write_package(tmp_path, heading)
    assert to_run, "every recipe ends with something to try"
    for code in to_run:
        done = run(code, beside=tmp_path)
        assert done.returncode == 0, done.stderr[-3000:]
        assert done.stdout.strip()


def test_two_of_one_name_are_refused_and_so_is_what_is_no_plug_in(tmp_path: Path) -> None:
    write_package(tmp_path, "A query strategy")
    entries = tmp_path / "lab-1.0.dist-info" / "entry_points.txt"
    ask = "from desirepath.learning.queries.choosing import STRATEGIES; print(STRATEGIES['even'])"
    entries.write_text("[desirepath.query_strategies]\neven = lab_asking.even\nrandom = lab_asking.even\n")
    taken = run(ask, beside=tmp_path).stderr
    assert "lab_asking.even offers 'random', as desirepath.learning.queries.strategies.random does: rename" in taken
    entries.write_text("[desirepath.query_strategies]\neven = lab_asking\n")
    assert "'even' is the module lab_asking, which needs STRATEGY" in run(ask, beside=tmp_path).stderr


IN_THE_PAGES = """
from pathlib import Path
from fastapi.testclient import TestClient
from desirepath.settings import Settings
from desirepath.web.application import build_services, create_application
from desirepath.web.core import plug_ins

services = build_services(Settings(data=Path("data")))
browser = TestClient(create_application(services))
script = browser.get("/static/js/kinds/note.js")
assert script.headers["content-type"].startswith("text/javascript"), script.headers
assert script.text == Path("lab_steps/note.js").read_text()
assert browser.get("/static/js/kinds/trial.js").status_code == 200
assert browser.get("/static/js/kinds/secret.js").status_code == 404
assert [services.texts.get(one)("participant.note.title") for one in ("en", "de")] == [
    "In your own words", "In Ihren Worten",
]
template = services.templates.env.get_template("participant/steps/note.html")
assert "step-form" in services.templates.env.loader.get_source(services.templates.env, template.name)[0]
assert "trial" not in plug_ins.scripts(), "only other packages'"
"""


def test_a_kind_of_step_brings_its_page_script_and_words(tmp_path: Path) -> None:
    write_package(tmp_path, "A kind of step")
    (tmp_path / "lab_steps" / "secret.js").write_text("not a plug-in's")
    done = run(IN_THE_PAGES, beside=tmp_path)
    assert done.returncode == 0, done.stderr[-3000:]


def test_no_file_from_elsewhere_is_served_and_no_text_replaced(tmp_path: Path) -> None:
    write_package(tmp_path, "A kind of step")
    (tmp_path / "elsewhere.js").write_text("private")
    (tmp_path / "lab_steps" / "note.js").unlink()
    (tmp_path / "lab_steps" / "note.js").symlink_to(tmp_path / "elsewhere.js")
    assert run("from desirepath.web.core import plug_ins; print(plug_ins.scripts())", beside=tmp_path).stdout == "{}\n"
    (tmp_path / "lab_steps" / "note.en.yaml").write_text("participant: {continue: Skip}\n")
    said = run("from desirepath.web.application import _texts; _texts()", beside=tmp_path).stderr
    assert "note.en.yaml: 'continue' has a text already; a plug-in only adds texts" in said


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A copy of the source, compiled functions included."""
    for name in COPIED:
        shutil.copytree(ROOT / name, tmp_path / name)
    for name in (*LINKED, "pyproject.toml"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def write_into(source: Path, heading: str) -> None:
    """Put each fence where the recipe has it: a file, a function or class, a line of a table, a case, words."""
    for fence in fences_of("docs/extending.md", heading):
        path, text = source / fence.file, fence.text
        if not path.exists():
            path.write_text(text)
        elif fence.language == "yaml":
            for language in ("en", "de"):
                put(text, path.parents[1] / language / path.name, "^kinds:\n")
        elif text.startswith("("):
            table = next(table for begin, table in TABLES.items() if re.sub(r"\s", "", text).startswith(begin))
            put(text.strip()[1:-1].strip() + "\n", path, rf"^{re.escape(table)}(?s:.*?)(?=^ *\)$)")
        elif text.startswith(" "):
            put(text, path, "^(?=    raise TypeError)")
        else:
            put(f"\n\n{text}\n\n", path, "^(?=KINDS = |RESULTS: )" if text.startswith("class") else r"\Z")


def put(text: str, path: Path, behind: str) -> None:
    """Write the text behind the first place in the file that is so."""
    written, times = re.subn(behind, lambda found: found[0] + text, path.read_text(), count=1, flags=re.MULTILINE)
    assert times == 1, f"{path.name} has no {behind}"
    path.write_text(written)


def in_source(source: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": f"{source / 'backend'}{os.pathsep}{source / 'app'}"}
    asked = [sys.executable, *words]
    return subprocess.run(asked, env=environment, cwd=source, capture_output=True, text=True, timeout=250)


def test_a_job_is_started_by_its_name_and_has_all_that_a_kind_needs(source: Path) -> None:
    write_into(source, "A job")
    package = source / "backend" / "desirepath"
    put("counting, ", package / "jobs" / "runners.py", "^from desirepath.jobs import ")
    put('    "count_scenes": CountScenesResult,\n', package / "store" / "job_results.py", r"^RESULTS: .*\n")
    put('    "count_scenes",\n', package / "cli" / "jobs.py", r"^JOB_KINDS = .*\n")
    told = in_source(
        source, "-m", "pytest", "-q", "-k", "every_kind", "tests/jobs/test_kinds.py", "tests/cli/test_words.py"
    )
    assert told.returncode == 0, told.stdout[-3000:]
    done = in_source(source, "-m", "desirepath", "jobs", "start", "count_scenes", "--set", "scenes=50", "--json")
    assert done.returncode == 0, done.stderr[-3000:]
    result = json.loads(done.stdout)
    assert (0 < result["near"] < 50, result["scenes"]) == (True, 50)


LEARNED = """
import desirepath as dp
queries = dp.load_queries("study_room/queries_varied_200").queries
posterior = dp.Posterior.prior("study_room")
for query in queries[:20]:
    steady = [abs(t.actions[1:, 0] - t.actions[:-1, 0]).mean() for t in (query.trajectory_a, query.trajectory_b)]
    posterior = posterior.update(query, steady[0] < steady[1])
print(posterior.weights["steadier"], dp.Posterior.prior("crowd_hall").weights["steadier"])
dp.load_policy("study_room/conditioned")
"""


def test_an_objective_is_learned_at_once_and_what_was_trained_without_it_is_refused(source: Path) -> None:
    write_into(source, "An objective")
    for catalogue in (source / "frontend" / "locales").glob("*/*.yaml"):
        if catalogue.name in ("shared.yaml", "flow.yaml"):
            put("  steadier: steadier\n", catalogue, r"^objectives:(?s:.*?)^  faster: .*\n")
    learned = in_source(source, "-c", LEARNED)
    assert "needed are" in learned.stderr
    assert "steadier" in learned.stderr
    assert len([float(weight) for weight in learned.stdout.split()]) == 2
    checked = in_source(source, "-m", "pytest", "-q", "tests/learning/test_objectives.py").stdout
    failed = {line.split("::")[1].partition("[")[0] for line in checked.splitlines() if line.startswith("FAILED")}
    assert failed == {"test_shipped_policies_were_trained_on_this_table"}

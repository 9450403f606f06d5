"""The recipes of docs/extending.md, followed: their files in a package of their own, installed beside Desire Path."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest

from desirepath.installed import DOCS

FENCE = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^## (.+)$", re.MULTILINE)
PLUG_INS = ("A kind of step", "A query strategy", "A reward model", "An alignment", "A policy")


def fences_of(heading: str) -> list[tuple[str, str, str]]:
    """(language, file, text) of that section's fences."""
    parts = HEADING.split((DOCS / "extending.md").read_text("utf-8"))
    return FENCE.findall(parts[parts.index(heading) + 1])


def write_package(folder: Path, heading: str) -> list[str]:
    """Write the recipe's files below the folder, with what an installer makes of its entry points; returns what is left
    to run."""
    to_run, groups = [], defaultdict[str, list[str]](list)
    for language, file, text in fences_of(heading):
        if file == "pyproject.toml":
            for group, entries in tomllib.loads(text)["project"]["entry-points"].items():
                groups[group] += [f"{name} = {module}" for name, module in entries.items()]
        elif file:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text, "utf-8")
        elif language == "python":
            to_run.append(text)
    about = folder / "lab-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "".join(f"[{group}]\n" + "\n".join(entries) + "\n" for group, entries in groups.items())
    )
    return to_run


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

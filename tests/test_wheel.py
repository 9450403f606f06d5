"""The wheel by itself, away from the checkout: it brings its pages, texts, protocols and shipped data with it."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import httpx
import pytest
import yaml

from desirepath.cli.loopback import loopback_server
from desirepath.settings import Settings

ROOT = Path(__file__).resolve().parents[1]
BUILD = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check"]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the wheel holds, as pip would lay it out."""
    built = tmp_path_factory.mktemp("wheel")
    subprocess.run([sys.executable, *BUILD, "-w", str(built), str(ROOT)], check=True, cwd=built)
    (wheel,) = built.glob("desirepath-*.whl")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(built / "site")
    product = ROOT / "backend" / "desirepath"
    for compiled in product.rglob("__pycache__/*.nb[ic]"):  # Numba takes it for a file of the same size and time
        source = compiled.parents[1].relative_to(product) / f"{compiled.name.partition('.')[0]}.py"
        there = built / "site" / "desirepath" / source
        (there.parent / "__pycache__").mkdir(exist_ok=True)
        shutil.copy2(compiled, there.parent / "__pycache__")
        shutil.copystat(product / source, there)
    return built / "site"


def run(installed: Path, *arguments: str) -> str:
    """What Python says that sees the wheel's content before the checkout's, from a folder of its own."""
    environment = os.environ | {"PYTHONPATH": str(installed)}
    command = [sys.executable, "-P", *arguments]
    return subprocess.run(
        command, env=environment, cwd=installed.parent, capture_output=True, text=True, check=True
    ).stdout


def test_a_wheel_finds_protocols_and_shipped_policies_in_itself(installed: Path) -> None:
    said = run(installed, "-c", "from desirepath import installed; print(installed.ROOT)")
    assert Path(said.strip()) == installed / "desirepath" / "files"
    judged = json.loads(
        run(installed, "-m", "desirepath", "policies", "evaluate", "study_room/base", "--scenes", "20", "--json")
    )
    assert judged["n"] == 20
    assert judged["success_rate"] > 0.8
    protocol = installed / "desirepath" / "files" / "study_protocols" / "quick_preference_study.yaml"
    checked = run(installed, "-m", "desirepath", "studies", "check", str(protocol), "--json")
    assert json.loads(checked)["valid"]


def test_a_wheel_brings_its_licences_and_its_version_is_the_one_to_cite(installed: Path) -> None:
    (about,) = installed.glob("desirepath-*.dist-info")
    texts = {name: (about / "licenses" / name).read_text() for name in ("LICENSE", "datasets/LICENSE")}
    assert texts == {name: (ROOT / name).read_text() for name in texts}
    version = yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"]
    assert about.name == f"desirepath-{version}.dist-info"
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()


def test_a_wheel_serves_the_demo(installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(installed))
    monkeypatch.chdir(tmp_path)
    with (
        loopback_server(
            Settings(data=tmp_path / "data", _env_file=None), worker=False, arguments=("--demo", "--no-example")
        ) as (
            url,
            _,
        ),
        httpx.Client(base_url=url, follow_redirects=True) as browser,
    ):
        page = browser.get("/")
        assert page.status_code == 200
        assert "<h1" in page.text
        assert browser.get("/static/css/tokens.css").status_code == 200


@pytest.mark.parametrize("folder", ["frontend/templates", "frontend/locales", "study_protocols", "datasets", "docs"])
def test_a_wheel_holds_all_that_is_tracked(installed: Path, folder: str) -> None:
    listed = subprocess.run(["git", "ls-files", folder], cwd=ROOT, capture_output=True, text=True, check=True)
    tracked = set(listed.stdout.split())
    files = installed / "desirepath" / "files"
    assert tracked
    assert tracked <= {str(one.relative_to(files)) for one in (files / folder).rglob("*")}

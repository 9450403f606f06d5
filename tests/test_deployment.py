"""What a server is deployed with: the compose file, its one secret, the images, how each container says it lives."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from sqlalchemy import make_url

from desirepath.jobs import heartbeat
from desirepath.jobs.process import environment_of
from desirepath.settings import Settings, SettingsError
from desirepath.study.protocol.freezing import freeze
from tests.composed import shortened

ROOT = Path(__file__).resolve().parents[1]
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
SERVER = "postgresql+psycopg://desirepath@database/desirepath"


def test_every_image_is_pinned_to_an_exact_version() -> None:
    images = [service["image"] for service in COMPOSE["services"].values()]
    images += re.findall(r"^FROM (\S+)", (ROOT / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(images) >= 5
    for image in images:
        assert re.search(r":\d+\.\d+(\.\d+)?(-[a-z-]+)?$", image), f"{image} may be another one tomorrow"
    own = {COMPOSE["services"][name]["image"] for name in ("web", "worker")}
    version = re.search(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert version is not None
    assert own == {f"desirepath:{version[1]}"}


def test_the_image_has_the_folders_that_its_package_names_when_that_is_installed() -> None:
    """The build of an editable package ends where a folder of its wheel is missing."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    named = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    before, _, _ = (ROOT / "Dockerfile").read_text(encoding="utf-8").partition("scripts/setup.sh")
    there = {word for line in re.findall(r"(?:COPY|mkdir) ([^&\n]+)", before) for word in line.split()}
    assert there >= set(named)


def test_what_is_walked_through_a_deployment_is_the_quick_study_with_fewer_pairs(tmp_path: Path) -> None:
    quick = ROOT / "study_protocols/quick_preference_study.yaml"
    whole, short = (freeze(file).yaml.splitlines() for file in (quick, shortened(3, tmp_path / "in")))
    changed = [new.split("#")[0].strip() for old, new in zip(whole, short, strict=True) if old != new]
    assert changed == [
        "- queries: {count: 3, choose: information}",
        "- comparison: {arms: [base, own], scenes: 1, blind: true, guess: true}",
        "- meet_your_robot: {setup: study_room, scenes: 3, view: top_down, preferred: 1}",
    ]


def test_every_container_but_the_proxy_says_whether_it_lives() -> None:
    assert {name for name, service in COMPOSE["services"].items() if "healthcheck" not in service} == {"proxy"}
    assert COMPOSE["services"]["worker"]["healthcheck"]["test"] == ["CMD", "python", "-m", "desirepath.jobs.heartbeat"]


def test_one_secret_serves_the_database_and_the_server_and_no_value_of_it_is_in_the_file() -> None:
    assert list(COMPOSE["secrets"]) == ["database_password"]
    for name in ("web", "worker", "database"):
        assert COMPOSE["services"][name]["secrets"] == ["database_password"]
    for name in ("web", "worker"):
        told = COMPOSE["services"][name]["environment"]
        assert told["DESIREPATH_DATABASE_PASSWORD_FILE"] == "/run/secrets/database_password"
        assert "PGPASSFILE" not in told, "libpq reads that one only where owner and mode suit it, and says nothing"
        assert make_url(told["DESIREPATH_DATABASE_URL"]).password is None


def test_one_command_makes_the_secret_once(tmp_path: Path) -> None:
    def made() -> str:
        subprocess.run(["make", "-s", "-f", str(ROOT / "Makefile"), "secrets"], cwd=tmp_path, check=True)
        return (tmp_path / "secrets/database_password").read_text(encoding="utf-8")

    secret = made()
    assert re.fullmatch("[0-9a-f]{48}", secret)
    assert made() == secret, "the database has that one already"
    assert (tmp_path / "secrets").stat().st_mode & 0o777 == 0o700, "nobody else on the machine"
    assert (tmp_path / "secrets/database_password").stat().st_mode & 0o004, "the container's user is another one"


@pytest.mark.parametrize("mode", [0o444, 0o644, 0o600, 0o666])
def test_the_password_is_read_whatever_the_files_mode(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "database_password"
    file.write_text("p:ss/w@rd?\n")
    file.chmod(mode)
    settings = Settings(database_url=SERVER, database_password_file=file, data=tmp_path, _env_file=None)
    for url in (settings.database, settings.jobs_database, environment_of(settings)["DESIREPATH_DATABASE_URL"]):
        read = make_url(url)
        assert (read.username, read.password, read.host) == ("desirepath", "p:ss/w@rd?", "database")


def test_a_password_in_the_url_is_kept_and_sqlite_needs_none(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere"
    with_one = "postgresql://me:mine@database/desirepath"
    assert Settings(database_url=with_one, database_password_file=nowhere, _env_file=None).database == with_one
    here = Settings(database_url=None, database_password_file=nowhere, data=tmp_path, _env_file=None)
    assert here.database.startswith("sqlite:///")


@pytest.mark.parametrize(
    ("content", "told"), [(None, "No such file or directory"), ("", "must hold one line"), ("a\nb\n", "must hold one")]
)
def test_a_password_file_that_cannot_serve_is_told_by_name(tmp_path: Path, content: str | None, told: str) -> None:
    file = tmp_path / "database_password"
    if content is not None:
        file.write_text(content)
    with pytest.raises(SettingsError, match=told) as said:
        _ = Settings(database_url=SERVER, database_password_file=file, _env_file=None).database
    assert str(file) in str(said.value)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_file_of_another_user_is_refused_with_what_would_help(tmp_path: Path) -> None:
    file = tmp_path / "database_password"
    file.write_text("secret")
    file.chmod(0o600)
    for folder in (tmp_path, *tmp_path.parents):
        if folder.stat().st_uid == 0 and folder != Path("/"):
            folder.chmod(folder.stat().st_mode | 0o055)
    reading, writing = os.pipe()
    if (child := os.fork()) == 0:  # another process: nobody becomes root again
        os.setgid(65534)
        os.setuid(65534)
        try:
            told = Settings(database_url=SERVER, database_password_file=file, _env_file=None).database
        except SettingsError as problem:
            told = str(problem)
        os.write(writing, told.encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    assert "cannot be read by user 65534 (Permission denied)" in said
    assert "chmod 644" in said


def test_a_worker_that_was_silent_for_long_is_not_healthy(tmp_path: Path) -> None:
    def healthy() -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "desirepath.jobs.heartbeat"]
        known = os.environ | {"DESIREPATH_DATA": str(tmp_path)}
        return subprocess.run(command, env=known, capture_output=True, text=True, check=False, cwd=ROOT)

    assert healthy().returncode == 1
    heartbeat.beat(tmp_path)
    assert healthy().returncode == 0
    long_ago = time.time() - heartbeat.SILENT_S - 5
    os.utime(tmp_path / heartbeat.FILE, (long_ago, long_ago))
    ended = healthy()
    assert ended.returncode == 1
    assert "silent" in ended.stderr

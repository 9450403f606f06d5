"""What `desirepath serve --demo` prints: three addresses that open something, the experimenter's once."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from desirepath.cli.loopback import free_port_pair
from desirepath.cli.main import app
from desirepath.web.application import create_application
from desirepath.web.core.dependencies import Services


def start(data: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> tuple[str, Services]:
    """What the command printed, and its services; nothing listens: real starts are in tests/faults, tests/journeys."""
    installations: list[Services] = []

    def ready(services: Services, on_ready: Callable[[], None]) -> None:
        installations.append(services)
        on_ready()

    monkeypatch.setattr("desirepath.web.server.run", ready)
    ended = CliRunner().invoke(
        app, ["serve", "--demo", "--no-example", "--data", str(data), "--port", str(free_port_pair()), *arguments]
    )
    assert ended.exit_code == 0, ended.output
    return ended.stdout, installations[0]


def address(printed: str, whose: str) -> str:
    found = re.search(rf"^ *{whose} +http://127\.0\.0\.1:\d+(/\S+)$", printed, re.MULTILINE)
    assert found, printed
    return found.group(1)


def browser_here(services: Services) -> TestClient:
    """A browser on this machine."""
    application = create_application(services)
    return TestClient(application, "http://127.0.0.1:8000", follow_redirects=False, client=("127.0.0.1", 50_000))


def test_the_demo_prints_three_addresses_and_on_loopback_no_password(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed, services = start(tmp_path, monkeypatch)
    assert "password" not in printed
    participant, once = address(printed, "Participant"), address(printed, "Experimenter")
    with browser_here(services) as browser:
        assert browser.get(participant).status_code == 200
        assert browser.get(address(printed, "Analyst")).headers["location"].startswith("/lab/sign-in")
        assert browser.get(once).headers["location"] == "/lab/studies"
        assert browser.get(address(printed, "Analyst")).status_code == 200
    services.database.close()

    again, services = start(tmp_path, monkeypatch)
    assert address(again, "Participant") == participant
    assert address(again, "Experimenter") != once
    with browser_here(services) as browser:
        assert browser.get(address(again, "Experimenter")).headers["location"] == "/lab/studies"
    services.database.close()


def test_a_password_is_printed_once_the_installation_is_opened_to_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed, services = start(tmp_path, monkeypatch)
    services.database.close()
    opened, services = start(tmp_path, monkeypatch, "--host", "0.0.0.0")
    password = re.search(r"with password (\S+)$", opened, re.MULTILINE)
    assert password, opened
    with browser_here(services) as browser:
        assert browser.get(address(printed, "Experimenter")).status_code == 403
        signed_in = browser.post("/lab/sign-in", data={"name": "experimenter", "password": password.group(1)})
        assert signed_in.status_code == 303
    services.database.close()
    for arguments in (("--host", "0.0.0.0"), ()):
        again, services = start(tmp_path, monkeypatch, *arguments)
        services.database.close()
        assert "with password" not in again
        assert address(again, "Experimenter") == "/lab/studies"


def test_another_address_is_printed_by_a_command_and_stops_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed, services = start(tmp_path, monkeypatch)
    ended = CliRunner().invoke(app, ["link", "--data", str(tmp_path), "--json"])
    another = json.loads(ended.stdout)["address"].partition(":8000")[2]
    with browser_here(services) as browser:
        assert browser.get(address(printed, "Experimenter")).status_code == 403
        assert browser.get(another).headers["location"] == "/lab/studies"
    services.database.close()
    CliRunner().invoke(app, ["password", "--data", str(tmp_path)])
    ended = CliRunner().invoke(app, ["link", "--data", str(tmp_path)])
    assert (ended.exit_code, "desirepath password" in ended.stderr) == (1, True)


def test_a_server_starts_without_what_takes_seconds_to_load(tmp_path):
    """Pages are there within three seconds of a restart; statistics and splines are loaded where they are used."""
    code = """
import sys
for name in ("authlib", "joserfc", "s3fs", "pybullet"):
    sys.modules[name] = None  # what a wheel without extras does not have
import desirepath.cli.main, desirepath.web.server
from desirepath.web.application import build_services, create_application
from desirepath.settings import Settings
from desirepath.store.shipped_policies import register_shipped
import pathlib
services = build_services(Settings(data=pathlib.Path(sys.argv[1]), _env_file=None))
with services.database.transaction() as s:
    register_shipped(s, services.files)
create_application(services)
slow = ("torch", "scipy.stats", "scipy.interpolate", "matplotlib", "alembic", "mako", "PIL.Image")
print([name for name in slow if name in sys.modules])
"""
    command = [sys.executable, "-c", code, str(tmp_path / "data")]
    subprocess.run(command, capture_output=True, check=True)  # the first start makes tables and artefacts
    told = subprocess.run(command, capture_output=True, text=True, check=True)
    assert told.stdout.splitlines()[-1] == "[]"

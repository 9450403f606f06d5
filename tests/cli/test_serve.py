"""What `desirepath serve --demo` prints: three addresses that open something, and the first password once."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from desirepath.cli.loopback import free_port_pair
from desirepath.cli.main import app
from desirepath.web.application import create_application
from desirepath.web.core.dependencies import Services


def start(data: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Services]:
    """What the command printed, and its services; nothing listens: real starts are in tests/faults, tests/journeys."""
    installations: list[Services] = []

    def ready(services: Services, on_ready: Callable[[], None]) -> None:
        installations.append(services)
        on_ready()

    monkeypatch.setattr("desirepath.web.server.run", ready)
    ended = CliRunner().invoke(app, ["serve", "--demo", "--data", str(data), "--port", str(free_port_pair())])
    assert ended.exit_code == 0, ended.output
    return ended.stdout, installations[0]


def address(printed: str, whose: str) -> str:
    found = re.search(rf"^ *{whose} +http://127\.0\.0\.1:\d+(/\S+)$", printed, re.MULTILINE)
    assert found, printed
    return found.group(1)


def test_the_demo_prints_three_addresses_and_the_first_password_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed, services = start(tmp_path, monkeypatch)
    participant = address(printed, "Participant")
    password = re.search(r"with password (\S+)$", printed, re.MULTILINE)
    assert password, printed
    with TestClient(create_application(services), follow_redirects=False) as browser:
        assert browser.get(participant).status_code == 200
        for whose in ("Experimenter", "Analyst"):
            sent = browser.get(address(printed, whose))
            assert sent.headers["location"].startswith("/lab/sign-in")
        signed_in = browser.post("/lab/sign-in", data={"name": "experimenter", "password": password.group(1)})
        assert signed_in.status_code == 303
    services.database.close()

    again, services = start(tmp_path, monkeypatch)
    services.database.close()
    assert address(again, "Participant") == participant
    assert "password" not in again

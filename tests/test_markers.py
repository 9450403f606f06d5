"""Every test has one speed, and `fast` is true of those that `make check` runs."""

from __future__ import annotations

import ast
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

SPEEDS = {"fast", "server", "browser", "slow"}


def test_every_test_has_exactly_one_speed(request: pytest.FixtureRequest) -> None:
    for item in request.session.items:
        assert len(SPEEDS & {mark.name for mark in item.iter_markers()}) == 1, item.nodeid


def test_no_fast_test_trains(request: pytest.FixtureRequest) -> None:
    files = {item.path for item in request.session.items if item.get_closest_marker("fast")}
    for file in files | {folder / "conftest.py" for folder in {file.parent for file in files}}:
        assert not trainings_in(file), file


def trainings_in(file: Path) -> list[str]:
    """Names of what trains, by our names for it, that a file imports."""
    every = ast.walk(ast.parse(file.read_text("utf-8"))) if file.exists() else ()
    names = [alias.name for node in every if isinstance(node, ast.ImportFrom) for alias in node.names]
    return [name for name in names if re.fullmatch(r"train_\w+|\w+Training", name)]


def test_a_fast_test_cannot_start_a_server_or_a_browser() -> None:
    with pytest.raises(AssertionError, match="marked fast"), socket.socket() as server:
        server.bind(("127.0.0.1", 0))
    for words in (["chromium-headless-shell", "--headless"], [sys.executable, "-m", "desirepath", "worker"]):
        with pytest.raises(AssertionError, match="marked fast"):
            subprocess.run(words, check=False)

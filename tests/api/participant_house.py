"""A house with studies that a participant can join, for the tests of their pages."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from backend.api.application import build_house
from backend.api.dependencies import House
from backend.settings import Settings
from tests.study import walking


@pytest.fixture(scope="module")
def furnished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with studies of twenty queries; copied by every test."""
    folder = tmp_path_factory.mktemp("furnished")
    walking.furnish(folder, walking.twenty_queries(tmp_path_factory.mktemp("queries")))
    return folder


@pytest.fixture
def house(furnished: Path, tmp_path: Path, database_of: Callable[[Path], str]) -> Iterator[House]:
    """A house of its own over the furnished folder, without a stage."""
    data = shutil.copytree(furnished, tmp_path / "data")
    found = build_house(Settings(data=data, database_url=database_of(data), _env_file=None))
    yield found
    found.database.close()

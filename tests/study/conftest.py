"""A data folder with two studies, made once and copied for every test."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sqlalchemy import select

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Study
from desirepath.study.studies import create_study
from tests.study import walking
from tests.study.small_protocol import small_protocol
from tests.study.walking import GIVEN, Walker


@pytest.fixture(scope="session")
def twenty_queries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return walking.twenty_queries(tmp_path_factory.mktemp("queries"))


@pytest.fixture(scope="session")
def furnished(tmp_path_factory: pytest.TempPathFactory, twenty_queries: Path) -> Path:
    folder = tmp_path_factory.mktemp("furnished")
    walking.furnish(folder, twenty_queries)
    return folder


@pytest.fixture
def database(tmp_path: Path, furnished: Path, database_of: Callable[[Path], str]) -> Iterator[Database]:
    shutil.copytree(furnished, tmp_path, dirs_exist_ok=True)
    found = Database(database_of(tmp_path))
    yield found
    found.close()


@pytest.fixture
def study(database: Database) -> Study:
    with database.session() as s:
        return s.scalars(select(Study).where(Study.name == "Short")).one()


@pytest.fixture
def full_study(database: Database) -> Study:
    with database.session() as s:
        return s.scalars(select(Study).where(Study.name == "Full")).one()


@pytest.fixture
def walker(database: Database, files: ArtefactStore, study: Study) -> Walker:
    return Walker(database, files, study)


@pytest.fixture
def walk(tmp_path, database, files, twenty_queries):
    """Opens a study with these stages and joins it; the walker stands after the consent."""

    def opened(*stages, consent=GIVEN, **keys) -> Walker:
        frozen = small_protocol(tmp_path, list(stages), query_set=str(twenty_queries), **keys)
        with database.transaction() as s:
            study = create_study(s, files, frozen, name="Small", created_by=None)
        walker = Walker(database, files, study)
        walker.submit("consent", consent)
        return walker

    return opened

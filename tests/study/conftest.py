"""A study over 20 of the shipped queries that asks four of them; made once, copied for every test."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from sqlalchemy import select

from backend.learning.queries import QuerySet
from backend.learning.shipped import load_queries
from backend.store.artefacts import ArtefactStore
from backend.store.database import Database
from backend.store.models import Study
from backend.study.protocol import freeze_text
from backend.study.studies import create_study
from tests.study.walking import QUICK, Walker


@pytest.fixture(scope="session")
def twenty_queries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    shipped = load_queries("study_room/queries_200")
    path = tmp_path_factory.mktemp("queries") / "twenty.npz"
    QuerySet(shipped.setup, shipped.queries[:20], {}).save(path)
    return path


@pytest.fixture(scope="session")
def furnished(tmp_path_factory: pytest.TempPathFactory, twenty_queries: Path) -> Path:
    """A data folder with two studies: "Short" asks three queries, "Full" asks fifteen."""
    folder = tmp_path_factory.mktemp("furnished")
    database = Database(f"sqlite:///{folder / 'desirepath.sqlite'}")
    database.migrate()
    files = ArtefactStore((folder / "artefacts").as_uri())
    full = QUICK.read_text().replace("study_room/queries_200", str(twenty_queries))
    with database.transaction() as s:
        for name, text in (("Full", full), ("Short", full.replace("count: 15", "count: 3"))):
            create_study(s, files, freeze_text(text), name=name, created_by=None)
    database.close()
    return folder


@pytest.fixture
def database(tmp_path: Path, furnished: Path) -> Database:
    shutil.copytree(furnished, tmp_path, dirs_exist_ok=True)
    return Database(f"sqlite:///{tmp_path / 'desirepath.sqlite'}")


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

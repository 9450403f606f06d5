"""What the store's tests share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from tests import postgres
from tests.store.small_study import SmallStudy


@pytest.fixture
def study(database: Database, files: ArtefactStore) -> SmallStudy:
    """An open study without participants."""
    return SmallStudy(database, files)


@pytest.fixture(params=["sqlite", "postgresql"])
def either(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """An empty database of each kind, not migrated."""
    if request.param == "sqlite":
        yield Database(f"sqlite:///{tmp_path / 'either.sqlite'}")
        return
    with postgres.holding(request.getfixturevalue("postgres_server"), tmp_path / "none") as url:
        found = Database(url)
        with found.engine.begin() as connection:
            connection.execute(text("DROP SCHEMA public CASCADE"))
            connection.execute(text("CREATE SCHEMA public"))
        yield found
        found.close()

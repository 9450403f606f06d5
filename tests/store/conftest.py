"""What the store's tests share."""

from __future__ import annotations

import pytest
from small_study import SmallStudy

from backend.store.artefacts import ArtefactStore
from backend.store.database import Database


@pytest.fixture
def study(database: Database, files: ArtefactStore) -> SmallStudy:
    """An open study without participants."""
    return SmallStudy(database, files)

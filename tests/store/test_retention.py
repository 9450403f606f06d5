"""How long data are kept: the promised day, and the erasing of everybody once it is over."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import func, select

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Audit, Participant, Response, Study, Tombstone
from desirepath.store.retention import RetentionError, check_day, erase_overdue
from desirepath.store.snapshots import SnapshotError, take_snapshot
from tests.store.small_study import SmallStudy

NOW = datetime(2026, 11, 21, 10, 0, tzinfo=UTC)


def test_a_day_counts_until_its_end_and_not_in_the_past():
    assert check_day("", NOW) is None
    assert check_day("2026-11-21", NOW) == datetime(2026, 11, 21, 23, 59, 59, tzinfo=UTC)
    for wrong in ("2026-11-20", "21.11.2026", "soon"):
        with pytest.raises(ValueError, match=wrong):
            check_day(wrong, NOW)


def test_everybody_of_a_study_is_erased_once_its_day_is_over_and_not_before(
    database: Database, files: ArtefactStore, tmp_path: Path
):
    due, other = SmallStudy(database, files), SmallStudy(database, files)
    for k, code in enumerate(("P1", "P2")):
        due.participant(code, secret="told in confidence", drives=100 * k)
    other.participant("P1", drives=500)

    def erase() -> dict[str, object]:
        return erase_overdue(database, files, due.id, "tester", now=NOW, data=tmp_path)

    with pytest.raises(RetentionError, match="without a date"):
        erase()
    with database.transaction() as s:
        s.get_one(Study, due.id).retain_until = NOW + timedelta(hours=1)
    with pytest.raises(RetentionError, match="until 2026-11-21"):
        erase()
    with database.transaction() as s:
        s.get_one(Study, due.id).retain_until = NOW - timedelta(hours=1)
    assert erase() == {"study": due.id, "erased": 2, "compacted": True}
    with database.session() as s:
        assert s.scalars(select(Participant.study_id)).all() == [other.id]
        assert s.scalar(select(func.count()).select_from(Tombstone)) == 2
        assert s.scalar(select(func.count()).select_from(Response)) == 6
        assert [(e.by, e.data) for e in s.scalars(select(Audit))] == [("tester", {"participants": 2})]
    assert database.file is not None
    assert b"told in confidence" not in database.file.read_bytes()
    with pytest.raises(LookupError, match="no study"):
        erase_overdue(database, files, "unknown", "tester", now=NOW, data=tmp_path)


def test_a_study_s_snapshot_leaves_pilot_participants_out(database: Database, files: ArtefactStore):
    study = SmallStudy(database, files)
    _, session = study.participant("P1", pilot=True)
    with pytest.raises(SnapshotError, match="left out: 5 pilot"), database.transaction() as s:
        take_snapshot(s, files, study_id=study.id)
    with database.transaction() as s:
        assert take_snapshot(s, files, session_id=session).card["answers"] == 4

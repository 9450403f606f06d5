"""Watching a training process."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from desirepath.jobs import process
from desirepath.store import database as stored
from desirepath.store.database import Database, DatabaseBusy
from desirepath.store.models import Job
from desirepath.store.outbox import enqueue_job


def test_a_training_is_not_lost_because_others_keep_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its signs of life cannot be written while another process holds the database; it is watched to its end."""
    monkeypatch.setattr(stored, "BUSY_TIMEOUT_MS", 100)
    monkeypatch.setattr(process, "HEARTBEAT_S", 0.1)
    file = tmp_path / "jobs.sqlite"
    database = Database(f"sqlite:///{file}")
    database.migrate()
    with database.transaction() as s:
        job = enqueue_job(s, "evaluate", {}).id
    with closing(sqlite3.connect(file, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        training = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1.5)"])
        assert process.watch(database, job, training) == 0
    with database.session() as s:
        assert s.get_one(Job, job).heartbeat_at is None


def test_the_line_about_a_jobs_end_is_written_when_the_others_are_done(monkeypatch: pytest.MonkeyPatch) -> None:
    turns = iter([DatabaseBusy("busy"), DatabaseBusy("busy"), None])

    def write() -> str:
        if problem := next(turns):
            raise problem
        return "written"

    assert process.patiently(write) == "written"
    monkeypatch.setattr(process, "WRITE_TRIES", 2)
    turns = iter([DatabaseBusy("busy"), DatabaseBusy("busy"), None])
    with pytest.raises(DatabaseBusy):
        process.patiently(write)

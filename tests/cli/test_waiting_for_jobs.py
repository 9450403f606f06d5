"""A command that waits for a job of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from desirepath.cli.science import follow_job
from desirepath.store.database import Database
from desirepath.store.outbox import enqueue_job


def test_a_worker_that_died_is_noticed(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'jobs.sqlite'}")
    database.migrate()
    with database.transaction() as s:
        job = enqueue_job(s, "evaluate", {}).id
    dead = subprocess.Popen([sys.executable, "-c", "raise SystemExit(7)"])
    dead.wait()
    with pytest.raises(RuntimeError, match=f"job {job} is queued: the worker .* ended with code 7"):
        follow_job(database, job, [dead])

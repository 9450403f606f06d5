"""What a running job is given: the store, its own row, and a way to say how far it is."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.jobs.leases import holds, say_under_way
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database, StorageError
from desirepath.store.models import Job, JobMetric

WRITE_EVERY_S = 0.5  # progress is for eyes; every write is a transaction
PAUSED = "paused: somebody waits for another training"
STEP_NAMES = ("updates", "steps", "epoch", "scenes", "step", "tried")  # a curve's horizontal axis, first found


class Progress:
    """Collects progress and curve points and writes them at most twice a second."""

    def __init__(self, database: Database, job_id: str, attempt: str | None = None) -> None:
        self._database, self._job_id, self._attempt = database, job_id, attempt
        self._points: list[dict[str, Any]] = []
        self._fraction, self._message = 0.0, ""
        self._calls = 0
        self._written = 0.0
        self.must_pause: Callable[[DatabaseSession], bool] = lambda _: False

    def __call__(self, fraction: float, metrics: Mapping[str, float] | None = None, message: str | None = None) -> None:
        """fraction done in [0, 1]; metrics by name, one of STEP_NAMES among them says where on the curve."""
        self._calls += 1
        self._fraction = min(1.0, max(0.0, fraction))
        if message is not None:
            self._message = message
        metrics = dict(metrics or {})
        step = next((int(metrics.pop(name)) for name in STEP_NAMES if name in metrics), self._calls)
        for name, value in metrics.items():
            if math.isfinite(value):
                self._points.append({"step": step, "name": name, "value": float(value)})
        if time.monotonic() - self._written >= WRITE_EVERY_S:
            self.flush()
            self.give_way()

    def part(self, first: float, last: float) -> Part:
        """A progress callback for one part of the job, which fills the bar from `first` to `last`."""
        return Part(self, first, last)

    def give_way(self) -> None:
        """Return once the training may go on: it stands still here, between two of its steps, for as long as another
        goes first. Whoever cancels it or ends its worker ends it here, too."""
        message = self._message
        while self._pauses():
            if self._message != PAUSED:
                print(PAUSED, flush=True)
                self._message = PAUSED
            self.flush()
            time.sleep(WRITE_EVERY_S)
        if self._message == PAUSED:
            print("goes on", flush=True)
            self._message = message
            self.flush()

    def _pauses(self) -> bool:
        with contextlib.suppress(StorageError), self._database.session() as s:
            return self.must_pause(s)
        return False

    def flush(self) -> None:
        """Write what has not been written; where the database is away or busy, with the next."""
        with contextlib.suppress(StorageError):
            self.write()

    def write(self) -> None:
        """Write what has not been written. Raises StorageError; then it is still to be written."""
        self._written = time.monotonic()
        points = [JobMetric(job_id=self._job_id, **point) for point in self._points]
        with self._database.transaction() as s:
            job = s.get(Job, self._job_id)
            if holds(job, self._attempt):
                job.progress, job.message = self._fraction, self._message
                say_under_way(s, job)
                s.add_all(points)
        self._points = []


@dataclass(frozen=True)
class Part:
    """A slice of a job's progress bar; called as `desirepath.learning` calls its progress callbacks."""

    progress: Progress
    first: float
    last: float

    def __call__(self, fraction: float, metrics: Mapping[str, float] | None = None) -> None:
        self.progress(self.first + (self.last - self.first) * fraction, metrics)


@dataclass(frozen=True)
class JobContext:
    """Everything a kind of job may use. `job` is a detached copy of its row as it was at the start."""

    settings: Settings
    database: Database
    files: ArtefactStore
    job: Job
    progress: Progress

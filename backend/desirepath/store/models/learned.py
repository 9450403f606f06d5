"""What is learned and collected, what it was made from, and the jobs that make it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any, TypeVar

from sqlalchemy import JSON, Boolean, CheckConstraint, Float, ForeignKey, Integer, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from desirepath.store.job_results import RESULTS, JobResult
from desirepath.store.models.base import Base, new_id, utc_now


class Artefact(Base):
    """A learned or collected thing with its card; id is the sha256 of its content in the artefact store.

    `kind`: one of `ARTEFACT_KINDS` (`store/artefacts.py`). `card` as datasets/README.md describes.
    """

    __tablename__ = "artefact"
    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    kind: Mapped[str] = mapped_column(String(20), index=True)
    name: Mapped[str] = mapped_column(String(160))
    setup: Mapped[str] = mapped_column(String(60))
    card: Mapped[dict[str, Any]] = mapped_column(JSON)
    study_id: Mapped[str | None] = mapped_column(ForeignKey("study.id"), index=True)
    job_id: Mapped[str | None] = mapped_column(String(32), index=True)
    simulated: Mapped[bool] = mapped_column(Boolean, default=False)  # made from simulated answers
    quarantined_at: Mapped[datetime | None]
    archived_at: Mapped[datetime | None]  # out of the lists from which something is chosen
    archived_by: Mapped[str | None] = mapped_column(String(80))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class ArtefactParent(Base):
    """Lineage: `artefact` was made from `parent` (an artefact's id) in the role named."""

    __tablename__ = "artefact_parent"
    artefact_id: Mapped[str] = mapped_column(ForeignKey("artefact.id"), primary_key=True)
    parent_id: Mapped[str] = mapped_column(ForeignKey("artefact.id"), primary_key=True)
    role: Mapped[str] = mapped_column(String(40), primary_key=True)


class ArtefactAnswer(Base):
    """Lineage's last step: the snapshot was made from this response."""

    __tablename__ = "artefact_answer"
    artefact_id: Mapped[str] = mapped_column(ForeignKey("artefact.id"), primary_key=True)
    response_id: Mapped[str] = mapped_column(ForeignKey("response.id"), primary_key=True)


R = TypeVar("R", bound=JobResult)


class Job(Base):
    """One piece of background work. Written in the transaction that causes it; the worker starts it from here.

    States: queued, running, cancelling, succeeded, failed, cancelled. `result` names the artefacts made.
    """

    __tablename__ = "job"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    kind: Mapped[str] = mapped_column(String(40))
    params: Mapped[dict[str, Any]] = mapped_column(JSON)
    state: Mapped[str] = mapped_column(String(16), default="queued", index=True)
    priority: Mapped[int] = mapped_column(Integer, default=10)  # smaller first; participants waiting: 1
    progress: Mapped[float] = mapped_column(Float, default=0.0)
    message: Mapped[str] = mapped_column(Text, default="")
    error: Mapped[str | None] = mapped_column(Text)
    result: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    study_id: Mapped[str | None] = mapped_column(ForeignKey("study.id"), index=True)
    session_id: Mapped[str | None] = mapped_column(ForeignKey("session.id"), index=True)
    retry_of: Mapped[str | None] = mapped_column(String(32))
    created_by: Mapped[str | None] = mapped_column(String(80))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    heartbeat_at: Mapped[datetime | None]
    held_by: Mapped[str | None] = mapped_column(String(32))  # the attempt (`JobAttempt`) that may write how it ends

    def keep_result(self, result: Mapping[str, Any]) -> None:
        """Raises pydantic's ValidationError for what its kind does not result in."""
        if self.kind in RESULTS:
            RESULTS[self.kind].model_validate(result)
        self.result = dict(result)

    def result_as(self, of: type[R]) -> R | None:
        """Its result, None where it has none or is of a kind that results in something else."""
        model = RESULTS.get(self.kind)
        if self.result is None or model is None or not issubclass(model, of):
            return None
        # A newer version, running beside this one during an upgrade, may say more.
        return model.model_validate(self.result, extra="ignore")

    __table_args__ = (
        CheckConstraint(
            "state in ('queued', 'running', 'cancelling', 'succeeded', 'failed', 'cancelled')", name="state"
        ),
    )


class JobAttempt(Base):
    """One time that a worker took a job up: which one, on which machine, from when to when, and how that ended.

    outcome: succeeded, failed, cancelled, crashed (its process was killed), again (the database was away or the disk
    full), lost (nothing was heard of the worker, and another took the job up), stopped (its worker was stopped in
    order, which counts as no attempt). `log`: the end of what it printed.
    """

    __tablename__ = "job_attempt"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    job_id: Mapped[str] = mapped_column(ForeignKey("job.id"), index=True)
    worker: Mapped[str] = mapped_column(String(120))
    machine: Mapped[str] = mapped_column(String(80))
    began_at: Mapped[datetime] = mapped_column(default=utc_now)
    ended_at: Mapped[datetime | None]
    outcome: Mapped[str | None] = mapped_column(String(16))
    log: Mapped[str] = mapped_column(Text, default="")


class TaskFile(Base):
    """What one task of a sweep came to (`desirepath reproduce --on workers`), by the key of all that it depends on."""

    __tablename__ = "task_file"
    key: Mapped[str] = mapped_column(String(120), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64))
    job_id: Mapped[str | None] = mapped_column(String(32))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class JobMetric(Base):
    """One point of a live curve."""

    __tablename__ = "job_metric"
    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=True)
    job_id: Mapped[str] = mapped_column(ForeignKey("job.id"), index=True)
    step: Mapped[int] = mapped_column(Integer)
    name: Mapped[str] = mapped_column(String(60))
    value: Mapped[float] = mapped_column(Float)

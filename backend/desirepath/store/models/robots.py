"""Robots that drive in studies, and their runs. What a run's bytes hold is `deploy/recorder.py`'s."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, Boolean, CheckConstraint, ForeignKey, Integer, String, UniqueConstraint, false
from sqlalchemy.orm import Mapped, mapped_column

from desirepath.store.models.base import Base, new_id, utc_now


class StudyRobot(Base):
    """A robot that an experimenter let into one study. Its token is stored as sha256 only and opens that study's robot
    routes alone. `number` counts whatever changed for it. `person`: [x, y] m in its odometry frame, where somebody
    clicked; None: nobody did."""

    __tablename__ = "study_robot"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), index=True)
    name: Mapped[str] = mapped_column(String(80))
    token_hash: Mapped[str] = mapped_column(String(64), unique=True)
    number: Mapped[int] = mapped_column(Integer, default=0)
    person: Mapped[list[Any] | None] = mapped_column(JSON(none_as_null=True))
    made_by: Mapped[str] = mapped_column(String(80))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    revoked_at: Mapped[datetime | None]


class RobotRun(Base):
    """One drive of a robot, of a session's step or (no session) of the lab. `goal`: [x, y] m from where it stands when
    it starts, x ahead; `weights`: objective -> weight that it is to drive by now. `answers`, `asked_at`: how many of
    the session's answers it was learned from, and when the last was given. `moved_at`: its wheels turned. `summary`:
    what it said at the end, {"driven_s", "way_m", "reached", "stops": [{"at_s", "reason"}]}. `recording`: sha256 of its
    MCAP in the artefact store."""

    __tablename__ = "robot_run"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), index=True)
    robot_id: Mapped[str | None] = mapped_column(ForeignKey("study_robot.id"), index=True)
    session_id: Mapped[str | None] = mapped_column(ForeignKey("session.id"), index=True)
    step_key: Mapped[str | None] = mapped_column(String(80))
    simulated: Mapped[bool] = mapped_column(Boolean, default=False, server_default=false())
    setup: Mapped[str] = mapped_column(String(60))
    goal: Mapped[list[Any]] = mapped_column(JSON)
    weights: Mapped[dict[str, Any]] = mapped_column(JSON)
    state: Mapped[str] = mapped_column(String(16), default="waiting")
    answers: Mapped[int] = mapped_column(Integer, default=0)
    asked_at: Mapped[datetime | None]
    started_by: Mapped[str | None] = mapped_column(String(80))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    started_at: Mapped[datetime | None]
    moved_at: Mapped[datetime | None]
    ended_at: Mapped[datetime | None]
    recording: Mapped[str | None] = mapped_column(String(64))
    summary: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    __table_args__ = (
        UniqueConstraint("session_id", "step_key"),
        CheckConstraint("state in ('waiting', 'started', 'over')", name="state"),
    )

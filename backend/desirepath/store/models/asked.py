"""What was asked in sessions, shown, drawn, answered and noticed. One row of `response` is one answer."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, Boolean, CheckConstraint, Float, ForeignKey, Integer, String, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from desirepath.store.models.base import Base, new_id, utc_now


class Trial(Base):
    """One thing asked of the participant. `kind`: query, comparison or evaluation. `role`: practice, regular, or a
    probe's: repeat, swap, transitivity (the last are the three pairs of three trajectories in one scene); further:
    asked on, where the answers before did not say enough. `block`: the
    block's stage, or the condition's name where the block is crossed over conditions. `probe_of`: the trial that a
    repeat or swap asks again. `sides_swapped`: the query's second trajectory is A (None in comparisons and in data of
    before). `replays`: pairs watched again.

    `hmd`: whether all that was watched was watched with a headset; None: not told (nothing watched, data of before).
    `headset`: by side, with what (shapes: study/wire.py, HeadsetUsed), None: in the window.

    `phase`: ready, playing_a, playing_b, choosing, answered. `arms` (comparison only) says which policy was A and B.
    Of an order `arms` is {"shown": ids of all that are shown, by number}, of which the first two are A and B.
    """

    __tablename__ = "trial"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    session_id: Mapped[str] = mapped_column(ForeignKey("session.id"), index=True)
    step_key: Mapped[str] = mapped_column(String(80))
    index: Mapped[int] = mapped_column(Integer)
    block: Mapped[str | None] = mapped_column(String(80))
    kind: Mapped[str] = mapped_column(String(20))
    role: Mapped[str] = mapped_column(String(20), default="regular")
    view: Mapped[str] = mapped_column(String(20))
    query_id: Mapped[str | None] = mapped_column(String(80))
    trajectory_a: Mapped[str] = mapped_column(ForeignKey("trajectory.id"))
    trajectory_b: Mapped[str] = mapped_column(ForeignKey("trajectory.id"))
    # comparison only: {"a": artefact id or "dwa", "b": as a, "own": "a"|"b", "look_alike": bool}; with another
    # participant's policy also "other": "a"|"b" and "lent": what is the same for equal policies, "stand_in": true for a
    # simulated person's; with the conditioned policy without preferences "neutral": "a"|"b", with the one by what
    # earlier participants want "population": "a"|"b" and "people": how many they are
    arms: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    phase: Mapped[str] = mapped_column(String(16), default="ready")
    phase_since: Mapped[datetime | None]
    a_seen_at: Mapped[datetime | None]
    b_seen_at: Mapped[datetime | None]
    restarts: Mapped[int] = mapped_column(Integer, default=0)
    replays: Mapped[int] = mapped_column(Integer, default=0, server_default="0")
    probe_of: Mapped[str | None] = mapped_column(String(32))
    sides_swapped: Mapped[bool | None] = mapped_column(Boolean)
    hmd: Mapped[bool | None] = mapped_column(Boolean)
    headset: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    __table_args__ = (
        UniqueConstraint("session_id", "step_key"),
        CheckConstraint("phase in ('ready', 'playing_a', 'playing_b', 'choosing', 'answered')", name="phase"),
    )

    @property
    def shown(self) -> list[str]:
        """All that it shows."""
        return list((self.arms or {}).get("shown") or (self.trajectory_a, self.trajectory_b))


class Response(Base):
    """One answer. One per step of a session, so one per trial, by constraint; never updated.

    `value` by kind: preference / comparison {"choice": "a"|"b"}, or {"timed_out": true} where the protocol's time for
    the choice was over; questionnaire {item: answer} (a ranking's answer is a list, best first), with "passed" where
    items are instructed; comprehension the same with "passed"; attention {"choice", "instructed", "passed"}; consent
    {"given": true, "version", "text_hash", "purposes"}; guess {"choice": "a"|"b"}; mark {"marks": [{"at_s", "why"}]}
    (`store/marks.py`). `consent_id`: the consent in force (a response's id); None before it.
    """

    __tablename__ = "response"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    session_id: Mapped[str] = mapped_column(ForeignKey("session.id"), index=True)
    trial_id: Mapped[str | None] = mapped_column(ForeignKey("trial.id"), unique=True)
    step_key: Mapped[str] = mapped_column(String(80))
    kind: Mapped[str] = mapped_column(String(20))
    value: Mapped[dict[str, Any]] = mapped_column(JSON)
    request_id: Mapped[str] = mapped_column(String(64), unique=True)
    client_time: Mapped[datetime | None]
    decision_s: Mapped[float | None] = mapped_column(Float)  # from the choice becoming possible to the answer
    consent_id: Mapped[str | None] = mapped_column(String(32))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    __table_args__ = (UniqueConstraint("session_id", "step_key"),)


class Event(Base):
    """Append-only log (triggers refuse update and delete, save the erasure path)."""

    __tablename__ = "event"
    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=True)
    at: Mapped[datetime] = mapped_column(default=utc_now, index=True)
    study_id: Mapped[str | None] = mapped_column(String(32), index=True)
    session_id: Mapped[str | None] = mapped_column(String(32), index=True)
    trial_id: Mapped[str | None] = mapped_column(String(32))
    kind: Mapped[str] = mapped_column(String(60))
    client_time: Mapped[datetime | None]
    data: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)


class TrajectoryRow(Base):
    """A stored trajectory: id is the sha256 of its NPZ bytes in the artefact store; the numbers are for listings."""

    __tablename__ = "trajectory"
    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    setup: Mapped[str] = mapped_column(String(60))
    scene_hash: Mapped[str] = mapped_column(String(64), index=True)
    steps: Mapped[int] = mapped_column(Integer)
    duration_s: Mapped[float] = mapped_column(Float)
    outcome: Mapped[int] = mapped_column(Integer)
    made_by: Mapped[str | None] = mapped_column(String(64))  # the policy's artefact id, or Recorded.maker
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class StrokeRow(Base):
    """One path that a participant drew, kept whatever came of it. One of a step is `kept` at most, by its response.

    `drawn`: {"points": [[x, y]...] m, "speeds": [...] m/s, "times_s": [...]}, never updated. `state`: refused (by
    `problem`), drawn (can be driven), watched, kept or redone. `demonstration`: sha256 of its file in the
    artefact store; where the participant walks beside the robot, there is one from their walk on.
    `walk`: how the person walked while the robot drove (shapes: strokes.py), None: they stood. Never updated.
    `hmd`: whether it was drawn with a headset, and watched as far as it was; None: not told (data of before).
    `headset`: of `drawn` and `watched`, with what, as a trial's of its sides.
    """

    __tablename__ = "stroke"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    session_id: Mapped[str] = mapped_column(ForeignKey("session.id"), index=True)
    step_key: Mapped[str] = mapped_column(String(80))
    attempt: Mapped[int] = mapped_column(Integer)  # counts from 1 within its step
    environment: Mapped[str] = mapped_column(String(40))
    pair: Mapped[int] = mapped_column(Integer)
    view: Mapped[str] = mapped_column(String(20))
    pointer: Mapped[str] = mapped_column(String(40))  # strokes.POINTERS, several joined by +
    hmd: Mapped[bool | None] = mapped_column(Boolean)
    headset: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    drawn: Mapped[dict[str, Any]] = mapped_column(JSON)
    state: Mapped[str] = mapped_column(String(16))
    # refused only: {"code", "message", "at": [x, y] | null, "thing": ... | null, and numbers with units in their names}
    problem: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    walk: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    demonstration: Mapped[str | None] = mapped_column(String(64))
    trajectory: Mapped[str | None] = mapped_column(ForeignKey("trajectory.id"))
    shown_since: Mapped[datetime | None]  # the robot drives it since then; None: not now
    watched_at: Mapped[datetime | None]
    request_id: Mapped[str] = mapped_column(String(64), unique=True)
    client_time: Mapped[datetime | None]
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    left_out_at: Mapped[datetime | None]  # an analyst does not want to learn from it
    left_out_by: Mapped[str | None] = mapped_column(String(80))
    left_out_reason: Mapped[str | None] = mapped_column(Text)
    __table_args__ = (
        UniqueConstraint("session_id", "step_key", "attempt"),
        CheckConstraint("state in ('refused', 'drawn', 'watched', 'kept', 'redone')", name="state"),
    )


class HeadPose(Base):
    """A few seconds of how a head moved in a headset, in the scene's frame; never updated (`store/head_poses.py`).

    wearing, part: the time for which the headset was on, by a name of the page's own, and the part's place in it, from
    0. began_s: seconds from putting it on to the part. Where something was playing: trial_id, side, showing (which one
    of that side, rising with restarts and replays), and playing_s: from the robot's first move to the part, negative
    before. recorded: {"times_s": [...] from 0, "poses": [[x, y, z m, qx, qy, qz, qw], ...]}, samples: how many.
    """

    __tablename__ = "head_pose"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    session_id: Mapped[str] = mapped_column(ForeignKey("session.id"), index=True)
    step_key: Mapped[str] = mapped_column(String(80))
    trial_id: Mapped[str | None] = mapped_column(ForeignKey("trial.id"))
    side: Mapped[str | None] = mapped_column(String(1))
    showing: Mapped[int | None] = mapped_column(Integer)
    wearing: Mapped[str] = mapped_column(String(32))
    part: Mapped[int] = mapped_column(Integer)
    began_s: Mapped[float] = mapped_column(Float)
    playing_s: Mapped[float | None] = mapped_column(Float)
    samples: Mapped[int] = mapped_column(Integer)
    recorded: Mapped[dict[str, Any]] = mapped_column(JSON)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    __table_args__ = (UniqueConstraint("session_id", "wearing", "part"),)


class ProblemReport(Base):
    """What a participant wrote by 'report a problem'."""

    __tablename__ = "problem_report"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    session_id: Mapped[str] = mapped_column(ForeignKey("session.id"), index=True)
    text: Mapped[str] = mapped_column(Text)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)

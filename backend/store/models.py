"""The tables. One row of `response` is one answer; nothing here knows the web or how studies run.

Times are UTC, timezone-aware. Ids are random UUID hex unless said otherwise. JSON columns hold plain data whose
shape is documented beside them and in docs/data-dictionary.md. After a change here draft the next revision:
`python -m backend.store.migrations "what changes"`; tests compare the newest revision with what stands here.
"""

from __future__ import annotations

import hashlib
import json
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    Boolean,
    CheckConstraint,
    DateTime,
    Float,
    ForeignKey,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Text,
    TypeDecorator,
    UniqueConstraint,
    false,
)
from sqlalchemy.engine import Dialect
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship


def new_id() -> str:
    return uuid.uuid4().hex


def utc_now() -> datetime:
    return datetime.now(UTC)


class UtcDateTime(TypeDecorator[datetime]):
    """Timezone-aware UTC in, timezone-aware UTC out, also on SQLite. Refuses naive datetimes."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        if value is not None and value.tzinfo is None:
            raise ValueError(f"naive datetime {value!r}; pass one with a timezone")
        return value.astimezone(UTC) if value else None

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        return value.replace(tzinfo=UTC) if value and value.tzinfo is None else value


class Base(DeclarativeBase):
    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(column_0_label)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {dict[str, Any]: JSON, list[Any]: JSON, datetime: UtcDateTime}


class User(Base):
    """Somebody who signs in. Participants never do. `role`: owner, experimenter, analyst or viewer; what each may do
    stands in `api/roles.py`."""

    __tablename__ = "user"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    name: Mapped[str] = mapped_column(String(80), unique=True)
    password_hash: Mapped[str] = mapped_column(Text)
    must_change_password: Mapped[bool] = mapped_column(Boolean, default=False)
    role: Mapped[str] = mapped_column(String(16), default="viewer", server_default="viewer")
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class Setting(Base):
    """Installation settings that are changed in the browser, e.g. `public_url`."""

    __tablename__ = "setting"
    key: Mapped[str] = mapped_column(String(80), primary_key=True)
    value: Mapped[dict[str, Any]] = mapped_column(JSON)


def protocol_digest(protocol_yaml: str, files: Mapping[str, Any]) -> str:
    """sha256 of a protocol and all texts it names: a study's `protocol_hash`."""
    return hashlib.sha256(
        json.dumps({"yaml": protocol_yaml, "files": dict(files)}, sort_keys=True).encode()
    ).hexdigest()


class Study(Base):
    """One run of a protocol with its own frozen copy. `files` maps every text the protocol names to its content;
    `protocol_hash` is the `protocol_digest` of YAML and files. `pilot`: who joins now is a pilot participant.
    `retain_until`: when the participants' data are to be erased; None where no date was promised."""

    __tablename__ = "study"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    name: Mapped[str] = mapped_column(String(200))
    protocol_name: Mapped[str] = mapped_column(String(120))
    protocol_version: Mapped[int] = mapped_column(Integer)
    protocol_yaml: Mapped[str] = mapped_column(Text)
    protocol: Mapped[dict[str, Any]] = mapped_column(JSON)
    files: Mapped[dict[str, Any]] = mapped_column(JSON)
    protocol_hash: Mapped[str] = mapped_column(String(64))
    state: Mapped[str] = mapped_column(String(16), default="open")
    recruiting_token: Mapped[str] = mapped_column(String(64), unique=True)
    seed: Mapped[int] = mapped_column(Integer)
    pilot: Mapped[bool] = mapped_column(Boolean, default=False, server_default=false())
    retain_until: Mapped[datetime | None]
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    created_by: Mapped[str | None] = mapped_column(ForeignKey("user.id"))
    __table_args__ = (CheckConstraint("state in ('open', 'closed')", name="state"),)


class ProtocolVersion(Base):
    """A later protocol of a running study, frozen like the study's own, which is number 1. `changes`: what differs from
    the one before, as `study/revising.py` says it. Sessions name theirs in `protocol_number`."""

    __tablename__ = "protocol_version"
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), primary_key=True)
    number: Mapped[int] = mapped_column(Integer, primary_key=True)
    protocol_version: Mapped[int] = mapped_column(Integer)
    protocol_yaml: Mapped[str] = mapped_column(Text)
    protocol: Mapped[dict[str, Any]] = mapped_column(JSON)
    files: Mapped[dict[str, Any]] = mapped_column(JSON)
    protocol_hash: Mapped[str] = mapped_column(String(64))
    changes: Mapped[list[Any]] = mapped_column(JSON)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    created_by: Mapped[str | None] = mapped_column(String(80))


class Participant(Base):
    """A pseudonymous code in one study. `simulated` and `pilot` are set at creation and cannot be changed (triggers).

    `consents`: what was agreed to beside the study itself, {"training": bool, "open_data": bool}; a purpose that was
    not asked about is missing; None before the consent.
    """

    __tablename__ = "participant"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), index=True)
    code: Mapped[str] = mapped_column(String(16))
    simulated: Mapped[bool] = mapped_column(Boolean, default=False)
    oracle: Mapped[dict[str, Any] | None] = mapped_column(JSON)  # simulated only: name, noise, seed
    pilot: Mapped[bool] = mapped_column(Boolean, default=False, server_default=false())  # joined while it was a pilot
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    withdrawn_at: Mapped[datetime | None]
    excluded_at: Mapped[datetime | None]
    excluded_reason: Mapped[str | None] = mapped_column(Text)
    excluded_by: Mapped[str | None] = mapped_column(String(80))
    consents: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    __table_args__ = (UniqueConstraint("study_id", "code"),)
    sessions: Mapped[list[Session]] = relationship(back_populates="participant")


class RecruitingId(Base):
    """What a recruiting platform calls a participant; never exported, never logged, never beside the answers."""

    __tablename__ = "recruiting_id"
    participant_id: Mapped[str] = mapped_column(ForeignKey("participant.id"), primary_key=True)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), index=True)
    platform: Mapped[str] = mapped_column(String(40))
    external_id: Mapped[str] = mapped_column(String(200))
    details: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)
    __table_args__ = (UniqueConstraint("study_id", "platform", "external_id"),)


class Session(Base):
    """One appointment. `plan` is the immutable seeded list of steps; `position` is the index of the current one.

    The link's token is stored as sha256 only. States: active, paused, completed, withdrawn, expired, screened_out.
    `assignment`: the place in the counterbalancing, the same in all appointments of a participant: {"scheme", "row"
    (None where drawn by lot), "rows", "order": [condition, ...], "blocks": {stage: [condition, ...]}, "design": digest
    of the rows}. `ended_because` (screened_out only): comprehension or quota.
    """

    __tablename__ = "session"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    participant_id: Mapped[str] = mapped_column(ForeignKey("participant.id"), index=True)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), index=True)
    token_hash: Mapped[str] = mapped_column(String(64), unique=True)
    state: Mapped[str] = mapped_column(String(16), default="active")
    language: Mapped[str] = mapped_column(String(8), default="en")
    simulated: Mapped[bool] = mapped_column(Boolean, default=False)
    seed: Mapped[int] = mapped_column(Integer)
    plan: Mapped[list[Any]] = mapped_column(JSON)
    position: Mapped[int] = mapped_column(Integer, default=0)
    device: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)
    completion_code: Mapped[str | None] = mapped_column(String(40))
    personalisation: Mapped[str | None] = mapped_column(String(40))  # why a comparison was or was not shown
    assignment: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    appointment: Mapped[int] = mapped_column(Integer, default=1, server_default="1")
    protocol_number: Mapped[int] = mapped_column(Integer, default=1, server_default="1")
    ended_because: Mapped[str | None] = mapped_column(String(80))
    opens_at: Mapped[datetime | None]  # a later appointment cannot be entered before
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    last_seen_at: Mapped[datetime | None]
    expires_at: Mapped[datetime]
    participant: Mapped[Participant] = relationship(back_populates="sessions")
    __table_args__ = (
        CheckConstraint(
            "state in ('active', 'paused', 'completed', 'withdrawn', 'expired', 'screened_out')", name="state"
        ),
    )


class Trial(Base):
    """One thing asked of the participant. `kind`: query or comparison. `role`: learning, regular, or a probe's: repeat,
    swap, transitivity (the last are the three pairs of three drives in one scene). `block`: the block's stage, or the
    condition's name where the block is crossed over conditions. `probe_of`: the trial that a repeat or swap asks again.
    `turned`: the query's second drive is A (None in comparisons and in data of before). `replays`: pairs watched again.

    `phase`: ready, playing_a, playing_b, choosing, answered. `arms` (comparison only) says which policy was A and B.
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
    # participant's policy also "other": "a"|"b"
    arms: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    phase: Mapped[str] = mapped_column(String(16), default="ready")
    phase_since: Mapped[datetime | None]
    a_seen_at: Mapped[datetime | None]
    b_seen_at: Mapped[datetime | None]
    restarts: Mapped[int] = mapped_column(Integer, default=0)
    replays: Mapped[int] = mapped_column(Integer, default=0, server_default="0")
    probe_of: Mapped[str | None] = mapped_column(String(32))
    turned: Mapped[bool | None] = mapped_column(Boolean)
    __table_args__ = (
        UniqueConstraint("session_id", "step_key"),
        CheckConstraint("phase in ('ready', 'playing_a', 'playing_b', 'choosing', 'answered')", name="phase"),
    )


MARKS = ("timed_out", "passed")  # in a questionnaire's value beside the items' answers


class Response(Base):
    """One answer. One per step of a session, so one per trial, by constraint; never updated.

    `value` by kind: preference / comparison {"choice": "a"|"b"}, or {"timed_out": true} where the protocol's time for
    the choice was over; questionnaire {item: answer} (a ranking's answer is a list, best first), with "passed" where
    items are instructed; comprehension the same with "passed"; attention {"choice", "instructed", "passed"}; consent
    {"given": true, "version", "text_hash", "purposes"}; guess {"choice": "a"|"b"}. `consent_id`: the consent in force
    (a response's id); None before it.
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
    setup: Mapped[str] = mapped_column(String(40))
    scene_hash: Mapped[str] = mapped_column(String(64), index=True)
    steps: Mapped[int] = mapped_column(Integer)
    duration_s: Mapped[float] = mapped_column(Float)
    outcome: Mapped[int] = mapped_column(Integer)
    made_by: Mapped[str | None] = mapped_column(String(64))  # artefact id of the policy, where there is one
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class StrokeRow(Base):
    """One path that a participant drew, kept whatever came of it. One of a step is `kept` at most, by its response.

    `drawn`: {"points": [[x, y]...] m, "speeds": [...] m/s, "times_s": [...]}, never updated. `state`: refused (by
    `problem`), drawn (can be driven), watched, kept or redone. `demonstration`: sha256 of its file in the
    artefact store; where the participant walks beside the drive, there is one from their walk on.
    `walk`: how the person walked while the robot drove (shapes: strokes.py), None: they stood. Never updated.
    """

    __tablename__ = "stroke"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    session_id: Mapped[str] = mapped_column(ForeignKey("session.id"), index=True)
    step_key: Mapped[str] = mapped_column(String(80))
    attempt: Mapped[int] = mapped_column(Integer)  # counts from 1 within its step
    environment: Mapped[str] = mapped_column(String(40))
    pair: Mapped[int] = mapped_column(Integer)
    view: Mapped[str] = mapped_column(String(20))
    pointer: Mapped[str] = mapped_column(String(40))  # mouse, touch, pen, keys, bot, or several joined by +
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


class Artefact(Base):
    """A learned or collected thing with its card; id is the sha256 of its content in the artefact store.

    `kind`: policy, conditioned_policy, reward_model, query_set, snapshot, demonstrations, evaluation. `card` as
    datasets/README.md describes.
    """

    __tablename__ = "artefact"
    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    kind: Mapped[str] = mapped_column(String(20), index=True)
    name: Mapped[str] = mapped_column(String(160))
    setup: Mapped[str] = mapped_column(String(40))
    card: Mapped[dict[str, Any]] = mapped_column(JSON)
    study_id: Mapped[str | None] = mapped_column(ForeignKey("study.id"), index=True)
    job_id: Mapped[str | None] = mapped_column(String(32), index=True)
    simulated: Mapped[bool] = mapped_column(Boolean, default=False)  # made from simulated answers
    quarantined_at: Mapped[datetime | None]
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
    __table_args__ = (
        CheckConstraint(
            "state in ('queued', 'running', 'cancelling', 'succeeded', 'failed', 'cancelled')", name="state"
        ),
    )


class JobMetric(Base):
    """One point of a live curve."""

    __tablename__ = "job_metric"
    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=True)
    job_id: Mapped[str] = mapped_column(ForeignKey("job.id"), index=True)
    step: Mapped[int] = mapped_column(Integer)
    name: Mapped[str] = mapped_column(String(60))
    value: Mapped[float] = mapped_column(Float)


class ProblemReport(Base):
    """What a participant wrote by 'report a problem'."""

    __tablename__ = "problem_report"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    session_id: Mapped[str] = mapped_column(ForeignKey("session.id"), index=True)
    text: Mapped[str] = mapped_column(Text)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class Note(Base):
    """What somebody who runs the study wrote about a participant, or about one session of theirs."""

    __tablename__ = "note"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    participant_id: Mapped[str] = mapped_column(ForeignKey("participant.id"), index=True)
    session_id: Mapped[str | None] = mapped_column(ForeignKey("session.id"), index=True)
    text: Mapped[str] = mapped_column(Text)
    written_by: Mapped[str] = mapped_column(String(80))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class Audit(Base):
    """Who of those who sign in did what, and when. Append-only (triggers), save that an erasure takes the entries about
    the participant. `outcome`: done, or refused by the role. `data`: plain JSON without content of answers."""

    __tablename__ = "audit"
    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=True)
    at: Mapped[datetime] = mapped_column(default=utc_now, index=True)
    by: Mapped[str] = mapped_column(String(80))
    role: Mapped[str | None] = mapped_column(String(16))  # None: on the command line
    action: Mapped[str] = mapped_column(String(60), index=True)
    outcome: Mapped[str] = mapped_column(String(16), default="done")
    study_id: Mapped[str | None] = mapped_column(String(32), index=True)
    participant_id: Mapped[str | None] = mapped_column(String(32), index=True)
    data: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)


class Tombstone(Base):
    """What is left of an erased participant: that somebody was erased, when, by whom; no content."""

    __tablename__ = "tombstone"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), index=True)
    erased_at: Mapped[datetime] = mapped_column(default=utc_now)
    erased_by: Mapped[str] = mapped_column(String(80))
    counts: Mapped[dict[str, Any]] = mapped_column(JSON)


class Erasing(Base):
    """The key to the one way around the triggers: lives only inside an erasure's transaction, never committed."""

    __tablename__ = "erasing"
    participant_id: Mapped[str] = mapped_column(ForeignKey("participant.id"), primary_key=True)


class SignIn(Base):
    """A signed-in browser of a user; the cookie's token is stored as sha256 only."""

    __tablename__ = "sign_in"
    token_hash: Mapped[bytes] = mapped_column(LargeBinary(32), primary_key=True)
    user_id: Mapped[str] = mapped_column(ForeignKey("user.id"))
    csrf: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    expires_at: Mapped[datetime]

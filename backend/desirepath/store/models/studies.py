"""Studies, their protocols, who takes part and in which sessions. What was asked and answered is `asked.py`'s."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import JSON, Boolean, CheckConstraint, ForeignKey, Integer, String, Text, UniqueConstraint, false
from sqlalchemy.orm import Mapped, mapped_column, relationship

from desirepath.store.models.base import Base, new_id, utc_now


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
    step_since: Mapped[datetime | None]  # when the step was reached; None: nobody has come to this appointment yet
    device: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)
    completion_code: Mapped[str | None] = mapped_column(String(40))
    personalisation: Mapped[str | None] = mapped_column(String(40))  # why a comparison was or was not shown
    predictive_check: Mapped[dict[str, Any] | None] = mapped_column(JSON)  # whether answers look like what is believed
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

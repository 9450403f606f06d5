"""Who runs studies: accounts, settings, notes, the audit log. Participants are `studies.py`'s."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, Boolean, ForeignKey, Integer, LargeBinary, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from backend.store.models.base import Base, new_id, utc_now


class User(Base):
    """Somebody who signs in. Participants never do. `role` holds in every study (`member`: in none); what each role may
    do stands in `api/core/roles.py`."""

    __tablename__ = "user"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    name: Mapped[str] = mapped_column(String(80), unique=True)
    password_hash: Mapped[str] = mapped_column(Text)
    must_change_password: Mapped[bool] = mapped_column(Boolean, default=False)
    role: Mapped[str] = mapped_column(String(16), default="viewer", server_default="viewer")
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class StudyRole(Base):
    """A role that somebody has in one study. Several add up, also with the role of the installation."""

    __tablename__ = "study_role"
    user_id: Mapped[str] = mapped_column(ForeignKey("user.id"), primary_key=True)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), primary_key=True, index=True)
    role: Mapped[str] = mapped_column(String(16), primary_key=True)
    given_by: Mapped[str] = mapped_column(String(80))
    given_at: Mapped[datetime] = mapped_column(default=utc_now)


class SignIn(Base):
    """A signed-in browser of a user; the cookie's token is stored as sha256 only."""

    __tablename__ = "sign_in"
    token_hash: Mapped[bytes] = mapped_column(LargeBinary(32), primary_key=True)
    user_id: Mapped[str] = mapped_column(ForeignKey("user.id"))
    csrf: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    expires_at: Mapped[datetime]


class Setting(Base):
    """Installation settings that are changed in the browser, e.g. `public_url`."""

    __tablename__ = "setting"
    key: Mapped[str] = mapped_column(String(80), primary_key=True)
    value: Mapped[dict[str, Any]] = mapped_column(JSON)


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

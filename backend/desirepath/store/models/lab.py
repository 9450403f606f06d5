"""Who runs studies: accounts, settings, notes, the audit log. Participants are `studies.py`'s."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, BigInteger, Boolean, ForeignKey, Integer, LargeBinary, String, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from desirepath.store.models.base import Base, new_id, utc_now


class User(Base):
    """Somebody who signs in. Participants never do. `role` holds in every study (`member`: in none); what each role may
    do stands in `web/core/roles.py`."""

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
    """A signed-in browser of a user; the cookie's token is stored as sha256 only. `address`, `browser`: for the user's
    own list of them; `method`: password, or openid."""

    __tablename__ = "sign_in"
    token_hash: Mapped[bytes] = mapped_column(LargeBinary(32), primary_key=True)
    user_id: Mapped[str] = mapped_column(ForeignKey("user.id"))
    csrf: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    expires_at: Mapped[datetime]
    # None where a server from before these columns wrote the row.
    seen_at: Mapped[datetime | None]
    address: Mapped[str | None] = mapped_column(String(64))
    browser: Mapped[str | None] = mapped_column(String(40))
    method: Mapped[str] = mapped_column(String(16), default="password", server_default="password")


class SignInUnderWay(Base):
    """A sign-in that needs another step: `purpose` code (second factor) or openid. Bound to a browser by a cookie whose
    sha256 stands here. `data`: where to go on, and what the other step is checked against."""

    __tablename__ = "sign_in_under_way"
    token_hash: Mapped[bytes] = mapped_column(LargeBinary(32), primary_key=True)
    purpose: Mapped[str] = mapped_column(String(16))
    user_id: Mapped[str | None] = mapped_column(ForeignKey("user.id"), index=True)
    data: Mapped[dict[str, Any]] = mapped_column(JSON)
    expires_at: Mapped[datetime]


class SecondFactor(Base):
    """The secret of a user's authenticator app. Counts from its first right code on (`confirmed_at`); `last_step`: of
    the clock, whose code was used last, so that none is used twice."""

    __tablename__ = "second_factor"
    user_id: Mapped[str] = mapped_column(ForeignKey("user.id"), primary_key=True)
    secret: Mapped[str] = mapped_column(String(64))
    last_step: Mapped[int | None] = mapped_column(BigInteger)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    confirmed_at: Mapped[datetime | None]


class RecoveryCode(Base):
    """A code that opens once in the app's place, as sha256."""

    __tablename__ = "recovery_code"
    code_hash: Mapped[bytes] = mapped_column(LargeBinary(32), primary_key=True)
    user_id: Mapped[str] = mapped_column(ForeignKey("user.id"), index=True)
    used_at: Mapped[datetime | None]


class Identity(Base):
    """Somebody at an OpenID provider (issuer and subject), for whom an account opens. `email`: as it was when linked,
    for the account's own page; nothing is decided by it."""

    __tablename__ = "identity"
    __table_args__ = (UniqueConstraint("issuer", "subject"),)
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    user_id: Mapped[str] = mapped_column(ForeignKey("user.id"), index=True)
    issuer: Mapped[str] = mapped_column(String(300))
    subject: Mapped[str] = mapped_column(String(255))
    email: Mapped[str] = mapped_column(String(254), default="")
    linked_at: Mapped[datetime] = mapped_column(default=utc_now)


class Invitation(Base):
    """Whoever proves this address at the OpenID provider gets an account with this role, once."""

    __tablename__ = "invitation"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    email: Mapped[str] = mapped_column(String(254), unique=True)
    role: Mapped[str] = mapped_column(String(16))
    invited_by: Mapped[str] = mapped_column(String(80))
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

"""How the lab reads what participants wrote in their own words: its codebook, and the codes of each answer."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, CheckConstraint, ForeignKey, String, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from desirepath.store.models.base import Base, new_id, utc_now


class CodebookCode(Base):
    """One code of the codebook of an open question (`item`: its key in the questionnaire) of a study."""

    __tablename__ = "codebook_code"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), index=True)
    item: Mapped[str] = mapped_column(String(80))
    name: Mapped[str] = mapped_column(String(60))
    definition: Mapped[str] = mapped_column(Text)
    written_by: Mapped[str] = mapped_column(String(80))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    __table_args__ = (UniqueConstraint("study_id", "item", "name"),)


class Coding(Base):
    """The codes that one answer got. `role`: first and second are the two coders, each blind to the other and to the
    condition; agreed is what they settled on where they differed. `codes`: ids of codes, none where none fits."""

    __tablename__ = "coding"
    id: Mapped[str] = mapped_column(String(32), primary_key=True, default=new_id)
    study_id: Mapped[str] = mapped_column(ForeignKey("study.id"), index=True)
    response_id: Mapped[str] = mapped_column(ForeignKey("response.id"), index=True)
    item: Mapped[str] = mapped_column(String(80))
    role: Mapped[str] = mapped_column(String(10))
    coder: Mapped[str] = mapped_column(String(80))
    codes: Mapped[list[Any]] = mapped_column(JSON)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    __table_args__ = (
        UniqueConstraint("response_id", "item", "role"),
        CheckConstraint("role in ('first', 'second', 'agreed')", name="role"),
    )

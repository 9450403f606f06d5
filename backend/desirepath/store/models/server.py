"""What several server processes of one installation share while they run. Nothing of it is anybody's data."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import BigInteger, Float, Integer, String
from sqlalchemy.orm import Mapped, mapped_column

from desirepath.store.models.base import Base


class ServerProcess(Base):
    """A server process that lives. `address`: host and port at which the others reach its inner door."""

    __tablename__ = "server_process"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    address: Mapped[str] = mapped_column(String(200))
    started_at: Mapped[datetime]
    seen_at: Mapped[datetime]


class WorkerProcess(Base):
    """A background worker that lives, on whichever machine. `id` is the same after a restart in its data folder."""

    __tablename__ = "worker_process"
    id: Mapped[str] = mapped_column(String(120), primary_key=True)
    machine: Mapped[str] = mapped_column(String(80))
    trainings: Mapped[int] = mapped_column(Integer)  # at once
    started_at: Mapped[datetime]
    seen_at: Mapped[datetime]


class RateWindow(Base):
    """How often something was asked for, in this window of time and in the one before. The key as sha256 only."""

    __tablename__ = "rate_window"
    key_hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    window_number: Mapped[int] = mapped_column(BigInteger)
    current: Mapped[int] = mapped_column(Integer)
    previous: Mapped[int] = mapped_column(Integer)
    expires_at: Mapped[float] = mapped_column(Float, index=True)  # seconds since 1970

"""Which row holds the protocol of a session: the study's own, or that of a later version. Reads no protocol."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import ProtocolVersion, Session, Study

FIRST = 1  # number of the study's own protocol


def protocol_row(s: DatabaseSession, study: Study, number: int) -> Study | ProtocolVersion:
    """The row that holds that protocol of the study."""
    return study if number == FIRST else s.get_one(ProtocolVersion, (study.id, number))


def row_of(s: DatabaseSession, session: Session) -> Study | ProtocolVersion:
    """The row that holds the protocol of a session, with `protocol["materials"]`."""
    return protocol_row(s, s.get_one(Study, session.study_id), session.protocol_number)


def newest_number(s: DatabaseSession, study: Study) -> int:
    """Number of the newest protocol, 1 where there is only the study's own."""
    numbers = select(ProtocolVersion.number).where(ProtocolVersion.study_id == study.id)
    return s.scalars(numbers.order_by(ProtocolVersion.number.desc()).limit(1)).first() or FIRST

"""The protocol a session runs on, read. Which row holds it: `protocol_rows.py`; new versions: `revising.py`."""

from __future__ import annotations

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Session, Study
from desirepath.study.protocol.freezing import FrozenProtocol, thaw
from desirepath.study.protocol_rows import newest_number, protocol_row, row_of


def protocol_of(s: DatabaseSession, session: Session) -> FrozenProtocol:
    """The protocol that a session runs on; it never changes under way. Looked up once in a transaction."""
    known: dict[tuple[str, int], FrozenProtocol] = s.info.setdefault("protocols", {})
    key = (session.study_id, session.protocol_number)
    if key not in known:
        known[key] = thaw(row_of(s, session))
    return known[key]


def newest_protocol(s: DatabaseSession, study: Study) -> tuple[int, FrozenProtocol]:
    """Number and content of the protocol that whoever joins now gets."""
    number = newest_number(s, study)
    return number, thaw(protocol_row(s, study, number))

"""How long the data of a study are kept: the day that was promised, whether it is over, and the erasing of what is due.

Nothing is erased by itself: somebody has to ask for it (`desirepath studies erase-overdue`).
"""

from __future__ import annotations

from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Any

from sqlalchemy import select

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.audit import record
from desirepath.store.database import Database
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Participant, Study


class RetentionError(ValueError):
    """Nothing was erased: the date is not over, or there is none."""


def check_day(text: str, now: datetime) -> datetime | None:
    """The end of a day (UTC) as 2027-03-31; None for an empty text. Raises ValueError for what is no day or over."""
    if not text:
        return None
    end = datetime.combine(date.fromisoformat(text), time(23, 59, 59), UTC)
    if end < now:
        raise ValueError(text)
    return end


def is_overdue(study: Study, now: datetime) -> bool:
    """Whether the study's data were to be erased by now."""
    return study.retain_until is not None and study.retain_until < now


def erase_overdue(
    db: Database, files: ArtefactStore, study_id: str, by: str, *, now: datetime, data: Path
) -> dict[str, Any]:
    """Erase every participant of a study whose date is over, as `erase_participant` does it for one.

    Returns {"study", "erased", "compacted"}. An erasure that is cut short can be repeated. Raises LookupError for an
    unknown study, RetentionError if its date is not over.
    """
    with db.session() as s:
        study = s.get(Study, study_id)
        if study is None:
            raise LookupError(f"no study with id {study_id!r}; `desirepath studies list` shows them")
        if not is_overdue(study, now):
            until = f"until {study.retain_until:%Y-%m-%d}" if study.retain_until else "without a date"
            raise RetentionError(f"study {study.name!r} is kept {until}; nothing is due, and nothing was erased")
        people = list(s.scalars(select(Participant.id).where(Participant.study_id == study_id)))
    compacted = True
    for number, participant_id in enumerate(people, 1):
        last = number == len(people)
        compacted = erase_participant(db, files, participant_id, by, data=data, compact=last)["compacted"]
    with db.transaction() as s:
        record(s, "overdue_erased", by=by, study_id=study_id, participants=len(people))
    return {"study": study_id, "erased": len(people), "compacted": compacted}

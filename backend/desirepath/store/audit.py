"""The audit log: who of those who sign in did what, and when. What participants do is in `events.py`."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.store.events import check_keys
from desirepath.store.models import Artefact, Audit, Job, Participant
from desirepath.store.models import Session as SessionRow


def record(
    s: Session,
    action: str,
    *,
    by: str,
    role: str | None = None,
    outcome: str = "done",
    study_id: str | None = None,
    code: str | None = None,
    job_id: str | None = None,
    **data: Any,
) -> None:
    """Add one entry to the transaction.

    role: None on the command line. outcome: done or refused. code: a participant's, kept as their id only, so that an
    erasure finds the entry; likewise the participant for whom job_id runs, and the study of the job or of the artefact
    whose id stands in data as artefact_id. data: plain JSON without content of answers.
    Raises ValueError if a key names something that must not be logged.
    """
    check_keys(action, data)
    whose = None
    if code is not None:
        whose = select(Participant.id).where(Participant.study_id == study_id, Participant.code == code)
    elif job_id is not None:
        whose = select(SessionRow.participant_id).join(Job, Job.session_id == SessionRow.id).where(Job.id == job_id)
        study_id = study_id or s.scalar(select(Job.study_id).where(Job.id == job_id))
        data["job"] = job_id
    elif study_id is None and "artefact_id" in data:
        study_id = s.scalar(select(Artefact.study_id).where(Artefact.id == data["artefact_id"]))
    s.add(
        Audit(
            action=action,
            by=by,
            role=role,
            outcome=outcome,
            study_id=study_id,
            participant_id=s.scalar(whose) if whose is not None else None,
            data=data,
        )
    )

"""The audit log as a page: who did what, and when. What writes it is `auditing.py`."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request
from sqlalchemy import select
from starlette.responses import Response

from desirepath.store.models import Audit, Participant, Study
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.dependencies import Db
from desirepath.web.core.lab_frame import lab_page
from desirepath.web.lab.study_rows import find_page

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["settings"])


@router.get("/lab/audit")
def audit(
    request: Request, database: Db, by: str = "", action: str = "", study: str = "", code: str = "", page: int = 1
) -> Response:
    """Newest first; a filter that is empty means any."""
    query = (
        select(Audit, Study.name, Participant.code)
        .outerjoin(Study, Study.id == Audit.study_id)
        .outerjoin(Participant, Participant.id == Audit.participant_id)
    )
    where = {"by": by, "action": action, "study": study, "code": code}
    columns = {"by": Audit.by, "action": Audit.action, "study": Audit.study_id, "code": Participant.code}
    for name, value in where.items():
        if value:
            query = query.where(columns[name] == value)
    with database.session() as s:
        return lab_page(
            request,
            "lab/audit.html",
            listed=find_page(s, query.order_by(Audit.id.desc()), page),
            where=where,
            people=list(s.scalars(select(Audit.by).distinct().order_by(Audit.by))),
            actions=list(s.scalars(select(Audit.action).distinct().order_by(Audit.action))),
        )

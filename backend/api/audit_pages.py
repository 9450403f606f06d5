"""The audit log as a page: who did what, and when. What writes it is `auditing.py`."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request
from sqlalchemy import func, select
from starlette.responses import Response

from backend.api.auth import checked_csrf
from backend.api.dependencies import Db
from backend.api.lab import lab_page
from backend.api.study_rows import ROWS_PER_PAGE, Page, page_of
from backend.store.models import Audit, Participant, Study

router = APIRouter(dependencies=[Depends(checked_csrf)], tags=["settings"])


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
        total = s.scalar(select(func.count()).select_from(query.subquery())) or 0
        page, pages = page_of(page, total)
        rows = s.execute(query.order_by(Audit.id.desc()).offset((page - 1) * ROWS_PER_PAGE).limit(ROWS_PER_PAGE)).all()
        return lab_page(
            request,
            "lab/audit.html",
            listed=Page(rows, total, page, pages),
            where=where,
            people=list(s.scalars(select(Audit.by).distinct().order_by(Audit.by))),
            actions=list(s.scalars(select(Audit.action).distinct().order_by(Audit.action))),
        )

"""Tidying up: an artefact's other name, the archive, deleting it, with what hangs on it said first.

What may go and what must stay is decided in `store/artefact_upkeep.py`.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.store.artefact_upkeep import (
    LONGEST_NAME,
    archive_artefact,
    delete_artefact,
    rename_artefact,
    restore_artefact,
    uses_of,
)
from desirepath.store.artefacts import ArtefactError, lineage
from desirepath.store.models import Artefact, utc_now
from desirepath.web.analyst.artefact_pages import artefact_href
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Files
from desirepath.web.core.lab_frame import LabRefusal, lab_page, rights_in
from desirepath.web.core.permits import may_with
from desirepath.web.core.roles import Right

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])


@router.get("/lab/artefacts/{artefact_id}/upkeep")
def upkeep(request: Request, artefact_id: str, database: Db) -> Response:
    """What it was made from, what hangs on it, and what may be done with it."""
    with database.session() as s:
        return _page(request, s, artefact_id)


@router.post("/lab/artefacts/{artefact_id}/rename")
def rename(
    request: Request, artefact_id: str, database: Db, user: CheckedCsrf, name: Annotated[str, Form()] = ""
) -> Response:
    with database.transaction() as s:
        before = _artefact(s, artefact_id).name
        try:
            renamed = rename_artefact(s, artefact_id, name)
        except ArtefactError:
            return _page(request, s, artefact_id, status=422, problem="name", typed=name)
        audit_details(request, before=before, after=renamed.name)
        return RedirectResponse(artefact_href(renamed), status_code=303)


@router.post("/lab/artefacts/{artefact_id}/archive")
def archive(artefact_id: str, database: Db, user: CheckedCsrf) -> Response:
    with database.transaction() as s:
        _artefact(s, artefact_id)
        archived = archive_artefact(s, artefact_id, by=user.name, now=utc_now())
        return RedirectResponse(f"/lab/artefacts/{archived.id}/upkeep", status_code=303)


@router.post("/lab/artefacts/{artefact_id}/restore")
def restore(artefact_id: str, database: Db, user: CheckedCsrf) -> Response:
    with database.transaction() as s:
        _artefact(s, artefact_id)
        restored = restore_artefact(s, artefact_id)
        return RedirectResponse(f"/lab/artefacts/{restored.id}/upkeep", status_code=303)


@router.post("/lab/artefacts/{artefact_id}/delete")
def delete(
    request: Request,
    artefact_id: str,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    typed: Annotated[str, Form()] = "",
) -> Response:
    """Delete it, once its name was typed; 409 where something hangs on it."""
    with database.transaction() as s:
        found = _artefact(s, artefact_id)
        if typed.strip() != found.name.strip():
            return _page(request, s, artefact_id, status=422, problem="typed")
        try:
            gone = delete_artefact(s, files, artefact_id)
        except ArtefactError:
            return _page(request, s, artefact_id, status=409, problem="needed")
    audit_details(request, kind=gone.kind, name=gone.name, study_id=gone.study_id)
    back = {"snapshot": "/lab/snapshots", "evaluation": "/lab/compare"}.get(gone.kind, f"/lab/policies#{gone.kind}")
    return RedirectResponse(back, status_code=303)


def _artefact(s: DatabaseSession, artefact_id: str) -> Artefact:
    found = s.get(Artefact, artefact_id)
    if found is None:
        raise LabRefusal(404, "no_artefact")
    return found


def _page(
    request: Request,
    s: DatabaseSession,
    artefact_id: str,
    *,
    status: int = 200,
    problem: str | None = None,
    typed: str | None = None,
) -> Response:
    found = _artefact(s, artefact_id)
    uses = uses_of(s, artefact_id)
    return lab_page(
        request,
        "analyst/upkeep.html",
        status=status,
        artefact=found,
        href=artefact_href(found),
        tree=lineage(s, artefact_id),
        uses=uses,
        made=[made for made in uses.made if may_with(s, rights_in(request), Right.LOOK, made)],
        stays=bool(uses.against_deleting()),
        problem=problem,
        typed=found.name if typed is None else typed,
        longest=LONGEST_NAME,
    )

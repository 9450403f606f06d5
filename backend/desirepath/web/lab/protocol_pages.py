"""A study's protocol in the browser: reading it, comparing its versions, giving a running study a new one.

What a change means is `study/revising.py`'s, drafts are `drafts.py`'s; making a new study lives in `new_study.py`.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

from fastapi import APIRouter, Depends, File, Form, Request, UploadFile
from starlette.responses import PlainTextResponse, RedirectResponse, Response

from desirepath.store.payment_codes import REMOVED, is_payment_code, yaml_without
from desirepath.study.protocol.freezing import ProtocolError, thaw
from desirepath.study.protocol.outline import describe_stages, estimate_minutes
from desirepath.study.protocol_rows import protocol_row
from desirepath.study.revising import query_sets_for, revise_study, revision_of, versions_of
from desirepath.study.session.versions import newest_protocol
from desirepath.study.studies import StudyError
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Files, TheServices
from desirepath.web.core.roles import Right
from desirepath.web.lab import drafts
from desirepath.web.lab.drafts import Draft, DraftError, decode_upload
from desirepath.web.lab.new_study import TheDraft, keep_edits, read_texts, read_upload
from desirepath.web.lab.preview import first_steps
from desirepath.web.lab.study_tabs import study_tab, the_study

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])
VEIL = "•••"
_VERSION = re.compile(r"""^(version:[ \t]*)(["']?)\d+\2""", re.MULTILINE)


@router.get("/lab/studies/{study_id}/protocol")
def protocol(request: Request, study_id: str, database: Db, number: int = 0) -> Response:
    """The study's newest protocol, or the one of that number, with the list of all."""
    with database.session() as s:
        study = the_study(s, study_id)
        versions = versions_of(s, study)
        shown = next((line.number for line in versions if line.number == number), versions[-1].number)
        row = protocol_row(s, study, shown)
        frozen = thaw(row)
        taking = request.state.sign_in.may(Right.TAKE, study.id)
        return study_tab(
            request,
            study,
            "protocol",
            frozen=frozen,
            stages=describe_stages(row.protocol, row.files),
            first_steps=first_steps(frozen),
            versions=versions,
            shown=shown,
            yaml=frozen.yaml if taking else yaml_without(frozen.yaml, dict.fromkeys(REMOVED, VEIL)),
            veiled=None if taking else _veiled,
        )


def _veiled(field: str, value: object) -> str:
    """A field of the protocol as who takes no data sees it: completion codes and ways back are worth money."""
    return VEIL if is_payment_code(field, value) else str(value)


@router.get("/lab/studies/{study_id}/protocol.yaml")
def protocol_file(study_id: str, database: Db, number: int = 0) -> Response:
    """The study's frozen copy, the newest or that number's, byte for byte."""
    with database.session() as s:
        study = the_study(s, study_id)
        numbers = [line.number for line in versions_of(s, study)]
        return PlainTextResponse(
            protocol_row(s, study, number if number in numbers else numbers[-1]).protocol_yaml,
            media_type="application/yaml",
            headers={"Content-Disposition": f'attachment; filename="{study.protocol_name}.yaml"'},
        )


# ---- a new version for a running study -------------------------------------------------------------------------------


@router.get("/lab/studies/{study_id}/revise")
def choose_change(request: Request, study_id: str, database: Db) -> Response:
    """How the change is made: by editing the newest protocol here, or with files."""
    return _choose_page(request, study_id, database)


def _choose_page(request: Request, study_id: str, database: Db, problem: DraftError | None = None) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return study_tab(
            request,
            study,
            "protocol",
            "lab/revise_choose.html",
            status=422 if problem else 200,
            files=sorted(newest_protocol(s, study)[1].files),
            problem=problem,
        )


@router.post("/lab/studies/{study_id}/revise")
def make_change(
    request: Request,
    study_id: str,
    database: Db,
    services: TheServices,
    protocol: Annotated[UploadFile | None, File()] = None,
    texts: Annotated[list[UploadFile] | None, File()] = None,
) -> Response:
    """A draft of the newest protocol with all its files, over which those lie that were uploaded."""
    with database.session() as s:
        newest = newest_protocol(s, the_study(s, study_id))[1]
    try:
        yaml = _VERSION.sub(rf"\g<1>{newest.protocol.version + 1}", newest.yaml, count=1)
        if protocol is not None and protocol.filename:
            yaml = decode_upload(protocol.filename, read_upload(protocol))
        draft = drafts.draft_from_text(services.settings.data, yaml, read_texts(texts), newest.files)
    except DraftError as problem:
        return _choose_page(request, study_id, database, problem)
    return RedirectResponse(f"/lab/studies/{study_id}/revise/{draft.id}", status_code=303)


@router.get("/lab/studies/{study_id}/revise/{draft_id}")
def check_change(request: Request, study_id: str, draft: TheDraft, database: Db) -> Response:
    return _check_page(request, study_id, draft, database)


@router.post("/lab/studies/{study_id}/revise/{draft_id}")
def save_change(
    request: Request,
    study_id: str,
    draft: TheDraft,
    database: Db,
    yaml: Annotated[str, Form()] = "",
    texts: Annotated[list[UploadFile] | None, File()] = None,
) -> Response:
    """Keep the edited YAML and what was uploaded with it, and check again. What cannot be kept stays in the form."""
    try:
        keep_edits(draft, yaml, texts)
    except DraftError as problem:
        return _check_page(request, study_id, draft, database, problem=problem, edited=yaml)
    return RedirectResponse(f"/lab/studies/{study_id}/revise/{draft.id}", status_code=303)


def _check_page(
    request: Request,
    study_id: str,
    draft: Draft,
    database: Db,
    *,
    problem: DraftError | None = None,
    edited: str | None = None,
) -> Response:
    """What is wrong; or what changes, what that means for the data, and the button that makes the version."""
    shown: dict[str, Any] = {"frozen": None, "problems": [], "changes": [], "refusal": None}
    with database.session() as s:
        study = the_study(s, study_id)
        try:
            frozen = shown["frozen"] = draft.freeze(query_sets_for(s, study))
            shown |= {
                "minutes": estimate_minutes(frozen.protocol),
                "stages": describe_stages(frozen.data, frozen.files),
                "first_steps": first_steps(frozen),
            }
            shown["changes"] = revision_of(s, study, frozen)[1]
        except ProtocolError as wrong:
            shown["problems"] = wrong.problems
        except StudyError as refusal:
            shown["refusal"] = refusal
        lines = {wrong.line for wrong in shown["problems"] if wrong.file == draft.file.name}
        return study_tab(
            request,
            study,
            "protocol",
            "lab/revise_check.html",
            status=422 if problem else 200,
            draft=draft,
            versions=versions_of(s, study),
            problem=problem,
            wrong_lines=lines,
            veiled=None,
            edited=edited,
            **shown,
        )


@router.post("/lab/studies/{study_id}/revise/{draft_id}/open")
def make_version(
    request: Request, study_id: str, draft: TheDraft, database: Db, files: Files, user: CheckedCsrf
) -> Response:
    """Give new participants the new version."""
    try:
        with database.session() as s:
            frozen = draft.freeze(query_sets_for(s, the_study(s, study_id)))
        with database.transaction() as s:
            version = revise_study(s, files, the_study(s, study_id), frozen, by=user.name)
            audit_details(request, version=version.protocol_version, number=version.number)
    except StudyError as refusal:
        return _check_page(request, study_id, draft, database, problem=DraftError("version", problem=refusal))
    except ProtocolError:
        return _check_page(request, study_id, draft, database)
    draft.discard()
    return RedirectResponse(f"/lab/studies/{study_id}/protocol?done=study_revised", status_code=303)

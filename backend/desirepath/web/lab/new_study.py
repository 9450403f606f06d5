"""A new study in three steps: choose a protocol, check it, open the study. Drafts themselves live in `drafts.py`."""

from __future__ import annotations

import re
import unicodedata
from typing import Annotated

from fastapi import APIRouter, Depends, File, Form, Request, UploadFile
from starlette.responses import RedirectResponse, Response

from desirepath.grammar.editing import set_value
from desirepath.store.query_sets import query_sets_here
from desirepath.study.protocol.freezing import ProtocolError
from desirepath.study.studies import StudyError, create_study
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Files, TheServices
from desirepath.web.core.lab_frame import LANGUAGES, LabRefusal, lab_language, lab_page
from desirepath.web.lab import drafts
from desirepath.web.lab.draft_view import draft_view
from desirepath.web.lab.drafts import Draft, DraftError, decode_upload
from desirepath.web.lab.protocol_cards import QUESTIONS, find_card, protocol_cards, unmet

LONGEST_NAME = 200
EMPTY = """\
protocol: x
version: 1
title:
  {first}: "-"
  {second}: "-"
languages: [{first}, {second}]
minutes: 15
query_set: study_room/queries_varied_200
stages: []
"""

router = APIRouter(prefix="/lab/new", dependencies=[Depends(check_csrf)], tags=["new study"])


def _draft(services: TheServices, draft_id: str) -> Draft:
    found = drafts.find_draft(services.settings.data, draft_id)
    if found is None:
        raise LabRefusal(404, "no_draft")
    return found


TheDraft = Annotated[Draft, Depends(_draft)]


@router.get("")
def choose(request: Request) -> Response:
    return _choose_page(request)


def _choose_page(request: Request, *, status: int = 200, problem: DraftError | None = None, yaml: str = "") -> Response:
    """The cards; the one that answers the three questions of the address stands out."""
    asked, cards = request.query_params, protocol_cards()
    fits = find_card(asked, cards)
    cards = tuple(sorted(cards, key=lambda card: card is not fits))
    misses = unmet(asked, fits) if fits else []
    shown = {"cards": cards, "fits": fits, "misses": misses, "questions": QUESTIONS, "asked": asked}
    return lab_page(request, "lab/new_choose.html", status=status, problem=problem, yaml=yaml, **shown)


@router.post("")
def make_draft(
    request: Request,
    services: TheServices,
    source: Annotated[str, Form()] = "",
    yaml: Annotated[str, Form()] = "",
    title: Annotated[str, Form()] = "",
    protocol: Annotated[UploadFile | None, File()] = None,
    texts: Annotated[list[UploadFile] | None, File()] = None,
) -> Response:
    """`source`: shipped:NAME, empty (with `title`), upload or paste."""
    data = services.settings.data
    try:
        if source.startswith("shipped:"):
            draft = drafts.draft_from_shipped(data, source.removeprefix("shipped:"))
        elif source == "upload":
            if protocol is None or not protocol.filename:
                raise DraftError("no_file")
            yaml = decode_upload(protocol.filename, read_upload(protocol))
            draft = drafts.draft_from_text(data, yaml, read_texts(texts))
        elif source == "empty":
            draft = drafts.draft_from_text(data, empty_protocol(title, lab_language(request)))
        elif source == "paste":
            draft = drafts.draft_from_text(data, yaml)
        else:
            raise DraftError("no_source")
    except DraftError as problem:
        return _choose_page(request, status=422, problem=problem, yaml=yaml)
    return RedirectResponse(f"/lab/new/{draft.id}", status_code=303)


def empty_protocol(title: str, language: str) -> str:
    """YAML of a protocol that has no stage yet, in the languages of the shipped texts. title: as participants see it,
    in either of them until it is translated; language: the one that comes first."""
    title = " ".join(title.split())[:LONGEST_NAME]
    if not title:
        raise DraftError("no_name")
    word = unicodedata.normalize("NFKD", title).encode("ascii", "ignore").decode().lower()
    name = re.sub(r"[^a-z0-9]+", "_", word).strip("_").lstrip("0123456789_")[:60] or "my_study"
    (other,) = set(LANGUAGES) - {language}
    text = set_value(EMPTY.format(first=language, second=other), ("protocol",), name)
    for code in LANGUAGES:
        text = set_value(text, ("title", code), title)
    return text


def keep_edits(draft: Draft, yaml: str, texts: list[UploadFile] | None) -> None:
    """Raises DraftError before anything is kept that cannot be."""
    draft.add(read_texts(texts))
    draft.save(yaml)


def read_texts(texts: list[UploadFile] | None) -> dict[str, bytes]:
    """File name -> content."""
    return {file.filename: read_upload(file) for file in texts or [] if file.filename}


def read_upload(file: UploadFile) -> bytes:
    content = file.file.read(drafts.LARGEST_FILE + 1)
    if len(content) > drafts.LARGEST_FILE:
        raise DraftError("too_large", name=file.filename, kb=drafts.LARGEST_FILE // 1024)
    return content


@router.get("/{draft_id}")
def check(request: Request, draft: TheDraft) -> Response:
    return _check_page(request, draft)


@router.post("/{draft_id}")
def save(
    request: Request,
    draft: TheDraft,
    user: CheckedCsrf,
    yaml: Annotated[str, Form()] = "",
    texts: Annotated[list[UploadFile] | None, File()] = None,
) -> Response:
    """Keep the edited YAML and what was uploaded with it, and check again. What cannot be kept stays in the form."""
    try:
        keep_edits(draft, yaml, texts)
    except DraftError as problem:
        return _check_page(request, draft, status=422, problem=problem, edited=yaml)
    return RedirectResponse(f"/lab/new/{draft.id}", status_code=303)


def _check_page(
    request: Request,
    draft: Draft,
    *,
    status: int = 200,
    problem: DraftError | None = None,
    name: str | None = None,
    edited: str | None = None,
    pilot: bool = True,
) -> Response:
    """The second and third step on one page: what is wrong, or what the study will be and the button that opens it."""
    shown = draft_view(request, draft) | {"pilot": pilot} | ({} if name is None else {"name": name})
    return lab_page(request, "lab/new_check.html", status=status, problem=problem, edited=edited, **shown)


@router.post("/{draft_id}/open")
def open_study(
    request: Request,
    draft: TheDraft,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    name: Annotated[str, Form()] = "",
    pilot: Annotated[bool, Form()] = False,
) -> Response:
    """Make the study: it keeps its own copy of the protocol, so later changes of files do not reach it. `pilot`: it
    begins with a pilot phase."""
    name = " ".join(name.split())[:LONGEST_NAME]
    try:
        with database.session() as s:
            frozen = draft.freeze(query_sets_here(s))
        if not name:
            raise DraftError("no_name")
        with database.transaction() as s:
            study = create_study(s, files, frozen, name=name, created_by=user.id)
            study.pilot = pilot
            study_id = study.id
    except StudyError as refused:
        return _check_page(
            request, draft, status=422, problem=DraftError("study", problem=refused), name=name, pilot=pilot
        )
    except ProtocolError:
        return _check_page(request, draft, status=422)
    except DraftError as problem:
        return _check_page(request, draft, status=422, problem=problem, name=name, pilot=pilot)
    draft.discard()
    audit_details(request, study_id=study_id, pilot=pilot)
    return RedirectResponse(f"/lab/studies/{study_id}/recruit?done=study_created", status_code=303)

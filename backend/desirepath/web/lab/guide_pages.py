"""The manual inside the lab, for who is signed in. What it says is `docs/`'s."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request
from starlette.responses import FileResponse, Response

from desirepath.installed import DOCS
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.guides import CONTENTS, GUIDES, find, guide
from desirepath.web.core.lab_frame import LabRefusal, lab_page
from desirepath.web.core.media import answers_with

router = APIRouter(prefix="/lab/guides", dependencies=[Depends(check_csrf)], tags=["guides"])


@router.get("")
def guides(request: Request, words: Annotated[str, Query(alias="find", max_length=100)] = "") -> Response:
    """What the manual has, and what is found in it."""
    return lab_page(request, "lab/guides.html", contents=CONTENTS, guide_of=guide, words=words, found=find(words))


@router.get("/images/{name}", response_class=Response, responses=answers_with("webp"))
def picture(name: str) -> Response:
    """A picture of the manual."""
    found = {file.name: file for file in (DOCS / "images").glob("*.webp")}.get(name)
    if found is None:
        raise LabRefusal(404, "no_guide")
    return FileResponse(found, media_type="image/webp", headers={"Cache-Control": "private, max-age=3600"})


@router.get("/{name}")
def one_guide(request: Request, name: str) -> Response:
    """One page of the manual."""
    if name not in GUIDES:
        raise LabRefusal(404, "no_guide")
    return lab_page(request, "lab/guide.html", guide=guide(name), contents=CONTENTS, guide_of=guide)

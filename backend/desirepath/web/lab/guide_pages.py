"""The guides and the protocol reference inside the lab, for who is signed in. What they say is `docs/`'s."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from desirepath.web.core.auth import check_csrf
from desirepath.web.core.guides import GUIDES, guide
from desirepath.web.core.lab_frame import LabRefusal, lab_page

router = APIRouter(prefix="/lab/guides", dependencies=[Depends(check_csrf)], tags=["guides"])


@router.get("")
def guides(request: Request) -> Response:
    """Which guides there are, with their parts."""
    return lab_page(request, "lab/guides.html", guides=[guide(name) for name in GUIDES])


@router.get("/{name}")
def one_guide(request: Request, name: str) -> Response:
    """One guide."""
    if name not in GUIDES:
        raise LabRefusal(404, "no_guide")
    return lab_page(request, "lab/guide.html", guide=guide(name))

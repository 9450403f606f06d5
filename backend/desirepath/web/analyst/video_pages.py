"""A kept video, for who is signed in: previews and answers show it as it was shown."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from desirepath.simulation.recorded import Video
from desirepath.store.models import Artefact
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.dependencies import Db, Files
from desirepath.web.core.lab_frame import LabRefusal
from desirepath.web.core.videos import ANSWERS, video_response

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])


@router.get("/lab/videos/{artefact_id}", response_class=Response, responses=ANSWERS)
def video(request: Request, artefact_id: str, database: Db, files: Files) -> Response:
    """Its bytes, by ranges."""
    with database.session() as s:
        found = s.get(Artefact, artefact_id)
        if found is None or found.kind != "video":
            raise LabRefusal(404, "no_artefact")
        return video_response(request, files, Video(**found.card["video"]))

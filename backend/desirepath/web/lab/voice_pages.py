"""What somebody said aloud, to be listened to in the lab: the recording that an answer names."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from desirepath.store.artefacts import ArtefactError
from desirepath.store.models import Response as Answered
from desirepath.store.models import Session
from desirepath.store.robot_recordings import VOICE
from desirepath.web.core.dependencies import Db, Files
from desirepath.web.core.lab_frame import LabRefusal

router = APIRouter(tags=["experimenter"])
POLICY = "default-src 'none'; media-src 'self'"  # where the file is opened by itself


@router.get(
    "/lab/studies/{study_id}/voices/{response_id}.webm",
    response_class=Response,
    responses={200: {"content": {"audio/webm": {}}}},
)
def voice(study_id: str, response_id: str, database: Db, files: Files) -> Response:
    """The recording of an answer of kind `think_aloud`."""
    with database.session() as s:
        given = s.get(Answered, response_id)
        session = s.get(Session, given.session_id) if given is not None else None
        sha = given.value.get("recording") if given is not None and given.kind == VOICE else None
        if session is None or session.study_id != study_id or not isinstance(sha, str):
            raise LabRefusal(404, "no_voice")
        try:
            content = files.get(sha)
        except ArtefactError:  # left out of a data set that was brought here
            raise LabRefusal(404, "no_voice") from None
    return Response(content, media_type="audio/webm", headers={"Content-Security-Policy": POLICY})

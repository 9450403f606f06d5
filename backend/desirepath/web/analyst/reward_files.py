"""Takes in a lab's own fitted reward: a manifest and its network become a reward model of the store.

Nothing is opened here but the manifest: the network is read in the process of the job that asks it, tensors alone.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, File, Form, Request, UploadFile
from starlette.responses import RedirectResponse, Response

from desirepath.learning.errors import LearningError
from desirepath.learning.people.reward_manifest import MANIFEST_BYTES, pack, read_manifest
from desirepath.store.artefacts import save_artefact
from desirepath.web.analyst.job_pages import study_of_new
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Files
from desirepath.web.core.lab_frame import LabRefusal, rights_in

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])
LARGEST_NETWORK = 2_000_000  # bytes: a little less than any body that is taken in


@router.post("/lab/reward-files")
def take_in(
    request: Request,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    manifest: Annotated[UploadFile | None, File()] = None,
    network: Annotated[UploadFile | None, File()] = None,
    study: Annotated[str, Form()] = "",
) -> Response:
    """Keep both as one reward model and go on to the form that asks it; 422 with what is wrong."""
    if manifest is None or network is None or not manifest.filename or not network.filename:
        raise LabRefusal(422, "reward_files_missing")
    described, content = manifest.file.read(MANIFEST_BYTES + 1), network.file.read(LARGEST_NETWORK + 1)
    if len(content) > LARGEST_NETWORK:
        raise LabRefusal(422, "reward_too_large", kb=LARGEST_NETWORK // 1000)
    try:
        checked = read_manifest(described, manifest.filename)
        kept = pack(checked, content)
    except LearningError as problem:
        raise LabRefusal(422, "no_reward_file", problem=str(problem)) from None
    if checked.file != network.filename:
        raise LabRefusal(422, "other_reward_file", named=checked.file, given=network.filename)
    with database.transaction() as s:
        card = {"results": {}, "config": checked.model_dump(mode="json"), "uploaded_by": user.name}
        made = save_artefact(
            s,
            files,
            kind="reward_model",
            name=f"uploaded: {checked.file}",
            setup=checked.setup,
            content=kept,
            card=card,
            study_id=study_of_new(s, rights_in(request), None, study),
        )
        reward = made.id
    audit_details(request, artefact=reward)
    return RedirectResponse(f"/lab/jobs/new/ask_person?reward={reward}", status_code=303)

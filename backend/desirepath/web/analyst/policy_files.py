"""Takes in a lab's own policy: ONNX with a manifest, a zip of Stable-Baselines3, our own file, as an artefact.

What is read of it is `learning/policies/importing.py`'s, in a process of its own.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, File, Form, Request, UploadFile
from starlette.responses import RedirectResponse, Response

from desirepath.simulation.setups import setup_folders
from desirepath.store.artefact_upkeep import LONGEST_NAME
from desirepath.store.artefacts import ArtefactError
from desirepath.store.models import utc_now
from desirepath.web.analyst.artefact_pages import artefact_href
from desirepath.web.analyst.job_pages import study_of_new
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Files
from desirepath.web.core.guard import LARGER
from desirepath.web.core.lab_frame import LabRefusal, rights_in

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])
ROUTE = "/lab/policy-files"
LARGEST_FILE = LARGER[ROUTE] - 300_000  # with a manifest of its own beside


@router.post(ROUTE)
def take_in(
    request: Request,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    policy: Annotated[UploadFile | None, File()] = None,
    manifest: Annotated[UploadFile | None, File()] = None,
    name: Annotated[str, Form()] = "",
    setup: Annotated[str, Form()] = "",
    study: Annotated[str, Form()] = "",
) -> Response:
    """Keep it and go on to its page; 422 with what is wrong and what would work."""
    from desirepath.learning.policies.importing import import_policy
    from desirepath.learning.policies.manifest import MANIFEST_BYTES
    from desirepath.store.imported_policies import save_imported_policy

    if policy is None or not policy.filename:
        raise LabRefusal(422, "policy_file_missing")
    content = policy.file.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise LabRefusal(422, "policy_too_large", mb=LARGEST_FILE // 1_000_000)
    beside = manifest.file.read(MANIFEST_BYTES + 1) if manifest is not None and manifest.filename else None
    if setup and setup not in setup_folders():
        raise LabRefusal(
            422, "no_policy_file", problem=f"setup = {setup[:60]!r}: known are {', '.join(setup_folders())}"
        )
    try:
        found = import_policy(
            content,
            policy.filename,
            setup=setup,
            manifest=beside,
            manifest_named=(manifest and manifest.filename) or "manifest",
        )
        with database.transaction() as s:
            kept, _ = save_imported_policy(
                s,
                files,
                found,
                name=name[:LONGEST_NAME],
                by=user.name,
                now=utc_now(),
                study_id=study_of_new(s, rights_in(request), None, study),
            )
            audit_details(request, artefact=kept.id, file_sha256=found.sha256)
            return RedirectResponse(artefact_href(kept), status_code=303)
    except (ValueError, ArtefactError) as problem:
        raise LabRefusal(422, "no_policy_file", problem=str(problem)) from None

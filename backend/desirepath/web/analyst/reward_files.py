"""Takes in a lab's own fitted reward: a manifest and its network become a reward model of the store, once somebody has
seen what it says of three trajectories and that this looks right.

The network is opened in a process of its own alone, tensors only.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Depends, File, Form, Request, UploadFile
from markupsafe import Markup
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.learning.errors import LearningError
from desirepath.learning.people.reward_manifest import MANIFEST_BYTES, pack, read_manifest
from desirepath.store.artefacts import ArtefactStore, save_artefact
from desirepath.store.models import Artefact, utc_now
from desirepath.web.analyst.job_pages import study_of_new
from desirepath.web.core import svg_figures
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from desirepath.web.core.media import csv_response

if TYPE_CHECKING:  # the simulator comes with it
    from desirepath.learning.people.looked_over import LookedOver

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
    """Keep both as one reward model and go on to what it says; 422 with what is wrong."""
    if manifest is None or network is None or not manifest.filename or not network.filename:
        raise LabRefusal(422, "reward_files_missing")
    described, content = manifest.file.read(MANIFEST_BYTES + 1), network.file.read(LARGEST_NETWORK + 1)
    if len(content) > LARGEST_NETWORK:
        raise LabRefusal(422, "reward_too_large", kb=LARGEST_NETWORK // 1000)
    try:
        checked = read_manifest(described, manifest.filename)
        kept = pack(checked, content)
        if checked.file != network.filename:
            raise LabRefusal(422, "other_reward_file", named=checked.file, given=network.filename)
        _look_over(kept)
    except LearningError as problem:
        raise LabRefusal(422, "no_reward_file", problem=str(problem)) from None
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
    return RedirectResponse(f"/lab/rewards/{reward}", status_code=303)


@router.get("/lab/rewards/{artefact_id}")
def what_it_says(request: Request, artefact_id: str, database: Db, files: Files) -> Response:
    """Three trajectories that differ plainly, and what the model says of them; where that looks right is said here."""
    from desirepath.analysis.metrics import measure

    with database.session() as s:
        artefact = _uploaded(s, artefact_id)
        found = _asked(files, artefact)
        t = services_of(request).texts.get(lab_language(request))
        names = [t(f"analyst.looked_over.{name}") for name in _names()]
        of_steps = {
            name: [(float(step), float(value)) for step, value in enumerate(values)]
            for name, values in zip(names, found.rewards, strict=True)
        }
        said = svg_figures.curves(
            of_steps,
            title=t("analyst.looked_over.along"),
            x_label=t("analyst.looked_over.step"),
            y_label=t("analyst.looked_over.reward"),
            number=svg_figures.exact(t.number),
            width=560,
        )
        return lab_page(
            request,
            "analyst/looked_over.html",
            artefact=artefact,
            names=names,
            found=found,
            measured=measure(found.trajectories),
            plan=Markup(_plan(request, found)),  # noqa: S704 - made by us, texts escaped
            said=Markup(said),  # noqa: S704
        )


@router.get("/lab/rewards/{artefact_id}/plan.svg")
def plan_svg(request: Request, artefact_id: str, database: Db, files: Files) -> Response:
    with database.session() as s:
        found = _asked(files, _uploaded(s, artefact_id))
    return Response(_plan(request, found), media_type="image/svg+xml")


@router.get("/lab/rewards/{artefact_id}/steps.csv")
def steps_csv(artefact_id: str, database: Db, files: Files) -> Response:
    with database.session() as s:
        found = _asked(files, _uploaded(s, artefact_id))
    rows = [
        [name, step, *(float(place) for place in trajectory.poses[step, :2]), float(value)]
        for name, trajectory, values in zip(_names(), found.trajectories, found.rewards, strict=True)
        for step, value in enumerate(values)
    ]
    return csv_response(["trajectory", "step", "x_m", "y_m", "reward"], rows, "reward_of_steps.csv")


@router.post("/lab/rewards/{artefact_id}/looks-right")
def looks_right(request: Request, artefact_id: str, database: Db, user: CheckedCsrf) -> Response:
    """Write down who found that it looks right, and when; it may be asked from now on."""
    with database.transaction() as s:
        artefact = _uploaded(s, artefact_id)
        if not artefact.card.get("looks_right"):
            noted = {"by": user.name, "at": utc_now().isoformat(timespec="seconds")}
            artefact.card = {**artefact.card, "looks_right": noted}
    audit_details(request, artefact=artefact_id)
    return RedirectResponse(f"/lab/jobs/new/ask_person?reward={artefact_id}", status_code=303)


def _names() -> tuple[str, ...]:
    from desirepath.learning.people.looked_over import NAMES

    return NAMES


def _uploaded(s: DatabaseSession, artefact_id: str) -> Artefact:
    artefact = s.get(Artefact, artefact_id)
    if artefact is None or artefact.kind != "reward_model" or not artefact.card.get("uploaded_by"):
        raise LabRefusal(404, "no_artefact")
    if artefact.quarantined_at is not None:
        raise LabRefusal(410, "quarantined")
    return artefact


def _asked(files: ArtefactStore, artefact: Artefact) -> LookedOver:
    try:
        return _look_over(files.get(artefact.id))
    except LearningError as problem:
        raise LabRefusal(422, "no_reward_file", problem=str(problem)) from None


@lru_cache(maxsize=8)  # some hundred numbers each; asking again takes seconds
def _look_over(content: bytes) -> LookedOver:
    from desirepath.learning.people.looked_over import look_over
    from desirepath.learning.people.reward_file import RewardFileMember, reward_of_store
    from desirepath.learning.people.reward_manifest import unpack

    kept = unpack(content)
    member = reward_of_store(content, kept[0].setup if kept else "")
    if not isinstance(member, RewardFileMember):
        raise LearningError("a reward model that was fitted here needs no looking over")
    try:
        return look_over(member)
    finally:
        member.close()


def _plan(request: Request, found: LookedOver) -> str:
    t = services_of(request).texts.get(lab_language(request))
    return svg_figures.valued_paths(
        found.trajectories[0].scene,
        found.trajectories,
        found.rewards,
        names=[t(f"analyst.looked_over.{name}") for name in _names()],
        title=t("analyst.looked_over.plan"),
        scale_label=t("analyst.looked_over.scale"),
        number=lambda value: svg_figures.exact(t.number)(float(f"{value:.3g}")),
    )

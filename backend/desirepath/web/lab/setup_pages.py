"""The page of the setups: what a lab drives in, its own brought as files, drawn, trained, taken away and removed.

What is taken in, and how it is checked, is `simulation/setup_intake.py`'s; training is a job like any other.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

from fastapi import APIRouter, Depends, File, Form, Request, UploadFile
from sqlalchemy import select
from starlette.responses import RedirectResponse, Response

from desirepath.grammar.source import ProtocolError
from desirepath.jobs.kinds import get_kind
from desirepath.simulation.setup_files import shipped_robots
from desirepath.simulation.setups import SetupError, get_setup, own_setups, setup_folders, uploaded_setups, version
from desirepath.store.models import Artefact, Job, Study
from desirepath.store.outbox import ENDED, enqueue_job
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db
from desirepath.web.core.lab_frame import LabRefusal, lab_page

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["settings"])
ADDRESS = "/lab/settings/setups"
KIND = "train_setup"


@dataclass(frozen=True)
class SetupLine:
    """A setup as the page lists it. artefacts: what lies in its folder; job: the newest training, None: none yet.
    removable: brought here, and no study has asked in it."""

    name: str
    robot: str
    where: str
    size_m: tuple[float, float] | None
    artefacts: tuple[str, ...]
    success_rate: float | None
    job: Job | None
    removable: bool


@router.get(ADDRESS)
def setups(request: Request, database: Db) -> Response:
    return _setups_page(request, database)


@router.post(ADDRESS)
def bring(
    request: Request,
    database: Db,
    user: CheckedCsrf,
    files: Annotated[list[UploadFile] | None, File()] = None,
    name: Annotated[str, Form()] = "",
    robot: Annotated[str, Form()] = "",
) -> Response:
    """Take in a setup: files or one zip. What is wrong is said as `desirepath setup check` says it."""
    from desirepath.simulation.setup_intake import IntakeError, gather, take_in

    root = uploaded_setups()
    try:
        root.mkdir(parents=True, exist_ok=True)
        brought = gather((file.filename, file.file) for file in files or [] if file.filename)
        take_in(name.strip(), brought, root, robot)
    except (IntakeError, SetupError) as wrong:
        return _setups_page(request, database, status=422, problems=[str(wrong)], name=name, robot=robot)
    except ProtocolError as wrong:
        told = [str(problem) for problem in wrong.problems]
        return _setups_page(request, database, status=422, problems=told, name=name, robot=robot)
    audit_details(request, setup=name.strip())
    return RedirectResponse(f"{ADDRESS}?done=setup_brought#{name.strip()}", status_code=303)


@router.post(f"{ADDRESS}/{{name}}/train")
def train(request: Request, name: str, database: Db, user: CheckedCsrf) -> Response:
    """Start the job that makes a setup ready, unless it runs."""
    if name not in own_setups():
        raise LabRefusal(404, "no_setup", name=name)
    with database.transaction() as s:
        running = _newest_job(s.scalars(select(Job).where(Job.kind == KIND).order_by(Job.created_at.desc())), name)
        if running is not None and running.state not in ENDED:
            return RedirectResponse(f"/lab/jobs/{running.id}", status_code=303)
        params = get_kind(KIND).parse({"setup": name})
        job = enqueue_job(s, KIND, params.asked(), created_by=user.name)
        started = job.id
    audit_details(request, setup=name, job=started)
    return RedirectResponse(f"/lab/jobs/{started}", status_code=303)


@router.post(f"{ADDRESS}/{{name}}/remove")
def take_away(request: Request, name: str, database: Db, user: CheckedCsrf) -> Response:
    """Remove a setup that was brought here, unless a study asks in it. What was trained stays among the artefacts."""
    from desirepath.simulation.setup_intake import remove

    with database.session() as s:
        if asking := _studies_in(s, name, _words_of_studies(s)):
            raise LabRefusal(409, "setup_in_use", name=name, study=asking[0])
    try:
        remove(name, uploaded_setups())
    except SetupError:
        raise LabRefusal(404, "no_setup", name=name) from None
    audit_details(request, setup=name)
    return RedirectResponse(f"{ADDRESS}?done=setup_removed", status_code=303)


@router.get(f"{ADDRESS}/{{name}}/setup.zip")
def take_out(name: str) -> Response:
    """All that lies in an own setup's folder."""
    from desirepath.simulation.setup_intake import take_out as packed

    if name not in own_setups():
        raise LabRefusal(404, "no_setup", name=name)
    headers = {"Content-Disposition": f'attachment; filename="{name}.zip"'}
    return Response(packed(name), media_type="application/zip", headers=headers)


@router.get(f"{ADDRESS}/{{name}}/picture.png")
def picture(name: str) -> Response:
    """An own setup from above, with some of its scenes."""
    if name not in own_setups():
        raise LabRefusal(404, "no_setup", name=name)
    return Response(_picture(name, version()), media_type="image/png", headers={"Cache-Control": "private, max-age=60"})


@lru_cache(maxsize=32)
def _picture(name: str, version_of_setups: int) -> bytes:
    from desirepath.simulation.setup_drawing import draw_setup

    out = io.BytesIO()
    draw_setup(get_setup(name)).savefig(out, format="png", dpi=110)
    return out.getvalue()


def _words_of_studies(s: Any) -> list[tuple[str, set[str]]]:
    """Each study's name and the words of its protocol."""
    return [(name, set(re.findall(r"\w+", yaml))) for name, yaml in s.execute(select(Study.name, Study.protocol_yaml))]


def _studies_in(s: Any, name: str, words: list[tuple[str, set[str]]]) -> list[str]:
    """Names of the studies whose protocol names the setup, or a query set of it."""
    named = {name, *s.scalars(select(Artefact.id).where(Artefact.setup == name, Artefact.kind == "query_set"))}
    return [study for study, its in words if named & its]


def _newest_job(jobs: Any, name: str) -> Job | None:
    return next((job for job in jobs if job.params.get("setup") == name), None)


def _setups_page(request: Request, database: Db, *, status: int = 200, **context: object) -> Response:
    from desirepath.learning.shipping.own_setup import trained_already
    from desirepath.simulation.scenes import map_of

    folders, uploaded = setup_folders(), uploaded_setups().resolve()
    with database.session() as s:
        jobs = list(s.scalars(select(Job).where(Job.kind == KIND).order_by(Job.created_at.desc())))
        lines, words = [], _words_of_studies(s)
        for name in own_setups():
            setup, here = get_setup(name), map_of(name)
            there = trained_already(folders[name])
            brought = folders[name].parent == uploaded
            lines.append(
                SetupLine(
                    name,
                    setup.robot.name,
                    setup.world,
                    (round(here.size_m[0], 1), round(here.size_m[1], 1)) if here else None,
                    tuple(there["artefacts"]),
                    there["success_rate"],
                    _newest_job(jobs, name),
                    brought and not _studies_in(s, name, words),
                )
            )
    shown = {"problems": [], "name": "", "robot": ""}
    return lab_page(
        request,
        "lab/setups.html",
        status=status,
        lines=lines,
        robots=list(shipped_robots()),
        shipped=[name for name in setup_folders() if name not in own_setups()],
        ended=ENDED,
        **(shown | context),
    )

"""The page of the setups: what a lab drives in, its own brought as files, drawn, trained, taken away and removed.

What is taken in, and how it is checked, is `simulation/setup_intake.py`'s; training is a job like any other.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends, File, Form, Request, UploadFile
from sqlalchemy import select
from sqlalchemy.orm import Session
from starlette.responses import RedirectResponse, Response

from desirepath.grammar.source import ProtocolError
from desirepath.jobs.kinds import get_kind
from desirepath.simulation.setup_files import shipped_robots
from desirepath.simulation.setups import (
    SETUP_FILE,
    SetupError,
    broken_setups,
    get_setup,
    is_shipped,
    own_setups,
    setup_folders,
    tell_changed,
    uploaded_setups,
    version,
)
from desirepath.store.models import Artefact, Job, ProtocolVersion, Study
from desirepath.store.outbox import ENDED, enqueue_job
from desirepath.store.query_sets import register_made
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["settings"])
ADDRESS = "/lab/settings/setups"
KIND = "train_setup"
IN_FOLDER = re.compile(r"/[a-z0-9_/]+")  # what follows a setup's name in the name of something of it
MOST_USES = 12  # that are listed


@dataclass(frozen=True)
class SetupLine:
    """A setup as the page lists it. artefacts: what lies in its folder; job: the newest training, None: none yet.
    brought: here, so that it can be removed, unless something is made in it. checked: what was said then."""

    name: str
    robot: str
    where: str
    size_m: tuple[float, float] | None
    artefacts: tuple[str, ...]
    success_rate: float | None
    job: Job | None
    brought: bool
    uses: list[str]
    checked: dict[str, Any]


@router.get(ADDRESS)
def setups(request: Request, database: Db) -> Response:
    return _setups_page(request, database)


@router.post(ADDRESS)
def bring(
    request: Request,
    database: Db,
    store: Files,
    user: CheckedCsrf,
    files: Annotated[list[UploadFile] | None, File()] = None,
    name: Annotated[str, Form()] = "",
    robot: Annotated[str, Form()] = "",
) -> Response:
    """Take in a setup, with what was trained in it: files or one zip. Problems are said as `setups check` says them."""
    from desirepath.learning.shipping.brought_back import split
    from desirepath.simulation.setup_intake import IntakeError, gather, take_in

    root = uploaded_setups()
    try:
        root.mkdir(parents=True, exist_ok=True)
        trained, brought = split(gather((file.filename, file.file) for file in files or [] if file.filename))
        take_in(name.strip(), brought, root, robot)
    except (IntakeError, SetupError) as wrong:
        return _setups_page(request, database, status=422, problems=[str(wrong)], name=name, robot=robot)
    except ProtocolError as wrong:
        told = [str(problem) for problem in wrong.problems]
        return _setups_page(request, database, status=422, problems=told, name=name, robot=robot)
    artefacts = _bring_back(database, store, root / name.strip(), trained) if trained else []
    audit_details(request, setup=name.strip(), artefacts=len(artefacts))
    return RedirectResponse(f"{ADDRESS}?done=setup_brought#{name.strip()}", status_code=303)


def _bring_back(database: Db, store: Files, folder: Path, trained: Mapping[str, bytes]) -> list[str]:
    """Trained artefacts into the setup's folder and into the store; what is left out stands beside the setup."""
    from desirepath.learning.shipping.brought_back import bring_back
    from desirepath.simulation.setup_intake import add_left_out

    kept, left_out = bring_back(folder, trained)
    if left_out:
        add_left_out(folder, left_out)
    tell_changed()
    with database.transaction() as s:
        return [register_made(s, store, one).id for one in kept]


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
    """Remove a setup that was brought here, unless something stands on it, which could not be opened without it."""
    from desirepath.simulation.setup_intake import remove

    with database.session() as s:
        if _is_found(name) and (uses := _uses(request, s, [name])[name]):
            raise LabRefusal(409, "setup_in_use", name=name, uses=", ".join(uses))
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


def _is_found(name: str) -> bool:
    """Whether the setup of that name is the one that was brought, and no other that has its name."""
    return setup_folders().get(name) == (uploaded_setups() / name).resolve()


def _uses(request: Request, s: Session, names: Iterable[str]) -> dict[str, list[str]]:
    """By setup what stands on it, in words, at most MOST_USES each: studies, jobs under way, what was made in it."""
    words = services_of(request).texts.get(lab_language(request))
    found: dict[str, list[str]] = {name: [] for name in names}
    if not found:
        return found
    later = select(Study.name, ProtocolVersion.protocol).join(ProtocolVersion, ProtocolVersion.study_id == Study.id)
    under_way = select(Job.id, Job.params).where(Job.state.not_in(ENDED))
    for kind, asked in (("study", select(Study.name, Study.protocol)), ("study", later), ("job", under_way)):
        for called, data in s.execute(asked):
            for name in found:
                if _names(data, name):
                    found[name].append(words(f"lab.setups.uses.{kind}", name=called))
    made = select(Artefact.setup, Artefact.name).where(Artefact.setup.in_(found)).order_by(Artefact.name)
    for name, called in s.execute(made):
        found[name].append(words("lab.setups.uses.artefact", name=called))
    return {name: uses[:MOST_USES] for name, uses in found.items()}


def _names(data: Any, name: str) -> bool:
    """Whether plain data have a field `setup` of that name, or name something that lies in its folder."""
    if isinstance(data, dict):
        return any((key == "setup" and value == name) or _names(value, name) for key, value in data.items())
    if isinstance(data, list):
        return any(_names(one, name) for one in data)
    return isinstance(data, str) and data.startswith(f"{name}/") and IN_FOLDER.fullmatch(data, len(name)) is not None


def _newest_job(jobs: Any, name: str) -> Job | None:
    return next((job for job in jobs if job.params.get("setup") == name), None)


def _setups_page(request: Request, database: Db, *, status: int = 200, **context: object) -> Response:
    from desirepath.learning.shipping.own_setup import trained_already
    from desirepath.simulation.scenes import map_of
    from desirepath.simulation.setup_intake import checked

    folders, uploaded = setup_folders(), uploaded_setups().resolve()
    with database.session() as s:
        jobs = list(s.scalars(select(Job).where(Job.kind == KIND).order_by(Job.created_at.desc())))
        brought_here = [name for name in own_setups() if folders[name].parent == uploaded]
        uses = _uses(request, s, brought_here)
        lines = []
        for name in own_setups():
            setup, here = get_setup(name), map_of(name)
            there = trained_already(folders[name])
            lines.append(
                SetupLine(
                    name,
                    setup.robot.name,
                    setup.world,
                    (round(here.size_m[0], 1), round(here.size_m[1], 1)) if here else None,
                    tuple(there["artefacts"]),
                    there["success_rate"],
                    _newest_job(jobs, name),
                    name in uses,
                    uses.get(name, []),
                    checked(folders[name]),
                )
            )
    shown = {"problems": [], "name": "", "robot": ""}
    return lab_page(
        request,
        "lab/setups.html",
        status=status,
        lines=lines,
        broken=broken_setups(),
        uploaded=[file.parent.name for file in uploaded.glob(f"*/{SETUP_FILE}")],
        robots=list(shipped_robots()),
        shipped=[name for name, folder in folders.items() if is_shipped(folder)],
        ended=ENDED,
        **(shown | context),
    )

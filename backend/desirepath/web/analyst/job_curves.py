"""A job's learning curves on its page: figures with words and units, CSV, TensorBoard files, and the time to go."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from datetime import datetime

from fastapi import APIRouter, Depends, Request
from markupsafe import Markup
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.jobs.curves import Points, curves_of, step_of
from desirepath.jobs.tensorboard import event_files
from desirepath.store.models import Job, utc_now
from desirepath.web.core import svg_figures
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.dependencies import Db, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language
from desirepath.web.core.media import csv_response

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])
SURE_FROM = 0.02  # share done, below which the time to go is a guess


def draw_curves(t: Catalogue, s: DatabaseSession, job: Job) -> list[tuple[str, str, Markup]]:
    """(name, title, figure) of every curve of a job."""
    found = curves_of(s, job.id)
    return [(name, label_of(t, job, name), Markup(_draw(t, job, name, lines))) for name, lines in found.items()]  # noqa: S704


def label_of(t: Catalogue, job: Job, name: str) -> str:
    """A metric in words with its unit; what a kind of job means by it goes first."""
    keys = (f"curves.of.{job.kind}.{name}", f"curves.metrics.{name}", f"analyst.metrics.{name}")
    return next((t(key) for key in keys if t.knows(key)), name)


def seconds_to_go(job: Job, now: datetime) -> float | None:
    """How long a running job still needs if it goes on as it did; None where that is not known."""
    if job.state != "running" or job.started_at is None or not SURE_FROM <= job.progress < 1:
        return None
    return (now - job.started_at).total_seconds() * (1 - job.progress) / job.progress


@router.get("/lab/jobs/{job_id}/curves/{name}.svg")
def curve_svg(request: Request, job_id: str, name: str, database: Db) -> Response:
    t = services_of(request).texts.get(lab_language(request))
    with database.session() as s:
        job, lines = _found(s, job_id, name)
    return Response(_draw(t, job, name, lines), media_type="image/svg+xml")


@router.get("/lab/jobs/{job_id}/curves/{name}.csv")
def curve_csv(job_id: str, name: str, database: Db) -> Response:
    with database.session() as s:
        job, lines = _found(s, job_id, name)
    at: dict[int, dict[str, float]] = {}
    for line, points in lines.items():
        for step, value in points:
            at.setdefault(step, {})[line] = value
    header = [step_of(job), *(f"{name}_{line}" if line else name for line in lines)]
    rows = [[step, *(values.get(line, "") for line in lines)] for step, values in sorted(at.items())]
    return csv_response(header, rows, f"{name}.csv")


@router.get("/lab/jobs/{job_id}/tensorboard.zip")
def tensorboard(job_id: str, database: Db) -> Response:
    """All curves as a log folder: unpack it and run `tensorboard --logdir FOLDER`."""
    with database.session() as s:
        job = find_job(s, job_id)
        files = event_files(curves_of(s, job.id), job=job.id[:8], at=(job.started_at or utc_now()).timestamp())
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, content in files.items():
            archive.writestr(path, content)
    headers = {"Content-Disposition": f'attachment; filename="tensorboard-{job_id[:8]}.zip"'}
    return Response(packed.getvalue(), media_type="application/zip", headers=headers)


def find_job(s: DatabaseSession, job_id: str) -> Job:
    job = s.get(Job, job_id)
    if job is None:
        raise LabRefusal(404, "no_job")
    return job


def _found(s: DatabaseSession, job_id: str, name: str) -> tuple[Job, dict[str, Points]]:
    job = find_job(s, job_id)
    lines = curves_of(s, job.id).get(name)
    if lines is None:
        raise LabRefusal(404, "no_figure")
    return job, lines


def _draw(t: Catalogue, job: Job, name: str, lines: Mapping[str, Points]) -> str:
    label = label_of(t, job, name)
    named = {t(f"curves.lines.{line}") if line else label: points for line, points in lines.items()}
    x_label = t(f"curves.steps.{step_of(job)}")
    return svg_figures.curves(named, title=label, x_label=x_label, y_label=label, number=svg_figures.exact(t.number))

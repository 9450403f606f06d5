"""The whole report of a study in the browser: made by a process of its own, shown and taken away from here.

The numbers and figures are those of `desirepath report`, which is what the process runs. Reports are kept in memory
only, each under what it was made from, so that none is shown after an erasure or shows yesterday's answers.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Depends, Request
from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from backend.api.analyst.flow_pages import FIGURE_POLICY, MEDIA_TYPES
from backend.api.core.auth import checked_csrf
from backend.api.core.dependencies import Db, services_of
from backend.api.core.lab_frame import LabRefusal, lab_page
from backend.api.lab.study_tabs import study_tab, the_study
from backend.jobs.process import ONE_THREAD, environment_of
from backend.report.study_report import REPORT_FILE
from backend.settings import Settings
from backend.store.models import Participant, Session, Study
from backend.store.models import Response as Answer

router = APIRouter(dependencies=[Depends(checked_csrf)], tags=["experimenter"])

WHO = ("people", "simulated")
MOST_KEPT = 4  # reports; about five MB each
NICENESS = 5  # as figures: an analyst waits for it, but everything of participants goes first
LONGEST_S = 600.0
SHOWN = ("html", "png", "svg")  # endings of what is looked at; all else is data
REPORT_MEDIA = MEDIA_TYPES | {"html": "text/html; charset=utf-8", "json": "application/json"}


class ReportError(RuntimeError):
    """A report that could not be made; says why, for people."""


@dataclass(frozen=True)
class Made:
    """A report's files: path within the report -> content."""

    files: dict[str, bytes]

    def as_zip(self) -> bytes:
        """All of it, to be taken away; the same report gives the same bytes."""
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
            for name, content in sorted(self.files.items()):
                packed.writestr(zipfile.ZipInfo(f"report/{name}"), content)
        return out.getvalue()


class Reports:
    """Makes reports one after another in the background and keeps the latest."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._turn = threading.Lock()
        self._known: OrderedDict[str, Future[Made]] = OrderedDict()

    def report(self, study: str, who: str, mark: str) -> Future[Made]:
        """The report of these answers; begun at first asking. `mark` changes with what it is made from."""
        key = f"{study}:{who}:{mark}"
        with self._lock:
            found = self._known.get(key)
            if found is None:
                found = self._known[key] = Future()
                threading.Thread(target=self._make, args=(found, study, who), daemon=True).start()
                while len(self._known) > MOST_KEPT:
                    self._known.popitem(last=False)
        return found

    def _make(self, promised: Future[Made], study: str, who: str) -> None:
        try:
            with self._turn:
                promised.set_result(self._made(study, who))
        except Exception as problem:  # whatever it was: somebody waits for this promise
            promised.set_exception(ReportError(str(problem)))

    def _made(self, study: str, who: str) -> Made:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "backend.cli", "report", study, "--who", who, "--out", folder, "--json"]
            child = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment_of(self._settings) | ONE_THREAD,
            )
            os.setpriority(os.PRIO_PROCESS, child.pid, NICENESS)
            try:
                told, _ = child.communicate(timeout=LONGEST_S)
            finally:
                if child.poll() is None:
                    child.kill()
                    child.wait()
            if child.returncode:
                raise ReportError(_error_in(told))
            root = Path(folder)
            return Made({f.relative_to(root).as_posix(): f.read_bytes() for f in root.rglob("*") if f.is_file()})


def _error_in(told: bytes) -> str:
    try:
        return str(json.loads(told)["error"])
    except (ValueError, KeyError, TypeError):
        return "the process ended without an answer"


def _mark(s: DatabaseSession, study: Study) -> str:
    """Changes with every answer, exclusion, withdrawal, erasure and change of protocol."""
    answers = s.execute(
        select(func.count(), func.max(Answer.created_at)).join(Session).where(Session.study_id == study.id)
    ).one()
    people = s.execute(
        select(Participant.code, Participant.excluded_at, Participant.withdrawn_at)
        .where(Participant.study_id == study.id)
        .order_by(Participant.code)
    ).all()
    states = s.execute(
        select(Session.state, func.count()).where(Session.study_id == study.id).group_by(Session.state)
    ).all()
    told = [tuple(answers), [tuple(row) for row in people], sorted(map(tuple, states)), study.protocol_hash]
    return hashlib.sha256(repr(told).encode()).hexdigest()


def _asked(request: Request, s: DatabaseSession, study_id: str, who: str) -> tuple[Study, Future[Made]]:
    if who not in WHO:
        raise LabRefusal(404, "no_report")
    study = the_study(s, study_id)
    return study, services_of(request).reports.report(study.id, who, _mark(s, study))


@router.get("/lab/studies/{study_id}/analysis/{who}")
def analysis(request: Request, study_id: str, who: str, database: Db) -> Response:
    """Begins the report if nobody has; says when it is there, or why there is none. A fragment when asked for one."""
    with database.session() as s:
        study, report = _asked(request, s, study_id, who)
        shown: dict[str, Any] = {
            "who": who,
            "ready": report.done(),
            "problem": report.exception() if report.done() else None,
        }
        if request.headers.get("X-Fragment"):
            return lab_page(request, "lab/study_analysis_part.html", study=study, **shown)
        return study_tab(request, study, "report", "lab/study_analysis.html", **shown)


@router.get("/lab/studies/{study_id}/analysis/{who}/report.zip")
def analysis_zip(request: Request, study_id: str, who: str, database: Db) -> Response:
    """HTML, figures, tests and their data."""
    with database.session() as s:
        study, report = _asked(request, s, study_id, who)
    headers = {"Content-Disposition": f'attachment; filename="report-{study.id[:8]}-{who}.zip"'}
    return Response(_ready(report).as_zip(), media_type="application/zip", headers=headers)


@router.get("/lab/studies/{study_id}/analysis/{who}/{name:path}.csv")
def analysis_rows(request: Request, study_id: str, who: str, name: str, database: Db) -> Response:
    """The rows beside a figure or a table of the report."""
    return _file(request, study_id, who, f"{name}.csv", database)


@router.get("/lab/studies/{study_id}/analysis/{who}/{name:path}.json")
def analysis_findings(request: Request, study_id: str, who: str, name: str, database: Db) -> Response:
    """The findings as data."""
    return _file(request, study_id, who, f"{name}.json", database)


@router.get("/lab/studies/{study_id}/analysis/{who}/{name:path}")
def analysis_file(request: Request, study_id: str, who: str, name: str, database: Db) -> Response:
    """The report's page, or one of its pictures."""
    if name.rpartition(".")[2] not in SHOWN:
        raise LabRefusal(404, "no_report")  # data are taken away by routes of their own, which need the right to it
    return _file(request, study_id, who, name, database)


def _file(request: Request, study_id: str, who: str, name: str, database: Db) -> Response:
    with database.session() as s:
        study, report = _asked(request, s, study_id, who)
        if name == REPORT_FILE and not report.done():
            return RedirectResponse(f"/lab/studies/{study.id}/analysis/{who}", status_code=303)
    files = _ready(report).files
    if name not in files:
        raise LabRefusal(404, "no_report")
    ending = name.rpartition(".")[2]
    headers = {"Cache-Control": "private, no-cache", "Content-Security-Policy": FIGURE_POLICY}
    if ending not in SHOWN:
        headers["Content-Disposition"] = f'attachment; filename="{name.rpartition("/")[2]}"'
    return Response(files[name], media_type=REPORT_MEDIA[ending], headers=headers)


def _ready(report: Future[Made]) -> Made:
    """Raises LabRefusal for one that is not there (yet)."""
    if not report.done() or report.exception() is not None:
        raise LabRefusal(404, "no_report")
    return report.result()

"""The whole report of a study in the browser: shown and taken away from here. `whole_reports.py` makes it.

The numbers and figures are those of `desirepath studies report`.
"""

from __future__ import annotations

import re
from typing import Any

from fastapi import APIRouter, Depends, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.store.models import Participant, Session, Study
from desirepath.store.who_counts import FINISHED, not_left_out, same_kind
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.dependencies import Db, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_page, rights_in
from desirepath.web.core.media import answers_with, figure_file
from desirepath.web.core.roles import Right
from desirepath.web.lab.study_tabs import study_tab, the_study
from desirepath.web.lab.whole_reports import MadeFrom, ReportFiles

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])

WHO = ("people", "simulated")
LINK_TO_ROWS = re.compile(rb'<a href="[^"]*[.]csv">CSV</a>,\s*')  # as `printed.html` has it; not for who only looks
SHOWN = ("html", "png", "svg")  # endings of what is looked at; all else is data


def _study_of(s: DatabaseSession, study_id: str, who: str) -> Study:
    if who not in WHO:
        raise LabRefusal(404, "no_report")
    return the_study(s, study_id)


def _only_pilots(s: DatabaseSession, study: Study, who: str) -> bool:
    """Whether some of these joined, and all of them during a pilot phase, which no report counts."""
    joined = select(Participant.pilot).where(
        Participant.study_id == study.id, Participant.simulated.is_(who == "simulated")
    )
    phases = set(s.scalars(joined))
    return phases == {True}


def _nobody_counts(s: DatabaseSession, study: Study, who: str) -> bool:
    """Whether none of these whom a report counts has completed the study."""
    done = (
        select(Session.id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(
            Participant.study_id == study.id,
            same_kind(simulated=who == "simulated", pilot=False),
            not_left_out(),
            Session.state == FINISHED,
        )
        .limit(1)
    )
    return s.scalars(done).first() is None


def _there(request: Request, study: Study, who: str, s: DatabaseSession) -> ReportFiles | None:
    return services_of(request).reports.there(study.id, who, MadeFrom.of(s, study))


@router.get("/lab/studies/{study_id}/analysis/{who}")
def analysis(request: Request, study_id: str, who: str, database: Db, recompute: bool = False) -> Response:
    """Begins the report if there is none to show; says when it is there, how old it is, or why there is none. A
    fragment when asked for one. `recompute`: begins another one if answers came since."""
    with database.session() as s:
        study = _study_of(s, study_id, who)
        now = MadeFrom.of(s, study)
        report = services_of(request).reports.ask(study.id, who, now, recompute=recompute)
        if recompute:
            return RedirectResponse(f"/lab/studies/{study.id}/analysis/{who}", status_code=303)
        shown: dict[str, Any] = {
            "who": who,
            "ready": report.ready,
            "problem": report.problem,
            "only_pilots": report.problem is not None and _only_pilots(s, study, who),
            "nobody_counts": report.problem is not None and _nobody_counts(s, study, who),
            "report": report,
            "newer": now.answers - report.made_from.answers,
            "old": now != report.made_from,
        }
        if request.headers.get("X-Fragment"):
            return lab_page(request, "lab/study_analysis_part.html", study=study, **shown)
        return study_tab(request, study, "report", "lab/study_analysis.html", **shown)


@router.get("/lab/studies/{study_id}/analysis/{who}/report.zip")
def analysis_zip(request: Request, study_id: str, who: str, database: Db) -> Response:
    """HTML, figures, tests and their data."""
    with database.session() as s:
        study = _study_of(s, study_id, who)
        report = _there(request, study, who, s)
    if report is None:
        raise LabRefusal(404, "no_report")
    headers = {"Content-Disposition": f'attachment; filename="report-{study.id[:8]}-{who}.zip"'}
    return Response(report.as_zip(), media_type="application/zip", headers=headers)


@router.get("/lab/studies/{study_id}/analysis/{who}/{name:path}.csv")
def analysis_rows(request: Request, study_id: str, who: str, name: str, database: Db) -> Response:
    """The rows beside a figure or a table of the report."""
    return _file(request, study_id, who, f"{name}.csv", database)


@router.get("/lab/studies/{study_id}/analysis/{who}/{name:path}.json")
def analysis_findings(request: Request, study_id: str, who: str, name: str, database: Db) -> Response:
    """The findings as data."""
    return _file(request, study_id, who, f"{name}.json", database)


@router.get(
    "/lab/studies/{study_id}/analysis/{who}/{name:path}",
    response_class=Response,
    responses=answers_with("html", "png", "svg", "csv", "json"),
)
def analysis_file(request: Request, study_id: str, who: str, name: str, database: Db) -> Response:
    """The report's page, or one of its pictures."""
    if name.rpartition(".")[2] not in SHOWN:
        raise LabRefusal(404, "no_report")  # data are taken away by routes of their own, which need the right to it
    return _file(request, study_id, who, name, database)


def _file(request: Request, study_id: str, who: str, name: str, database: Db) -> Response:
    from desirepath.report.study_report import REPORT_FILE  # scipy comes with it; a server starts without

    with database.session() as s:
        study = _study_of(s, study_id, who)
        report = _there(request, study, who, s)
    if report is None and name == REPORT_FILE:
        return RedirectResponse(f"/lab/studies/{study.id}/analysis/{who}", status_code=303)
    if report is None or name not in report.files:
        raise LabRefusal(404, "no_report")
    content = report.files[name]
    if name == REPORT_FILE and not rights_in(request).may(Right.TAKE, study_id):
        content = LINK_TO_ROWS.sub(b"", content)
    return figure_file(request, name, content, shown=SHOWN)

"""The experimenters' pages: the studies and one study's tabs. One participant's page lives in `people_pages.py`, making
a study in `new_study.py`, its protocol in `protocol_pages.py`, the numbers of the Report tab in `report_tab.py`,
accounts in `auth.py`."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.background import BackgroundTask
from starlette.responses import FileResponse, RedirectResponse, Response

from desirepath.store.dataset.writing import export_study
from desirepath.store.events import log_event
from desirepath.store.example_study import ExampleError, example_id, remove_example, was_brought
from desirepath.store.models import Event, Study, utc_now
from desirepath.store.retention import check_day, is_overdue
from desirepath.store.who_counts import GROUPS
from desirepath.study.kinds.debriefing import DebriefingStage
from desirepath.study.plan.assignment import STANDINGS, assignment_table
from desirepath.study.protocol.outline import describe_stages
from desirepath.study.session.joining import UNFILLED
from desirepath.study.session.platforms import PLATFORMS
from desirepath.study.session.versions import newest_protocol
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, SignedIn, check_csrf
from desirepath.web.core.contract import reply_of
from desirepath.web.core.dependencies import Db, Files, contact, public_url, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from desirepath.web.core.media import answers_with
from desirepath.web.core.permits import in_studies
from desirepath.web.lab import (
    analysis_pages,
    answer_replay,
    audit_pages,
    coding_pages,
    guide_pages,
    monitoring,
    new_study,
    payments,
    people_pages,
    people_rows,
    power_pages,
    preview,
    protocol_editor,
    protocol_pages,
    robot_pages,
    settings_pages,
    study_rows,
    team_pages,
    voice_pages,
)
from desirepath.web.lab.answer_rows import AnswerFilter, answers_page
from desirepath.web.lab.first_pair import draw_first_pair
from desirepath.web.lab.lab_data import Monitor
from desirepath.web.lab.report_tab import Report, study_report
from desirepath.web.lab.study_tabs import study_tab, the_study

EXAMPLE_EVERY_S = 3  # ours: how often the list looks for it while it is on its way

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])
router.include_router(analysis_pages.router)
router.include_router(answer_replay.router)
router.include_router(voice_pages.router)
router.include_router(audit_pages.router)
router.include_router(coding_pages.router)
router.include_router(guide_pages.router)
router.include_router(new_study.router)
router.include_router(payments.router)
router.include_router(people_pages.router)
router.include_router(power_pages.router)
router.include_router(protocol_editor.router)
router.include_router(preview.router)
router.include_router(protocol_pages.router)
router.include_router(robot_pages.router)
router.include_router(settings_pages.router)
router.include_router(team_pages.router)


@router.get("/lab/studies")
def studies(request: Request, database: Db, files: Files) -> Response:
    services = services_of(request)
    with database.session() as s:
        coming = services.brings_example and not was_brought(s)
        lines = study_rows.study_lines(s, in_studies(rights_in(request), Study.id))
        t = services.texts.get(lab_language(request))
        pair = draw_first_pair(s, files, [line.study for line in lines], t)
        listed = lab_page(request, "lab/studies.html", lines=lines, pair=pair, coming=coming, example=example_id(s))
    if coming:
        listed.headers["Refresh"] = str(EXAMPLE_EVERY_S)
    return listed


@router.post("/lab/studies/{study_id}/remove-example")
def remove_example_study(request: Request, study_id: str, database: Db, files: Files) -> Response:
    """Remove the example study with all that came with it."""
    with database.session() as s:
        if example_id(s) != study_id:
            raise LabRefusal(404, "no_study")
    try:
        remove_example(database, files, services_of(request).settings.data)
    except ExampleError:
        raise LabRefusal(422, "example_has_people") from None
    return RedirectResponse("/lab/studies?done=example_removed", status_code=303)


@router.get("/lab/studies/{study_id}")
def study_home(study_id: str, database: Db) -> Response:
    with database.session() as s:
        return RedirectResponse(f"/lab/studies/{the_study(s, study_id).id}/now", status_code=303)


@router.get("/lab/studies/{study_id}/now")
def now(request: Request, study_id: str, database: Db) -> Response:
    """Who is where. With the header `X-Fragment`, only the part that changes."""
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = people_rows.people(s, study.id, utc_now())
        template = "lab/now_part.html" if request.headers.get("X-Fragment") else None
        return study_tab(
            request,
            study,
            "now",
            template,
            everyone=everyone,
            shown=people_rows.filter_people,
            stages=people_rows.stages_of(everyone, _stage_keys(s, study)),
            orders=assignment_table(s, study, newest_protocol(s, study)[1].protocol, now=utc_now()),
            standings=STANDINGS,
            order_name=people_rows.order_name,
            median_trial_s=people_rows.median_trial_s(everyone),
            erased=len(study_rows.tombstones(s, study.id)),
        )


@router.get("/api/lab/studies/{study_id}/monitor", response_model=Monitor)
def monitor(study_id: str, database: Db) -> Response:
    """The Now tab as data: one object per participant, and how many are in and were lost at each stage."""
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = people_rows.people(s, study.id, utc_now())
        newest = newest_protocol(s, study)[1].protocol
        now = {
            "study": study.id,
            "state": study.state,
            "people": [
                {
                    "code": p.code,
                    "simulated": p.simulated,
                    "excluded": p.excluded_at is not None,
                    "presence": p.presence,
                    "stage": p.stage,
                    "step": p.step_key,
                    "phase": p.phase,
                    "progress": round(p.progress, 3),
                    "answers": p.answers,
                    "restarts": p.restarts,
                    "flags": p.flags,
                    "pilot": p.pilot,
                    "trial_s": p.trial_s,
                    "last_seen_at": p.last_seen_at,
                }
                for p in everyone
            ],
            "stages": [
                {"stage": stage, "under_way": here, "dropped": gone}
                for stage, here, gone in people_rows.stages_of(everyone, _stage_keys(s, study))
            ],
            "median_trial_s": people_rows.median_trial_s(everyone),
            "orders": [asdict(line) for line in assignment_table(s, study, newest, now=utc_now())],
        }
    return reply_of(Monitor, now)


@router.get("/lab/studies/{study_id}/people")
def people(
    request: Request, study_id: str, database: Db, show: str = "all", q: str = "", sort: str = "", page: int = 1
) -> Response:
    """`q`: part of a code; `sort`: a column, with `-` before it from its largest."""
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = people_rows.people(s, study.id, utc_now())
        filtered = people_rows.filter_people(everyone, show)
        return study_tab(
            request,
            study,
            "people",
            everyone=everyone,
            show=show,
            count=people_rows.filter_people,
            median_trial_s=people_rows.median_trial_s(everyone),
            q=q,
            sort=sort,
            flags=monitoring.RULES,
            listed=study_rows.slice_page(people_rows.search_people(filtered, q, sort), page),
            erased=len(study_rows.tombstones(s, study.id)),
        )


@router.get("/lab/studies/{study_id}/answers")
def answers(
    request: Request,
    study_id: str,
    database: Db,
    where: Annotated[AnswerFilter, Depends()],
    page: int = 1,
) -> Response:
    """The rows behind every number of answers."""
    with database.session() as s:
        study = the_study(s, study_id)
        listed = answers_page(s, study.id, where, page)
        return study_tab(request, study, "data", "lab/answers.html", listed=listed, where=where)


@router.get("/lab/studies/{study_id}/events")
def events(
    request: Request, study_id: str, database: Db, kind: str = "", participant: str = "", page: int = 1
) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        return study_tab(
            request,
            study,
            "data",
            "lab/events.html",
            listed=study_rows.events(s, study.id, kind=kind or None, participant=participant or None, page=page),
            kinds=study_rows.event_kinds(s, study.id),
            kind=kind,
            participant=participant,
        )


@router.get("/lab/studies/{study_id}/problems")
def problems(request: Request, study_id: str, database: Db, participant: str = "") -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        reports = study_rows.problems(s, study.id, participant=participant or None)
        return study_tab(request, study, "people", "lab/problems.html", reports=reports)


@router.get("/lab/studies/{study_id}/recruit")
def recruit(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        link = f"{public_url(request)}/join/{study.recruiting_token}"
        frozen = newest_protocol(s, study)[1]
        helper = frozen.protocol.contact or contact(request)
        way_back = bool(frozen.stage(DebriefingStage).return_url)
        noted = select(func.count(), func.max(Event.at)).where(Event.study_id == study.id, Event.kind == UNFILLED)
        return study_tab(
            request,
            study,
            "recruit",
            link=link,
            loopback=_is_loopback(link),
            contact=helper,
            way_back=way_back,
            platforms=PLATFORMS,
            unfilled=s.execute(noted).one(),
        )


@router.post("/lab/studies/{study_id}/state")
def set_state(
    request: Request, study_id: str, database: Db, user: CheckedCsrf, state: Annotated[str, Form()] = ""
) -> Response:
    """Close a study to new participants, or open it again. Who has begun may finish either way."""
    if state not in ("open", "closed"):
        raise LabRefusal(422, "bad_state", state=state)
    with database.transaction() as s:
        study = the_study(s, study_id)
        if study.state != state:
            study.state = state
            log_event(s, f"study_{state}", study_id=study.id, by=user.name)
    audit_details(request, state=state)
    return RedirectResponse(f"/lab/studies/{study_id}/recruit?done=study_{state}", status_code=303)


@router.post("/lab/studies/{study_id}/pilot")
def set_pilot(
    request: Request, study_id: str, database: Db, user: CheckedCsrf, pilot: Annotated[str, Form()] = ""
) -> Response:
    """Begin or end a pilot: new participants are pilot participants or not, for good."""
    with database.transaction() as s:
        study = the_study(s, study_id)
        if study.pilot != bool(pilot):
            study.pilot = bool(pilot)
            log_event(s, "pilot_begun" if pilot else "pilot_ended", study_id=study.id, by=user.name)
    audit_details(request, pilot=bool(pilot))
    done = "pilot_begun" if pilot else "pilot_ended"
    return RedirectResponse(f"/lab/studies/{study_id}/recruit?done={done}", status_code=303)


@router.post("/lab/studies/{study_id}/retention")
def set_retention(
    request: Request, study_id: str, database: Db, user: CheckedCsrf, until: Annotated[str, Form()] = ""
) -> Response:
    """Until when the data are to be kept, as promised to the participants; empty: no date was promised."""
    try:
        day = check_day(until.strip(), utc_now())
    except ValueError:
        raise LabRefusal(422, "bad_date", value=until[:20]) from None
    with database.transaction() as s:
        the_study(s, study_id).retain_until = day
        log_event(s, "retention_changed", study_id=study_id, until=day.date().isoformat() if day else None)
    audit_details(request, until=day.date().isoformat() if day else None)
    return RedirectResponse(f"/lab/studies/{study_id}/data?done=retention_set#retention", status_code=303)


@router.get("/lab/studies/{study_id}/data")
def data(request: Request, study_id: str, database: Db) -> Response:
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = people_rows.people(s, study.id, utc_now())
        return study_tab(
            request,
            study,
            "data",
            everyone=everyone,
            pilots=len(people_rows.filter_people(everyone, "pilot")),
            overdue=is_overdue(study, utc_now()),
            shown=people_rows.filter_people,
            kinds=study_rows.answer_kinds(s, study.id),
            event_kinds=study_rows.event_kinds(s, study.id),
        )


@router.post("/lab/studies/{study_id}/export", response_class=Response, responses=answers_with("zip"))
def export(
    request: Request,
    study_id: str,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    pilots: Annotated[bool, Form()] = False,
) -> Response:
    """The data set of `desirepath studies export` as one zip file; `pilots`: with the pilot participants."""
    with database.session() as s:
        study = the_study(s, study_id)
        name = f"{study.protocol_name}-{study.id[:8]}-{utc_now():%Y%m%d-%H%M}"
    folder = Path(tempfile.mkdtemp(prefix="desirepath-export-"))
    try:
        export_study(database, files, study_id, folder / name, pilots=pilots)
        packed = shutil.make_archive(str(folder / "export"), "zip", folder, name)
        shutil.rmtree(folder / name)
        with database.transaction() as s:
            log_event(s, "study_exported", study_id=study_id, by=user.name)
        audit_details(request, pilots=pilots)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return FileResponse(
        packed,
        media_type="application/zip",
        filename=f"{name}.zip",
        background=BackgroundTask(shutil.rmtree, folder, ignore_errors=True),
    )


@router.get("/lab/data-dictionary")
def dictionary() -> Response:
    """What every column of an export means stands among the guides."""
    return RedirectResponse("/lab/guides/data-dictionary", status_code=308)


@router.get("/lab/studies/{study_id}/report")
def report(request: Request, study_id: str, database: Db, who: str = "") -> Response:
    """The summary numbers, each linked to its rows; `who`: people (of the live study), pilot or simulated, never two of
    them in one number; unless it says, the first of them that has anybody."""
    with database.session() as s:
        study = the_study(s, study_id)
        joined = study_rows.count_joined(s, study.id)
        if who not in GROUPS:
            who = next((name for name in GROUPS if joined[name]), "people")
        shown = study_report(s, study, who, utc_now())
        return study_tab(request, study, "report", report=shown, who=who, joined=joined)


@router.get("/api/lab/studies/{study_id}/report", response_model=Report)
def report_data(study_id: str, database: Db, user: SignedIn, who: str = "people") -> Report:
    """The summary numbers as data."""
    with database.session() as s:
        study = the_study(s, study_id)
        wanted = who if who in GROUPS else "people"
        return study_report(s, study, wanted, utc_now())


def _stage_keys(s: DatabaseSession, study: Study) -> list[str]:
    newest = newest_protocol(s, study)[1]
    return [stage.key for stage in describe_stages(newest.data, newest.files)]


def _is_loopback(address: str) -> bool:
    return any(f"//{host}" in address for host in ("127.0.0.1", "localhost", "[::1]"))

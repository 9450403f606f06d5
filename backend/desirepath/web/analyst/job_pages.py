"""The analysts' pages about jobs: list, launch forms, one job with its curves and log; cancel, retry, run again.

What a kind of job may be asked stands in `jobs/kinds.py`; the forms are made from that in `job_forms.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.datastructures import FormData
from starlette.responses import PlainTextResponse, RedirectResponse, Response

from desirepath.jobs.curves import Points, curves_of
from desirepath.jobs.kept_artefacts import command_of, find_artefact
from desirepath.jobs.kinds import ALIGNMENTS, ANY_POLICY, CONDITIONED, KINDS, WEIGHED, JobParamsError, Kind, get_kind
from desirepath.jobs.leases import attempts_at, kept_log
from desirepath.jobs.params import Params
from desirepath.jobs.process import FINAL_STATES, read_log
from desirepath.store.artefacts import ArtefactError
from desirepath.store.job_results import JobResult
from desirepath.store.models import Artefact, Job, JobAttempt, Study, utc_now
from desirepath.store.outbox import cancel_job, enqueue_job
from desirepath.store.shipped_policies import find_artefact as find_by_name
from desirepath.web.analyst.job_curves import draw_curves, find_job, seconds_to_go
from desirepath.web.analyst.job_forms import form_fields, read_values
from desirepath.web.analyst.job_rows import line_of, of_participant, order_jobs, params_of
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.contract import form_of, reply_of
from desirepath.web.core.dependencies import Db, TheServices, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from desirepath.web.core.permits import in_studies, may_with, seen_jobs
from desirepath.web.core.roles import Right, Rights
from desirepath.web.lab.lab_data import JobData
from desirepath.web.lab.study_rows import find_page

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])

ROWS_PER_PAGE = 50
LOG_TAIL_BYTES = 6_000


@router.get("/lab/jobs")
def jobs(
    request: Request,
    database: Db,
    state: str = "",
    kind: str = "",
    study: str = "",
    recipe: str = "",
    participant: str = "",
    sort: str = "",
    page: int = 1,
) -> Response:
    """`participant`: a code; `sort`: one of SORTS, with `-` the other way round; else newest first."""
    given = {"state": state, "kind": kind, "recipe": recipe, "study": study, "participant": participant.strip()}
    where = {name: value for name, value in {**given, "sort": sort}.items() if value}
    rights = rights_in(request)
    chosen = select(Job).where(seen_jobs(rights))
    columns = {"state": Job.state, "kind": Job.kind, "study": Job.study_id, "recipe": Job.params["recipe"].as_string()}
    for name, value in where.items():
        if name in columns:
            chosen = chosen.where(columns[name] == value)
    if "participant" in where:
        chosen = chosen.where(of_participant(where["participant"]))
    with database.session() as s:
        listed = find_page(s, order_jobs(chosen, sort), page, ROWS_PER_PAGE)
        lines = [line_of(s, job) for (job,) in listed.rows]
        used_kinds = sorted(s.scalars(select(Job.kind).where(seen_jobs(rights)).distinct()))
    template = "analyst/jobs_part.html" if request.headers.get("X-Fragment") else "analyst/jobs.html"
    return lab_page(
        request,
        template,
        lines=lines,
        where=where,
        total=listed.total,
        page=listed.page,
        pages=listed.pages,
        used_kinds=used_kinds,
        recipes=list(ALIGNMENTS),
    )


@router.get("/lab/jobs/new")
def choose_kind(request: Request) -> Response:
    rights = rights_in(request)
    return lab_page(request, "analyst/job_kinds.html", kinds=[one for one in KINDS.values() if _may(rights, one.name)])


@router.get("/lab/jobs/new/{kind_name}")
def new_job(request: Request, kind_name: str, database: Db, again: str = "", study: str = "") -> Response:
    """The launch form; `again` fills it from another job, other query parameters fill single fields."""
    kind = _kind(request, kind_name)
    known = {name for variant in kind.variants.values() for name in variant.model_fields}
    values: dict[str, Any] = {name: v for name, v in request.query_params.items() if name in known}
    with database.session() as s:
        if again:
            earlier = _seen(s, rights_in(request), again)
            values = {**earlier.params, **values}
            study = study or earlier.study_id or ""
        return _form(request, s, kind, values, study=study, again=again)


ASKED = sorted({name for kind in KINDS.values() for variant in kind.variants.values() for name in variant.model_fields})


async def read_form(request: Request) -> FormData:
    """The fields of the form that was sent, for routes that work in a thread."""
    return await request.form()


@router.post("/lab/jobs/new/{kind_name}", openapi_extra=form_of(ASKED))
def launch(
    request: Request, kind_name: str, database: Db, user: CheckedCsrf, form: Annotated[FormData, Depends(read_form)]
) -> Response:
    """Start a job; 422 with what is wrong at which field."""
    kind = _kind(request, kind_name)
    values = read_values(kind, form)
    study = str(form.get("study") or "")
    with database.transaction() as s:
        try:
            params = kind.parse(values)
            study_id = study_of_new(s, rights_in(request), _check_artefacts(s, rights_in(request), kind, params), study)
        except JobParamsError as wrong:
            return _form(request, s, kind, values, study=study, wrong=wrong, status=422)
        job = enqueue_job(s, kind.name, params.asked(), study_id=study_id, created_by=user.name)
    audit_details(request, job_id=job.id)
    return RedirectResponse(f"/lab/jobs/{job.id}", status_code=303)


@router.get("/lab/jobs/{job_id}")
def job_page(request: Request, job_id: str, database: Db) -> Response:
    with database.session() as s:
        job = find_job(s, job_id)
        return lab_page(
            request,
            "analyst/job.html",
            params=params_of(s, rights_in(request), job, find_made(s, job)),
            **_live(request, s, job),
        )


@router.get("/lab/jobs/{job_id}/live")
def job_live(request: Request, job_id: str, database: Db) -> Response:
    """The part of a job's page that changes while it runs."""
    with database.session() as s:
        return lab_page(request, "analyst/job_live.html", **_live(request, s, find_job(s, job_id)))


@router.get("/api/lab/jobs/{job_id}", response_model=JobData)
def job_state(job_id: str, database: Db) -> Response:
    """The job as data, its curves included."""
    with database.session() as s:
        job = find_job(s, job_id)
        now = {
            "job": job.id,
            "kind": job.kind,
            "state": job.state,
            "progress": job.progress,
            "message": job.message,
            "error": job.error,
            "params": job.params,
            "result": job.result,
            "attempts": [
                {**_attempt(attempt), "began_at": attempt.began_at.isoformat()} for attempt in attempts_at(s, job.id)
            ],
            "curves": {name: _together(lines) for name, lines in curves_of(s, job.id).items()},
        }
    return reply_of(JobData, now)


@router.post("/lab/jobs/{job_id}/cancel")
def cancel(job_id: str, database: Db, user: CheckedCsrf) -> Response:
    with database.transaction() as s:
        find_job(s, job_id)
        try:
            cancel_job(s, job_id, by=user.name)
        except ValueError:
            raise LabRefusal(409, "job_ended") from None
    return RedirectResponse(f"/lab/jobs/{job_id}", status_code=303)


@router.post("/lab/jobs/{job_id}/retry")
def retry(request: Request, job_id: str, database: Db, user: CheckedCsrf) -> Response:
    """The same job once more, as a new one that names the old one. A session that waited for the old one goes on
    without it, so the new one belongs to the study only."""
    with database.transaction() as s:
        old = find_job(s, job_id)
        if old.state not in FINAL_STATES:
            raise LabRefusal(409, "job_not_ended")
        _require_right(request, old.kind)
        new = enqueue_job(s, old.kind, old.params, study_id=old.study_id, created_by=user.name, retry_of=old.id)
    audit_details(request, new_job=new.id)
    return RedirectResponse(f"/lab/jobs/{new.id}", status_code=303)


@router.get("/lab/jobs/{job_id}/log.txt")
def log(job_id: str, database: Db, services: TheServices) -> Response:
    with database.session() as s:
        find_job(s, job_id)
        kept = kept_log(attempts_at(s, job_id))
    return PlainTextResponse(read_log(services.settings, job_id, last_bytes=5_000_000) or kept)


def find_made(s: DatabaseSession, job: Job) -> list[Artefact]:
    """What a job made, in the order its result names it; artefacts that were erased since are not among them."""
    result = job.result_as(JobResult)
    ids = result.made if result is not None else []
    return [found for found in (s.get(Artefact, artefact_id) for artefact_id in ids) if found is not None]


def _policies(found: Iterable[Artefact]) -> list[Artefact]:
    """Those that drive, which a picture can be drawn of."""
    return [one for one in found if one.kind in ANY_POLICY.split("|") and one.quarantined_at is None]


def _named_by(request: Request, s: DatabaseSession, job: Job) -> list[Artefact]:
    """The artefacts that a job works on, as far as one may look at them."""
    named = [value for value in job.params.values() if isinstance(value, str)]
    found = [artefact for value in named if (artefact := find_by_name(s, value)) is not None]
    return [one for one in found if may_with(s, rights_in(request), Right.LOOK, one)]


def _together(lines: Mapping[str, Points]) -> list[list[float]]:
    """All points of a curve in order; of a step with raw and averaged weights the raw one's first."""
    return [list(point) for point in sorted(chain.from_iterable(lines.values()), key=lambda point: point[0])]


def _attempt(one: JobAttempt) -> dict[str, Any]:
    """Who worked on a job, and how that ended."""
    return {
        "machine": one.machine,
        "worker": one.worker,
        "began_at": one.began_at,
        "seconds": None if one.ended_at is None else max(0.0, (one.ended_at - one.began_at).total_seconds()),
        "outcome": one.outcome or "running",
    }


def _kind(request: Request, name: str) -> Kind:
    """A kind that has a form, and that one may start; tasks of sweeps have none."""
    if name not in KINDS:
        raise LabRefusal(404, "no_job_kind", name=name)
    _require_right(request, name)
    return KINDS[name]


def _require_right(request: Request, kind: str) -> None:
    if not _may(rights_in(request), kind):
        raise LabRefusal(403, "role", role=request.state.sign_in.role)


def _may(rights: Rights, kind: str) -> bool:
    """Whether jobs of that kind may be started by who may start jobs: setups are the installation's."""
    return kind != "train_setup" or rights.may(Right.EQUIP)


def _seen(s: DatabaseSession, rights: Rights, job_id: str) -> Job:
    """A job that may be looked at; others are not there."""
    job = s.scalar(select(Job).where(Job.id == job_id, seen_jobs(rights)))
    if job is None:
        raise LabRefusal(404, "no_job")
    return job


def study_of_new(s: DatabaseSession, rights: Rights, learns_from: str | None, asked: str) -> str | None:
    """The study that a new job belongs to: that of what it works on, else the one that was asked for. Who may start
    jobs in some studies only has every job in one of them."""
    if learns_from is not None:
        return learns_from
    if asked and rights.may(Right.ANALYSE, asked) and s.get(Study, asked) is not None:
        return asked
    studies = in_studies(rights, Study.id, Right.ANALYSE)
    newest = select(Study.id).where(studies).order_by(Study.created_at.desc())
    return None if rights.studies(Right.ANALYSE) is None else s.scalars(newest).first()


def studies_to_keep_in(s: DatabaseSession, rights: Rights) -> list[tuple[str, str]]:
    """(id, name), newest first, of the studies to which something brought may belong; first an empty id, of none, for
    who may start jobs in all."""
    rows = select(Study.id, Study.name).where(in_studies(rights, Study.id, Right.ANALYSE))
    found = [(one.id, one.name) for one in s.execute(rows.order_by(Study.created_at.desc()))]
    return [("", ""), *found] if rights.studies(Right.ANALYSE) is None else found


def _form(
    request: Request,
    s: DatabaseSession,
    kind: Kind,
    values: Mapping[str, Any],
    *,
    study: str,
    again: str = "",
    wrong: JobParamsError | None = None,
    status: int = 200,
) -> Response:
    fields = form_fields(s, kind, values, rights_in(request), wrong)
    known = {field.name for field in fields}
    others = [p for p in wrong.problems if p["field"].split(".")[0] not in known] if wrong else []
    return lab_page(
        request,
        "analyst/job_form.html",
        status=status,
        kind=kind,
        fields=fields,
        algorithms=list(kind.variants) if kind.union is not None else [],
        algorithm=kind.algorithm_of(values),
        study=study,
        keep_in=studies_to_keep_in(s, rights_in(request)),
        again=again,
        wrong=wrong,
        others=others,
    )


def _check_artefacts(s: DatabaseSession, rights: Rights, kind: Kind, params: Params) -> str | None:
    """Refuse artefacts that are not there, are another study's, or do not belong together now, not minutes later in the
    log. Returns the study that the answers come from, where there is one."""
    problems: list[dict[str, Any]] = []
    setups: dict[str, str] = {}
    kinds: dict[str, str] = {}
    study: str | None = None
    for name, info in type(params).model_fields.items():
        extra = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
        given = getattr(params, name)
        if "artefact" not in extra or given is None:
            continue
        for one in given if isinstance(given, tuple) else (given,):
            try:
                artefact = find_artefact(s, one, str(extra["artefact"]))
                if not may_with(s, rights, Right.ANALYSE, artefact):
                    raise LookupError(f"{artefact.name!r} belongs to a study in which your role starts no jobs")
            except (ArtefactError, LookupError, ValueError) as problem:
                problems.append(_problem(name, one, "other", str(problem)))
                continue
            setups.setdefault(artefact.setup, name)
            kinds[name] = artefact.kind
            study = study or artefact.study_id
    for name, info in type(params).model_fields.items():
        extra = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
        of = str(extra.get("weights_of", ""))
        if of and getattr(params, name) and kinds.get(of, CONDITIONED) not in WEIGHED:
            problems.append(_problem(name, getattr(params, name), "other", f"{of} takes none: it is not conditioned"))
    if len(setups) > 1:
        named = ", ".join(f"{name}: {setup}" for setup, name in setups.items())
        problems.append(_problem(list(setups.values())[-1], "", "setups", named))
    if problems:
        raise JobParamsError(kind.name, problems)
    return study


def _problem(field: str, value: object, type_: str, message: str) -> dict[str, Any]:
    return {"field": field, "value": value, "message": message, "type": type_, "limits": {}}


def _command(job: Job) -> str | None:
    try:
        return command_of(job.kind, get_kind(job.kind).parse(job.params))
    except JobParamsError:
        return None


def _live(request: Request, s: DatabaseSession, job: Job) -> dict[str, Any]:
    t = services_of(request).texts.get(lab_language(request))
    waiting_before = 0
    if job.state == "queued":
        earlier = select(func.count()).select_from(Job).where(Job.state == "queued", Job.created_at < job.created_at)
        waiting_before = s.scalar(earlier) or 0
    attempts, made = attempts_at(s, job.id), find_made(s, job)
    settings = services_of(request).settings
    return {
        "line": line_of(s, job),
        "job": job,
        "made": made,
        "drawn": _policies(made) or _policies(_named_by(request, s, job)),
        "curves": draw_curves(t, s, job),
        "to_go": seconds_to_go(job, utc_now()),
        "attempts": [_attempt(attempt) for attempt in attempts],
        "log": read_log(settings, job.id, last_bytes=LOG_TAIL_BYTES) or kept_log(attempts),
        "waiting_before": waiting_before,
        "known_kind": job.kind in KINDS,
        "command": _command(job),
    }

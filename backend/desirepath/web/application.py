"""Puts the rooms together into the two ASGI applications: the pages, and the door of the 3D stage."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import structlog
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.staticfiles import StaticFiles
from fastapi.templating import Jinja2Templates
from sqlalchemy.exc import DataError
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from desirepath.installed import FRONTEND
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database, DatabaseBusy, check_writable, is_full
from desirepath.store.places import StoreAway
from desirepath.store.plain_data import Unstorable
from desirepath.store.shipped_policies import came_with_product
from desirepath.study.refusals import Refused
from desirepath.web.core import plug_ins
from desirepath.web.core.artefact_names import artefact_name, study_name
from desirepath.web.core.catalogues import Texts
from desirepath.web.core.contract import trouble_in
from desirepath.web.core.dependencies import Application, Services, route_of
from desirepath.web.core.figure_process import FigureProcess
from desirepath.web.core.guides import prose
from desirepath.web.core.heads import BoundedHeads
from desirepath.web.core.monitoring import Monitoring
from desirepath.web.core.openid import OpenId
from desirepath.web.core.throttle import TooLarge, limiter_for
from desirepath.web.lab.power_runs import PowerRuns
from desirepath.web.lab.whole_reports import Reports
from desirepath.web.participant.joining_together import Doors
from desirepath.web.participant.requests import refusal_page
from desirepath.web.replicas.notices import notices_for
from desirepath.web.replicas.peers import Peers
from desirepath.web.replicas.shared_limits import SharedCounts
from desirepath.web.robot.mirror import Mirror
from desirepath.web.stage.admission import Admission
from desirepath.web.stage.listening import Listeners
from desirepath.web.stage.presenting import Presenter
from desirepath.web.stage.replay_stages import ReplayStages
from desirepath.web.stage.stage_proxy import INNER, StageDoor

RETRY_AFTER_S = 2  # ours: sent with a 503; the pages, bots and benchmarks wait as long and ask again
log = structlog.get_logger("desirepath.web")


@cache
def _texts() -> Texts:
    """Read once in a process, however many services it builds; so are templates compiled."""
    return Texts(FRONTEND / "locales", plug_ins.text_files)


@cache
def _templates() -> Jinja2Templates:
    templates = Jinja2Templates(FRONTEND / "templates")
    if templates.env.loader is not None:
        templates.env.loader = plug_ins.with_step_templates(templates.env.loader)
    templates.env.trim_blocks = templates.env.lstrip_blocks = True
    templates.env.filters["prose"] = prose
    templates.env.filters["artefact_name"] = artefact_name
    templates.env.filters["study_name"] = study_name
    templates.env.tests["came_with_product"] = came_with_product
    return templates


def build_services(settings: Settings) -> Services:
    """Open data folder, database (migrated) and artefact store. Raises StorageError with what to do about it."""
    check_writable(settings.data)
    database = Database(settings.database)
    database.migrate()
    files, notices = ArtefactStore(settings.artefacts), notices_for(database)
    counts = SharedCounts(database) if notices.shared else None
    peers = Peers(database, notices, counts)
    replays, listeners = ReplayStages(peers), Listeners(notices)
    return Services(
        settings=settings,
        database=database,
        files=files,
        texts=_texts(),
        templates=_templates(),
        limiter=limiter_for(counts),
        notices=notices,
        peers=peers,
        mirror=Mirror(notices),
        replays=replays,
        figures=FigureProcess(),
        reports=Reports(settings),
        power=PowerRuns(settings),
        doors=Doors(database, files),
        monitoring=Monitoring(),
        openid=OpenId(settings) if settings.openid_issuer else None,
        presenter=Presenter(database, files, replays, listeners, notices),
        listeners=listeners,
        admission=Admission(settings, database, replays),
    )


def _serving(script: Path) -> Callable[[Request], Response]:
    return lambda _: FileResponse(script, media_type="text/javascript")


def create_application(services: Services) -> Application:
    """The pages and their API. Routes find everything they need in `dependencies.services_of`."""
    from desirepath.web.analyst import (
        artefact_pages,
        attention_pages,
        compare_pages,
        demonstration_pages,
        explanation_pages,
        flow_pages,
        job_curves,
        job_pages,
        live_pages,
        policy_files,
        recording_pages,
        reward_files,
        upkeep_pages,
        video_pages,
    )
    from desirepath.web.core import auth, published, server_routes
    from desirepath.web.core.guard import Guard, trouble
    from desirepath.web.lab import account_pages, learnt_pages, openid_pages, setup_pages, sign_in_pages, study_pages
    from desirepath.web.participant import session_pages
    from desirepath.web.robot import robot_requests

    application = Application(
        services, title="Desire Path", version="1", docs_url=None, redoc_url=None, openapi_url=None
    )
    for kind, script in plug_ins.scripts().items():
        application.router.routes.append(Route(f"/static/js/kinds/{kind}.js", _serving(script)))
    application.mount("/static", StaticFiles(directory=FRONTEND / "static"), name="static")
    lab = (sign_in_pages, openid_pages, account_pages, setup_pages, study_pages, learnt_pages)
    policies = (compare_pages, flow_pages, explanation_pages, live_pages, attention_pages)
    foreign = (policy_files, reward_files, recording_pages, video_pages)
    analyst = (job_curves, job_pages, artefact_pages, *policies, demonstration_pages, *foreign, upkeep_pages)
    for module in (session_pages, *lab, *analyst, robot_requests, published, server_routes):
        application.include_router(module.router)
    application.include_router(openid_pages.behind)
    for exception, handler in (auth.exception_handlers | {Refused: refusal_page}).items():
        application.add_exception_handler(exception, handler)

    @application.exception_handler(HTTPException)
    def http(request: Request, problem: HTTPException) -> Response:
        if problem.status_code == 404:
            return trouble(request, 404, "not_found", "There is nothing at this address.")
        if is_full(problem):  # an upload that found no room on its way in, which FastAPI calls the sender's fault
            return no_room(request, problem)
        return trouble(request, problem.status_code, "refused", str(problem.detail), headers=problem.headers)

    @application.exception_handler(RequestValidationError)
    def bad_value(request: Request, problem: RequestValidationError) -> Response:
        found = trouble_in(problem.errors())
        return trouble(request, 422, found.code, found.message, field=found.field, value=found.value)

    @application.exception_handler(DataError)
    def not_storable(request: Request, problem: Exception) -> Response:
        log.warning("a value fits into no column", route=route_of(request), problem=str(problem)[:300])
        return trouble(request, 422, "bad_value", "Something that was sent is too long or no text; nothing was stored.")

    @application.exception_handler(Unstorable)
    def too_deep(request: Request, problem: Exception) -> Response:
        return trouble(request, 422, "bad_value", f"{problem}; nothing was stored", field="body")

    @application.exception_handler(TooLarge)
    def too_large(request: Request, problem: TooLarge) -> Response:
        return trouble(request, 413, "too_large", problem.detail)

    @application.exception_handler(DatabaseBusy)
    def busy(request: Request, problem: Exception) -> Response:
        log.warning("the database was busy", route=route_of(request), problem=str(problem))
        response = trouble(request, 503, "busy", "Too much is going on here right now; nothing was stored. Try again.")
        response.headers["Retry-After"] = str(RETRY_AFTER_S)
        return response

    @application.exception_handler(StoreAway)
    def files_away(request: Request, problem: Exception) -> Response:
        log.error("the artefact store does not answer", route=route_of(request), problem=str(problem)[:300])
        message = "The server's store of files does not answer; nothing was stored. Try again."
        return trouble(request, 503, "files_away", message, headers={"Retry-After": str(RETRY_AFTER_S)})

    @application.exception_handler(OSError)
    def disk_full(request: Request, problem: OSError) -> Response:
        if not is_full(problem):
            raise problem
        return no_room(request, problem)

    def no_room(request: Request, problem: Exception) -> Response:
        log.error("the disk is full", route=route_of(request), problem=str(problem)[:300])
        message = "The disk of the server is full; nothing was stored. Try again once there is room."
        return trouble(request, 507, "disk_full", message, headers={"Retry-After": str(RETRY_AFTER_S)})

    application.add_middleware(Guard)
    application.add_middleware(BoundedHeads)
    return application


def create_stage_application(services: Services, *, inner: bool = False) -> ASGIApp:
    """The door as an ASGI application of its own, for the stage's port. inner: for the other server processes of this
    installation, which come for replays."""
    server, admission = services.presenter.server, services.admission
    if server is None:
        raise RuntimeError("the stage server has to be started before its door")
    door = StageDoor(
        admit=admission.admit_peer if inner else admission.admit,
        upstream_url=server.upstream_url,
        origins=(lambda _host: INNER) if inner else admission.origins,
        on_refused=admission.on_refused,
    )
    return door.asgi()

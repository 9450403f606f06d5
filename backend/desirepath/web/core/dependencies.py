"""What every route may ask for: the running services, a rendered page, where the stage lives. No route lives here."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import urlsplit

from fastapi import Depends, FastAPI, Request
from fastapi.templating import Jinja2Templates
from starlette.responses import HTMLResponse

from desirepath.settings import Settings, in_url
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Setting
from desirepath.web.core.addresses import safe_base_url

if TYPE_CHECKING:
    from limits.strategies import RateLimiter

    from desirepath.web.core.catalogues import Texts
    from desirepath.web.core.figure_process import FigureProcess
    from desirepath.web.core.monitoring import Monitoring
    from desirepath.web.core.openid import OpenId
    from desirepath.web.lab.power_runs import PowerRuns
    from desirepath.web.lab.whole_reports import Reports
    from desirepath.web.participant.joining_together import Doors
    from desirepath.web.replicas.notices import Notices
    from desirepath.web.replicas.peers import Peers
    from desirepath.web.robot.mirror import Mirror
    from desirepath.web.stage.admission import Admission
    from desirepath.web.stage.listening import Listeners
    from desirepath.web.stage.presenting import Presenter
    from desirepath.web.stage.replay_stages import ReplayStages


@dataclass
class Services:
    """Everything one running server is made of; put together by `application.build_services`."""

    settings: Settings
    database: Database
    files: ArtefactStore
    texts: Texts
    templates: Jinja2Templates
    limiter: RateLimiter
    notices: Notices
    peers: Peers
    mirror: Mirror
    replays: ReplayStages
    figures: FigureProcess
    reports: Reports
    power: PowerRuns
    doors: Doors
    monitoring: Monitoring
    openid: OpenId | None
    presenter: Presenter
    listeners: Listeners
    admission: Admission
    prepared: threading.Event = field(default_factory=threading.Event)  # all is loaded that visitors wait for
    brings_example: bool = False  # the example study is on its way


class Application(FastAPI):
    """The pages' application, which knows the services that its routes work with."""

    def __init__(self, services: Services, **options: Any) -> None:
        super().__init__(**options)
        self.services = services


def services_of(request: Request) -> Services:
    """The services of the server that was asked."""
    application = request.app
    if not isinstance(application, Application):
        raise TypeError(f"{application!r} is no Application: it has no services")
    return application.services


# Coroutines, because FastAPI sends every other dependency through a thread of its own.


async def _services(request: Request) -> Services:
    return services_of(request)


async def _database(request: Request) -> Database:
    return services_of(request).database


async def _files(request: Request) -> ArtefactStore:
    return services_of(request).files


TheServices = Annotated[Services, Depends(_services)]


Db = Annotated[Database, Depends(_database)]
Files = Annotated[ArtefactStore, Depends(_files)]


def route_of(request: Request) -> str:
    """The route's pattern (`/p/{token}`), never the path itself: a path can hold somebody's token."""
    return getattr(request.scope.get("route"), "path", "(no route)")


def public_url(request: Request) -> str:
    """Address of the pages without a trailing slash, to be handed on: as it is set in the browser, else in the
    environment, else as the browser asked where that can be ours."""
    services = services_of(request)
    with services.database.session() as s:
        row = s.get(Setting, "public_url")
        stored = str(row.value.get("url", "")) if row else ""
    return (stored or services.settings.public_url or safe_base_url(request)).rstrip("/")


def contact(request: Request) -> str:
    """Whom participants can ask for help: the setting made in the browser, else the environment's."""
    services = services_of(request)
    with services.database.session() as s:
        row = s.get(Setting, "contact")
        return (str(row.value.get("text", "")) if row else "") or services.settings.contact


def stage_origin(request: Request) -> str:
    """Origin of the 3D stage: the environment's, else the next port of the host the browser asked for."""
    settings = services_of(request).settings
    if settings.public_stage_url:
        return settings.public_stage_url.rstrip("/")
    asked = urlsplit(str(request.base_url))
    return f"{asked.scheme}://{in_url(asked.hostname or '')}:{settings.port + 1}"


def page(request: Request, template: str, *, language: str = "en", status: int = 200, **context: Any) -> HTMLResponse:
    """Render `frontend/templates/TEMPLATE`; the template has `t(key, **values)`, `language` and `stage_origin`."""
    services = services_of(request)
    return services.templates.TemplateResponse(
        request,
        template,
        {
            "t": services.texts.get(language),
            "language": language,
            "stage_origin": stage_origin(request),
            **context,
        },
        status_code=status,
    )

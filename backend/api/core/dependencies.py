"""What every route may ask for: the house's parts, a rendered page, where the stage lives. No route lives here."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, TypeVar
from urllib.parse import urlsplit

from fastapi import Depends, Request
from fastapi.templating import Jinja2Templates
from starlette.responses import HTMLResponse

from backend.settings import Settings
from backend.store.artefacts import ArtefactStore
from backend.store.database import Database
from backend.store.models import Setting

if TYPE_CHECKING:
    from app.server import StageServer
    from backend.api.core.texts import Texts


T = TypeVar("T")


@dataclass
class House:
    """Everything one running server is made of; hangs on `app.state.house`."""

    settings: Settings
    database: Database
    files: ArtefactStore
    texts: Texts
    templates: Jinja2Templates
    stage: StageServer | None = None
    extras: dict[str, Any] = field(default_factory=dict)
    _making: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def part(self, name: str, make: Callable[[], T]) -> T:
        """The house's own part of this name, made at its first use. From any thread."""
        if name not in self.extras:
            with self._making:
                if name not in self.extras:
                    self.extras[name] = make()
        found: T = self.extras[name]
        return found


def house(request: Request) -> House:
    """The running house. Also reachable from websockets through `app.state.house`."""
    found: House = request.app.state.house
    return found


# Coroutines, because FastAPI sends every other dependency through a thread of its own.


async def _house(request: Request) -> House:
    return house(request)


async def _database(request: Request) -> Database:
    return house(request).database


async def _files(request: Request) -> ArtefactStore:
    return house(request).files


TheHouse = Annotated[House, Depends(_house)]


Db = Annotated[Database, Depends(_database)]
Files = Annotated[ArtefactStore, Depends(_files)]


def route_of(request: Request) -> str:
    """The route's pattern (`/p/{token}`), never the path itself: a path can hold somebody's token."""
    return getattr(request.scope.get("route"), "path", "(no route)")


def public_url(request: Request) -> str:
    """Address of the pages without a trailing slash: the setting, else the environment's, else as the browser asked."""
    parts = house(request)
    with parts.database.session() as s:
        row = s.get(Setting, "public_url")
        stored = str(row.value.get("url", "")) if row else ""
    return (stored or parts.settings.public_url or str(request.base_url)).rstrip("/")


def contact(request: Request) -> str:
    """Whom participants can ask for help: the setting made in the browser, else the environment's."""
    parts = house(request)
    with parts.database.session() as s:
        row = s.get(Setting, "contact")
        return (str(row.value.get("text", "")) if row else "") or parts.settings.contact


def stage_origin(request: Request) -> str:
    """Origin of the 3D stage: the environment's, else the next port of the host the browser asked for."""
    settings = house(request).settings
    if settings.public_stage_url:
        return settings.public_stage_url.rstrip("/")
    asked = urlsplit(str(request.base_url))
    return f"{asked.scheme}://{asked.hostname}:{settings.port + 1}"


def page(request: Request, template: str, *, language: str = "en", status: int = 200, **context: Any) -> HTMLResponse:
    """Render `frontend/templates/TEMPLATE`; the template has `t(key, **values)`, `language` and `stage_origin`."""
    parts = house(request)
    return parts.templates.TemplateResponse(
        request,
        template,
        {
            "t": parts.texts.get(language),
            "language": language,
            "stage_origin": stage_origin(request),
            **context,
        },
        status_code=status,
    )

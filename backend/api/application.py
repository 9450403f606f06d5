"""Puts the rooms together into the two ASGI applications: the pages, and the door of the 3D stage."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import structlog
from fastapi import FastAPI, Request
from fastapi.staticfiles import StaticFiles
from fastapi.templating import Jinja2Templates
from starlette.responses import JSONResponse, RedirectResponse, Response

from backend.api.dependencies import House, house, page, stage_origin
from backend.api.prose import prose
from backend.api.texts import Texts
from backend.api.throttle import BodyLimit, TooLarge, declared_too_large
from backend.settings import Settings
from backend.store.artefacts import ArtefactStore
from backend.store.database import Database, DatabaseBusy, check_writable

FRONTEND = Path(__file__).resolve().parents[2] / "frontend"
RETRY_AFTER_S = 2  # ours: told with a 503; the pages, bots and benchmarks wait as long and ask again
log = structlog.get_logger("desirepath.web")


def build_house(settings: Settings) -> House:
    """Open data folder, database (migrated) and artefact store. Raises StorageError with what to do about it."""
    check_writable(settings.data)
    database = Database(settings.database)
    database.migrate()
    templates = Jinja2Templates(FRONTEND / "templates")
    templates.env.trim_blocks = templates.env.lstrip_blocks = True
    templates.env.filters["prose"] = prose
    return House(
        settings=settings,
        database=database,
        files=ArtefactStore(settings.artefacts),
        texts=Texts(FRONTEND / "locales"),
        templates=templates,
    )


def create_application(house: House) -> FastAPI:
    """The pages and their API. Everything a route needs hangs on `app.state.house`."""
    from backend.api import analyst, auth, experimenter, participant

    application = FastAPI(title="Desire Path", version="1", docs_url=None, redoc_url=None, openapi_url=None)
    application.state.house = house
    application.mount("/static", StaticFiles(directory=FRONTEND / "static"), name="static")
    for module in (participant, auth, experimenter, analyst):
        application.include_router(module.router)
        for exception, handler in getattr(module, "exception_handlers", {}).items():
            application.add_exception_handler(exception, handler)

    @application.get("/", include_in_schema=False)
    def home() -> Response:
        return RedirectResponse("/lab/studies", status_code=303)

    @application.get("/health")
    def health() -> dict[str, str]:
        """For load balancers and containers."""
        with house.database.session() as s:
            s.connection().exec_driver_sql("SELECT 1")
        return {"status": "ok"}

    @application.exception_handler(404)
    def not_found(request: Request, _: Exception) -> Response:
        return _trouble(request, 404, "not_found", "There is nothing at this address.")

    @application.exception_handler(TooLarge)
    def too_large(request: Request, _: Exception) -> Response:
        return _trouble(request, 413, "too_large", TooLarge().detail)

    @application.exception_handler(DatabaseBusy)
    def busy(request: Request, problem: Exception) -> Response:
        log.warning("the database was busy", route=_route(request), problem=str(problem))
        response = _trouble(request, 503, "busy", "Too much is going on here right now; nothing was stored. Try again.")
        response.headers["Retry-After"] = str(RETRY_AFTER_S)
        return response

    application.add_middleware(BodyLimit)

    @application.middleware("http")
    async def guard(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:
        """Security headers, and an access log that holds neither tokens nor query strings."""
        began = time.perf_counter()
        try:
            if declared_too_large(request):
                response = _trouble(request, 413, "too_large", TooLarge().detail)
            else:
                response = await call_next(request)
        except Exception:
            log.exception("request failed", method=request.method, route=_route(request))
            response = _trouble(request, 500, "internal", "Something went wrong here; it was written to the log.")
        headers = response.headers
        headers.setdefault(
            "Content-Security-Policy",
            f"default-src 'self'; img-src 'self' data: blob:; frame-src {stage_origin(request)}; "
            "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'",
        )
        headers.setdefault("X-Content-Type-Options", "nosniff")
        headers.setdefault("Referrer-Policy", "no-referrer")
        headers.setdefault("Permissions-Policy", "camera=(), microphone=(), geolocation=()")
        if not request.url.path.startswith("/static"):
            headers.setdefault("Cache-Control", "no-store")
            log.info(
                "request",
                method=request.method,
                route=_route(request),
                status=response.status_code,
                ms=round((time.perf_counter() - began) * 1000, 1),
            )
        return response

    return application


def _trouble(request: Request, status: int, code: str, message: str) -> Response:
    """A page for people, JSON for scripts. Reads no table: it has to work when the store does not."""
    if request.url.path.startswith(("/api/", "/static/")):
        return JSONResponse({"error": {"code": code, "message": message}}, status)
    parts = house(request)
    language = parts.texts.best(request.headers.get("Accept-Language"))
    contact = parts.settings.contact
    return page(request, "participant/refusal.html", language=language, status=status, code=code, contact=contact)


def _route(request: Request) -> str:
    """The route's pattern (`/p/{token}`), never the path itself: a path can hold somebody's token."""
    return getattr(request.scope.get("route"), "path", "(no route)")

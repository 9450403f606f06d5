"""The door to the stage: the only way from a browser to viser, on an origin of its own.

Admission is asked of the caller (`admit`); the rules for what passes are here. No study logic, no other pages.
The stage needs `unsafe-eval`, so it must not share an origin with our pages: serve it on a port or host name of its
own, without websocket compression (geometry is compressed already, and it costs a core).
"""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass

import websockets
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from desirepath.web.core.addresses import STRICT_TRANSPORT, insists_on_tls, permissions, policy_source
from desirepath.web.core.heads import BoundedHeads
from desirepath_stage import viser_hooks
from desirepath_stage.page import stage_page

MESSAGES_PER_S = 20.0  # a page of ours sends one message per connection; the rest is room for reconnects
MESSAGES_BURST = 40.0
REFUSALS_BEFORE_CLOSING = 100  # a client that goes on sending what it may not is dropped
TOKEN_PREFIX_LENGTH = 6

_TOKEN = re.compile(r"[A-Za-z0-9_.~-]{1,400}")
_POLICY_VIOLATION, _GOING_AWAY = 1008, 1001


@dataclass(frozen=True)
class StageGrant:
    """Admission to one stage. key: which one, the same that `StageServer.on_connect` is told. kept_at: host and port of
    the other process that has it, None: this one."""

    key: str
    kept_at: str | None = None


@dataclass(frozen=True)
class Origins:
    """Where the pages and the stage live, each like "https://study.example:8443"."""

    page: str
    stage: str


INNER = Origins("http://inner", "http://inner")  # what processes of one installation say to each other's doors

Admit = Callable[[str, Mapping[str, str], str | None], Awaitable[StageGrant | None]]
OnRefused = Callable[[str, str], None]
OriginsOf = Callable[[str], Origins | None]


class _Allowance:
    """A token bucket: `MESSAGES_PER_S` on average, `MESSAGES_BURST` at once."""

    def __init__(self) -> None:
        self._left, self._at = MESSAGES_BURST, time.monotonic()

    def take(self) -> bool:
        now = time.monotonic()
        self._left = min(MESSAGES_BURST, self._left + (now - self._at) * MESSAGES_PER_S)
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


class _WithoutBodies:
    """Turns away requests that bring a body and closes their connection: nothing here reads one."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            headers = Headers(scope=scope)
            if headers.get("content-length", "0") != "0" or "transfer-encoding" in headers:
                refusal = PlainTextResponse("The stage takes no body.", 413, headers={"Connection": "close"})
                await refusal(scope, receive, send)
                return
        await self._app(scope, receive, send)


class StageDoor:
    """Serves `/stage/{token}/` and its websocket. Build once, mount with `asgi()`."""

    def __init__(
        self,
        *,
        admit: Admit,
        upstream_url: Callable[[str], str],
        origins: OriginsOf,
        on_refused: OnRefused,
    ) -> None:
        """admit(token, cookies, origin): a grant or None; `origin` is None for the page itself, which has none.

        upstream_url(key): viser's websocket address (`StageServer.upstream_url`). origins(host): where page and stage
        live for a request with that Host header, None for a name that is not ours. on_refused(reason, token_prefix):
        for the log, which must never see a whole token.
        """
        self._admit, self._upstream_url = admit, upstream_url
        self._origins, self._on_refused = origins, on_refused

    def asgi(self) -> Starlette:
        """The door as an ASGI application."""
        return Starlette(
            routes=[
                Route("/stage/{token}/", self._page, methods=["GET"]),
                WebSocketRoute("/stage/{token}", self._websocket),
            ],
            middleware=[Middleware(BoundedHeads), Middleware(_WithoutBodies)],
        )

    def _refused(self, reason: str, token: str) -> None:
        self._on_refused(reason, token[:TOKEN_PREFIX_LENGTH])

    async def _page(self, request: Request) -> Response:
        token = request.path_params["token"]
        origins = self._origins(request.headers.get("host", ""))
        if origins is None:
            self._refused("page: unknown host name", token)
            return PlainTextResponse("This address does not serve a stage.", 404)
        if request.url.query:  # viser's page would take another server's address from there
            self._refused("page: address with a query", token)
            return PlainTextResponse("The stage's address takes no query.", 400)
        grant = await self._admit(token, request.cookies, None) if _TOKEN.fullmatch(token) else None
        if grant is None:
            self._refused("page: not admitted", token)
            return PlainTextResponse("This link is not valid here, or no longer. Please reload the study page.", 403)
        websocket_origin = "ws" + origins.stage.removeprefix("http")
        policy = {
            "default-src": "'none'",
            "script-src": "'unsafe-inline' 'unsafe-eval' blob: data:",
            "worker-src": "blob: data:",
            "style-src": "'unsafe-inline'",
            "img-src": "data: blob:",
            "font-src": "data:",
            "connect-src": f"{policy_source(websocket_origin)} blob: data:",
            "frame-ancestors": policy_source(origins.page),
            "base-uri": "'none'",
            "form-action": "'none'",
        }
        page = stage_page(origins.page)
        known = page.etag in request.headers.get("if-none-match", "")
        return Response(
            b"" if known else page.html,
            status_code=304 if known else 200,
            media_type="text/html",
            headers={
                "Content-Security-Policy": "; ".join(f"{name} {value}" for name, value in policy.items()),
                "Cache-Control": "private, no-cache",  # kept, but admission is asked every time
                "ETag": page.etag,
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
                "Cross-Origin-Resource-Policy": "same-site",
                "Permissions-Policy": permissions(),
                **(dict([STRICT_TRANSPORT]) if insists_on_tls(request) else {}),
            },
        )

    async def _websocket(self, socket: WebSocket) -> None:
        token = socket.path_params["token"]
        origins = self._origins(socket.headers.get("host", ""))
        origin = socket.headers.get("origin")
        grant = None
        reason = "websocket: not admitted"
        if origins is None:
            reason = "websocket: unknown host name"
        elif origin != origins.stage:
            reason = f"websocket: wrong origin {origin!r}"[:120]
        elif viser_hooks.SUBPROTOCOL not in socket.scope["subprotocols"]:
            reason = "websocket: wrong subprotocol"
        elif not _TOKEN.fullmatch(token):
            reason = "websocket: malformed token"
        else:
            grant = await self._admit(token, socket.cookies, origin)
        if grant is None:
            self._refused(reason, token)
            await socket.close(_POLICY_VIOLATION)
            return
        inner = grant.kept_at and f"ws://{grant.kept_at}/stage/{token}"
        try:
            upstream = await websockets.connect(
                inner or self._upstream_url(grant.key),
                origin=websockets.Origin(INNER.stage) if inner else None,
                subprotocols=[websockets.Subprotocol(viser_hooks.SUBPROTOCOL)],
                compression=None,
                max_size=None,
                open_timeout=5,
            )
        except (OSError, TimeoutError, websockets.exceptions.WebSocketException):
            self._refused("websocket: the stage server does not answer", token)
            await socket.close(_GOING_AWAY)
            return
        async with upstream:
            await socket.accept(subprotocol=viser_hooks.SUBPROTOCOL)
            up = asyncio.create_task(self._from_client(socket, upstream, token))
            down = asyncio.create_task(self._to_client(socket, upstream))
            try:
                await asyncio.wait((up, down), return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in (up, down):
                    task.cancel()
                await asyncio.gather(up, down, return_exceptions=True)
        if socket.application_state is not WebSocketState.DISCONNECTED:
            try:
                await socket.close(_GOING_AWAY)
            except (RuntimeError, WebSocketDisconnect):
                return  # the browser was faster

    async def _from_client(self, socket: WebSocket, upstream: websockets.ClientConnection, token: str) -> None:
        """Pass what the allow-list has; anything else is dropped and logged once per connection and reason."""
        allowance, refusals = _Allowance(), 0
        logged: set[str] = set()
        while refusals < REFUSALS_BEFORE_CLOSING:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            frame = message.get("bytes")
            if frame is None or not viser_hooks.is_allowed_from_client(frame):
                reason = "message: type, size or form not allowed"
            elif not allowance.take():
                reason = "message: too many"
            else:
                await upstream.send(frame)
                continue
            refusals += 1
            if reason not in logged:
                logged.add(reason)
                self._refused(reason, token)
        self._refused("message: closed after too many refusals", token)

    async def _to_client(self, socket: WebSocket, upstream: websockets.ClientConnection) -> None:
        async for frame in upstream:
            if isinstance(frame, bytes):
                await socket.send_bytes(frame)
            else:
                await socket.send_text(frame)

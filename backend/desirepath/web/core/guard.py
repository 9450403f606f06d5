"""What stands before every route: the largest body, who may send one, security headers, the access log.

Plain ASGI, because Starlette's function middleware costs two tasks and a stream per request. Routes live elsewhere.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import unquote

import structlog
from fastapi import Request
from python_multipart.multipart import parse_options_header
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from desirepath.store.plain_data import is_deeper, without_texts
from desirepath.web.core import auditing, auth
from desirepath.web.core.addresses import STRICT_TRANSPORT, insists_on_tls, permissions, policy_source
from desirepath.web.core.contract import DEEPEST, MOST_CONTAINERS, MOST_VALUES, Refusal, Trouble, is_json
from desirepath.web.core.dependencies import page, route_of, services_of, stage_origin
from desirepath.web.core.lab_frame import LabRefusal, lab_refusal
from desirepath.web.core.media import ANY_FILE
from desirepath.web.core.throttle import (
    LARGEST_BODY,
    LARGEST_OPEN_BODY,
    LARGEST_RECORDING,
    LARGEST_STREAM,
    TooLarge,
    is_declared_too_large,
)

READING = ("GET", "HEAD", "OPTIONS")
BEHIND_SIGN_IN = ("/lab/", "/api/lab/")
SIGN_IN = "/lab/sign-in"
STREAMED = ("/api/lab/recordings/files",)
"""Routes that write a file as it comes in, and count it themselves."""
RECORDED = "/api/robot/recording"
"""Another such route, opened by a robot's token, which it looks at before it reads."""
LARGER = {"/lab/settings/setups": 66 * 1024**2, "/lab/policy-files": 16 * 1024**2}
"""Largest body (bytes) of a form with files, of those that take more: parts of a form go to the disk from 1 MB on."""
NUL = re.compile("\x00")
MOST_SEPARATORS = 1_000  # of a form's fields; Starlette takes as many fields, but any number of empty ones

log = structlog.get_logger("desirepath.web")


class Guard:
    """The outermost middleware of the pages' application."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand a request on, unless something is known against it before a byte of its body was read."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        began = time.perf_counter()
        answered = False

        async def sending(message: Message) -> None:
            nonlocal answered
            if message["type"] == "http.response.start":
                answered = True
                await auditing.write(request, message["status"])
                _finish(request, message, began)
            await send(message)

        limit = _limit_of(request)
        try:
            refusal = await _refusal(request, limit)
            bounded = _counted(receive, limit)
            if refusal is None and (wrong_with := _bounds_of(request.headers.get("content-type"))):
                bounded, refusal = await _read_whole(request, bounded, wrong_with)
            await (refusal or self._app)(scope, bounded, sending)
        except Exception:
            log.exception("request failed", method=request.method, route=route_of(request))
            if answered:
                raise
            message = "Something went wrong here; it was written to the log."
            await trouble(request, 500, "internal", message)(scope, receive, sending)


def _limit_of(request: Request) -> int:
    """The largest body that is taken. A file that its route writes down as it comes in may be larger: nothing parses
    it, so nothing holds it."""
    if not _behind_sign_in(request):
        recorded = request.url.path == RECORDED and request.headers.get("content-type") == ANY_FILE
        return LARGEST_RECORDING if recorded else LARGEST_OPEN_BODY
    streamed = request.headers.get("content-type") == ANY_FILE and request.url.path in STREAMED
    return LARGEST_STREAM if streamed else LARGER.get(request.url.path, LARGEST_BODY)


def _behind_sign_in(request: Request) -> bool:
    path = request.url.path
    return path.startswith(BEHIND_SIGN_IN) and path != SIGN_IN and not path.startswith(f"{SIGN_IN}/")


async def _refusal(request: Request, limit: int) -> Response | None:
    """What is to be answered without reading the body, None where the request may go on."""
    if NUL.search(request.url.path):
        return trouble(request, 404, "not_found", "There is nothing at this address.")
    if NUL.search(unquote(request.url.query)):
        return trouble(request, 422, "bad_value", "must be texts without NUL characters", field="query")
    if not _is_readable_form(request.headers.get("content-type")):
        return trouble(request, 422, "bad_value", "must be a form in UTF-8", field="body")
    if is_declared_too_large(request, limit):
        return trouble(request, 413, "too_large", TooLarge(limit).detail)
    if request.method in READING or not _behind_sign_in(request):
        return None
    try:
        await run_in_threadpool(auth.require_sign_in, request, services_of(request).database)
    except (auth.NotSignedIn, auth.PasswordMustChange, auth.SecondFactorMissing) as problem:
        return auth.exception_handlers[type(problem)](request, problem)
    return None


def _is_readable_form(content_type: str | None) -> bool:
    """Whether whatever is sent in parts is sent in UTF-8: Starlette reads it by any codec of Python that is named,
    some of which are slow (`idna`, `punycode`) or raise errors of their own. Looked at by the means that it uses."""
    kind, options = parse_options_header(content_type)
    return kind != b"multipart/form-data" or options.get(b"charset", b"utf-8").lower() == b"utf-8"


def _counted(receive: Receive, limit: int) -> Receive:
    """Count what really comes in: a body sent in chunks declares no length. Reading too much raises TooLarge."""
    read = 0

    async def counted() -> Message:
        nonlocal read
        message = await receive()
        read += len(message.get("body", b""))
        if read > limit:
            raise TooLarge(limit)
        return message

    return counted


def _bounds_of(content_type: str | None) -> Callable[[bytes], str | None] | None:
    """What tells why a body of that type is not parsed, None where any may be. Parsing holds up all who are served."""
    if is_json(content_type):
        return _wrong_with_json
    kind, _ = parse_options_header(content_type)
    return _wrong_with_form if kind == b"application/x-www-form-urlencoded" else None


def _wrong_with_json(body: bytes) -> str | None:
    if not json.detect_encoding(body).startswith("utf-8"):  # json.loads would read it, is_deeper does not
        return "must be JSON in UTF-8"
    bare = without_texts(body)
    if is_deeper(bare, DEEPEST):
        return f"has more than {DEEPEST} arrays and objects inside each other"
    containers = bare.count(b"[") + bare.count(b"{")
    if containers > MOST_CONTAINERS:
        return f"has more than {MOST_CONTAINERS} arrays and objects"
    if containers + bare.count(b",") > MOST_VALUES:
        return f"has more than {MOST_VALUES} values"
    return None


def _wrong_with_form(body: bytes) -> str | None:
    return f"has more than {MOST_SEPARATORS} fields" if body.count(b"&") > MOST_SEPARATORS else None


async def _read_whole(
    request: Request, receive: Receive, wrong_with: Callable[[bytes], str | None]
) -> tuple[Receive, Response | None]:
    """A body read whole before anything parses it, to be received again; or why it is refused."""
    parts, more = [], True
    try:
        while more:
            message = await receive()
            if message["type"] != "http.request":
                return receive, Response(status_code=400)  # who asked is gone
            parts.append(message.get("body", b""))
            more = message.get("more_body", False)
    except TooLarge as problem:
        return receive, trouble(request, 413, "too_large", problem.detail)
    body = b"".join(parts)
    if (wrong := wrong_with(body)) is not None:
        return receive, trouble(request, 422, "bad_value", wrong, field="body")
    whole: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def again() -> Message:
        return whole.pop() if whole else await receive()

    return again, None


def _finish(request: Request, start: Message, began: float) -> None:
    """Security headers, and an access log that holds neither tokens nor query strings."""
    headers = MutableHeaders(scope=start)
    headers.setdefault(
        "Content-Security-Policy",
        f"default-src 'self'; img-src 'self' data: blob:; frame-src 'self' {policy_source(stage_origin(request))}; "
        "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'",
    )
    headers.setdefault("X-Content-Type-Options", "nosniff")
    if insists_on_tls(request):
        headers.setdefault(*STRICT_TRANSPORT)
    headers.setdefault("Referrer-Policy", "no-referrer")
    headers.setdefault("Permissions-Policy", permissions())
    if request.url.path.startswith("/static"):
        return
    headers.setdefault("Cache-Control", "no-store")
    seconds, route = time.perf_counter() - began, route_of(request)
    services_of(request).monitoring.count_answered(request.method, route, start["status"], seconds)
    log.info("request", method=request.method, route=route, status=start["status"], ms=round(seconds * 1000, 1))


def trouble(
    request: Request,
    status: int,
    code: str,
    message: str,
    *,
    headers: Mapping[str, str] | None = None,
    **where: Any,
) -> Response:
    """A page for people, JSON for scripts. Reads no table: it has to work when the store does not.

    where: `field` and `value`, where it is a value that is refused.
    """
    sent_json = is_json(request.headers.get("content-type"))
    if sent_json or request.url.path.startswith(("/api/", "/static/")):
        refusal = Refusal(error=Trouble(code=code, message=message, **where))
        return JSONResponse(refusal.model_dump(), status, headers)
    if request.url.path.startswith("/lab/"):
        return lab_refusal(request, LabRefusal(status, code, message=message))
    services = services_of(request)
    language = services.texts.best(request.headers.get("Accept-Language"))
    contact = services.settings.contact
    return page(request, "participant/refusal.html", language=language, status=status, code=code, contact=contact)

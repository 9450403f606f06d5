"""How much the head of a request may bring, at both doors. What stands in single headers is its readers' to judge.

Plain ASGI and the outermost of all: nothing else has looked at a header before. What never becomes a request is the
protocol's to stop.
"""

from __future__ import annotations

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

LARGEST_HEAD = 32 * 1024  # bytes of address and headers, ours: what nginx takes; browsers send some hundred
LARGEST_UNFINISHED = 2**20  # bytes in which no head and no part of a body came to its end; reads are up to 256 kB
POLICY_VIOLATION = 1008


class BoundedProtocol(HttpToolsProtocol):
    """Uvicorn's, which keeps a head or trailer for as long as it grows: closes what grows without an end."""

    _unfinished = 0

    def data_received(self, data: bytes) -> None:
        self._unfinished += len(data)
        super().data_received(data)
        if self._unfinished > LARGEST_UNFINISHED and not self.transport.is_closing():
            self.send_400_response("The head of the request does not end.")

    def on_headers_complete(self) -> None:
        self._unfinished = 0
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        self._unfinished = 0
        super().on_body(body)


class BoundedHeads:
    """Turns away requests and websockets whose head is too large, and takes backslashes out of cookies: none of ours
    has any, and Python's reader of quoted ones takes seconds for some kB (CVE-2024-7592)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            address = len(scope.get("raw_path") or b"") + len(scope["query_string"])
            if address + sum(len(name) + len(value) for name, value in scope["headers"]) > LARGEST_HEAD:
                if scope["type"] == "websocket":
                    await send({"type": "websocket.close", "code": POLICY_VIOLATION})
                else:
                    message = f"Address and headers have more than {LARGEST_HEAD} bytes."
                    await PlainTextResponse(message, 431, headers={"Connection": "close"})(scope, receive, send)
                return
            headers = [
                (name, value.replace(b"\\", b"") if name == b"cookie" else value) for name, value in scope["headers"]
            ]
            scope = {**scope, "headers": headers}
        await self._app(scope, receive, send)

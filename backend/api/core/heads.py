"""How much the head of a request may bring, at both doors. What stands in single headers is its readers' to judge.

Plain ASGI and the outermost of all: nothing else has looked at a header before.
"""

from __future__ import annotations

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

LARGEST_HEAD = 32 * 1024  # bytes of address and headers, ours: what nginx takes; browsers send some hundred
POLICY_VIOLATION = 1008


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
                    said = f"Address and headers have more than {LARGEST_HEAD} bytes."
                    await PlainTextResponse(said, 431, headers={"Connection": "close"})(scope, receive, send)
                return
            headers = [
                (name, value.replace(b"\\", b"") if name == b"cookie" else value) for name, value in scope["headers"]
            ]
            scope = {**scope, "headers": headers}
        await self._app(scope, receive, send)

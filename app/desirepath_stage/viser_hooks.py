"""Every part of viser that its public interface does not promise, in one place, pinned to one version.

`tests/stage/test_viser_hooks.py` fails when viser changes any of it. The page's side of the same bargain is
`client/viser_hooks.js`. Nothing else here may touch a private name of viser.
"""

from __future__ import annotations

import asyncio
import functools
import logging
import sys
from pathlib import Path
from typing import Any

import msgspec
import rich
import viser
import zstandard
from viser import _messages
from viser.infra import _async_message_buffer

PINNED_VERSION = "1.1.1"
SUBPROTOCOL = f"viser-v{PINNED_VERSION}"
MAX_CLIENT_MESSAGE_BYTES = 2048  # a camera report is about 300


class HookError(RuntimeError):
    """The installed viser is not the one these hooks were written for."""


def require_pinned_viser() -> None:
    """Raise HookError when another viser is installed."""
    if viser.__version__ != PINNED_VERSION:
        raise HookError(f"viser is {viser.__version__!r}; the hooks need exactly {PINNED_VERSION}")


def run_javascript(client: viser.ClientHandle, source: str) -> None:
    """Have one client's page run `source`, after everything that was sent to it before."""
    client.gui._websock_interface.queue_message(_messages.RunJavascriptMessage(source=source))


class _MessageEvent(asyncio.Event):
    """Set from any thread. asyncio's own walks its waiters while the loop's thread changes them, and then fails
    ("deque mutated during iteration", one in 1,700 trajectories): what was being sent was lost."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._at_home = loop

    def set(self) -> None:
        self._value = True
        try:
            at_home = asyncio.get_running_loop() is self._at_home
        except RuntimeError:
            at_home = False
        if at_home:  # another thread asks the loop to set it as well, right afterwards (`push`, `atomic_end`)
            for waiter in self._waiters:
                if not waiter.done():
                    waiter.set_result(True)


def let_any_thread_send() -> None:
    """Make viser's message buffers safe to be pushed to from threads that are not its event loop's."""
    buffer = _async_message_buffer.AsyncMessageBuffer
    original = buffer.__init__
    if getattr(original, "wakes_at_home", False):
        return

    @functools.wraps(original)
    def with_safe_event(self: Any, event_loop: asyncio.AbstractEventLoop, *args: Any, **options: Any) -> None:
        original(self, event_loop, *args, **options)
        self.message_event = _MessageEvent(event_loop)

    with_safe_event.wakes_at_home = True  # type: ignore[attr-defined]
    buffer.__init__ = with_safe_event  # type: ignore[method-assign]


def connection_path(server: viser.ViserServer, client_id: int) -> str | None:
    """The path that a client connected to, "/..." and still percent-encoded; None when it is gone."""
    connection = server._websock_server._live_connections.get(client_id)
    return None if connection is None or connection.request is None else connection.request.path


def disconnect(server: viser.ViserServer, client_id: int, *, after_s: float = 0.0) -> None:
    """Close one client's connection, after what was queued for it had `after_s` seconds to leave. Quiet when gone."""
    connection = server._websock_server._live_connections.get(client_id)
    loop = server._websock_server._background_event_loop
    if connection is None or loop is None or loop.is_closed():
        return

    async def close() -> None:
        await asyncio.sleep(after_s)
        await connection.close()

    asyncio.run_coroutine_threadsafe(close(), loop)


def index_html() -> str:
    """viser's own page: one file with its script and style inside."""
    return (Path(viser.__file__).parent / "client" / "build" / "index.html").read_text(encoding="utf-8")


class CameraReport(msgspec.Struct, tag="ViewerCameraMessage", forbid_unknown_fields=True):
    """What a page tells about its camera. viser counts a client as connected from its first one on."""

    wxyz: tuple[float, float, float, float]
    position: tuple[float, float, float]
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: tuple[float, float, float]
    up_direction: tuple[float, float, float]


_decoder = msgspec.msgpack.Decoder(CameraReport)  # grows to a union when a page may send more


def is_allowed_from_client(frame: bytes) -> bool:
    """Whether a page may send this frame to viser: small, of a type on the list above, and well formed."""
    if len(frame) > MAX_CLIENT_MESSAGE_BYTES:
        return False
    try:
        _decoder.decode(frame)
    except (msgspec.DecodeError, ValueError):
        return False
    return True


def readable_part(frame: bytes) -> bytes:
    """The messages in a frame from viser to a page, without the arrays behind them; for clients that are no browser.

    A frame is two little-endian lengths of 8 bytes, the zstd-compressed messages, then raw arrays.
    """
    compressed = int.from_bytes(frame[8:16], "little")
    return zstandard.ZstdDecompressor().decompress(frame[16 : 16 + compressed])


def silence_viser() -> None:
    """Keep viser's start and stop notices off stdout, where `--json` output belongs to the caller, and the loopback
    port that it listens on out of the log: nobody can open it."""
    logging.getLogger("websockets.server").setLevel(logging.WARNING)
    if getattr(rich.print, "silences_viser", False):
        return
    original = rich.print

    @functools.wraps(original)
    def print_unless_viser(*objects: Any, **options: Any) -> None:
        if not sys._getframe(1).f_globals.get("__name__", "").startswith("viser."):
            original(*objects, **options)

    print_unless_viser.silences_viser = True  # type: ignore[attr-defined]
    rich.print = print_unless_viser

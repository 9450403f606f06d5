"""What tests wait for: an application served on a thread of this process, anything that becomes true."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import uvicorn

PATIENCE_S = 200.0  # a busy machine is slow, not wrong


@contextmanager
def served(application: Any, *, port: int = 0, **options: Any) -> Iterator[str]:
    """Address at which an application is served for real, on that port of loopback or any that is free."""
    options = {"timeout_graceful_shutdown": 1, **options}  # a page that still listens is not waited for
    server = uvicorn.Server(uvicorn.Config(application, port=port, log_level="critical", **options))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        until(lambda: server.started or not thread.is_alive())
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(10)


def until(holds: Callable[[], object], told: str = "") -> None:
    """Wait for it; told: what it means if it never holds."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, told
        time.sleep(0.02)

"""A server of the example pages."""

import threading
from collections.abc import Iterator

import pytest
import uvicorn

from tests.frontend.example_pages import example_application


@pytest.fixture(scope="session")
def pages() -> Iterator[str]:
    """Address of a server of the example pages."""
    server = uvicorn.Server(uvicorn.Config(example_application(), port=0, log_level="critical"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        thread.join(0.02)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join(5)

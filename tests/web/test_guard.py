"""What stands before every route: bodies are read only of who may send them, and dead links fill no log."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select
from starlette.types import Receive, Scope, Send

from desirepath.settings import Settings
from desirepath.store.models import Event
from desirepath.study import refusals
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from desirepath.web.core.heads import LARGEST_HEAD, LARGEST_UNFINISHED, BoundedProtocol
from desirepath.web.core.lab_frame import LANGUAGE_COOKIE
from desirepath.web.core.throttle import LARGEST_BODY, LARGEST_OPEN_BODY
from tests.running import served


@pytest.fixture
def services(tmp_path: Path) -> Services:
    return build_services(Settings(data=tmp_path, _env_file=None))


@pytest.fixture
def client(services: Services) -> Iterator[TestClient]:
    with TestClient(create_application(services), follow_redirects=False) as client:
        yield client


@pytest.mark.parametrize("path", ["/lab/new", "/lab/jobs/new/align", "/lab/settings/accounts", "/lab/sign-out"])
def test_who_is_not_signed_in_is_sent_to_sign_in_before_a_form_is_looked_at(client: TestClient, path: str) -> None:
    answered = client.post(path, content=b"not a form at all", headers={"Content-Type": "multipart/form-data"})
    assert (answered.status_code, answered.headers["location"].partition("?")[0]) == (303, "/lab/sign-in")


@pytest.mark.parametrize("path", ["/lab/sign-in", "/join/nowhere", "/api/session/nowhere/problem"])
def test_everybody_may_send_a_little_and_signed_in_pages_take_more(client: TestClient, path: str) -> None:
    assert LARGEST_OPEN_BODY < LARGEST_BODY
    too_much = client.post(path, content=b"x" * (LARGEST_OPEN_BODY + 1))
    assert too_much.status_code == 413
    enough = client.post(path, content=b"x" * (LARGEST_OPEN_BODY - 1), headers={"Content-Type": "application/json"})
    assert enough.status_code not in (413, 500)


def test_a_head_that_is_too_large_is_read_by_nobody(client: TestClient) -> None:
    for headers in ({"x": "y" * LARGEST_HEAD}, dict.fromkeys(map(str, range(4000)), "y" * 9)):
        assert client.get("/health", headers=headers).status_code == 431
    assert client.get("/health?" + "x" * LARGEST_HEAD).status_code == 431
    assert client.get("/health?" + "x" * (LARGEST_HEAD // 2)).status_code == 200


def _taken(browser: socket.socket, begins: bytes) -> int:
    """How many pieces went before the connection was closed."""
    for pieces in range(40):
        try:
            browser.sendall(b"y" * LARGEST_UNFINISHED if pieces else begins)
        except OSError:
            return pieces
    return 40


@pytest.mark.parametrize(
    "begins",
    [b"GET / HTTP/1.1\r\nx: ", b"GET /?", b"POST / HTTP/1.1\r\ntransfer-encoding: chunked\r\n\r\n1\r\nx\r\n0\r\nx: "],
)
def test_what_never_ends_is_not_kept_for_as_long_as_it_grows(begins: bytes) -> None:
    """A head of 200 MB was, by one connection of anybody."""

    async def waits(scope: Scope, receive: Receive, send: Send) -> None:
        while (await receive()).get("more_body"):
            pass

    with served(waits, http=BoundedProtocol, lifespan="off") as url:
        here = urlsplit(url)
        with socket.create_connection((here.hostname, here.port)) as browser:
            assert _taken(browser, begins) < 40, "whatever was sent was kept"


def test_quoted_cookies_of_others_cost_nothing_and_ours_are_read(client: TestClient, services: Services) -> None:
    """Python's reader of cookies takes a second for 16 kB of them, in the loop that serves everybody."""
    theirs = 'theirs="' + '\\"' * (LARGEST_HEAD // 2 - 500) + '"'
    took = []
    for _ in range(3):  # of which other threads of this process may have slowed down some
        began = time.process_time()
        page = client.get("/lab/sign-in", headers={"cookie": f"{theirs}; {LANGUAGE_COOKIE}=de"})
        took.append(time.process_time() - began)
        assert 'lang="de"' in page.text
    assert min(took) < 1


@pytest.mark.parametrize("charset", ["idna", "punycode", "undefined", "utf-7", "a\0b", "unheard-of", '"IDNA"'])
def test_forms_in_parts_are_read_in_utf_8_only(client: TestClient, charset: str) -> None:
    """Python's codec `idna` takes a second for 256 kB, in the loop that serves everybody; `undefined` raises."""
    form = b'--B\r\nContent-Disposition: form-data; name="password"\r\n\r\nxn--' + b"a" * 200_000 + b"\r\n--B--\r\n"
    kind = "multipart/form-data; boundary=B"
    refused = client.post("/lab/sign-in", content=form, headers={"Content-Type": f"{kind}; charset={charset}"})
    assert refused.status_code == 422
    for read in (kind, f"{kind}; charset=UTF-8"):
        assert client.post("/lab/sign-in", content=form, headers={"Content-Type": read}).status_code == 401


def told(services: Services, code: str) -> int:
    with services.database.session() as s:
        return sum(event.data["code"] == code for event in s.scalars(select(Event).where(Event.kind == "refused")))


def test_a_dead_link_is_written_down_once_an_hour(
    client: TestClient, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(5):
        assert client.get("/api/session/dead-link").status_code == 404
        asyncio.run(services.admission.admit("dead.stage", {}, None))
    assert (told(services, "unknown"), told(services, "unknown_stage")) == (1, 1)
    monkeypatch.setattr(refusals, "LOGGED_AGAIN_AFTER_S", 0.0)  # the hour is over
    assert client.get("/api/session/dead-link").status_code == 404
    assert told(services, "unknown") == 2


def test_more_dead_links_than_the_log_takes_are_refused_all_the_same(
    client: TestClient, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refusals, "MOST_LOGGED", 3)
    assert [client.get(f"/api/session/guess-{number}").status_code for number in range(6)] == [404] * 6
    assert told(services, "unknown") == 3

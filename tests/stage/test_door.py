"""The door to the stage, knocked at without a browser: who gets in, and what may be said inside."""

from __future__ import annotations

import asyncio
import contextlib

import httpx
import msgspec
import pytest
import websockets

from desirepath.web.stage.stage_proxy import MESSAGES_BURST, REFUSALS_BEFORE_CLOSING
from desirepath_stage.viser_hooks import SUBPROTOCOL
from tests.stage.stage_rig import CAMERA_REPORT, StageRig, listen_to_the_end, run_async


def frame(message: dict[str, object]) -> bytes:
    return msgspec.msgpack.encode(message)


def connect(
    rig: StageRig, token: str = "token-for-amber", origin: str | None = None, subprotocol: str = SUBPROTOCOL
) -> websockets.connect:
    return websockets.connect(
        f"ws://127.0.0.1:{rig.stage_port}/stage/{token}",
        origin=websockets.Origin(rig.stage_origin if origin is None else origin),
        subprotocols=[websockets.Subprotocol(subprotocol)],
        max_size=None,
    )


@pytest.mark.parametrize(
    ("knock", "reason"),
    [
        ({"token": "forged"}, "websocket: not admitted"),
        ({"token": "token%20with%20spaces"}, "websocket: malformed token"),
        ({"origin": "http://elsewhere.example"}, "websocket: wrong origin"),
        ({"subprotocol": "viser-v0.0.1"}, "websocket: wrong subprotocol"),
    ],
)
def test_strangers_are_refused_and_logged(rig: StageRig, knock: dict[str, str], reason: str) -> None:
    async def refused() -> None:
        with pytest.raises(websockets.exceptions.InvalidStatus) as answer:
            async with connect(rig, **knock):
                pass
        assert answer.value.response.status_code == 403

    run_async(refused())
    assert [said for said, _ in rig.refusals if said.startswith(reason)]
    assert rig.connections == []
    assert all(len(prefix) <= 6 for _, prefix in rig.refusals), "a log never holds a whole token"


@pytest.mark.parametrize(("method", "path"), [("POST", "/stage/token-for-amber/"), ("GET", "/stage/token-for-amber/")])
@pytest.mark.parametrize("declared", [True, False])
def test_a_request_that_brings_a_body_is_turned_away(rig: StageRig, method: str, path: str, declared: bool) -> None:
    body = b"x" * 1000
    with httpx.Client(base_url=rig.stage_origin) as client:
        answer = client.request(method, path, content=body if declared else iter([body]))
    assert (answer.status_code, answer.headers["connection"]) == (413, "close")


def test_the_pages_own_origin_is_not_the_stages(rig: StageRig) -> None:
    async def refused() -> None:
        with pytest.raises(websockets.exceptions.InvalidStatus):
            async with connect(rig, origin=rig.page_origin):
                pass

    run_async(refused())


def test_only_camera_reports_reach_viser(rig: StageRig) -> None:
    forbidden = [
        frame({"type": "RunJavascriptMessage", "source": "alert(1)"}),
        frame({"type": "ShareUrlRequest"}),
        frame({"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": 1}}),
        frame({**CAMERA_REPORT, "extra": 1}),
        frame({**CAMERA_REPORT, "position": ["here", 0, 0]}),
        frame({**CAMERA_REPORT, "padding": "x" * 4000}),
        b"\xc1not msgpack",
    ]

    async def talk() -> None:
        async with connect(rig) as socket:
            for said in forbidden:
                await socket.send(said)
            await socket.send("text is not spoken here")
            await asyncio.sleep(0.3)
            assert rig.connections == [], "viser must not have heard anything yet"
            await socket.send(frame(CAMERA_REPORT))
            assert await socket.recv(), "the connection is still good, and viser answers"
            while not rig.connections:
                await asyncio.sleep(0.05)

    run_async(talk())
    assert rig.connections == ["amber"]
    assert ("message: type, size or form not allowed", "token-") in rig.refusals
    assert len(rig.refusals) == 1, "one line per connection and reason, not one per frame"


def test_whoever_talks_too_much_is_cut_off(rig: StageRig) -> None:
    async def talk() -> None:
        async with connect(rig) as socket:
            with contextlib.suppress(websockets.exceptions.ConnectionClosed):
                for _ in range(int(MESSAGES_BURST) + REFUSALS_BEFORE_CLOSING + 200):
                    await socket.send(frame(CAMERA_REPORT))
                    await asyncio.sleep(0)
            await listen_to_the_end(socket)

    run_async(talk())
    reasons = [reason for reason, _ in rig.refusals]
    assert reasons == ["message: too many", "message: closed after too many refusals"]


def test_nobody_gets_past_the_door_to_the_loopback_port(rig: StageRig) -> None:
    async def sneak() -> None:
        async with websockets.connect(
            f"ws://127.0.0.1:{rig.server.port}/amber", subprotocols=[websockets.Subprotocol(SUBPROTOCOL)]
        ) as socket:
            await socket.send(frame(CAMERA_REPORT))
            await listen_to_the_end(socket)

    run_async(sneak())
    assert rig.connections == []


def test_the_page_is_guarded_by_token_query_and_policy(rig: StageRig) -> None:
    with httpx.Client(base_url=rig.stage_origin) as browser:
        assert browser.get("/stage/forged/").status_code == 403
        assert browser.get("/stage/token-for-amber/?websocket=ws://elsewhere.example").status_code == 400
        page = browser.get("/stage/token-for-amber/")
        assert browser.get("/stage/token-for-amber/", headers={"Host": "elsewhere.example"}).status_code == 404
    assert page.status_code == 200
    policy = dict(part.split(" ", 1) for part in page.headers["content-security-policy"].split("; "))
    assert policy["frame-ancestors"] == rig.page_origin
    assert policy["default-src"] == "'none'"
    assert policy["connect-src"].split() == [f"ws://127.0.0.1:{rig.stage_port}", "blob:", "data:"]
    again = httpx.get(str(page.url), headers={"If-None-Match": page.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    forged = httpx.get(f"{rig.stage_origin}/stage/forged/", headers={"If-None-Match": page.headers["etag"]})
    assert forged.status_code == 403, "knowing the page is no admission"
    assert f'"pageOrigin": "{rig.page_origin}"' in page.text


def test_pages_and_stage_never_share_an_origin(rig: StageRig) -> None:
    assert httpx.get(f"{rig.page_origin}/stage/token-for-amber/").status_code == 404
    assert httpx.get(f"{rig.stage_origin}/token-for-amber").status_code == 404

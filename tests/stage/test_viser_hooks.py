"""Smoke tests of every private part of viser that we lean on: they fail when viser changes one of them."""

from __future__ import annotations

import asyncio
import dataclasses
import logging
import re
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any, get_type_hints

import msgspec
import pytest
import rich
import viser
import websockets
from viser import _messages
from viser.infra._async_message_buffer import AsyncMessageBuffer

from desirepath_stage import viser_hooks
from desirepath_stage.page import stage_page
from desirepath_stage.stage_server import StageServer
from tests.stage.stage_rig import CAMERA_REPORT, StageRig, listen_to_the_end, run_async

CLIENT_SOURCE = Path(viser.__file__).parent / "client" / "src"


def source(name: str) -> str:
    return (CLIENT_SOURCE / name).read_text(encoding="utf-8")


def test_the_installed_viser_is_the_pinned_one(monkeypatch: pytest.MonkeyPatch) -> None:
    viser_hooks.require_pinned_viser()
    monkeypatch.setattr(viser, "__version__", "9.9.9")
    with pytest.raises(viser_hooks.HookError, match=r"9\.9\.9.*1\.1\.1"):
        viser_hooks.require_pinned_viser()


def test_the_camera_report_is_visers_own_message() -> None:
    ours = {field.name for field in msgspec.structs.fields(viser_hooks.CameraReport)}
    theirs = {field.name for field in dataclasses.fields(_messages.ViewerCameraMessage)}
    assert ours == theirs
    for name, hint in get_type_hints(viser_hooks.CameraReport).items():
        assert str(hint).lower().replace("typing.", "") == str(
            get_type_hints(_messages.ViewerCameraMessage)[name]
        ).lower().replace("typing.", "")
    decoded = _messages.Message.deserialize(msgspec.msgpack.encode(CAMERA_REPORT))
    assert isinstance(decoded, _messages.ViewerCameraMessage)
    assert viser_hooks.is_allowed_from_client(msgspec.msgpack.encode(CAMERA_REPORT))


def test_the_page_can_be_opened_up_for_our_scripts() -> None:
    html = viser_hooks.index_html()
    assert html.count("<head>") == 1
    page = stage_page("https://host:9400/</script>").html.decode()
    assert "</script>" not in page[page.index("pageOrigin") : page.index(";</script>")]
    scripts = [page.index(mark) for mark in ("document.hasFocus = ", "desirePath.player = ", "__viserZstdWasm")]
    assert page.index("window.desirePathConfig") < min(scripts), "the configuration comes first"
    assert scripts == sorted(scripts), "our scripts run before viser's"


def test_a_clients_path_can_be_read_and_its_connection_closed(rig: StageRig) -> None:
    async def knock() -> None:
        async with websockets.connect(
            rig.server.upstream_url("a key/with?marks"),
            subprotocols=[websockets.Subprotocol(viser_hooks.SUBPROTOCOL)],
            max_size=None,
        ) as socket:
            await socket.send(msgspec.msgpack.encode(CAMERA_REPORT))
            while not rig.connections:
                await asyncio.sleep(0.05)
            stage = rig.server.stage("a key/with?marks")
            assert stage is not None
            stage.retire()
            assert await listen_to_the_end(socket) > 0

    run_async(knock())
    assert rig.connections == ["a key/with?marks"]


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("WebsocketInterface.tsx", r"document\.hasFocus\(\)"),
        ("WebsocketInterface.tsx", r'window\.addEventListener\("blur", updateRetryInterval\)'),
        ("WebsocketInterface.tsx", r'postToWorker\(\{ type: "send", message \}\)'),
        ("WebsocketClientWorker.ts", r'type: "connected"'),
        ("WebsocketClientWorker.ts", r'type: "closed"'),
        ("App.tsx", r"w\.__viserMutable = mutable\.current"),
        ("App.tsx", r"server\.split\(\"\?\"\)\[0\]"),
        ("MessageHandler.tsx", r"new Function\(message\.source\)\(\)"),
        ("ViewerContext.ts", r"nodePoseData: NodePoseDataMap"),
        ("ViewerContext.ts", r"backgroundMaterial: THREE\.ShaderMaterial"),
        ("ViewerContext.ts", r'poseUpdateState: "updated" \| "needsUpdate"'),
    ],
)
def test_the_pages_private_words_are_still_there(file: str, words: str) -> None:
    assert re.search(words, source(file)), (
        f"viser's {file} no longer says {words}; see app/desirepath_stage/client/viser_hooks.js"
    )


def test_visers_notices_stay_off_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    viser_hooks.silence_viser()
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    server.stop()
    rich.print("ours")
    assert capsys.readouterr().out == "ours\n"


class _GoneMeanwhile(asyncio.Future[bool]):
    """A waiter that leaves the line while another thread walks along it, as the loop's own thread lets it."""

    def __init__(self, line: deque[Any], loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(loop=loop)
        self.line = line

    def done(self) -> bool:
        self.line.remove(self)
        return True


def test_a_message_is_not_lost_while_viser_waits_for_it() -> None:
    """One in 1,700 trajectories was never played: "deque mutated during iteration", raised where it was sent."""
    viser_hooks.let_any_thread_send()
    loop = asyncio.new_event_loop()
    buffer = AsyncMessageBuffer(loop, persistent_messages=False)
    line = buffer.message_event._waiters = deque()  # type: ignore[attr-defined]
    for _ in range(3):
        line.append(_GoneMeanwhile(line, loop))
    buffer.push(_messages.RunJavascriptMessage(source="1"))
    assert buffer.message_event.is_set()
    loop.close()


def test_what_any_thread_sends_arrives_in_order() -> None:
    viser_hooks.let_any_thread_send()
    loop = asyncio.new_event_loop()
    serving = threading.Thread(target=loop.run_forever)
    serving.start()
    buffer = AsyncMessageBuffer(loop, persistent_messages=False)
    arrived: list[str] = []

    async def read() -> None:
        async for window in buffer.window_generator(0):
            arrived.extend(message.source for message in window)  # type: ignore[attr-defined]

    reading = asyncio.run_coroutine_threadsafe(read(), loop)
    sent = [str(number) for number in range(2_000)]
    for source_ in sent:
        buffer.push(_messages.RunJavascriptMessage(source=source_))
        buffer.flush()
    deadline = time.monotonic() + 20
    while len(arrived) < len(sent) and time.monotonic() < deadline:
        time.sleep(0.02)
    buffer.set_done()
    reading.result(10)
    loop.call_soon_threadsafe(loop.stop)
    serving.join(10)
    loop.close()
    assert arrived == sent


def test_the_loopback_port_is_not_announced(caplog: pytest.LogCaptureFixture) -> None:
    """`server listening on 127.0.0.1:36579` stood above the three addresses that people may open."""
    caplog.set_level(logging.INFO)
    server = StageServer(port=0, on_connect=lambda stage, key: None)
    server.stop()
    assert "listening" not in caplog.text

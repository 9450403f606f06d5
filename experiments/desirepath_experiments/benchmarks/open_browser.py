"""One simulated participant of `benchmark serve`: an HTTP client with everything that a browser holds open beside it.

That is its event stream, and a real websocket through the stage's door that hears the trajectories it is to watch. What
simulated participants answer lives in `study/simulated/participant.py`; who walks when, and what was stored, in
`serving.py`.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any
from uuid import uuid4

import httpx
import msgspec
import numpy as np
import websockets

from desirepath.study.links import token_hash
from desirepath.study.simulated.http import BUSY_TRIES, put_off_s
from desirepath.study.simulated.participant import any_answer
from desirepath_stage import viser_hooks

DECIDING = 0.5  # ours: share of the pace that lies between a pair's start and its answer
PATIENCE_S = 30.0  # how long the stage may take to tell of a trajectory
TRIES = 3  # of a request whose connection broke, always with the same request id, as the page does it

CAMERA = viser_hooks.CameraReport(
    wxyz=(1.0, 0.0, 0.0, 0.0),
    position=(0.0, 0.0, 1.0),
    fov=1.0,
    near=0.1,
    far=100.0,
    image_height=600,
    image_width=800,
    look_at=(0.0, 0.0, 0.0),
    up_direction=(0.0, 0.0, 1.0),
)


class ServeBenchmarkError(RuntimeError):
    """An answer was lost or counted twice, or a participant could not go on; says how many and what happened."""


@dataclass
class Tally:
    """What the participants of one walk saw. `acknowledged`: request id -> (hash of the session's token, step)."""

    sent: int = 0
    acknowledged: dict[str, tuple[str, str]] = field(default_factory=dict)
    pairs: set[str] = field(default_factory=set)  # request ids of answers to pairs of trajectories
    ack_ms: list[float] = field(default_factory=list)
    stage_ms: list[float] = field(default_factory=list)
    stage_messages: int = 0
    stage_bytes: int = 0
    stream_events: int = 0
    errors: list[str] = field(default_factory=list)


class OpenBrowser:
    """One simulated participant with everything a browser holds open."""

    def __init__(self, client: httpx.AsyncClient, number: int, tally: Tally) -> None:
        self._client, self._tally = client, tally
        self._random = np.random.default_rng([number, 17])
        self._number = number
        self._token = ""
        self._heard = ""  # what the stage last heard that a page acts upon
        self._news = asyncio.Condition()

    async def walk(self, link: str, answers: int, ready: asyncio.Barrier, offset_s: float, pace_s: float) -> None:
        """Join, wait at the first pair for everybody else, then answer pairs at the pace."""
        oracle = {"name": "random", "noise": 0.0, "seed": 0, "number": self._number}
        joined = await self._post(f"/join/{link}", {"simulated": True, "language": "en", "oracle": oracle})
        self._token = joined["token"]
        await self._get(f"/p/{self._token}")  # brings the cookie that the stage's door wants
        state = (await self._get(self._api)).json()
        while not state["step"]["trial"]:
            state = await self._submit(state["step"], any_answer(state["step"], self._random), tell=False)
        async with self._stream(), self._stage(state["stage_url"]):
            await self._until('"type": "show"')
            await ready.wait()
            begin = time.monotonic() + offset_s
            for number in range(answers):
                await asyncio.sleep(max(0.0, begin + number * pace_s - time.monotonic()))
                state = await self._pair(state["step"], begin + (number + DECIDING) * pace_s)

    async def _pair(self, step: dict[str, Any], decide_at: float) -> dict[str, Any]:
        """The way a page goes: start, hear from the stage what plays, tell that it was seen, choose."""
        trial = f"{self._api}/trials/{step['key']}"
        sent_at = time.perf_counter()
        state = await self._post(f"{trial}/start", {"request_id": uuid4().hex})
        for side in ("a", "b"):
            shown = state["step"]["trial"]["playback_id"]
            await self._until(shown)
            self._tally.stage_ms.append((time.perf_counter() - sent_at) * 1000)
            sent_at = time.perf_counter()
            state = await self._post(f"{trial}/seen", {"side": side, "playback_id": shown})
        await asyncio.sleep(max(0.0, decide_at - time.monotonic()))
        answered = await self._submit(state["step"], {"choice": "ab"[int(self._random.integers(2))]}, tell=True)
        await self._get(f"/p/{self._token}/step")
        return answered

    async def _submit(self, step: dict[str, Any], value: dict[str, Any], *, tell: bool) -> dict[str, Any]:
        """Send an answer until it is acknowledged; `tell`: it counts in the figures."""
        request_id = uuid4().hex
        body = {"request_id": request_id, "value": value}
        if tell:
            self._tally.sent += 1
            self._tally.pairs.add(request_id)
        sent_at = time.perf_counter()
        state = await self._post(f"{self._api}/steps/{step['key']}", body)
        if tell:
            self._tally.ack_ms.append((time.perf_counter() - sent_at) * 1000)
        self._tally.acknowledged[request_id] = (token_hash(self._token), step["key"])
        return state

    @property
    def _api(self) -> str:
        return f"/api/session/{self._token}"

    # ---- what a browser holds open -----------------------------------------------------------------------------------

    @contextlib.asynccontextmanager
    async def _stage(self, stage_url: str) -> AsyncIterator[None]:
        origin, _, rest = stage_url.partition("/stage/")
        cookies = "; ".join(f"{cookie.name}={cookie.value}" for cookie in self._client.cookies.jar)
        async with websockets.connect(
            f"ws{origin.removeprefix('http')}/stage/{rest.rstrip('/')}",
            origin=websockets.Origin(origin),
            subprotocols=[websockets.Subprotocol(viser_hooks.SUBPROTOCOL)],
            additional_headers={"Cookie": cookies},
            compression=None,
            max_size=None,
        ) as socket:
            await socket.send(msgspec.msgpack.encode(CAMERA))
            async with beside(self._hear(socket)):
                yield

    async def _hear(self, socket: websockets.ClientConnection) -> None:
        async for frame in socket:
            if not isinstance(frame, bytes):
                continue
            self._tally.stage_messages += 1
            self._tally.stage_bytes += len(frame)
            async with self._news:
                self._heard += viser_hooks.readable_part(frame).decode("utf-8", "replace")
                self._news.notify_all()

    async def _until(self, words: str) -> None:
        """Wait for the stage to be told that; what came before it is forgotten."""

        async def heard() -> None:
            async with self._news:
                await self._news.wait_for(lambda: words in self._heard)
                self._heard = self._heard.partition(words)[2]

        try:
            await asyncio.wait_for(heard(), PATIENCE_S)
        except TimeoutError:
            raise ServeBenchmarkError(f"the stage was not told {words!r} within {PATIENCE_S:.0f} s") from None

    @contextlib.asynccontextmanager
    async def _stream(self) -> AsyncIterator[None]:
        async with self._client.stream("GET", f"{self._api}/stream", timeout=None) as stream:

            async def read() -> None:
                async for line in stream.aiter_lines():
                    self._tally.stream_events += line.startswith("event:")

            async with beside(read()):
                yield

    async def _get(self, path: str) -> httpx.Response:
        return await self._request("GET", path)

    async def _post(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        state: dict[str, Any] = (await self._request("POST", path, body)).json()
        return state

    async def _send(self, method: str, path: str, body: dict[str, Any] | None) -> httpx.Response:
        """Joining alone is not tried again here: it would be somebody else who joins."""
        tries = 1 if path.startswith("/join/") else TRIES
        for left in reversed(range(tries)):
            try:
                return await self._client.request(method, path, json=body)
            except httpx.TransportError as problem:
                self._tally.errors.append(f"{type(problem).__name__} at {path.rpartition('/')[2]}")
                if not left:
                    raise
        raise AssertionError("unreachable: the last try raises")

    async def _request(self, method: str, path: str, body: dict[str, Any] | None = None) -> httpx.Response:
        """The answer to a request; what a busy server put off or a broken connection swallowed is sent again, as the
        page does it."""
        response = await self._send(method, path, body)
        for _ in range(BUSY_TRIES):
            wait_s = put_off_s(response)
            if wait_s is None:
                break
            self._tally.errors.append("put off: the server was busy")
            await asyncio.sleep(wait_s)
            response = await self._send(method, path, body)
        return _check(response)


@contextlib.asynccontextmanager
async def beside(listening: Any) -> AsyncIterator[None]:
    task = asyncio.create_task(listening)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError, httpx.TransportError, websockets.ConnectionClosed):
            await task


def _check(response: httpx.Response) -> httpx.Response:
    if response.is_success:
        return response
    endpoint = response.request.url.path.rsplit("/", 1)[-1]  # the rest of the path holds a token
    raise ServeBenchmarkError(f"the server refused {endpoint!r} with {response.status_code}: {response.text[:200]}")

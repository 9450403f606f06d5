"""A small rig around the stage: one parent page, the door, the stage server, a real Chromium."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Callable, Coroutine, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import uvicorn
import websockets
from playwright.sync_api import Frame, Page
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse
from starlette.routing import Route

from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.web.stage.stage_proxy import Origins, StageDoor, StageGrant
from desirepath_stage.stage import Stage
from desirepath_stage.stage_server import StageServer

# What viser's page says first; a knocking test without a browser says it too.
CAMERA_REPORT: dict[str, object] = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, 0.0, 1.0],
    "fov": 1.0,
    "near": 0.1,
    "far": 100.0,
    "image_height": 300,
    "image_width": 400,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}

PARENT_PAGE = """<!doctype html><title>parent</title>
<style>html,body{margin:0;height:100%;overflow:hidden}iframe{border:0;width:100vw;height:100vh;display:block}</style>
<script>
  window.events = [];
  addEventListener("message", (e) => { if (e.origin === "STAGE") window.events.push(e.data); });
</script>
<iframe id="stage" allow="ALLOW" src="STAGE/stage/TOKEN/"></iframe>"""


def bound_socket(port: int = 0) -> socket.socket:
    """A listening socket on the loopback address; 0 takes a free port."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(("127.0.0.1", port))
    return sock


class StageRig:
    """Pages on one port and the stage on another; tokens are `token-for-KEY`."""

    def __init__(self, on_connect: Callable[[Stage, str], None]) -> None:
        self.refusals: list[tuple[str, str]] = []
        self.connections: list[str] = []
        self.on_connect = on_connect
        self.allow = ""  # what the frame of the stage may use
        page_socket, stage_socket = bound_socket(), bound_socket()
        self.page_port, self.stage_port = page_socket.getsockname()[1], stage_socket.getsockname()[1]
        self.page_origin = f"http://127.0.0.1:{self.page_port}"
        self.stage_origin = f"http://127.0.0.1:{self.stage_port}"
        self.server = self.new_server(0)
        door = StageDoor(
            admit=self.admit,
            upstream_url=lambda key: self.server.upstream_url(key),
            origins=self.origins,
            on_refused=lambda reason, prefix: self.refusals.append((reason, prefix)),
        )
        pages = Starlette(routes=[Route("/{token}", self.parent)])
        self.web = [self.serve(pages, page_socket), self.serve(door.asgi(), stage_socket)]

    def serve(self, application: Starlette, sock: socket.socket) -> tuple[uvicorn.Server, threading.Thread]:
        """Serve on that socket, on a thread of its own, the way the product does."""
        config = uvicorn.Config(application, log_level="error", ws="websockets-sansio", ws_per_message_deflate=False)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([sock],), daemon=True)
        thread.start()
        while not server.started:
            time.sleep(0.02)
        return server, thread

    def origins(self, host: str) -> Origins | None:
        known = host == self.stage_origin.partition("://")[2]
        return Origins(self.page_origin, self.stage_origin) if known else None

    def new_server(self, port: int) -> StageServer:
        return StageServer(port=port, on_connect=self._connected)

    def _connected(self, stage: Stage, key: str) -> None:
        self.connections.append(key)
        self.on_connect(stage, key)

    async def admit(self, token: str, cookies: Mapping[str, str], origin: str | None) -> StageGrant | None:
        return StageGrant(token.removeprefix("token-for-")) if token.startswith("token-for-") else None

    async def parent(self, request: Request) -> HTMLResponse:
        token = request.path_params["token"]
        page = PARENT_PAGE.replace("ALLOW", self.allow)
        return HTMLResponse(page.replace("STAGE", self.stage_origin).replace("TOKEN", token))

    def restart_stage_server(self) -> None:
        port = self.server.port
        self.server.stop()
        self.server = self.new_server(port)

    def stop(self) -> None:
        self.server.stop()
        for server, thread in self.web:
            server.should_exit = True
            thread.join(timeout=10)


class Visitor:
    """One browser page that holds the stage, and what it was told."""

    def __init__(self, page: Page, rig: StageRig, key: str) -> None:
        self.page, self.rig, self.key = page, rig, key
        page.goto(f"{rig.page_origin}/token-for-{key}")

    @property
    def frame(self) -> Frame:
        return next(frame for frame in self.page.frames if "/stage/" in frame.url)

    def events(self, type_: str | None = None) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.page.evaluate("window.events")
        return [event for event in found if type_ is None or event["type"] == type_]

    def wait_for(self, type_: str, count: int = 1, timeout_s: float = 60, **fields: object) -> dict[str, Any]:
        """The `count`-th event of that type with those fields."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            found = [e for e in self.events(type_) if all(e.get(name) == value for name, value in fields.items())]
            if len(found) >= count:
                return found[count - 1]
            self.page.wait_for_timeout(50)
        raise AssertionError(f"no {type_} {fields} within {timeout_s} s; events: {self.events()}")

    def wait_until(self, holds: Callable[[], bool], what: str, timeout_s: float = 20) -> None:
        """Poll, because a busy machine may take its time to draw the next frame."""
        deadline = time.monotonic() + timeout_s
        while not holds():
            assert time.monotonic() < deadline, f"not within {timeout_s} s: {what}"
            self.page.wait_for_timeout(50)

    def camera(self) -> list[float]:
        """Camera position (m) and look direction, both in the world frame, z up."""
        pose: list[float] = self.frame.evaluate(
            "(() => { const { camera, nodeRefFromName } = window.__viserMutable;"
            " const back = nodeRefFromName[''].quaternion.clone().invert();"
            " const look = camera.getWorldDirection(camera.position.clone());"
            " return [camera.position.clone(), look].flatMap((v) => v.applyQuaternion(back).toArray()); })()"
        )
        return pose

    def robot(self) -> list[float]:
        """Position of the first robot in the world frame, metres."""
        return self.position_of("robot0")

    def position_of(self, node: str) -> list[float]:
        """Position of what bears that name in the scene that stands, in the world frame, metres."""
        position: list[float] = self.frame.evaluate(
            "(node) => { const poses = window.__viserMutable.nodePoseData;"
            " const found = Object.keys(poses).filter((name) => name.endsWith('/' + node)).at(-1);"
            " return poses[found].position; }",
            node,
        )
        return position


def study_room(seed: int = 1) -> Scene:
    """A furnished room with walls."""
    return draw_scene("study_room", seed)


def open_field(seed: int = 0) -> Scene:
    """Open ground with four cubes."""
    return draw_scene("open_field", seed)


def drive(scene: Scene, *, duration_s: float = 6.0, bend_m: float = 1.6) -> Trajectory:
    """A smooth arc from start to goal, bending by `bend_m` to the left at its middle."""
    n = round(duration_s / 0.2)
    u = np.linspace(0.0, 1.0, n + 1)
    start, goal = np.array([scene.start.x, scene.start.y]), np.array([scene.goal.x, scene.goal.y])
    along = goal - start
    left = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    xy = start + u[:, None] * along + (bend_m * np.sin(np.pi * u))[:, None] * left
    step = np.gradient(xy, axis=0)
    poses = np.column_stack([xy, np.arctan2(step[:, 1], step[:, 0])]).astype(np.float32)
    empty = np.zeros((n, 4), np.float32)
    return Trajectory(
        scene=scene,
        outcome=Outcome.SUCCESS,
        poses=poses,
        observations=empty,
        actions=np.zeros((n, 2), np.float32),
        rewards=np.zeros(n, np.float32),
        next_observations=empty,
        dones=np.arange(n) == n - 1,
    )


async def listen_to_the_end(socket: websockets.ClientConnection) -> int:
    """How many bytes came until the other side closed the connection, however it did."""
    received = 0
    with contextlib.suppress(websockets.exceptions.ConnectionClosed):
        async for frame in socket:
            received += len(frame)
    return received


def run_async(talk: Coroutine[Any, Any, None]) -> None:
    """Run a conversation to its end, on a thread of its own: playwright keeps a loop on the test's thread."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(asyncio.run, asyncio.wait_for(talk, 20)).result()

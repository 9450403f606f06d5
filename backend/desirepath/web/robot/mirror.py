"""Where robots are now, in memory: what each said last, and who is woken by it, whichever server process was told.

What they are to do stands in the database (`study/robots.py`); here is only that it changed.
"""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator
from typing import Any

from starlette.responses import Response, StreamingResponse

from desirepath.study.refusals import Refused
from desirepath.web.replicas.notices import Notice, Notices
from desirepath.web.stage.listening import Listener

FORGOTTEN_S = 5.0  # ours: a robot that was silent for so long is away
LOOK_S = 5.0
MOST_LISTENERS = 40  # pages and polls that wait for one robot, in one process


class Mirror:
    """What robots said last. Methods may be called from any thread, `listen` from an event loop."""

    def __init__(self, notices: Notices) -> None:
        self._notices = notices
        self._lock = threading.Lock()
        self._said: dict[str, tuple[float, dict[str, Any]]] = {}
        self._listeners: dict[str, set[Listener]] = {}
        notices.hear("robot_said", self._heard)
        notices.hear("robot_orders", lambda notice: self._wake(f"orders {notice.key}"))
        notices.hear("changed", lambda _: self._wake_all("orders "))  # a session: one may have come to a robot, or left
        notices.when_missed(self._wake_all)

    def say(self, robot_id: str, state: dict[str, Any]) -> None:
        """A robot says where it is."""
        self._notices.tell("robot_said", robot_id, state=state)

    def tell_orders(self, robot_id: str) -> None:
        """What a robot is to do has changed; call it after the transaction."""
        self._notices.tell("robot_orders", robot_id)

    def latest(self, robot_id: str) -> dict[str, Any] | None:
        """What it said last; None where that is long ago."""
        said = self._said.get(robot_id)
        return said[1] if said is not None and time.monotonic() - said[0] < FORGOTTEN_S else None

    def listen(self, key: str) -> Listener:
        """Woken by `orders ID` of a robot, `robot ID`, or `run ID` of one. Raises Refused for one too many."""
        listener = Listener(asyncio.get_running_loop())
        with self._lock:
            listening = self._listeners.setdefault(key, set())
            if len(listening) >= MOST_LISTENERS:
                raise Refused(429, "too_many", "This robot is watched, or waits, in too many places at once.")
            listening.add(listener)
        return listener

    def leave(self, key: str, listener: Listener) -> None:
        """It waits no more."""
        with self._lock:
            self._listeners.get(key, set()).discard(listener)
            if not self._listeners.get(key):
                self._listeners.pop(key, None)

    async def stream(self, robot_id: str, run: str | None, key: str, listener: Listener) -> AsyncIterator[str]:
        """Server-sent events: `robot` whenever it says something, `away` when it has long been silent. run: of other
        runs nothing is told; None: of all."""
        told: dict[str, Any] | None = {}
        try:
            while True:
                state = self.latest(robot_id)
                if run is not None and state is not None and state["run"] != run:
                    state = None
                if state is None and told is not None:
                    yield "event: away\ndata: {}\n\n"
                elif state is not None and state is not told:
                    yield f"event: robot\ndata: {json.dumps(state)}\n\n"
                else:
                    yield ": still here\n\n"
                told = state
                await listener.wait(LOOK_S)
        finally:
            self.leave(key, listener)

    def _heard(self, notice: Notice) -> None:
        with self._lock:
            self._said[notice.key] = (time.monotonic(), notice.data["state"])
        self._wake(f"robot {notice.key}")
        self._wake(f"run {notice.data['state']['run']}")

    def _wake(self, key: str) -> None:
        with self._lock:
            listeners = list(self._listeners.get(key, ()))
        for listener in listeners:
            listener.wake()

    def _wake_all(self, beginning: str = "") -> None:
        with self._lock:
            keys = [key for key in self._listeners if key.startswith(beginning)]
        for key in keys:
            self._wake(key)


def mirrored(mirror: Mirror, robot_id: str, run: str | None) -> Response:
    """The stream as an answer; for the event loop. Raises Refused where too many look; who watches a run takes no place
    of who watches the robot."""
    key = f"robot {robot_id}" if run is None else f"run {run}"
    listener = mirror.listen(key)
    return StreamingResponse(
        mirror.stream(robot_id, run, key, listener),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )

"""Who is told that a session changed: the pages' streams, whichever process they ask. What is sent to them is
`participant/stream.py`'s."""

from __future__ import annotations

import asyncio
import threading

from desirepath.web.replicas.claims import Claims
from desirepath.web.replicas.notices import Notice, Notices


class Listener:
    """One page's stream: woken from any thread, waited for on its event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._woken = asyncio.Event()
        self.taken_over = False

    def wake(self) -> None:
        """Something changed."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._woken.set)

    def take_over(self) -> None:
        """Another window of the same session is the one in use now."""
        self.taken_over = True
        self.wake()

    async def wait(self, at_most_s: float) -> None:
        """Until woken, or so long."""
        try:
            await asyncio.wait_for(self._woken.wait(), at_most_s)
        except TimeoutError:
            return
        self._woken.clear()


class Listeners:
    """The streams of all sessions. Methods may be called from any thread, `listen` from an event loop."""

    def __init__(self, notices: Notices) -> None:
        self._lock = threading.Lock()
        self._listeners: dict[str, list[Listener]] = {}
        self._notices = notices
        self._windows: Claims[Listener] = Claims(notices, "window", self._moved_elsewhere)
        notices.hear("changed", self._heard)
        notices.when_missed(self._wake_all)

    def listen(self, session_id: str) -> Listener:
        """A new listener for a session; older ones are told that another window took over. For the event loop."""
        listener = Listener(asyncio.get_running_loop())
        with self._lock:
            older = self._listeners.get(session_id, [])
            self._listeners[session_id] = [listener]
        for one in older:
            one.take_over()
        self._windows.claim(session_id, listener)
        return listener

    def leave(self, session_id: str, listener: Listener) -> None:
        """The listener's page is gone."""
        with self._lock:
            left = [other for other in self._listeners.get(session_id, []) if other is not listener]
            if left:
                self._listeners[session_id] = left
            else:
                self._listeners.pop(session_id, None)
                self._windows.give_up(session_id)

    def tell_changed(self, session_id: str) -> None:
        """Something about the session changed: wake whoever listens."""
        self._wake(session_id)
        self._notices.tell("changed", session_id)

    def _wake(self, session_id: str) -> None:
        with self._lock:
            listeners = list(self._listeners.get(session_id, []))
        for listener in listeners:
            listener.wake()

    def _wake_all(self) -> None:
        with self._lock:
            sessions = list(self._listeners)
        for session_id in sessions:
            self._wake(session_id)

    def _heard(self, notice: Notice) -> None:
        if not notice.own:
            self._wake(notice.key)

    def _moved_elsewhere(self, _session_id: str, listener: Listener) -> None:
        listener.take_over()  # and none that came after it

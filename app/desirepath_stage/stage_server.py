"""The one viser server: which connection belongs to which stage key, and who is told when one comes or goes.

It listens on the loopback address only; browsers reach it through the door, `web/stage/stage_proxy.py`.
"""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable
from urllib.parse import quote, unquote

import viser

from desirepath_stage import viser_hooks
from desirepath_stage.stage import Stage

_LAST_WORDS_S = 0.5  # a connection that is dropped first gets what was already said to it


class StageServer:
    """Starts viser and keeps the newest stage of every key."""

    def __init__(
        self,
        *,
        port: int,
        on_connect: Callable[[Stage, str], None],
        on_disconnect: Callable[[Stage, str], None] | None = None,
    ) -> None:
        """Listen on 127.0.0.1:`port` (0: any free one; a taken one: the next free one, see `port`).

        on_connect(stage, key): a page has connected and its stage is empty; show it what belongs there. Called on a
        thread of viser's, again after every reconnect. on_disconnect(stage, key): that page is gone.
        Raises HookError when another viser is installed than the pinned one.
        """
        viser_hooks.require_pinned_viser()
        viser_hooks.silence_viser()
        viser_hooks.let_any_thread_send()
        self._on_connect, self._on_disconnect = on_connect, on_disconnect
        self._secret = secrets.token_urlsafe(16)  # keeps other users of this machine out of the loopback port
        self._lock = threading.Lock()
        self._stage_of_key: dict[str, Stage] = {}
        self._stage_of_client: dict[int, Stage] = {}
        self._server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._disconnected)

    @property
    def port(self) -> int:
        """The port that is really listened on."""
        return int(self._server.get_port())

    def upstream_url(self, key: str) -> str:
        """The websocket address that belongs to a stage key, for the door."""
        return f"ws://127.0.0.1:{self.port}/{self._secret}/{quote(key, safe='')}"

    def stage(self, key: str) -> Stage | None:
        """The newest stage of that key, while it is connected."""
        with self._lock:
            return self._stage_of_key.get(key)

    def retire(self, key: str, stage: Stage) -> None:
        """That key's stage stands elsewhere now: tell the page of this one, and drop it."""
        with self._lock:
            if self._stage_of_key.get(key) is stage:
                del self._stage_of_key[key]
        stage.retire()

    def connected_keys(self) -> list[str]:
        """Of the stages that are connected."""
        with self._lock:
            return list(self._stage_of_key)

    def stop(self) -> None:
        """Drop all connections and stop listening."""
        self._server.stop()

    def _connected(self, client: viser.ClientHandle) -> None:
        path = viser_hooks.connection_path(self._server, client.client_id) or "/"
        secret, _, quoted_key = path.lstrip("/").partition("/")

        def close() -> None:
            viser_hooks.disconnect(self._server, client.client_id, after_s=_LAST_WORDS_S)

        if not secrets.compare_digest(secret.encode(), self._secret.encode()) or not quoted_key:
            close()
            return
        key = unquote(quoted_key)
        stage = Stage(key, client, close)
        with self._lock:
            older = self._stage_of_key.get(key)
            self._stage_of_key[key] = self._stage_of_client[client.client_id] = stage
        if older is not None:
            older.retire()
        self._on_connect(stage, key)

    def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            stage = self._stage_of_client.pop(client.client_id, None)
            if stage is not None and self._stage_of_key.get(stage.key) is stage:
                del self._stage_of_key[stage.key]
        if stage is None:
            return
        stage.leave()
        if self._on_disconnect is not None:
            self._on_disconnect(stage, stage.key)

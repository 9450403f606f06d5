"""Joins the session machine with the stage: who may open which stage, what stands on it, who is told of a change.

The machine's state is the truth; a stage that connects is shown what belongs there, and knows only scenes and drives.
Routes live in `participant.py`, the door's own rules in `stage_proxy.py`.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TYPE_CHECKING, cast
from urllib.parse import urlsplit

import structlog
from starlette.types import ASGIApp

from app.views import View
from backend.api.core.dependencies import House
from backend.api.stage import drawing_sheet
from backend.api.stage.replay_stages import replays
from backend.api.stage.stage_proxy import Origins, StageDoor, StageGrant
from backend.simulation.trajectory import Trajectory
from backend.store.artefacts import load_trajectory
from backend.store.database import DatabaseBusy
from backend.store.events import log_event
from backend.store.models import Session, Setting, utc_now
from backend.study.grammar.words import DRAWN_KINDS, TRIAL_KINDS
from backend.study.links import token_hash
from backend.study.refusals import first_this_hour
from backend.study.session import machine

if TYPE_CHECKING:
    from app.stage import Stage

log = structlog.get_logger("desirepath.stage")

KEPT_DRIVES = 128  # trajectories in memory; a session needs two at a time
COOKIE = "desirepath_stage_"


def _proof(session: Session, purpose: str) -> str:
    """Something only who holds the session's link (or the database) can know; another one for every purpose."""
    return hmac.new(session.token_hash.encode(), purpose.encode(), hashlib.sha256).hexdigest()[:40]


def stage_token(session: Session) -> str:
    """The token in the address of a session's stage. Says nothing about the participant, survives a restart."""
    return f"{session.id}.{_proof(session, 'stage')}"


def stage_cookie(session: Session) -> tuple[str, str]:
    """Name and value of the cookie that the door wants beside the token, so that a copied address opens nothing."""
    return f"{COOKIE}{session.id[:8]}", _proof(session, "cookie")


class StageBridge:
    """The connection between one house's database and its stages. Methods may be called from any thread.

    What stages are told goes through one line, in the order in which it was asked for: nobody who answers waits until
    a scene has been drawn, and no older scene can come after a newer one.
    """

    def __init__(self, house: House) -> None:
        self._house = house
        self._lock = threading.Lock()
        self._line = ThreadPoolExecutor(1, thread_name_prefix="stages")
        self._listeners: dict[str, list[Listener]] = {}
        self._drive = lru_cache(maxsize=KEPT_DRIVES)(self._load)

    # ---- what the stage shows ----------------------------------------------------------------------------------------

    def on_connect(self, stage: Stage, key: str) -> None:
        """A page's stage has connected and is empty: show what belongs there.

        Whatever played on an earlier connection is seen by nobody any more, so the checkpoint rule applies.
        """
        if replays(self._house).show(stage, key):
            return
        changed = self._interrupted(key)
        if changed is None:
            return
        self._line.submit(self._present, stage, key).result()
        if changed:
            self.changed(key)

    def _interrupted(self, session_id: str) -> bool | None:
        """Apply the checkpoint rule, however busy the database. Whether it changed anything; None: no such session."""
        while True:
            try:
                with self._house.database.transaction(durable=False) as s:
                    session = s.get(Session, session_id, with_for_update=True)
                    if session is None:
                        return None
                    return machine.interrupted(s, session, reason="stage_connected", now=utc_now())
            except DatabaseBusy:
                log.warning("a stage waits for the database")

    def connected(self, session_id: str) -> bool:
        """Whether the session's stage is there to play on; True where this process has no stages at all (tests)."""
        server = self._house.stage
        return server is None or server.stage(session_id) is not None

    def show(self, session_id: str, *, afresh: bool = False) -> None:
        """Bring the stage to what the session's current step needs. afresh: also stop what is playing."""

        def order(stage: Stage) -> None:
            if afresh:
                stage.clear()
            self._present(stage, session_id)

        self.tell_stage(session_id, order)

    def play(self, session_id: str, playback: machine.Playback) -> None:
        """Play a drive on the session's stage."""

        def order(stage: Stage) -> None:
            with self._house.database.session() as s:
                trial = machine.trial_of(s, s.get_one(Session, session_id))
            if trial is None or machine.playing(trial) != playback:
                return  # the session went on meanwhile
            stage.play(
                self._drive(playback.trajectory),
                label=playback.label,
                view=cast("View", playback.view),
                playback_id=playback.playback_id,
                trajectories=[self._drive(one) for one in (trial.trajectory_a, trial.trajectory_b)],
            )

        self.tell_stage(session_id, order)

    def tell_stage(self, session_id: str, order: Callable[[Stage], None]) -> None:
        """Put an order for the session's stage into the line; nobody waits for it, what goes wrong is logged."""
        server = self._house.stage
        if server is None:
            return

        def carry_out() -> None:
            stage = server.stage(session_id)
            try:
                if stage is not None:
                    order(stage)
            except Exception:
                log.exception("a stage could not be told what to show")

        self._line.submit(carry_out)

    def _present(self, stage: Stage, session_id: str) -> None:
        with self._house.database.session() as s:
            session = s.get(Session, session_id)
            trial = None
            active = session is not None and session.state == "active"
            kind = machine.step_of(session)["kind"] if active and session is not None else ""
            if session is not None and kind in TRIAL_KINDS:
                trial = machine.trial_of(s, session)
        if kind in DRAWN_KINDS:
            drawing_sheet.present(self._house, stage, session_id)
            return
        if trial is None:
            stage.clear()
            return
        a, b = self._drive(trial.trajectory_a), self._drive(trial.trajectory_b)
        assert session is not None  # noqa: S101  it has a trial
        stage.detail = "light" if session.device.get("scene_detail") == "light" else "full"
        stage.show(a.scene, cast("View", trial.view), trajectories=[a, b])

    def _load(self, trajectory_id: str) -> Trajectory:
        return load_trajectory(self._house.files, trajectory_id)

    # ---- who is told -------------------------------------------------------------------------------------------------

    def listen(self, session_id: str) -> Listener:
        """A new listener for a session; older ones are told that another window took over. For the event loop."""
        listener = Listener(asyncio.get_running_loop())
        with self._lock:
            older = self._listeners.get(session_id, [])
            self._listeners[session_id] = [listener]
        for one in older:
            one.take_over()
        return listener

    def leave(self, session_id: str, listener: Listener) -> None:
        """The listener's page is gone."""
        with self._lock:
            left = [one for one in self._listeners.get(session_id, []) if one is not listener]
            if left:
                self._listeners[session_id] = left
            else:
                self._listeners.pop(session_id, None)

    def changed(self, session_id: str) -> None:
        """Something about the session changed: wake whoever listens."""
        with self._lock:
            listeners = list(self._listeners.get(session_id, []))
        for one in listeners:
            one.wake()

    # ---- who may open a stage ----------------------------------------------------------------------------------------

    async def admit(self, token: str, cookies: Mapping[str, str], origin: str | None) -> StageGrant | None:
        """The door's question. Replays ask their own list; a session's stage wants its token and its cookie."""
        replay = replays(self._house).key_of(token)
        if replay is not None:
            return StageGrant(replay)
        return await asyncio.to_thread(self._admit_participant, token, dict(cookies))

    def _admit_participant(self, token: str, cookies: Mapping[str, str]) -> StageGrant | None:
        session_id, _, proof = token.partition(".")
        with self._house.database.session() as s:
            session = s.get(Session, session_id)
        reason = "unknown_stage" if session is None else self._reason_against(session, proof, cookies)
        if reason is None:
            return StageGrant(session_id)
        if first_this_hour(self._house.database, token_hash(token), reason):
            with self._house.database.transaction() as s:
                log_event(s, "refused", session_id=session.id if session else None, code=reason, request="stage")
        return None

    def _reason_against(self, session: Session, proof: str, cookies: Mapping[str, str]) -> str | None:
        if not hmac.compare_digest(proof.encode(), _proof(session, "stage").encode()):
            return "forged_stage"
        if session.state not in ("active", "paused") or utc_now() > session.expires_at:
            return "stage_of_ended_session"
        name, value = stage_cookie(session)
        if self._cookies_reach_the_stage() and not hmac.compare_digest(cookies.get(name, "").encode(), value.encode()):
            return "stage_without_cookie"
        return None

    def _cookies_reach_the_stage(self) -> bool:
        """A browser sends the page's cookie to the stage where both share a host name (ports do not matter)."""
        stage, page = self._house.settings.public_stage_url, self._house.settings.public_url
        return stage is None or (page is not None and urlsplit(stage).hostname == urlsplit(page).hostname)

    def on_refused(self, reason: str, token_prefix: str) -> None:
        """The door refused something by its own rules: into the event log, too."""
        if reason.endswith("not admitted"):  # `admit` has written down why
            return
        if first_this_hour(self._house.database, "stage door", token_prefix, reason):
            log.warning("stage door refused", reason=reason)
            threading.Thread(target=self._log_refusal, args=(reason,), daemon=True).start()

    def _log_refusal(self, reason: str) -> None:
        with self._house.database.transaction() as s:
            log_event(s, "refused", code="stage_door", request="stage", reason=reason)

    def origins(self, requested_host: str) -> Origins | None:
        """Page and stage origin for a request to the stage under that Host header; None: not a name of ours.

        With a public stage address only that one; else whatever host name the browser used, on the stage's port.
        """
        settings = self._house.settings
        if settings.public_stage_url:
            stage = settings.public_stage_url.rstrip("/")
            if requested_host != urlsplit(stage).netloc:
                return None
            return Origins(self._public_page() or stage, stage)
        name, _, port = requested_host.rpartition(":")
        if not name or port != str(settings.port + 1):
            return None
        return Origins(f"http://{name}:{settings.port}", f"http://{requested_host}")

    def _public_page(self) -> str | None:
        with self._house.database.session() as s:
            row = s.get(Setting, "public_url")
        stored = str(row.value.get("url", "")) if row else ""
        address = urlsplit(stored or self._house.settings.public_url or "")
        return f"{address.scheme}://{address.netloc}" if address.netloc else None


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


def bridge_of(house: House) -> StageBridge:
    """The house's bridge; made at first use where no server made one."""
    return house.part("bridge", lambda: StageBridge(house))


def create_stage_application(house: House, bridge: StageBridge) -> ASGIApp:
    """The door as an ASGI application of its own, for the stage's port."""
    server = house.stage
    if server is None:
        raise RuntimeError("the stage server has to be started before its door")
    door = StageDoor(
        admit=bridge.admit,
        upstream_url=server.upstream_url,
        origins=bridge.origins,
        on_refused=bridge.on_refused,
    )
    return door.asgi()

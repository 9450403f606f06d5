"""Who may open which stage: tokens, cookies, hosts, and the refusals that go into the event log.

The door's own rules are `stage_proxy.py`'s; what a stage shows is `presenting.py`'s.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import threading
from collections.abc import Mapping
from urllib.parse import urlsplit

import structlog

from desirepath.settings import Settings
from desirepath.store.database import Database
from desirepath.store.events import log_event
from desirepath.store.models import Session, Setting, utc_now
from desirepath.study.links import token_hash
from desirepath.study.refusals import first_this_hour
from desirepath.web.replicas.peers import MARK
from desirepath.web.stage.replay_stages import PREFIX, ReplayStages
from desirepath.web.stage.stage_proxy import Origins, StageGrant

log = structlog.get_logger("desirepath.stage")

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


class Admission:
    """The door's questions, answered from one server's database and settings."""

    def __init__(self, settings: Settings, database: Database, replays: ReplayStages) -> None:
        self._settings, self._database, self._replays = settings, database, replays

    async def admit_peer(self, token: str, _cookies: Mapping[str, str], _origin: str | None) -> StageGrant | None:
        """The inner door's question: other processes come for this one's replays and for nothing else."""
        replay = self._replays.key_of(token)
        return StageGrant(replay) if replay is not None else None

    async def admit(self, token: str, cookies: Mapping[str, str], origin: str | None) -> StageGrant | None:
        """The door's question. Replays ask their own list; a session's stage wants its token and its cookie."""
        replay = self._replays.key_of(token)
        if replay is not None:
            return StageGrant(replay)
        if MARK in token:
            kept_at = await asyncio.to_thread(self._replays.kept_at, token)
            return StageGrant(f"{PREFIX}{token}", kept_at) if kept_at else None
        return await asyncio.to_thread(self._admit_participant, token, dict(cookies))

    def _admit_participant(self, token: str, cookies: Mapping[str, str]) -> StageGrant | None:
        session_id, _, proof = token.partition(".")
        with self._database.session() as s:
            session = s.get(Session, session_id)
        reason = "unknown_stage" if session is None else self._reason_against(session, proof, cookies)
        if reason is None:
            return StageGrant(session_id)
        if first_this_hour(self._database, token_hash(token), reason):
            with self._database.transaction() as s:
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
        stage, page = self._settings.public_stage_url, self._settings.public_url
        return stage is None or (page is not None and urlsplit(stage).hostname == urlsplit(page).hostname)

    def on_refused(self, reason: str, token_prefix: str) -> None:
        """The door refused something by its own rules: into the event log, too."""
        if reason.endswith("not admitted"):  # `admit` has written down why
            return
        if first_this_hour(self._database, "stage door", token_prefix, reason):
            log.warning("stage door refused", reason=reason)
            threading.Thread(target=self._log_refusal, args=(reason,), daemon=True).start()

    def _log_refusal(self, reason: str) -> None:
        with self._database.transaction() as s:
            log_event(s, "refused", code="stage_door", request="stage", reason=reason)

    def origins(self, requested_host: str) -> Origins | None:
        """Page and stage origin for a request to the stage under that Host header; None: not a name of ours.

        With a public stage address only that one; else whatever host name the browser used, on the stage's port.
        """
        settings = self._settings
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
        with self._database.session() as s:
            row = s.get(Setting, "public_url")
        stored = str(row.value.get("url", "")) if row else ""
        address = urlsplit(stored or self._settings.public_url or "")
        return f"{address.scheme}://{address.netloc}" if address.netloc else None

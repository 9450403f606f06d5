"""Who is the newest of all processes: a session's window in use, a session's stage. The older ones are told."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from desirepath.web.replicas.notices import Notice, Notices

Holder = TypeVar("Holder")


@dataclass
class _Claim(Generic[Holder]):
    claim_id: str
    holder: Holder
    announced: bool = False  # all processes have heard of it, and what was claimed before it


class Claims(Generic[Holder]):
    """Of one topic. All processes hear of claims in one order, so of two at the same moment one goes everywhere."""

    def __init__(self, notices: Notices, topic: str, lost: Callable[[str, Holder], None]) -> None:
        """lost(key, holder): another process has claimed it after this holder did. What is newest within this process,
        its caller knows."""
        self._notices, self._topic, self._lost = notices, topic, lost
        self._lock = threading.Lock()
        self._standing: dict[str, _Claim[Holder]] = {}
        notices.hear(topic, self._heard)
        notices.when_missed(self._announce_again)

    def claim(self, key: str, holder: Holder) -> None:
        """This process has the newest."""
        claim = _Claim(secrets.token_hex(8), holder)
        with self._lock:
            self._standing[key] = claim
        self._notices.tell(self._topic, key, claim=claim.claim_id)

    def give_up(self, key: str) -> None:
        """This process has none any more."""
        with self._lock:
            self._standing.pop(key, None)

    def _announce_again(self) -> None:
        """Its own notice may be among those that were missed."""
        with self._lock:
            waiting = [(key, one.claim_id) for key, one in self._standing.items() if not one.announced]
        for key, claim_id in waiting:
            self._notices.tell(self._topic, key, claim=claim_id)

    def _heard(self, notice: Notice) -> None:
        with self._lock:
            standing = self._standing.get(notice.key)
            if standing is None:
                return
            if notice.data.get("claim") == standing.claim_id:
                standing.announced = True
                return
            if notice.own or not standing.announced:
                return
            del self._standing[notice.key]
        self._lost(notice.key, standing.holder)

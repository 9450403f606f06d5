"""Stages for signed-in people (two rollouts side by side, a protocol's preview): who may open one, and what it shows.

A grant lives in memory for an hour; the stage's own door (`stage_proxy.py`) and `presenting.py` ask here about keys
that begin with `replay:`. Participants' stages have nothing to do with this.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from desirepath.explain.shown_explanation import ShownExplanation
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.sides import Side
from desirepath.web.replicas.peers import Peers
from desirepath_stage.camera_pictures import CameraPictures
from desirepath_stage.paper import Beside
from desirepath_stage.views import View

if TYPE_CHECKING:
    from desirepath_stage.stage import Stage

PREFIX = "replay:"
GRANT_LASTS_S = 3_600.0
MOST_GRANTS = 200  # rollouts are kept in memory; the oldest grants go first


class Shown(Protocol):
    """Something that a stage can show as soon as it has connected."""

    def show(self, stage: Stage) -> None: ...


@runtime_checkable
class Played(Shown, Protocol):
    """Something that a stage also plays when it is asked to."""

    def play(self, stage: Stage, side: Side) -> None: ...


@dataclass(frozen=True)
class Replay:
    """One rollout, or two in one scene, with the names of their policies, and other paths beside them.

    pictures: what their cameras see, looked for when it is shown. explained: what is shown of the first one's reasons.
    """

    rollouts: tuple[Trajectory, ...]
    names: tuple[str, ...]
    beside: tuple[Beside, ...] = ()
    pictures: Callable[[], Sequence[CameraPictures]] = tuple
    explained: ShownExplanation | None = None
    view: View = "top_down"

    def show(self, stage: Stage) -> None:
        stage.replay(
            self.rollouts,
            names=self.names,
            beside=self.beside,
            pictures=self.pictures(),
            explained=self.explained,
            view=self.view,
        )


class ReplayStages:
    """The replays that signed-in people opened with this process. A token names the process that keeps its replay."""

    def __init__(self, peers: Peers) -> None:
        self._peers = peers
        self._granted: dict[str, tuple[float, Shown]] = {}

    def grant(self, shown: Shown) -> str:
        """Admit one browser to a stage with this on it; returns the token for the stage's address."""
        now = time.monotonic()
        self._granted = {token: entry for token, entry in self._granted.items() if now - entry[0] < GRANT_LASTS_S}
        while len(self._granted) >= MOST_GRANTS:
            del self._granted[next(iter(self._granted))]
        token = self._peers.mark(secrets.token_urlsafe(32))
        self._granted[token] = (now, shown)
        return token

    def key_of(self, token: str) -> str | None:
        """The stage key that a token opens, or None if it opens none (any more)."""
        entry = self._granted.get(token)
        if entry is None or time.monotonic() - entry[0] >= GRANT_LASTS_S:
            return None
        return f"{PREFIX}{token}"

    def find_shown(self, token: str) -> Shown | None:
        """What the stage of a token shows, None if the token opens none (any more)."""
        return self._granted[token][1] if self.key_of(token) else None

    def kept_at(self, token: str) -> str | None:
        """Host and port of the other process that keeps the replay, None where it is this one's or nobody's."""
        peer = self._peers.keeper_of(token)
        return peer.address if peer is not None else None

    def show(self, stage: Stage, key: str) -> bool:
        """Show what belongs to the key on a stage that has just connected. False if the key is not one of ours."""
        if not key.startswith(PREFIX):
            return False
        entry = self._granted.get(key.removeprefix(PREFIX))
        if entry is not None:
            entry[1].show(stage)
        return True

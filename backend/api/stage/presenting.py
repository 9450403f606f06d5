"""What stands on a stage: the session machine's state, shown, played, and shown anew when a page has connected.

The machine's state is the truth; a stage knows only scenes and trajectories. Who may open one is `admission.py`'s.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TYPE_CHECKING, cast

import structlog
from sqlalchemy.orm import Session as DatabaseSession

from app.views import View
from backend.api.stage import drawing_sheet, live_scene
from backend.api.stage.listening import Listeners
from backend.api.stage.replay_stages import ReplayStages
from backend.explain.shown_explanation import ShownExplanation
from backend.simulation.trajectory import Trajectory
from backend.store.artefacts import ArtefactStore, load_trajectory
from backend.store.database import Database, DatabaseBusy
from backend.store.models import Session, utc_now
from backend.study.drawing import paths
from backend.study.kinds import kind_of
from backend.study.kinds.base import Moment
from backend.study.session import machine
from backend.study.session.versions import protocol_of

if TYPE_CHECKING:
    from app.stage import Stage
    from app.stage_server import StageServer

log = structlog.get_logger("desirepath.stage")

KEPT_TRAJECTORIES = 128  # in memory; a session needs two at a time


class Presenter:
    """Brings the stages of one server to what its database says. Methods may be called from any thread.

    What stages are told goes through one line, in the order in which it was asked for: nobody who answers waits until
    a scene has been drawn, and no older scene can come after a newer one.
    """

    def __init__(self, database: Database, files: ArtefactStore, replays: ReplayStages, listeners: Listeners) -> None:
        self._database, self._files, self._replays, self._listeners = database, files, replays, listeners
        self._line = ThreadPoolExecutor(1, thread_name_prefix="stages")
        self._trajectory = lru_cache(maxsize=KEPT_TRAJECTORIES)(self._load)
        self.server: StageServer | None = None  # set when a server starts; tests and commands have none

    def on_connect(self, stage: Stage, key: str) -> None:
        """A page's stage has connected and is empty: show what belongs there.

        Whatever played on an earlier connection is seen by nobody any more, so the checkpoint rule applies.
        """
        if self._replays.show(stage, key):
            return
        changed = self._interrupted(key, "stage_connected")
        if changed is None:
            return
        self._line.submit(self._present, stage, key).result()
        if changed:
            self._listeners.changed(key)

    def _interrupted(self, session_id: str, reason: str) -> bool | None:
        """Apply the checkpoint rule, however busy the database. Whether it changed anything; None: no such session."""
        while True:
            try:
                with self._database.transaction(durable=False) as s:
                    session = s.get(Session, session_id, with_for_update=True)
                    if session is None:
                        return None
                    return machine.interrupted(s, session, reason=reason, now=utc_now())
            except DatabaseBusy:
                log.warning("a stage waits for the database")

    def connected(self, session_id: str) -> bool:
        """Whether the session's stage is there to play on; True where this process has no stages at all (tests)."""
        server = self.server
        return server is None or server.stage(session_id) is not None

    def show(self, session_id: str, *, afresh: bool = False) -> None:
        """Bring the stage to what the session's current step needs. afresh: also stop what is playing."""

        def order(stage: Stage) -> None:
            if afresh:
                stage.clear()
            self._present(stage, session_id)

        self._tell(session_id, order)

    def play(self, session_id: str, playback: machine.Playback) -> None:
        """Play a trajectory on the session's stage."""

        def order(stage: Stage) -> None:
            with self._database.session() as s:
                session = s.get_one(Session, session_id)
                trial = machine.trial_of(s, session)
                explained = _explained(s, session)
            if trial is None or machine.playing(trial) != playback:
                return  # the session went on meanwhile
            stage.play(
                self._trajectory(playback.trajectory),
                label=playback.label,
                label_s=playback.label_s,
                view=cast("View", playback.view),
                playback_id=playback.playback_id,
                trajectories=[self._trajectory(one) for one in (trial.trajectory_a, trial.trajectory_b)],
                explained=explained,
            )

        self._tell(session_id, order)

    def play_stroke(self, session_id: str, shown: paths.Showing) -> None:
        """Play the rollout of a drawn path on the session's stage."""
        self._tell(
            session_id, lambda stage: drawing_sheet.play_stroke(self._database, self._files, stage, session_id, shown)
        )

    def show_place(self, session_id: str, place: int) -> None:
        """Show another place of a step at which weights are changed by hand."""
        self._tell(session_id, lambda stage: live_scene.present(self._database, stage, session_id, place))

    def _tell(self, session_id: str, order: Callable[[Stage], None]) -> None:
        """Put an order for the session's stage into the line; nobody waits for it, what goes wrong is logged."""
        server = self.server
        if server is None:
            return

        def carry_out() -> None:
            stage = server.stage(session_id)
            try:
                if stage is not None:
                    order(stage)
            except Exception:
                log.exception("a stage could not be told what to show")
                self._recover(server, session_id)

        self._line.submit(carry_out)

    def _recover(self, server: StageServer, session_id: str) -> None:
        """Nobody waits for what will never play: the checkpoint rule applies, the page is told, the scene is shown."""
        if self._interrupted(session_id, "stage_failed"):
            self._listeners.changed(session_id)
        stage = server.stage(session_id)
        try:
            if stage is not None:
                stage.clear()
                self._present(stage, session_id)
        except Exception:
            log.exception("a stage could not be put back either")

    def _present(self, stage: Stage, session_id: str) -> None:
        with self._database.session() as s:
            session = s.get(Session, session_id)
            trial = explained = None
            active = session is not None and session.state == "active"
            shows = kind_of(machine.step_of(session)).shows if active and session is not None else "page"
            if session is not None and shows == "trajectories":
                trial = machine.trial_of(s, session)
                explained = _explained(s, session)
        if shows == "paper":
            drawing_sheet.present(self._database, stage, session_id)
            return
        if shows == "live":
            live_scene.present(self._database, stage, session_id)
            return
        if trial is None:
            stage.clear()
            return
        a, b = self._trajectory(trial.trajectory_a), self._trajectory(trial.trajectory_b)
        assert session is not None  # noqa: S101  it has a trial
        stage.detail = "light" if session.device.get("scene_detail") == "light" else "full"
        halted = explained is not None and trial.phase == "choosing"
        stage.show(a.scene, cast("View", trial.view), trajectories=[a, b], explained=explained, halted=halted)

    def _load(self, trajectory_id: str) -> Trajectory:
        return load_trajectory(self._files, trajectory_id)


def _explained(s: DatabaseSession, session: Session) -> ShownExplanation | None:
    """What the current step shows of a policy's reasons."""
    step = machine.step_of(session)
    return kind_of(step).explains(step, Moment(s, session, protocol_of(s, session), utc_now()))

"""What stands on a stage: the session machine's state, shown, played, and shown anew when a page has connected.

The machine's state is the truth; a stage knows only scenes and trajectories. Who may open one is `admission.py`'s. Of
several server processes one has a session's stage: what the others want shown there, they tell it.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, cast

import structlog
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.explain.shown_explanation import ShownExplanation
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.database import Database, DatabaseBusy
from desirepath.store.models import Session, utc_now
from desirepath.store.sides import Side
from desirepath.study.drawing import paths
from desirepath.study.kind import Moment, kind_of
from desirepath.study.kinds.live import LiveKind, LiveStep
from desirepath.study.kinds.order import COLOURS
from desirepath.study.session import machine
from desirepath.study.session.versions import protocol_of
from desirepath.study.session.watching import viewing_of
from desirepath.web.replicas.claims import Claims
from desirepath.web.replicas.notices import Notice, Notices
from desirepath.web.stage import drawing_sheet
from desirepath.web.stage.listening import Listeners
from desirepath.web.stage.replay_stages import PREFIX, Played, ReplayStages
from desirepath_stage.views import View

if TYPE_CHECKING:
    from desirepath_stage.stage import Stage
    from desirepath_stage.stage_server import StageServer

log = structlog.get_logger("desirepath.stage")

KEPT_TRAJECTORIES = 128  # in memory; a session needs two at a time


@dataclass(frozen=True)
class Order:
    """What a session's stage is to do. details: as keyword arguments, JSON's own types."""

    do: Literal["show", "play", "play_stroke", "show_place"]
    details: dict[str, Any] = field(default_factory=dict)


class Presenter:
    """Brings the stages of one server to what its database says. Methods may be called from any thread.

    What stages are told goes through one line, in the order in which it was asked for: nobody who answers waits until
    a scene has been drawn, and no older scene can come after a newer one.
    """

    def __init__(
        self,
        database: Database,
        files: ArtefactStore,
        replays: ReplayStages,
        listeners: Listeners,
        notices: Notices,
    ) -> None:
        self._database, self._files, self._replays, self._listeners = database, files, replays, listeners
        self._notices = notices
        self._claims: Claims[Stage] = Claims(notices, "stage", self._stands_elsewhere)
        notices.hear("order", self._ordered)
        notices.hear("replay", self._replay_ordered)
        notices.when_missed(self._missed)
        self._line = ThreadPoolExecutor(1, thread_name_prefix="stages")
        self._trajectory = lru_cache(maxsize=KEPT_TRAJECTORIES)(self._load)
        self.server: StageServer | None = None  # set when a server starts; tests and commands have none

    def on_connect(self, stage: Stage, key: str) -> None:
        """A page's stage has connected and is empty: show what belongs there.

        Whatever played on an earlier connection is seen by nobody any more, so the checkpoint rule applies.
        """
        if self._replays.show(stage, key):
            return
        self._notices.hold(_held_as(key))
        self._claims.claim(key, stage)
        changed = self._interrupted(key, "stage_connected")
        if changed is None:
            return
        self._line.submit(self._present, stage, key).result()
        if changed:
            self._listeners.tell_changed(key)

    def on_disconnect(self, _stage: Stage, key: str) -> None:
        """A page's stage is gone."""
        if self.server is not None and self.server.stage(key) is None:
            self._notices.let_go(_held_as(key))
            self._claims.give_up(key)

    def _stands_elsewhere(self, session_id: str, stage: Stage) -> None:
        """The session's page has its stage from another process now."""
        if self.server is None or self.server.stage(session_id) not in (None, stage):
            return  # and a newer one from this process again
        self._notices.let_go(_held_as(session_id))
        self._line.submit(self.server.retire, session_id, stage)

    def _interrupted(self, session_id: str, reason: str) -> bool | None:
        """Apply the checkpoint rule, however busy the database. Whether it changed anything; None: no such session."""
        while True:
            try:
                with self._database.transaction(durable=False) as s:
                    session = s.get(Session, session_id, with_for_update=True)
                    if session is None:
                        return None
                    return machine.interrupt(s, session, reason=reason, now=utc_now())
            except DatabaseBusy:
                log.warning("a stage waits for the database")

    def is_connected(self, session_id: str) -> bool:
        """Whether the session's stage is there to play on; True where this process has no stages at all (tests)."""
        server = self.server
        return server is None or server.stage(session_id) is not None or self._notices.is_held(_held_as(session_id))

    def show(self, session_id: str, *, afresh: bool = False) -> None:
        """Bring the stage to what the session's current step needs. afresh: also stop what is playing."""
        self._tell(session_id, Order("show", {"afresh": afresh}))

    def play(self, session_id: str, playback: machine.Playback) -> None:
        """Play a trajectory on the session's stage."""
        self._tell(session_id, Order("play", asdict(playback)))

    def play_stroke(self, session_id: str, shown: paths.Showing) -> None:
        """Play the rollout of a drawn path on the session's stage."""
        self._tell(session_id, Order("play_stroke", asdict(shown)))

    def show_place(self, session_id: str, place: int) -> None:
        """Show another place of a step at which weights are changed by hand."""
        self._tell(session_id, Order("show_place", {"place": place}))

    def play_replay(self, token: str, side: Side) -> bool:
        """Play a trajectory on a replay's stage, whichever process keeps it. False: there is no such stage."""
        if self._replays.kept_at(token) is None:
            return self._play_replay(token, side)
        self._notices.tell("replay", token, side=side)
        return True

    def _replay_ordered(self, notice: Notice) -> None:
        if not notice.own:
            self._play_replay(notice.key, notice.data["side"])

    def _play_replay(self, token: str, side: Side) -> bool:
        key, shown = self._replays.key_of(token), self._replays.find_shown(token)
        stage = self.server.stage(key) if self.server is not None and key is not None else None
        if stage is None or not isinstance(shown, Played):
            return False
        self._line.submit(shown.play, stage, side)
        return True

    def _tell(self, session_id: str, order: Order) -> None:
        """Put an order for the session's stage into the line, or send it to the process that has the stage. Nobody
        waits for it, what goes wrong is logged."""
        server = self.server
        if server is None:
            return
        if server.stage(session_id) is None and self._notices.shared:
            self._notices.tell("order", session_id, do=order.do, details=order.details)
        else:
            self._line.submit(self._carry_out, server, session_id, order)

    def _ordered(self, notice: Notice) -> None:
        server = self.server
        if notice.own or server is None or server.stage(notice.key) is None:
            return
        order = Order(notice.data["do"], notice.data["details"])
        self._line.submit(self._carry_out, server, notice.key, order)

    def _missed(self) -> None:
        """Orders may not have come: whatever is to be seen is begun anew."""
        server = self.server
        if server is None:
            return
        for session_id in server.connected_keys():
            if not session_id.startswith(PREFIX):
                self._line.submit(self._recover, server, session_id)

    def _carry_out(self, server: StageServer, session_id: str, order: Order) -> None:
        stage = server.stage(session_id)
        if stage is None:
            return
        try:
            match order.do:
                case "show":
                    if order.details["afresh"]:
                        stage.clear()
                    self._present(stage, session_id)
                case "play":
                    self._play(stage, session_id, machine.Playback(**order.details))
                case "play_stroke":
                    shown = paths.Showing(**order.details)
                    drawing_sheet.play_stroke(self._database, self._files, stage, session_id, shown)
                case "show_place":
                    _present_live(self._database, stage, session_id, order.details["place"])
        except Exception:
            log.exception("a stage could not be told what to show")
            self._recover(server, session_id)

    def _play(self, stage: Stage, session_id: str, playback: machine.Playback) -> None:
        with self._database.session() as s:
            session = s.get_one(Session, session_id)
            trial = machine.trial_of(s, session)
            explained = _explained(s, session)
            goal = viewing_of(session).goal_and_trail
        if trial is None or machine.playing(trial) != playback:
            return  # the session went on meanwhile
        stage.play(
            self._trajectory(playback.trajectory),
            label=playback.label,
            label_s=playback.label_s,
            view=cast("View", playback.view),
            playback_id=playback.playback_id,
            trajectories=[self._trajectory(trajectory) for trajectory in (trial.trajectory_a, trial.trajectory_b)],
            goal=goal,
            explained=explained,
        )

    def _recover(self, server: StageServer, session_id: str) -> None:
        """Nobody waits for what will never play: the checkpoint rule applies, the page is told, the scene is shown."""
        if self._interrupted(session_id, "stage_failed"):
            self._listeners.tell_changed(session_id)
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
            goal = False
            active = session is not None and session.state == "active"
            shows = kind_of(machine.step_of(session)).shows if active and session is not None else "page"
            if session is not None and shows == "trajectories":
                trial = machine.trial_of(s, session)
                explained = _explained(s, session)
                goal = viewing_of(session).goal_and_trail
        if shows == "paper":
            drawing_sheet.present(self._database, stage, session_id)
            return
        if shows == "live":
            _present_live(self._database, stage, session_id)
            return
        if trial is None:
            stage.clear()
            return
        a, b = self._trajectory(trial.trajectory_a), self._trajectory(trial.trajectory_b)
        if a.recorded is not None and a.recorded.video is not None:  # the page itself shows it
            stage.clear()
            return
        assert session is not None  # noqa: S101  it has a trial
        stage.detail = "light" if session.device.get("scene_detail") == "light" else "full"
        halted = explained is not None and trial.phase == "choosing"
        view = cast("View", trial.view)
        if len(trial.shown) > 2:
            stage.several(view, [self._trajectory(one) for one in trial.shown], COLOURS)
            return
        stage.show(a.scene, view, trajectories=[a, b], goal=goal, explained=explained, halted=halted)

    def _load(self, trajectory_id: str) -> Trajectory:
        return load_trajectory(self._files, trajectory_id)


def _held_as(session_id: str) -> str:
    """How a process says that it has the session's stage."""
    return f"stage {session_id}"


def _explained(s: DatabaseSession, session: Session) -> ShownExplanation | None:
    """What the current step shows of a policy's reasons."""
    step = machine.step_of(session)
    return kind_of(step).explains(step, Moment(s, session, protocol_of(s, session), utc_now()))


def _present_live(database: Database, stage: Stage, session_id: str, place: int = 0) -> None:
    """Show one of the places of a step at which weights are changed by hand, with its goal, unless the session went on
    meanwhile. The paths come from the page itself (`participant/live_requests.py`)."""
    from desirepath.study.personalising.live_rollouts import warm_up

    with database.session() as s:
        session = s.get_one(Session, session_id)
        step = machine.step_of(session)
        light = session.device.get("scene_detail") == "light"
    kind = kind_of(step)
    if not isinstance(step, LiveStep) or not isinstance(kind, LiveKind) or place >= step.scenes:
        return
    scene, beside = kind.scene(step, place)
    stage.detail = "light" if light else "full"
    stage.live(scene, step.view, trajectories=beside, robots=kind.robots_in(step), around_m=kind.around_m)
    warm_up(step.setup)  # while the browser builds the room, so that the first path is not waited for

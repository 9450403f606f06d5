"""Simulated participants in this process: through the real state machine and tables, without a server.

For power and benchmarks. What they answer lives in `participant.py`; over HTTP or here, the same seed leaves the same
data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any
from uuid import uuid4

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.database import Database
from desirepath.store.models import Participant, Session, Study, utc_now
from desirepath.store.outbox import cancel_job
from desirepath.study.drawing import paths, strokes, walks
from desirepath.study.kinds.demonstration import drawing_of
from desirepath.study.links import next_token
from desirepath.study.personalising import alignment_jobs
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.study.session.joining import join_study
from desirepath.study.simulated.known import tell_simulated
from desirepath.study.simulated.participant import (
    SIMULATED_HEADSET,
    Character,
    SaidMark,
    SimulationError,
    State,
    walk_all,
)


def walk_in_process(
    database: Database,
    files: ArtefactStore,
    study: Study,
    participants: int,
    character: Character | None = None,
    *,
    without_jobs: bool = False,
) -> dict[str, Any]:
    """Walk `participants` of them one after another through the study; returns what `participant.walk_all` does.

    In a study with a train stage a worker must run; without_jobs: its jobs are cancelled instead, and they go on
    without comparisons. Raises SimulationError if the machine refuses something, LearningError for an unknown oracle.
    """
    known: dict[str, Trajectory] = {}
    clients = (_InProcess(database, files, study, known, without_jobs) for _ in range(participants))
    return walk_all(clients, character or Character())


class _InProcess:
    """A session by direct calls, each in its own transaction, as a request would."""

    def __init__(
        self, database: Database, files: ArtefactStore, study: Study, known: dict[str, Trajectory], without_jobs: bool
    ) -> None:
        self._database, self._files, self._study, self._known = database, files, study, known
        self._without_jobs, self._token = without_jobs, ""

    def join(self, character: Mapping[str, Any]) -> str:
        try:
            with self._database.transaction() as s:
                session, self._token = join_study(
                    s, self._study, language="en", simulated=True, oracle=character, files=self._files
                )
                return s.get_one(Participant, session.participant_id).code
        except Refused as refused:
            raise SimulationError(f"the study refused a simulated participant: {refused.message}") from refused

    def come_back(self) -> State:
        self._token = next_token(self._token)
        return self.state()

    def state(self) -> State:
        def act(s: DatabaseSession, session: Session) -> None:
            for job in alignment_jobs.jobs_of(s, session) if self._without_jobs else ():
                if job.state == "queued":
                    cancel_job(s, job.id, by="a walk without jobs")
            machine.settle(s, self._files, session, now=utc_now())

        return self._do("look", act)

    def start(self, key: str) -> State:
        return self._do("start", lambda s, x: machine.start_trial(s, x, key, request_id=None, now=utc_now()))

    def report_seen(
        self, key: str, side: machine.Side, playback_id: str, *, worn: bool = False, marks: Sequence[SaidMark] = ()
    ) -> State:
        headset = dict(SIMULATED_HEADSET) if worn else None

        def act(s: DatabaseSession, session: Session) -> machine.Playback | None:
            return machine.trajectory_seen(s, session, key, side, playback_id, headset=headset, now=utc_now())

        return self._do("seen", act)

    def trajectories(self) -> list[Trajectory]:
        with acting(self._database, self._token, request="trajectories", now=utc_now()) as (s, session):
            trial = machine.trial_of(s, session)
            if trial is None:
                raise SimulationError("the current step is no trial")
            shown = trial.shown
        for trajectory in shown:
            if trajectory not in self._known:
                self._known[trajectory] = load_trajectory(self._files, trajectory)
        return [self._known[one] for one in shown]

    def draw(self, key: str, stroke: Mapping[str, Any]) -> State:
        problems: list[dict[str, Any] | None] = []

        def act(s: DatabaseSession, session: Session) -> None:
            step, now = drawing_of(session), utc_now()
            attempt = strokes.attempt_of(step, stroke, simulated=True)
            problems.append(attempt.problem)
            strokes.add_stroke(
                s, self._files, session, step, attempt, request_id=uuid4().hex, client_time=None, now=now
            )

        return {**self._do("draw", act), "problem": problems[0]}

    def report_walk(self, key: str, playback_id: str, walk: Mapping[str, Any]) -> State:
        problems: list[dict[str, Any] | None] = []

        def act(s: DatabaseSession, session: Session) -> None:
            step = drawing_of(session)
            stroke = paths.latest_stroke(s, session.id, key)
            if stroke is None:
                raise SimulationError(f"{key}: nothing was drawn to walk beside")
            scene = paths.scene_of(step)
            walked = walks.combine_with_walk(scene, stroke.drawn, stroke.trajectory, walk, simulated=True)
            problems.append(walked.problem)
            strokes.mark_watched(s, self._files, session, step, playback_id, walked, now=utc_now())

        return {**self._do("walked", act), "problem": problems[0]}

    def submit(self, key: str, value: Mapping[str, Any]) -> State:
        def act(s: DatabaseSession, session: Session) -> bool:
            submitted = machine.submit(
                s, self._files, session, key, value, request_id=uuid4().hex, client_time=None, now=utc_now()
            )
            return submitted.duplicate

        return self._do("submit", act)

    def _do(self, request: str, act: Callable[[DatabaseSession, Session], object]) -> dict[str, Any]:
        """What the API would answer after `act`."""
        try:
            with acting(self._database, self._token, request=request, now=utc_now()) as (s, session):
                done = act(s, session)
                view = machine.current(s, session)
                shown = view.as_dict() | tell_simulated(s, session, view)
                return {"state": session.state, "step": shown, "duplicate": done if isinstance(done, bool) else False}
        except Refused as refused:
            raise SimulationError(f"the machine refused {request!r}: {refused.code}, {refused.message}") from refused

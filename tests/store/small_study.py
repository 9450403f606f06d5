"""A small study written straight into the tables: real trajectories' bytes, a handful of participants and answers."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from desirepath.simulation.scene import Person, Pose, Room, Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.store.artefacts import ArtefactStore, save_artefact, save_trajectory
from desirepath.store.database import Database
from desirepath.store.events import log_event
from desirepath.store.models import (
    Participant,
    ProblemReport,
    RecruitingId,
    Response,
    Session,
    Study,
    Trial,
    new_id,
    protocol_digest,
)

STARTED = datetime(2026, 11, 2, 9, 30, tzinfo=UTC)
PROTOCOL_YAML = "protocol: quick_preference_study\r\nversion: 1\nscreen_out: {completion_code: PAID-1}\n"
FILES = {
    "questionnaires/background.yaml": """
title: {en: Background}
blocks:
  - items:
      - {key: age, type: number, text: {en: Age}}
      - {key: presence, type: scale, text: {en: Presence}, low: {en: low}, high: {en: high}}
  - items:
      - {key: remark, type: text, text: {en: Remark}}
      - {key: taste, type: choice, text: {en: Taste}, options: [{value: a, label: {en: A}}, {value: b, label: {en: B}}]}
""",
    "texts/information.md": "# Über diese Studie\n",
}


def trajectory(seed: int, steps: int = 6, setup: str = "study_room") -> Trajectory:
    """A short straight drive; every seed is another scene and other numbers."""
    rng = np.random.default_rng(seed)
    poses = np.zeros((steps + 1, 3), dtype=np.float32)
    poses[:, 0] = np.linspace(-2.0, 2.0, steps + 1)
    poses[:, 1] = 0.1 * seed
    observations = rng.normal(size=(steps + 1, get_setup(setup).observation_size)).astype(np.float32)
    dones = np.zeros(steps, dtype=np.bool_)
    dones[-1] = True
    return Trajectory(
        scene=Scene(
            setup=setup,
            seed=seed,
            start=Pose(-2.0, 0.0),
            goal=Pose(2.0, 0.0),
            goal_radius=0.36,
            person=Person(Pose(0.0, 1.5, -1.5)),
            room=Room(8.0, 11.0),
        ),
        outcome=Outcome.SUCCESS,
        poses=poses,
        observations=observations[:-1],
        actions=rng.uniform(-1, 1, size=(steps, 2)).astype(np.float32),
        rewards=rng.normal(size=steps).astype(np.float32),
        next_observations=observations[1:],
        dones=dones,
    )


@dataclass
class SmallStudy:
    """A study in a database; each method adds to it in a transaction of its own and returns ids."""

    database: Database
    files: ArtefactStore
    id: str = ""

    def __post_init__(self) -> None:
        with self.database.transaction() as s:
            study = Study(
                name="Passing people",
                protocol_name="quick_preference_study",
                protocol_version=1,
                protocol_yaml=PROTOCOL_YAML,
                protocol={
                    "protocol": "quick_preference_study",
                    "licence": "CC-BY-4.0",
                    "screen_out": {"completion_code": "PAID-1"},
                },
                files=FILES,
                protocol_hash=protocol_digest(PROTOCOL_YAML, FILES),
                recruiting_token=f"recruit-{new_id()}",
                seed=7,
                created_at=STARTED,
            )
            s.add(study)
        self.id = study.id

    def participant(
        self,
        code: str,
        choices: str = "abab",
        *,
        simulated: bool = False,
        pilot: bool = False,
        secret: str = "fine",
        drives: int = 0,
    ) -> tuple[str, str]:
        """A participant with a practice trial, one answered query per letter of `choices`, and a questionnaire.

        drives: seed of the first drive; query k shows drives + 2k and drives + 2k + 1. secret: what they write as free
        text everywhere where they can. Returns participant id and session id.
        """
        with self.database.transaction() as s:
            person = Participant(
                study_id=self.id,
                code=code,
                simulated=simulated,
                pilot=pilot,
                oracle={"name": "min-human-distance", "noise": 0.0} if simulated else None,
                created_at=STARTED,
            )
            s.add(person)
            s.flush()
            session = Session(
                participant_id=person.id,
                study_id=self.id,
                token_hash=hashlib.sha256(person.id.encode()).hexdigest(),
                simulated=simulated,
                seed=3,
                plan=[
                    {"key": "trial-0", "kind": "trial"},
                    {"key": "background", "kind": "questionnaire", "questionnaire": "background"},
                ],
                device={"width": 1280, "user_agent": f"Browser {secret}"},
                completion_code=f"done-{code}",
                created_at=STARTED,
                expires_at=STARTED + timedelta(days=1),
            )
            s.add(session)
            s.add(
                RecruitingId(
                    participant_id=person.id,
                    study_id=self.id,
                    platform="prolific",
                    external_id=f"prolific-{code}-{secret}",
                    details={"STUDY_ID": "recruiter-study-1"},
                )
            )
            s.flush()
            for k, choice in enumerate("a" + choices):
                a, b = (save_trajectory(s, self.files, trajectory(drives + 2 * k + side)) for side in (0, 1))
                trial = Trial(
                    session_id=session.id,
                    step_key=f"trial-{k}",
                    index=k,
                    block="top_down",
                    kind="query",
                    role="practice" if k == 0 else "regular",
                    view="top_down",
                    query_id=f"query-{drives + 2 * k}",
                    trajectory_a=a.id,
                    trajectory_b=b.id,
                    phase="answered",
                    a_seen_at=STARTED + timedelta(seconds=10 * k + 4),
                    b_seen_at=STARTED + timedelta(seconds=10 * k + 8),
                )
                s.add(trial)
                s.flush()
                at = STARTED + timedelta(seconds=10 * k + 9)
                s.add(self._response(session.id, f"trial-{k}", "preference", {"choice": choice}, at, trial.id))
                log_event(s, "answered", session_id=session.id, trial_id=trial.id, request=new_id())
            items = {"age": 44, "remark": secret, "presence": 6, "taste": "regular", "devices": ["tablet", "laptop"]}
            at = STARTED + timedelta(minutes=9)
            s.add(self._response(session.id, "background", "questionnaire", items, at))
            s.add(ProblemReport(session_id=session.id, text=secret))
            log_event(s, "problem_reported", session_id=session.id, text=secret)
            log_event(s, "participant_excluded_once", study_id=self.id, participant=code, reason=secret)
        return person.id, session.id

    def model(self, parent: str, *, kind: str = "policy", card: dict[str, object] | None = None) -> str:
        """A learned artefact made from another one. Returns its id."""
        with self.database.transaction() as s:
            made = save_artefact(
                s,
                self.files,
                kind=kind,
                name=f"{kind} of {parent[:6]}",
                setup="study_room",
                content=f"{kind} made from {parent}".encode(),
                card=card or {},
                parents=[(parent, "made_from")],
            )
        return made.id

    @staticmethod
    def _response(
        session: str, step: str, kind: str, value: dict[str, object], at: datetime, trial: str | None = None
    ) -> Response:
        return Response(
            session_id=session,
            trial_id=trial,
            step_key=step,
            kind=kind,
            value=value,
            request_id=new_id(),
            client_time=at - timedelta(milliseconds=30),
            decision_s=1.25 if trial else None,
            created_at=at,
        )

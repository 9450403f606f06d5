"""A study whose answers mean something: shipped queries, answered by an oracle, written straight into the tables.

For tests of what is learned from answers; how answers come in over HTTP is tested elsewhere.
"""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime, timedelta

from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.store.artefacts import ArtefactStore, save_trajectory
from desirepath.store.database import Database
from desirepath.store.models import Participant, Response, Session, Study, Trial, new_id, protocol_digest

STARTED = datetime(2026, 11, 2, 9, 30, tzinfo=UTC)
PROTOCOL_YAML = "protocol: quick_preference_study\n"


def add_answered_study(
    database: Database,
    files: ArtefactStore,
    *,
    participants: int = 1,
    answers: int = 15,
    oracle: str = "min-human-distance",
    name: str = "Passing people",
) -> str:
    """A study with that many simulated participants, each with its own queries; returns the study's id."""
    queries = load_queries("study_room/queries_500").queries[:200]
    taste = make_oracle(oracle)
    with database.transaction() as s:
        study = Study(
            name=name,
            protocol_name="quick_preference_study",
            protocol_version=1,
            protocol_yaml=PROTOCOL_YAML,
            protocol={"protocol": "quick_preference_study"},
            files={},
            protocol_hash=protocol_digest(PROTOCOL_YAML, {}),
            recruiting_token=f"recruit-{new_id()}",
            seed=7,
            created_at=STARTED,
        )
        s.add(study)
        s.flush()
        for number in range(participants):
            person = Participant(
                study_id=study.id,
                code=f"P{number + 1:03d}",
                simulated=True,
                oracle={"name": oracle, "noise": 0.0, "seed": number},
                created_at=STARTED,
            )
            s.add(person)
            s.flush()
            session = Session(
                participant_id=person.id,
                study_id=study.id,
                token_hash=hashlib.sha256(person.id.encode()).hexdigest(),
                simulated=True,
                seed=number,
                state="completed",
                plan=[{"key": f"trial-{k}", "kind": "trial"} for k in range(answers)],
                created_at=STARTED,
                expires_at=STARTED + timedelta(days=1),
            )
            s.add(session)
            s.flush()
            for k in range(answers):
                query = queries[(number * answers + k) % len(queries)]
                a, b = (save_trajectory(s, files, drive) for drive in (query.trajectory_a, query.trajectory_b))
                trial = Trial(
                    session_id=session.id,
                    step_key=f"trial-{k}",
                    index=k,
                    kind="query",
                    view="top_down",
                    query_id=query.digest(),
                    trajectory_a=a.id,
                    trajectory_b=b.id,
                    phase="answered",
                )
                s.add(trial)
                s.flush()
                s.add(
                    Response(
                        session_id=session.id,
                        trial_id=trial.id,
                        step_key=trial.step_key,
                        kind="preference",
                        value={"choice": "ab"[taste.choose(query)]},
                        request_id=new_id(),
                        decision_s=1.5,
                        created_at=STARTED + timedelta(seconds=20 * k),
                    )
                )
    return study.id

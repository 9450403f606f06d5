"""From a participant's answers to the comparison: starts the alignment, and turns its result into blind trials.

The alignment itself is a job (`backend/jobs`); which step comes next is decided in `machine.py`.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.artefacts import ArtefactStore
from backend.store.demonstration_snapshots import StrokeError, take_demonstrations
from backend.store.events import log_event
from backend.store.models import Artefact, Job, Participant, Response, Session, Study, TrajectoryRow, Trial
from backend.store.outbox import PARTICIPANT_WAITS, enqueue_job
from backend.store.snapshots import SnapshotError, take_snapshot
from backend.store.who_counts import not_left_out
from backend.study.plan.planning import Step
from backend.study.protocol.schema import Protocol
from backend.study.protocol.stages import TrainStage

BOT_PATIENCE = 10  # ours: nobody sits in front of a bot, and its comparisons are what a simulation is for
SIMULATED_WAITS = 5  # ours: bots wait behind people
PATHS_JOB = "train_demonstrations"
UPDATES_WHILE_ONE_WAITS = 16_000
"""Of the job above, instead of its own default: demonstrated starts are followed after half of these already, and
somebody waits for them. What more would buy is unseen goals (docs/numbers.md)."""
EVERY_PAIR = 4  # spec 02: situations of an environment
LARGEST_JOB_SEED = 9_999  # backend/jobs/kinds.py: seeds of a job name scene sets


def train_stage(protocol: Protocol) -> TrainStage:
    """The protocol's train stage."""
    return next(entry.train for entry in protocol.stages if entry.train)


def start_training(
    s: DatabaseSession, files: ArtefactStore, session: Session, study: Study, protocol: Protocol
) -> None:
    """Freeze the session's answers and put the alignment into the outbox, in the answer's own transaction.

    Recipe instant: two jobs, the second the conditioning search behind it. None where there are too few answers, or
    where the participant did not consent to learning from theirs; the session's `personalisation` says so.
    """
    stage = train_stage(protocol)
    if (s.get_one(Participant, session.participant_id).consents or {}).get("training") is False:
        session.personalisation = "no_consent"
        log_event(s, "personalisation", session_id=session.id, outcome="no_consent")
        return
    try:
        if stage.job == "demonstrations":
            _learn_from_paths(s, files, session, protocol)
            return
        snapshot = take_snapshot(s, files, session_id=session.id)
    except (SnapshotError, StrokeError) as problem:
        session.personalisation = "too_few_answers"
        log_event(s, "personalisation", session_id=session.id, outcome="too_few_answers", reason=str(problem))
        return
    comparison = next((entry.comparison for entry in protocol.stages if entry.comparison), None)
    other = _policy_of_another(s, session) if comparison is not None and "other" in comparison.opponents else None
    recipes: list[dict[str, str]] = [{"recipe": stage.recipe}]
    if stage.recipe == "instant":
        recipes.append({"recipe": "conditioning_search"})
    for recipe in recipes:
        job = enqueue_job(
            s,
            stage.job,
            {
                "snapshot": snapshot.id,
                "setup": snapshot.setup,
                "comparisons": comparison.scenes if comparison is not None else 0,
                "other": other,
                "symmetry": protocol.symmetry,
                "seed": session.seed % (LARGEST_JOB_SEED + 1),
                **recipe,
            },
            priority=SIMULATED_WAITS if session.simulated else PARTICIPANT_WAITS,
            study_id=study.id,
            session_id=session.id,
            created_by="study",
        )
        log_event(
            s, "training_started", session_id=session.id, job=job.id, snapshot=snapshot.id, recipe=recipe["recipe"]
        )


def _policy_of_another(s: DatabaseSession, session: Session) -> str | None:
    """The policy of the participant of the same study whose alignment was ready last; None where nobody's was yet.

    People are compared with people's, simulated participants with simulated ones'. Who withdrew or was excluded lends
    nothing.
    """
    lent = s.scalars(
        select(Job)
        .join(Session, Session.id == Job.session_id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(
            Session.study_id == session.study_id,
            Session.participant_id != session.participant_id,
            Session.simulated == session.simulated,
            not_left_out(),
            Job.kind == "align",
            Job.state == "succeeded",
        )
        .order_by(Job.finished_at.desc(), Job.id)
    )
    ready = (str((job.result or {})["policy"]) for job in lent if _verdict(job) == "shown")
    here = (one for one in ready if (kept := s.get(Artefact, one)) is not None and kept.quarantined_at is None)
    return next(here, None)


def _learn_from_paths(s: DatabaseSession, files: ArtefactStore, session: Session, protocol: Protocol) -> None:
    """One job per environment that was drawn in, in the order of the stages. StrokeError: nothing was kept in one."""
    scenes = next((entry.comparison.scenes for entry in protocol.stages if entry.comparison), 0)
    if any(entry.evaluation for entry in protocol.stages):
        scenes = EVERY_PAIR
    environments = dict.fromkeys(one.demonstrations.environment for one in protocol.stages if one.demonstrations)
    snapshots = [  # all of them before the first job: either every environment can be learned from, or none is
        take_demonstrations(s, files, study_id=session.study_id, environment=environment, session_id=session.id)
        for environment in environments
    ]
    for snapshot in snapshots:
        job = enqueue_job(
            s,
            PATHS_JOB,
            {
                "snapshot": snapshot.id,
                "comparisons": scenes,
                "seed": session.seed % (LARGEST_JOB_SEED + 1),
                "updates": UPDATES_WHILE_ONE_WAITS,
            },
            priority=SIMULATED_WAITS if session.simulated else PARTICIPANT_WAITS,
            study_id=session.study_id,
            session_id=session.id,
            created_by="study",
        )
        log_event(s, "training_started", session_id=session.id, job=job.id, snapshot=snapshot.id, recipe=job.kind)


def jobs_of(s: DatabaseSession, session: Session) -> list[Job]:
    """The session's alignments, of each recipe the newest (a retry counts), the one to be preferred first: a
    refinement is shown instead of the instant policy that it began with, once it is there and better."""
    found = s.scalars(
        select(Job)
        .join(Session, Session.id == Job.session_id)
        .where(Session.participant_id == session.participant_id, Job.kind.in_(("align", PATHS_JOB)))
        .order_by(Job.created_at, Job.id)
    )
    newest = {(job.params["snapshot"], job.params.get("recipe")): job for job in found}
    return sorted(newest.values(), key=lambda job: job.params.get("recipe") == "instant")


def ready_job(s: DatabaseSession, session: Session) -> Job | None:
    """The alignment whose policy may be shown now."""
    return next((job for job in jobs_of(s, session) if _verdict(job) == "shown"), None)


def _verdict(job: Job, *, rated: bool = False) -> str | None:
    """What became of one alignment, None while it goes on. rated: its drives are rated one by one, arrived or not."""
    if job.state == "succeeded":
        result = job.result or {}
        if not result.get("passed"):
            return "gate_not_passed"
        return "shown" if result.get("comparisons") or (rated and result.get("situations")) else "no_scenes"
    return "job_failed" if job.state in ("failed", "cancelled", "cancelling") else None


def progress_of(s: DatabaseSession, session: Session) -> float:
    """How far the learning is that somebody waits for, 0 to 1: of each snapshot the furthest job, on average."""
    furthest: dict[str, float] = {}
    for job in jobs_of(s, session):
        snapshot = job.params["snapshot"]
        furthest[snapshot] = max(job.progress, furthest.get(snapshot, 0.0))
    return sum(furthest.values()) / len(furthest) if furthest else 0.0


def outcome_of(s: DatabaseSession, session: Session, protocol: Protocol, now: datetime) -> str | None:
    """How the learning stands for somebody who waits: None means not ready and still worth waiting for. Of several
    recipes for one snapshot one that can be shown is enough; of several environments each is waited for.

    Else: shown, job_failed, late, gate_not_passed, too_few_answers, no_consent, no_scenes (a policy that
    passed the gate, but no scene in which both drives can be compared).
    """
    if session.personalisation is not None:
        return session.personalisation
    jobs = jobs_of(s, session)
    if not jobs:
        return "too_few_answers"
    rated = any(entry.evaluation for entry in protocol.stages)
    of_snapshot: dict[str, list[str | None]] = {}
    for job in jobs:
        of_snapshot.setdefault(job.params["snapshot"], []).append(_verdict(job, rated=rated))
    verdicts = ["shown" if "shown" in each else None if None in each else each[-1] for each in of_snapshot.values()]
    if None not in verdicts:
        return "shown" if "shown" in verdicts else verdicts[-1]
    last = s.scalar(select(func.max(Response.created_at)).where(Response.session_id == session.id))
    began = min(job.created_at for job in jobs)
    since = max(began, last) if last else began
    patience = timedelta(seconds=train_stage(protocol).give_up_after_s) * (BOT_PATIENCE if session.simulated else 1)
    if now - since <= patience:
        return None
    return "shown" if "shown" in verdicts else "late"


def make_comparisons(s: DatabaseSession, session: Session, now: datetime) -> int:
    """The comparison trials from the job's drives; sides as the plan's lot says. Returns how many there are."""
    job = ready_job(s, session)
    result: dict[str, Any] = (job.result or {}) if job is not None else {}
    planned: list[tuple[int, Step]] = [(i, step) for i, step in enumerate(session.plan) if step["kind"] == "comparison"]
    made = {"base": iter(result.get("comparisons", [])), "other": iter(result.get("yoked", []))}
    count = 0
    for index, step in planned:
        against = step.get("against", "base")
        drives = next(made[against], None)
        if drives is None:
            continue
        count += 1
        rival = s.get(TrajectoryRow, drives[against])
        policies = {"own": result["policy"], against: rival.made_by if rival is not None else None}
        if job is not None and job.kind == PATHS_JOB:
            policies["base"] = "dwa"  # which is no artefact
        a, b = ("own", against) if step["turned"] else (against, "own")
        arms = {"a": policies[a], "b": policies[b], "own": "a" if a == "own" else "b"}
        if against == "other":
            arms["other"] = "b" if a == "own" else "a"
        s.add(
            Trial(
                session_id=session.id,
                step_key=step["key"],
                index=index,
                block=step["stage"],
                kind="comparison",
                view=step["view"],
                trajectory_a=drives[a],
                trajectory_b=drives[b],
                arms={**arms, "look_alike": drives["look_alike"]},
                phase_since=now,
            )
        )
    s.flush()
    return count

"""From a participant's answers to what may be shown of them: starts the alignment, and says how its result stands.

The alignment itself is a job (`backend/desirepath/jobs`); what the session does meanwhile is `kinds/wait.py`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.simulation.setups import has_depth_camera
from desirepath.store.demonstration_snapshots import StrokeError, take_demonstrations
from desirepath.store.events import log_event
from desirepath.store.job_results import AlignResult, Learned
from desirepath.store.models import Artefact, Job, Participant, Response, Session, Trial
from desirepath.store.outbox import ENDED, NOBODY_WAITS, PARTICIPANT_WAITS, REFINES, cancel_job, enqueue_job
from desirepath.store.snapshots import SnapshotError, take_snapshot
from desirepath.store.who_counts import not_left_out, same_kind
from desirepath.study.frozen import Training
from desirepath.study.personalising.clicking import without_comparing
from desirepath.study.personalising.lending import Lent, lend_policy
from desirepath.study.personalising.verdicts import verdict

if TYPE_CHECKING:
    from desirepath.study.kind import Acting, Moment

BOT_PATIENCE = 10  # ours: nobody sits in front of a bot, and its comparisons are what a simulation is for
PATHS_JOB = "train_demonstrations"
REFINEMENTS = {"instant": "conditioning_search", "each_scene": "each_scene_trained"}
"""What looks for something better behind what is there at once, and takes its place."""
UPDATES_WHILE_ONE_WAITS = 16_000
"""Of the job above with a depth camera, instead of its own default: somebody waits for them."""
EVERY_PAIR = 4  # ch. 2: situations of an environment
SURELY_BETTER = 0.9
"""With what probability a policy has to be better for this very person before it is shown as theirs."""
MOST_EARLIER = 100  # people; more would hardly change what all weigh
LARGEST_JOB_SEED = 9_999  # backend/desirepath/jobs/kinds.py: seeds of a job name scene sets


def start_training(acting: Acting) -> None:
    """Freeze the session's answers and put the alignment into the outbox, in the answer's own transaction.

    Of recipes that are there at once: two jobs, the second one of `REFINEMENTS`. None where there are too few answers,
    where the participant did not consent to learning from theirs, or where they chose without comparing
    (`clicking.py`); the session's `personalisation` says so.
    """
    s, files, session, training = acting.s, acting.files, acting.session, acting.frozen.training
    assert training is not None  # noqa: S101  a step begins it only where a stage says so
    if (s.get_one(Participant, session.participant_id).consents or {}).get("training") is False:
        session.personalisation = "no_consent"
        log_event(s, "personalisation", session_id=session.id, outcome="no_consent")
        return
    careless = without_comparing(s, session)
    if careless is not None:
        session.personalisation = careless
        log_event(s, "personalisation", session_id=session.id, outcome=careless)
        return
    try:
        if training.job == "demonstrations":
            _learn_from_paths(acting, training)
            return
        snapshot = take_snapshot(s, files, session_id=session.id)
    except (SnapshotError, StrokeError) as problem:
        session.personalisation = "too_few_answers"
        log_event(s, "personalisation", session_id=session.id, outcome="too_few_answers", reason=str(problem))
        return
    lent: Lent = {}
    if "other" in training.opponents:
        lent = lend_policy(s, session, setup=snapshot.setup, stand_ins=training.stand_ins)
    neutral = {"neutral": training.scenes} if "neutral" in training.opponents else {}
    earlier = earlier_snapshots(s, session) if training.prior == "earlier_participants" else []
    in_general = {}
    if "population" in training.opponents:
        people = ",".join(earlier_snapshots(s, session))
        in_general = {"population": training.scenes, "people": people} if people else {}
    priority = _priority(session, training)
    recipes = {training.recipe: priority}
    if training.recipe in REFINEMENTS:
        recipes[REFINEMENTS[training.recipe]] = max(REFINES, priority + 1)  # behind what other bots wait for, too
    for recipe, after in recipes.items():
        job = enqueue_job(
            s,
            training.job,
            {
                "snapshot": snapshot.id,
                "setup": snapshot.setup,
                "comparisons": training.scenes,
                "other": None,
                **lent,
                **neutral,
                **in_general,
                **({"earlier": ",".join(earlier)} if earlier else {}),
                **({"prior": training.prior} if training.prior == "people_in_general" else {}),
                "surely_better": SURELY_BETTER,
                "symmetry": acting.frozen.protocol.symmetry,
                "seed": session.seed % (LARGEST_JOB_SEED + 1),
                "recipe": recipe,
            },
            priority=after,
            study_id=session.study_id,
            session_id=session.id,
            created_by="study",
        )
        log_event(
            s,
            "training_started",
            session_id=session.id,
            job=job.id,
            snapshot=snapshot.id,
            recipe=recipe,
            prior=training.prior,
            earlier=len(earlier),
        )


def start_training_again(acting: Acting) -> None:
    """After further pairs: all answers, in place of what was learned from fewer. Nothing where the outcome is known."""
    if acting.session.personalisation is not None:
        return
    end_trainings(acting.s, acting.session, by="study")
    start_training(acting)


def _priority(session: Session, training: Training) -> int:
    """Of what is trained: nobody sits in front of a bot, or waits for what no page shows."""
    waits = not session.simulated and (training.scenes > 0 or training.rated)
    return PARTICIPANT_WAITS if waits else NOBODY_WAITS


def end_trainings(s: DatabaseSession, session: Session, *, by: str, refinements_only: bool = False) -> None:
    """Cancel what the session still has under way."""
    for job in jobs_of(s, session):
        if job.state in (*ENDED, "cancelling") or (
            refinements_only and job.params.get("recipe") not in REFINEMENTS.values()
        ):
            continue
        with suppress(ValueError):  # it has just ended
            cancel_job(s, job.id, by=by)


def end_what_nobody_waits_for(s: DatabaseSession, session: Session, outcome: str | None = None) -> None:
    """Once it is settled what the session shows (outcome), or the session is over (None): nothing that was made for
    its pages goes on, so that it holds no process which somebody else waits for. A training of which no page shows
    anything is the study's own, and stays.
    """
    waited = [job for job in jobs_of(s, session) if job.priority <= PARTICIPANT_WAITS]
    only = outcome == "shown" or not waited  # of several environments others may be learned still
    end_trainings(s, session, by="study: nobody waits for it any more", refinements_only=only)


def _learn_from_paths(acting: Acting, training: Training) -> None:
    """One job per environment that was drawn in, in the order of the stages. StrokeError: nothing was kept in one."""
    s, files, session = acting.s, acting.files, acting.session
    scenes = EVERY_PAIR if training.rated else training.scenes
    snapshots = [  # all of them before the first job: either every environment can be learned from, or none is
        take_demonstrations(s, files, study_id=session.study_id, environment=environment, session_id=session.id)
        for environment in training.environments
    ]
    for snapshot in snapshots:
        by_depth = has_depth_camera(snapshot.setup)
        job = enqueue_job(
            s,
            PATHS_JOB,
            {
                "snapshot": snapshot.id,
                "comparisons": scenes,
                "seed": session.seed % (LARGEST_JOB_SEED + 1),
                "sensor": "depth" if by_depth else "places",
                "updates": UPDATES_WHILE_ONE_WAITS if by_depth else None,
            },
            priority=_priority(session, training),
            study_id=session.study_id,
            session_id=session.id,
            created_by="study",
        )
        log_event(s, "training_started", session_id=session.id, job=job.id, snapshot=snapshot.id, recipe=job.kind)


def jobs_of(s: DatabaseSession, session: Session) -> list[Job]:
    """The session's alignments, of each recipe the newest (a retry counts), the one to be preferred first: what came
    behind is shown instead of what was there at once, as soon as it may be shown. Of answers
    only those that learned from the most: after further pairs what fewer answers taught counts no more."""
    jobs = s.scalars(
        select(Job)
        .join(Session, Session.id == Job.session_id)
        .where(Session.participant_id == session.participant_id, Job.kind.in_(("align", PATHS_JOB)))
        .order_by(Job.created_at, Job.id)
    ).all()
    of_answers = list(dict.fromkeys(job.params["snapshot"] for job in jobs if job.kind == "align"))
    newest = {
        (job.params["snapshot"], job.params.get("recipe")): job
        for job in jobs
        if job.params["snapshot"] not in of_answers[:-1]
    }
    return sorted(newest.values(), key=lambda job: job.params.get("recipe") in REFINEMENTS)


def ready_job(s: DatabaseSession, session: Session) -> Job | None:
    """The alignment whose policy may be shown now; once one has been compared that one, whatever came since."""
    ready = [job for job in jobs_of(s, session) if verdict(job) == "shown"]
    compared = _compared_policies(s, session)
    return next(
        (job for job in ready if (of := job.result_as(Learned)) and of.policy in compared), next(iter(ready), None)
    )


def _compared_policies(s: DatabaseSession, session: Session) -> set[str]:
    """What was shown to this participant as their own, blind."""
    arms = s.scalars(
        select(Trial.arms)
        .join(Session, Session.id == Trial.session_id)
        .where(Session.participant_id == session.participant_id, Trial.kind == "comparison")
    )
    return {str(of[of["own"]]) for of in arms if of and of.get("own") in ("a", "b")}


def check_of(s: DatabaseSession, session: Session) -> dict[str, Any] | None:
    """Whether the session's answers look like what is believed of them (`PredictiveCheck`), with `personal`, the
    verdict on the policy that is shown, else on the instant one; None where no job has said so."""
    shown = ready_job(s, session)
    # what is shown first, then the instant policy: whether it is refused decides how long is waited
    for job in [*([shown] if shown is not None else []), *reversed(jobs_of(s, session))]:
        result = job.result_as(AlignResult)
        if result is not None and result.check is not None:
            prior = {"prior": result.prior} if result.prior is not None else {}
            return {**result.check, **prior, "personal": result.personal}
    return None


def find_awaited_jobs(s: DatabaseSession, session: Session) -> list[Job]:
    """Of each snapshot that nothing can be shown of yet, the unfinished job that will be there first."""
    of_snapshot: dict[str, list[Job]] = {}
    for job in jobs_of(s, session):
        of_snapshot.setdefault(job.params["snapshot"], []).append(job)
    unfinished = [
        [job for job in each if verdict(job) is None]
        for each in of_snapshot.values()
        if not any(verdict(job) == "shown" for job in each)
    ]
    return [each[-1] for each in unfinished if each]


def patience_of(moment: Moment) -> tuple[datetime, timedelta]:
    """Since when the session has waited for its jobs, and how long it does at most."""
    session, training = moment.session, moment.frozen.training
    assert training is not None  # noqa: S101  there are jobs only where a stage says so
    last = moment.s.scalar(select(func.max(Response.created_at)).where(Response.session_id == session.id))
    began = min(job.created_at for job in jobs_of(moment.s, session))
    patience = timedelta(seconds=training.give_up_after_s) * (BOT_PATIENCE if session.simulated else 1)
    return max(began, last) if last else began, patience


def outcome_of(moment: Moment) -> str | None:
    """How the learning stands for somebody who waits: None means not ready and still worth waiting for. Of several
    recipes for one snapshot one that can be shown is enough; of several environments each is waited for.

    Else: shown, job_failed, late, gate_not_passed, not_surely_better (for this very person), too_few_answers,
    no_consent, one_sided, too_fast (`clicking.py`), no_scenes (a policy that passed the gate, but no scene in which
    both trajectories can be compared).
    """
    s, session, training = moment.s, moment.session, moment.frozen.training
    if session.personalisation is not None or training is None:
        return session.personalisation or "too_few_answers"
    jobs = jobs_of(s, session)
    if not jobs:
        return "too_few_answers"
    of_snapshot: dict[str, list[str | None]] = {}
    for job in jobs:
        of_snapshot.setdefault(job.params["snapshot"], []).append(verdict(job, rated=training.rated))
    verdicts = [_together(each) for each in of_snapshot.values()]
    if None not in verdicts:
        return "shown" if "shown" in verdicts else verdicts[-1]
    since, patience = patience_of(moment)
    if moment.now - since <= patience:
        return None
    if "shown" in verdicts:
        return "shown"
    return next((known for each in of_snapshot.values() for known in reversed(each) if known is not None), "late")


def _together(each: Sequence[str | None]) -> str | None:
    """One snapshot's verdict from its jobs', the instant one's last. What is not surely better for this person now will
    hardly be after the search for the same weights: nobody waits for that.
    """
    if "shown" in each:
        return "shown"
    if each[-1] == "not_surely_better":
        return each[-1]
    return None if None in each else each[-1]


# ---- by the light of whose answers a participant's own may be read ---------------------------------------------------


def earlier_snapshots(s: DatabaseSession, session: Session) -> list[str]:
    """Snapshots of the newest answers of those who finished learning before, newest first, at most MOST_EARLIER.

    People learn from people, a pilot from its pilot, simulated participants from simulated ones. Never across groups:
    who was assigned to another group between participants, or met another version of the protocol, teaches nothing
    here, so that groups stay independent. Who did not consent to training, withdrew, was excluded or erased is not
    among them.
    """
    me = s.get_one(Participant, session.participant_id)
    rows = s.execute(
        select(Job, Session, Participant)
        .join(Session, Session.id == Job.session_id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(
            Session.study_id == session.study_id,
            Session.participant_id != session.participant_id,
            Session.protocol_number == session.protocol_number,
            same_kind(simulated=me.simulated, pilot=me.pilot),
            not_left_out(),
            Job.kind == "align",
            Job.state == "succeeded",
        )
        .order_by(Job.finished_at.desc(), Job.id)
    )
    snapshots: dict[str, str] = {}
    for job, other, person in rows:
        consented = (person.consents or {}).get("training") is True
        if person.id in snapshots or not consented or _groups(other) != _groups(session):
            continue
        artefact = s.get(Artefact, job.params["snapshot"])
        if artefact is not None and artefact.quarantined_at is None:
            snapshots[person.id] = artefact.id
        if len(snapshots) == MOST_EARLIER:
            break
    return list(snapshots.values())


def _groups(session: Session) -> dict[str, str]:
    return dict((session.assignment or {}).get("groups") or {})

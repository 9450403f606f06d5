"""Renames, archives and deletes artefacts, and says what hangs on one first. Who may do so is the API's.

What was made from answers is erased with them (`erasure.py`); here somebody tidies up. Nothing is deleted from which
something else was made, on which a study or a job stands, or which participants were shown.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import ColumnElement, and_, delete, select
from sqlalchemy.orm import Session

from desirepath.store.artefacts import ArtefactError, ArtefactStore
from desirepath.store.models import (
    Artefact,
    ArtefactAnswer,
    ArtefactParent,
    Job,
    ProtocolVersion,
    Study,
    TrajectoryRow,
    Trial,
)
from desirepath.store.outbox import ENDED
from desirepath.store.plain_data import mentions
from desirepath.store.shipped_policies import came_with_product

LONGEST_NAME = 160


@dataclass(frozen=True)
class Uses:
    """What hangs on an artefact. made: what was made from it, directly, by name and kind; studies: names of those that
    stand on it; jobs: ids of those that stand on it (`_jobs_on`); shown: trials in which its rollouts were shown."""

    made: tuple[Artefact, ...]
    studies: tuple[str, ...]
    jobs: tuple[str, ...]
    shown: int
    shipped: bool

    def against_deleting(self) -> list[str]:
        """In words why it must stay; empty where it may go."""
        reasons = []
        if self.shipped:
            reasons.append("it came with the product and would come back at the next start")
        if self.made:
            reasons.append(
                f"{len(self.made)} were made from it: {', '.join(artefact.name for artefact in self.made[:3])}"
            )
        if self.studies:
            reasons.append(f"studies ask from it: {', '.join(self.studies[:3])}")
        if self.jobs:
            reasons.append(f"jobs stand on it: {', '.join(self.jobs[:3])}")
        if self.shown:
            reasons.append(f"participants were shown it in {self.shown} trials")
        return reasons


def is_offered() -> ColumnElement[bool]:
    """A condition on `Artefact`: what may be chosen for something new."""
    return and_(Artefact.quarantined_at.is_(None), Artefact.archived_at.is_(None))


def uses_of(s: Session, artefact_id: str) -> Uses:
    """What hangs on an artefact; locks nothing, so that it can be looked at. Raises ArtefactError if there is none."""
    artefact = _artefact(s, artefact_id, lock=False)
    children = (
        select(Artefact)
        .join(ArtefactParent, ArtefactParent.artefact_id == Artefact.id)
        .where(ArtefactParent.parent_id == artefact_id)
        .order_by(Artefact.created_at, Artefact.id)
    )
    studies = [
        study.name
        for study in s.scalars(select(Study).order_by(Study.created_at))
        if mentions(_frozen_for(s, study), {artefact_id})
    ]
    arms = s.scalars(select(Trial.arms).where(Trial.arms.is_not(None)))
    return Uses(
        made=tuple(s.scalars(children).unique()),
        studies=tuple(studies),
        jobs=_jobs_on(s, artefact),
        shown=sum(mentions(compared, {artefact_id}) for compared in arms),
        shipped=came_with_product(artefact.id),
    )


def _jobs_on(s: Session, artefact: Artefact) -> tuple[str, ...]:
    """Those under way that name or make it. Of what holds answers all that ever named it: an erasure finds by it what
    was learned from somebody, unless they were imported: then this is how they are erased. And the one that made it for
    a participant, who may still be shown it.
    """
    answers = artefact.kind in ("snapshot", "demonstrations") and "imported" not in artefact.card
    jobs = s.execute(select(Job.id, Job.params, Job.state, Job.session_id).order_by(Job.created_at))
    return tuple(
        job
        for job, params, state, session in jobs
        if (mentions(params, {artefact.id}) and (answers or state not in ENDED))
        or (job == artefact.job_id and (session is not None or state not in ENDED))
    )


def rename_artefact(s: Session, artefact_id: str, name: str) -> Artefact:
    """Give it another name; its id, which is the hash of its content, stays. Raises ArtefactError for a name that is
    empty, too long or holds line breaks."""
    artefact = _artefact(s, artefact_id)
    wanted = name.strip()
    if not wanted or len(wanted) > LONGEST_NAME or not wanted.isprintable():
        raise ArtefactError(f"name = {name[:80]!r}: must be one line of 1 to {LONGEST_NAME} characters")
    artefact.name = wanted
    return artefact


def archive_artefact(s: Session, artefact_id: str, *, by: str, now: datetime) -> Artefact:
    """Take it out of the lists from which something is chosen; all that hangs on it goes on. Twice is once."""
    artefact = _artefact(s, artefact_id)
    if artefact.archived_at is None:
        artefact.archived_at, artefact.archived_by = now, by
    return artefact


def restore_artefact(s: Session, artefact_id: str) -> Artefact:
    """Bring an archived one back into the lists."""
    artefact = _artefact(s, artefact_id)
    artefact.archived_at = artefact.archived_by = None
    return artefact


def delete_artefact(s: Session, files: ArtefactStore, artefact_id: str) -> Artefact:
    """Delete it with its file and its lineage; what it was made from and its rollouts stay. Of recordings the
    trajectories and videos go, too, that nothing else has, of imported answers what jobs said of single people.
    Returns what it was.

    Raises ArtefactError that says why it must stay (`Uses.against_deleting`); archiving is always possible.
    """
    artefact = _artefact(s, artefact_id)
    against = uses_of(s, artefact_id).against_deleting()
    if against:
        raise ArtefactError(f"{artefact.kind} {artefact.name!r} stays: {'; '.join(against)}. It can be archived")
    if artefact.kind == "snapshot" and artefact.card.get("imported"):
        _forget_people(s, artefact_id)
    recorded = _only_in(s, artefact) if artefact.kind == "query_set" and artefact.card.get("recorded") else set()
    videos = select(ArtefactParent.parent_id).where(
        ArtefactParent.artefact_id == artefact_id, ArtefactParent.role == "video"
    )
    filmed = list(s.scalars(videos))
    s.execute(delete(ArtefactAnswer).where(ArtefactAnswer.artefact_id == artefact_id))
    s.execute(delete(ArtefactParent).where(ArtefactParent.artefact_id == artefact_id))
    s.execute(delete(Artefact).where(Artefact.id == artefact_id))
    s.flush()
    s.expunge(artefact)
    for video in filmed:
        if not uses_of(s, video).against_deleting():
            delete_artefact(s, files, video)
    s.execute(delete(TrajectoryRow).where(TrajectoryRow.id.in_(recorded)))
    for sha in sorted({artefact_id, *recorded}):
        files.delete(sha)  # before the rows commit: a deletion that is cut short can be repeated
    return artefact


def _forget_people(s: Session, snapshot_id: str) -> None:
    """Take what was said of single people out of the results of jobs on this snapshot."""
    for job in s.scalars(select(Job).where(Job.result.is_not(None))):
        if mentions(job.params, {snapshot_id}) and isinstance((job.result or {}).get("held_out"), list):
            job.result = {**(job.result or {}), "held_out": []}


def _only_in(s: Session, query_set: Artefact) -> set[str]:
    """The trajectories of a query set that no other one lists and nobody was shown."""
    own = {query[side] for query in query_set.card["stored_queries"] for side in ("trajectory_a", "trajectory_b")}
    others = select(Artefact.card).where(Artefact.id != query_set.id, Artefact.setup == query_set.setup)
    used = {sha for card in s.scalars(others) for sha in own if mentions(card, {sha})}
    shown = select(Trial.trajectory_a, Trial.trajectory_b, Trial.arms)
    used |= own & {sha for a, b, arms in s.execute(shown) for sha in (a, b, *(arms or {}).get("shown", ()))}
    return own - used


def _artefact(s: Session, artefact_id: str, *, lock: bool = True) -> Artefact:
    artefact = s.get(Artefact, artefact_id, with_for_update=lock or None)
    if artefact is None:
        raise ArtefactError(f"no artefact with id {artefact_id!r}")
    return artefact


def _frozen_for(s: Session, study: Study) -> list[object]:
    """Every protocol of the study, as it was frozen: `materials` name the artefacts that it stands on."""
    later = s.scalars(select(ProtocolVersion.protocol).where(ProtocolVersion.study_id == study.id))
    return [study.protocol, *later]

"""Erases a participant: the one privileged path through what is otherwise immutable.

What goes: their rows, the trajectories only they saw or caused, job payloads and logs, models made from their answers
alone, and snapshot files that contain their answers. What stays: a tombstone without content, and pooled models,
quarantined. Excluding (data kept, marked) and withdrawing (the participant's own act) are not here.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import time
from collections import defaultdict
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import CursorResult, Delete, delete, or_, select
from sqlalchemy.orm import Session

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import COMPACT_PENDING, Database
from desirepath.store.dataset.stroke_rows import trajectories_of
from desirepath.store.demonstration_snapshots import programmed_files
from desirepath.store.events import log_event
from desirepath.store.models import (
    Artefact,
    ArtefactAnswer,
    ArtefactParent,
    Audit,
    Coding,
    Erasing,
    Event,
    HeadPose,
    Job,
    JobAttempt,
    JobMetric,
    Note,
    Participant,
    ProblemReport,
    RecruitingId,
    Response,
    Setting,
    StrokeRow,
    TaskFile,
    Tombstone,
    TrajectoryRow,
    Trial,
    utc_now,
)
from desirepath.store.models import Session as SessionRow
from desirepath.store.plain_data import copy_data, mentions
from desirepath.store.robot_recordings import delete_runs, recordings_of
from desirepath.store.snapshots import SnapshotError, retake_snapshot

ORPHAN_AGE_S = 3600.0  # ours: a file without a row this old was left by a crash, not by a save that is still running
SEVERAL_PEOPLE = "in_general"  # in the configuration of a policy that holds several people's answers
EARLIER = ("earlier", "people")  # parameters of jobs that list the snapshots of who was there before, with commas
HASHES = re.compile(r"[0-9a-f]{64}")


class ErasureError(ValueError):
    """The erasure cannot be done as asked; nothing was erased."""


@dataclass(frozen=True)
class Erased:
    """What an erasure did. `counts` has no content; `replaced` maps quarantined snapshots to new ones without them."""

    tombstone: str
    counts: dict[str, int]
    quarantined: tuple[str, ...]
    replaced: dict[str, str]
    compacted: bool  # False: old pages are still in the database file; done at the next start

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass
class _Doomed:
    """What hangs on one participant."""

    ids: set[str]  # theirs, their sessions' and their artefacts': what other rows may mention
    code: str
    sessions: list[str]
    artefacts: set[str] = field(default_factory=set)  # made from their answers alone
    pooled: set[str] = field(default_factory=set)  # made from theirs and others'
    jobs: set[str] = field(default_factory=set)
    opened: set[str] = field(default_factory=set)  # pooled ones whose file holds the answers themselves
    trajectories: set[str] = field(default_factory=set)
    demonstrations: set[str] = field(default_factory=set)  # files made of their strokes
    recordings: set[str] = field(default_factory=set)  # of robots that drove for them


def erase_participant(
    db: Database, files: ArtefactStore, participant_id: str, by: str, *, data: Path | None = None, compact: bool = True
) -> dict[str, Any]:
    """Erase everything of a participant; returns `Erased.as_dict()`. Cannot be undone.

    by: who does it, for the tombstone. data: the data folder, where job logs and checkpoints lie; may be left out where
    the database is a file in it. compact: False where another erasure follows at once, which rewrites the file. Files
    go before the rows commit, so an erasure that is cut short can be repeated. Backups and exports made earlier are not
    reached. Raises LookupError if there is no such participant.
    """
    if data is None:
        if db.file is None:
            raise ErasureError("erase_participant: name the data folder; job logs lie there and must go, too")
        data = db.file.parent
    with db.transaction() as s:
        participant = s.get(Participant, participant_id, with_for_update=True)
        if participant is None:
            raise LookupError(f"no participant with id {participant_id!r}")
        study_id = participant.study_id
        doomed = _find(s, participant)
        counts = {
            "sessions": len(doomed.sessions),
            "artefacts": len(doomed.artefacts),
            "trajectories": len(doomed.trajectories),
            "demonstrations": len(doomed.demonstrations),
            "recordings": len(doomed.recordings),
            "jobs": len(doomed.jobs),
        }
        s.add(Erasing(participant_id=participant.id))
        s.flush()
        taken_apart = _quarantine(s, doomed)
        counts |= _delete_rows(s, participant, doomed)
        _unlist(s, doomed)
        for sha in sorted(
            doomed.trajectories | doomed.demonstrations | doomed.recordings | doomed.artefacts | doomed.opened
        ):
            files.delete(sha)
        counts["orphans"] = _sweep_orphans(s, files)
        counts["job_files"] = delete_job_files(data, doomed.jobs)
        replaced = replace_artefacts(s, files, study_id, taken_apart)
        tombstone = Tombstone(study_id=study_id, erased_by=by, counts=counts)
        s.add(tombstone)
        s.flush()
        log_event(s, "participant_erased", study_id=study_id, tombstone=tombstone.id)
        s.merge(Setting(key=COMPACT_PENDING, value={}))
    return Erased(
        tombstone=tombstone.id,
        counts=counts,
        quarantined=tuple(sorted(doomed.pooled)),
        replaced=replaced,
        compacted=compact and db.compact(),
    ).as_dict()


def _find(s: Session, participant: Participant) -> _Doomed:
    sessions = list(s.scalars(select(SessionRow.id).where(SessionRow.participant_id == participant.id)))
    doomed = _Doomed(ids={participant.id, *sessions}, code=participant.code, sessions=sessions)
    for artefact_id, owners in _owners_of_artefacts(s).items():
        if participant.id in owners:
            (doomed.artefacts if owners == {participant.id} else doomed.pooled).add(artefact_id)
    doomed.ids |= doomed.artefacts
    jobs = select(Artefact.job_id).where(Artefact.id.in_(doomed.artefacts), Artefact.job_id.is_not(None))
    doomed.jobs = {job_id for job_id in s.scalars(jobs) if job_id}
    doomed.recordings = recordings_of(s, sessions)
    own = {t for trial in s.scalars(select(Trial).where(Trial.session_id.in_(sessions))) for t in trial.shown}
    own |= set(s.scalars(select(TrajectoryRow.id).where(TrajectoryRow.made_by.in_(doomed.artefacts))))
    others = select(Trial.trajectory_a, Trial.trajectory_b, Trial.arms).where(Trial.session_id.not_in(sessions))
    used = {t for a, b, arms in s.execute(others) for t in (a, b, *(arms or {}).get("shown", ()))}
    rolled_out: dict[bool, set[str]] = {True: set(), False: set()}
    strokes = select(StrokeRow.session_id, StrokeRow.walk, StrokeRow.trajectory, StrokeRow.demonstration)
    for session_id, walk, trajectory, demonstration in s.execute(strokes):
        rolled_out[session_id in sessions] |= trajectories_of(walk, trajectory) | (
            {demonstration} if demonstration else set()
        )
    doomed.demonstrations = (
        rolled_out[True] - rolled_out[False]
    )  # two may have drawn the very same, if they are programs
    own |= rolled_out[True]
    used |= rolled_out[False]
    for job in s.execute(select(Job.id, Job.session_id, Job.study_id, Job.params, Job.result)):
        payload = [{key: value for key, value in job.params.items() if key not in EARLIER}, job.result]
        # Another study may have a participant of the same code.
        same_study = job.study_id == participant.study_id or mentions(payload, doomed.pooled)
        named = mentions(payload, doomed.ids) or (same_study and mentions(payload, {doomed.code}))
        if named or job.session_id in sessions or job.id in doomed.jobs:
            doomed.jobs.add(job.id)
            own |= set(HASHES.findall(json.dumps(payload)))
        else:
            used |= set(HASHES.findall(json.dumps(payload)))
    for card in s.scalars(select(Artefact.card).where(Artefact.id.not_in(doomed.artefacts))):
        used |= set(HASHES.findall(json.dumps(card)))  # query sets list their trajectories there
    doomed.trajectories = set(s.scalars(select(TrajectoryRow.id).where(TrajectoryRow.id.in_(own)))) - used
    return doomed


def _owners_of_artefacts(s: Session) -> dict[str, set[str]]:
    """artefact id -> ids of the participants whose answers it was made from, through all its ancestors."""
    owners: dict[str, set[str]] = defaultdict(set)
    answers = (
        select(ArtefactAnswer.artefact_id, SessionRow.participant_id)
        .join(Response, Response.id == ArtefactAnswer.response_id)
        .join(SessionRow, SessionRow.id == Response.session_id)
        .distinct()
    )
    for artefact_id, participant_id in s.execute(answers):
        owners[artefact_id].add(participant_id)
    edges = s.execute(select(ArtefactParent.artefact_id, ArtefactParent.parent_id)).all()
    changed = True
    while changed:  # the graph is small and has no cycle
        changed = False
        for child, parent in edges:
            if not owners[parent] <= owners[child]:
                owners[child] |= owners[parent]
                changed = True
    return owners


def _quarantine(s: Session, doomed: _Doomed) -> dict[str, list[str]]:
    """Mark what was made from their and others' answers. Snapshots, reports and policies in general hold the answers:
    their files go, too.

    Returns snapshot id -> the response ids of the others in it, for the snapshots that were still good.
    """
    others: dict[str, list[str]] = {}
    for artefact in s.scalars(select(Artefact).where(Artefact.id.in_(doomed.pooled)).order_by(Artefact.created_at)):
        if artefact.quarantined_at is None and artefact.kind == "snapshot":
            answers = (
                select(ArtefactAnswer.response_id)
                .join(Response, Response.id == ArtefactAnswer.response_id)
                .where(ArtefactAnswer.artefact_id == artefact.id, Response.session_id.not_in(doomed.sessions))
            )
            others[artefact.id] = list(s.scalars(answers))
        artefact.quarantined_at = artefact.quarantined_at or utc_now()
        artefact.card = _without(artefact.card, {*doomed.ids, doomed.code})
        holds = SEVERAL_PEOPLE in (artefact.card.get("config") or {})
        if holds or artefact.kind in ("snapshot", "demonstrations", "evaluation"):
            doomed.opened.add(artefact.id)
    return others


def _unlist(s: Session, doomed: _Doomed) -> None:
    """Take the erased snapshots from the lists of who was there before, in others' jobs and the commands on cards."""

    def without(text: str) -> str:
        for one in doomed.artefacts:
            text = text.replace(f"{one},", "").replace(f",{one}", "").replace(one, "")
        return text

    for job in s.scalars(select(Job)):
        lists = {key: job.params[key] for key in EARLIER if job.params.get(key)}
        if lists:
            job.params = {**job.params, **{key: without(listed) for key, listed in lists.items()}}
    for artefact in s.scalars(select(Artefact).where(Artefact.kind.in_(("policy", "reward_model")))):
        command = artefact.card.get("command") or ""
        if without(command) != command:
            artefact.card = {**artefact.card, "command": without(command)}


def replace_artefacts(s: Session, files: ArtefactStore, study_id: str, others: dict[str, list[str]]) -> dict[str, str]:
    """Take the snapshots again from the answers that are left; those with too few left get no successor."""
    replaced = {}
    for old_id, answers in others.items():
        with contextlib.suppress(SnapshotError):
            whose = s.get_one(Artefact, old_id).card["whose"]
            replaced[old_id] = retake_snapshot(s, files, study_id, answers, whose).id
    return replaced


def _delete_rows(s: Session, participant: Participant, doomed: _Doomed) -> dict[str, int]:
    """Delete everything that refers to the participant, children first. Returns how many of what."""
    of_sessions = doomed.sessions
    delete_runs(s, of_sessions)
    answers = select(Response.id).where(Response.session_id.in_(of_sessions))
    drawn = list(s.scalars(select(StrokeRow.id).where(StrokeRow.session_id.in_(of_sessions))))
    strokes = _count(s, delete(StrokeRow).where(StrokeRow.session_id.in_(of_sessions)))
    heads = _count(s, delete(HeadPose).where(HeadPose.session_id.in_(of_sessions)))
    coded = _count(s, delete(Coding).where(Coding.response_id.in_(answers)))
    s.execute(delete(ArtefactAnswer).where(ArtefactAnswer.response_id.in_(answers)))
    s.execute(delete(ArtefactAnswer).where(ArtefactAnswer.artefact_id.in_(doomed.artefacts)))
    edges = or_(ArtefactParent.artefact_id.in_(doomed.artefacts), ArtefactParent.parent_id.in_(doomed.artefacts))
    s.execute(delete(ArtefactParent).where(edges))
    s.execute(delete(Artefact).where(Artefact.id.in_(doomed.artefacts)))
    s.execute(delete(JobMetric).where(JobMetric.job_id.in_(doomed.jobs)))
    s.execute(delete(JobAttempt).where(JobAttempt.job_id.in_(doomed.jobs)))
    s.execute(delete(Job).where(Job.id.in_(doomed.jobs)))
    counts = {
        "strokes": strokes,
        "head_poses": heads,
        "codings": coded,
        "responses": _count(s, delete(Response).where(Response.session_id.in_(of_sessions))),
        "trials": _count(s, delete(Trial).where(Trial.session_id.in_(of_sessions))),
        "events": _count(s, delete(Event).where(Event.session_id.in_(of_sessions))),
        "problem_reports": _count(s, delete(ProblemReport).where(ProblemReport.session_id.in_(of_sessions))),
    }
    names = {*doomed.ids, doomed.code, *doomed.jobs, *drawn}
    about = [
        event.id
        for event in s.scalars(select(Event).where(Event.study_id == participant.study_id))
        if mentions(event.data, names)
    ]
    counts["events"] += _count(s, delete(Event).where(Event.id.in_(about)))
    in_audit = s.scalars(select(Audit).where(Audit.study_id == participant.study_id))
    about = [entry.id for entry in in_audit if mentions(entry.data, names)]
    s.execute(delete(Audit).where(or_(Audit.id.in_(about), Audit.participant_id == participant.id)))
    s.execute(delete(Note).where(Note.participant_id == participant.id))
    s.execute(delete(TrajectoryRow).where(TrajectoryRow.id.in_(doomed.trajectories)))
    s.execute(delete(RecruitingId).where(RecruitingId.participant_id == participant.id))
    s.flush()
    s.execute(delete(Erasing))  # before what its key opens: it refers to the participant
    s.execute(delete(SessionRow).where(SessionRow.id.in_(of_sessions)))
    s.execute(delete(Participant).where(Participant.id == participant.id))
    s.expire_all()
    return counts


def _count(s: Session, statement: Delete) -> int:
    done = s.execute(statement)
    return int(done.rowcount) if isinstance(done, CursorResult) else 0


def _without(data: Any, names: set[str]) -> Any:
    """Plain JSON data without the entries named so, and without list items that name one of them."""

    def names_them(key: str, value: Any) -> bool:
        if not key:
            return mentions(value, names)
        return key in names or (isinstance(value, str) and value in names)

    return copy_data(data, without=names_them)


def _sweep_orphans(s: Session, files: ArtefactStore) -> int:
    """Delete files without a row that a crash left behind: they may be trajectories or models of anybody."""
    known = set(s.scalars(select(TrajectoryRow.id))) | set(s.scalars(select(Artefact.id)))
    known |= {sha for sha in s.scalars(select(StrokeRow.demonstration)) if sha} | set(
        s.scalars(select(TaskFile.sha256))
    )
    known |= programmed_files(s, files) | recordings_of(s)
    now = time.time()
    orphans = [name for name in files.names() if name not in known and files.age_s(name, now) > ORPHAN_AGE_S]
    for name in orphans:
        files.delete(name)
    return len(orphans)


def delete_job_files(data: Path, jobs: set[str]) -> int:
    """Delete logs, checkpoints and whatever else is named by one of the jobs. Returns how many entries there were."""
    logs = [path for job_id in sorted(jobs) for path in data.rglob(f"*{job_id}*")]
    for path in logs:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    return len(logs)

"""What the pages about jobs list and show: lines with their headline, filters and orders, settings as they were taken.
Reads only; renders nothing, routes live in `job_pages.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Select, func, or_, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.jobs.kinds import KINDS
from desirepath.jobs.process import FINAL_STATES
from desirepath.store.artefacts import ArtefactError
from desirepath.store.job_results import JobResult
from desirepath.store.models import Artefact, ArtefactAnswer, Job, Participant, Response, Session, Study, utc_now
from desirepath.store.shipped_policies import policy_artefact
from desirepath.web.core.permits import seen_artefacts
from desirepath.web.core.roles import Rights

HEADLINES = (  # what a reader looks for first, and where results have it
    ("held_out", ("held_out", "accuracy")),
    ("held_out", ("predicted", "accuracy")),
    ("gate", ("gate", "success_rate")),
    ("success", ("measured", "success_rate")),
    ("success", ("judged", "success_rate")),
    ("success", ("success_rate",)),
    ("selection", ("selection_success",)),
    ("training", ("training_accuracy",)),
)
SORTS = ("kind", "state", "created", "participant", "headline")


@dataclass(frozen=True)
class JobLine:
    """One job as lists show it. participant: whose answers it learns from, where they are one person's."""

    job: Job
    study: Study | None
    seconds: float | None
    participant: str | None = None

    @property
    def recipe(self) -> str | None:
        """Of an alignment: which algorithm."""
        given = KINDS[self.job.kind].algorithm_of(self.job.params) if self.job.kind in KINDS else ""
        return given or None

    @property
    def headline(self) -> tuple[str, float] | None:
        """The number that a reader looks for first: (what, share)."""
        for what, path in HEADLINES:
            value: Any = self.job.result
            for key in path:
                value = value.get(key) if isinstance(value, Mapping) else None
            if isinstance(value, int | float):
                return what, float(value)
        return None

    @property
    def warning(self) -> str | None:
        """The verdict on what its answers predict, where that is not better than chance and majority."""
        verdict = getattr(self.job.result_as(JobResult), "predicted", {}).get("verdict")
        return verdict if verdict not in (None, "better") else None

    @property
    def unfinished(self) -> bool:
        return self.job.state not in FINAL_STATES


@dataclass(frozen=True)
class Param:
    """One parameter of a job, for reading. `artefacts` where it names some, `changed` where it is not the default,
    `automatic` where the job took value or artefact itself."""

    name: str
    value: Any
    source: str
    changed: bool
    artefacts: tuple[Artefact, ...]
    automatic: bool = False


def of_participant(code: str) -> Any:
    """A condition on `Job`: it ran in a session of theirs, or learns from answers of theirs."""
    sessions = select(Session.id).join(Participant).where(Participant.code == code)
    learned = select(ArtefactAnswer.artefact_id).join(Response).where(Response.session_id.in_(sessions))
    return or_(Job.session_id.in_(sessions), Job.params["snapshot"].as_string().in_(learned))


def order_jobs(jobs: Select[Any], sort: str) -> Select[Any]:
    """One of SORTS, with `-` the other way round; else newest first."""
    name = sort.removeprefix("-")
    by: Any = {"kind": Job.kind, "state": Job.state, "created": Job.created_at}.get(name)
    if name == "participant":
        jobs = jobs.outerjoin(Session, Session.id == Job.session_id).outerjoin(Participant)
        by = Participant.code
    elif name == "headline":
        by = func.coalesce(*(Job.result[path].as_float() for _, path in HEADLINES))
    if by is None:
        return jobs.order_by(Job.created_at.desc())
    return jobs.order_by((by.desc() if sort.startswith("-") else by).nulls_last(), Job.created_at.desc())


def line_of(s: DatabaseSession, job: Job) -> JobLine:
    end: datetime | None = job.finished_at or (utc_now() if job.state in ("running", "cancelling") else None)
    seconds = (end - job.started_at).total_seconds() if job.started_at and end else None
    people = select(Participant.code).join(Session, Session.participant_id == Participant.id)
    if job.session_id:
        codes = list(s.scalars(people.where(Session.id == job.session_id)))
    else:
        answered = people.join(Response, Response.session_id == Session.id)
        answered = answered.join(ArtefactAnswer, ArtefactAnswer.response_id == Response.id)
        codes = list(
            s.scalars(answered.where(ArtefactAnswer.artefact_id == job.params.get("snapshot")).distinct().limit(2))
        )
    study = s.get(Study, job.study_id) if job.study_id else None
    return JobLine(job, study, seconds, codes[0] if len(codes) == 1 and study is not None else None)


def params_of(s: DatabaseSession, rights: Rights, job: Job, made: list[Artefact]) -> list[Param]:
    """Every setting of a job, with what it took where nothing was chosen."""
    if job.kind not in KINDS:
        return [Param(name, value, "yours", True, ()) for name, value in job.params.items()]
    shown = []
    kind = KINDS[job.kind]
    given = job.params
    for name, info in kind.model_for(given).model_fields.items():
        extra = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
        default = None if info.is_required() else info.get_default()
        value = given.get(name, default)
        changed = name in given and value != default
        taken = _taken(s, job, made, name) if value is None else None
        if isinstance(taken, Artefact):
            shown.append(Param(name, taken.id, str(extra["source"]), changed, (taken,), automatic=True))
            continue
        ids = [str(item) for item in (value if isinstance(value, list | tuple) else [value])]
        named = select(Artefact).where(Artefact.id.in_(ids), seen_artefacts(rights))
        by_id = (
            {artefact.id: artefact for artefact in s.scalars(named)}
            if "artefact" in extra and value is not None
            else {}
        )
        artefacts = tuple(by_id[artefact_id] for artefact_id in ids if artefact_id in by_id)
        shown.append(
            Param(name, value if taken is None else taken, str(extra["source"]), changed, artefacts, taken is not None)
        )
    return shown


def _taken(s: DatabaseSession, job: Job, made: list[Artefact], name: str) -> Any:
    """What a job took for a setting that was left to it; None where that is not known (yet)."""
    snapshot = s.get(Artefact, str(job.params.get("snapshot")))
    setup = job.params.get("setup") or (snapshot.setup if snapshot is not None else None)
    if name == "setup":
        return setup
    if name in ("base", "conditioned") and setup:
        try:
            return policy_artefact(s, f"{setup}/{name}")
        except (ArtefactError, LookupError):
            return None
    if name == "reward_weight":
        for one in made:
            results = one.card.get("results", {})
            history, chosen = results.get("history"), results.get("chosen_checkpoint")
            if isinstance(history, list) and isinstance(chosen, int) and chosen < len(history):
                return history[chosen].get("preference_weight")
    return None

"""The analysts' page of a study's drawn paths: laid over each other, what is remarkable, what to leave out, training.

What a demonstration's flags mean is `backend/demonstrations/quality.py`'s; learning from them is a job.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Form, Request
from markupsafe import Markup
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from backend.api import figures
from backend.api.auditing import audit_details
from backend.api.auth import CheckedCsrf, checked_csrf
from backend.api.dependencies import Db, Files, house
from backend.api.lab import LabRefusal, lab_language
from backend.api.study_tabs import study_tab, the_participant, the_study
from backend.demonstrations.demonstration import Demonstration
from backend.demonstrations.quality import Quality, qualities
from backend.jobs.kinds import get_kind
from backend.simulation.demonstration_scenes import demonstration_scene
from backend.store.artefacts import ArtefactStore, load_trajectory
from backend.store.models import Job, Participant, Session, StrokeRow, Study, utc_now
from backend.store.outbox import enqueue_job
from backend.store.strokes import KEPT, StrokeError, take_demonstrations

router = APIRouter(dependencies=[Depends(checked_csrf)], tags=["analyst"])
JOB = "train_demonstrations"
LONGEST_REASON = 500
EVERYBODY = ""


@dataclass(frozen=True)
class Drawn:
    """One kept path as the page shows it."""

    stroke: StrokeRow
    person: Participant
    demonstration: Demonstration
    quality: Quality
    tries: int

    @property
    def counts(self) -> bool:
        """Whether it is learned from."""
        return self.stroke.left_out_at is None and self.person.excluded_at is None


@dataclass(frozen=True)
class Place:
    """One situation: the figure of its paths, and their rows."""

    environment: str
    pair: int
    figure: Markup
    drawn: Sequence[Drawn]


@router.get("/lab/studies/{study_id}/paths")
def paths_page(request: Request, study_id: str, database: Db, files: Files, participant: str = "") -> Response:
    """Every kept path of the study, or of one participant, place by place."""
    t = house(request).texts.get(lab_language(request))
    with database.session() as s:
        study = the_study(s, study_id)
        chosen = the_participant(s, study, participant) if participant else None
        drawn = _drawn(s, files, study, chosen)
        learned = _learned(s, files, study, chosen)
        attempts = _attempts(s, study)
        found: dict[tuple[str, int], list[Drawn]] = {}
        for one in drawn:
            found.setdefault((one.stroke.environment, one.stroke.pair), []).append(one)
        places = []
        for (environment, pair), rows in sorted(found.items()):
            groups: dict[str, list[Any]] = {}
            for one in rows:
                if one.counts:
                    points = one.demonstration.trajectory.poses
                    groups.setdefault(t("paths.drawn_by", code=one.person.code), []).append(points)
            for code, poses in learned.get((environment, pair), {}).items():
                groups[t("paths.learned_by", code=code)] = poses
            title = t("paths.place", environment=t(f"paths.environments.{environment}"), number=pair + 1)
            figure = Markup(figures.paths(demonstration_scene(environment, pair), groups, title=title))  # noqa: S704
            places.append(Place(environment, pair, figure, rows))
        return study_tab(
            request,
            study,
            "paths",
            places=places,
            attempts=attempts,
            chosen=participant,
            people=sorted({row["code"] for row in attempts}),
            environments=sorted({place.environment for place in places}),
        )


@router.post("/lab/studies/{study_id}/paths/{stroke_id}/leave-out")
def leave_out(
    request: Request,
    study_id: str,
    stroke_id: str,
    database: Db,
    user: CheckedCsrf,
    reason: Annotated[str, Form()] = "",
) -> Response:
    """Do not learn from a path, with a reason; it stays stored and is exported with the mark."""
    if not reason.strip():
        raise LabRefusal(422, "no_path_reason")
    with database.transaction() as s:
        stroke = _stroke(s, study_id, stroke_id)
        stroke.left_out_at, stroke.left_out_by = utc_now(), user.name
        stroke.left_out_reason = reason.strip()[:LONGEST_REASON]
    audit_details(request, stroke=stroke_id)
    return RedirectResponse(f"/lab/studies/{study_id}/paths", status_code=303)


@router.post("/lab/studies/{study_id}/paths/{stroke_id}/take-back")
def take_back(request: Request, study_id: str, stroke_id: str, database: Db, user: CheckedCsrf) -> Response:
    """Learn from a path again that was left out."""
    with database.transaction() as s:
        stroke = _stroke(s, study_id, stroke_id)
        stroke.left_out_at = stroke.left_out_by = stroke.left_out_reason = None
    audit_details(request, stroke=stroke_id)
    return RedirectResponse(f"/lab/studies/{study_id}/paths", status_code=303)


@router.post("/lab/studies/{study_id}/paths/train")
def train(
    request: Request,
    study_id: str,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    environment: Annotated[str, Form()],
    participant: Annotated[str, Form()] = EVERYBODY,
) -> Response:
    """Freeze the paths of one environment, of one participant or of everybody, and learn a controller from them."""
    with database.transaction() as s:
        study = the_study(s, study_id)
        person = the_participant(s, study, participant) if participant else None
        try:
            snapshot = take_demonstrations(
                s,
                files,
                study_id=study.id,
                environment=environment,
                participant_id=person.id if person is not None else None,
            )
        except StrokeError as problem:
            raise LabRefusal(422, "no_paths", problem=str(problem)) from None
        params = get_kind(JOB).parse({"snapshot": snapshot.id})
        job = enqueue_job(
            s, JOB, params.model_dump(mode="json", exclude_defaults=True), study_id=study.id, created_by=user.name
        )
    audit_details(request, job_id=job.id)
    return RedirectResponse(f"/lab/jobs/{job.id}", status_code=303)


def _stroke(s: DatabaseSession, study_id: str, stroke_id: str) -> StrokeRow:
    stroke = s.get(StrokeRow, stroke_id, with_for_update=True)
    if stroke is None or s.get_one(Session, stroke.session_id).study_id != study_id:
        raise LabRefusal(404, "no_path")
    return stroke


def _drawn(s: DatabaseSession, files: ArtefactStore, study: Study, person: Participant | None) -> list[Drawn]:
    """Kept paths of who did not withdraw, in order; flags compare within one participant and place."""
    asked = (
        select(StrokeRow, Participant)
        .join(Session, Session.id == StrokeRow.session_id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(Session.study_id == study.id, StrokeRow.state == KEPT, Participant.withdrawn_at.is_(None))
        .order_by(StrokeRow.environment, StrokeRow.pair, Participant.code, StrokeRow.created_at)
    )
    if person is not None:
        asked = asked.where(Participant.id == person.id)
    rows = [(stroke, who) for stroke, who in s.execute(asked)]
    made = [Demonstration.from_bytes(files.get(stroke.demonstration or "")) for stroke, _ in rows]
    groups = [(who.id, stroke.environment, stroke.pair) for stroke, who in rows]
    return [
        Drawn(stroke, who, demonstration, quality, stroke.attempt)
        for (stroke, who), demonstration, quality in zip(rows, made, qualities(made, groups), strict=True)
    ]


def _learned(
    s: DatabaseSession, files: ArtefactStore, study: Study, person: Participant | None
) -> Mapping[tuple[str, int], Mapping[str, list[Any]]]:
    """Drives of the newest controller of each participant from the demonstrated starts: (environment, pair) -> code ->
    poses; only of the one participant who is looked at, as drives of many would hide the paths.
    """
    if person is None:
        return {}
    asked = (
        select(Job)
        .join(Session, Session.id == Job.session_id)
        .where(Session.participant_id == person.id, Job.kind == JOB, Job.state == "succeeded")
        .order_by(Job.finished_at)
    )
    found: dict[tuple[str, int], dict[str, list[Any]]] = {}
    for job in s.scalars(asked):
        newest: dict[tuple[str, int], list[Any]] = {}
        for one in (job.result or {}).get("rollouts", []):
            trajectory = load_trajectory(files, one["trajectory"])
            newest.setdefault((trajectory.scene.setup, one["pair"]), []).append(trajectory.poses)
        found |= {place: {person.code: poses} for place, poses in newest.items()}
    return found


def _attempts(s: DatabaseSession, study: Study) -> list[dict[str, Any]]:
    """Per participant how many strokes were kept, taken back, refused."""
    asked = (
        select(Participant.code, Participant.simulated, StrokeRow.state)
        .join(Session, Session.participant_id == Participant.id)
        .join(StrokeRow, StrokeRow.session_id == Session.id)
        .where(Participant.study_id == study.id, Participant.withdrawn_at.is_(None))
        .order_by(Participant.code)
    )
    people: dict[str, dict[str, Any]] = {}
    for code, simulated, state in s.execute(asked):
        row = people.setdefault(code, {"code": code, "simulated": simulated, KEPT: 0, "redone": 0, "refused": 0})
        row[state] = row.get(state, 0) + 1
    return list(people.values())

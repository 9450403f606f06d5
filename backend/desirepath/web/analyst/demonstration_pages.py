"""The analysts' page of a study's drawn paths: laid over each other from above and in 3D, what is remarkable, what to
leave out, training.

What is shown is read in `path_rows.py`; what a flag means is `demonstration_quality.py`'s; learning is a job.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated
from urllib.parse import urlencode

import numpy as np
from fastapi import APIRouter, Depends, Form, Request
from markupsafe import Markup
from numpy.typing import ArrayLike
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.jobs.kinds import get_kind
from desirepath.simulation.setups import demonstration_setups
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.demonstration_snapshots import StrokeError, take_demonstrations
from desirepath.store.models import Participant, Session, StrokeRow, Study, utc_now
from desirepath.store.outbox import enqueue_job
from desirepath.study.personalising.alignment_jobs import PATHS_JOB
from desirepath.web.analyst.path_rows import (
    Controller,
    KeptPath,
    Placed,
    Who,
    attempts_of,
    controllers_of,
    find_drawn_paths,
    newest_of,
    places_of,
)
from desirepath.web.core import svg_figures
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language
from desirepath.web.core.media import csv_response
from desirepath.web.lab.study_tabs import study_tab, the_participant, the_study
from desirepath.web.stage.camera_views import camera_views
from desirepath.web.stage.replay_stages import Replay
from desirepath_stage.paper import Beside

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])
LONGEST_REASON = 500
EVERYBODY, EACH = "", "each"  # of the form that starts a training, beside a participant's code
MOST_AT_ONCE = 150  # paths on one page; more take seconds to read, and nobody looks at them all
MOST_WITH_COLOURS = 3  # people whose paths have colours of their own; of more, colours would say nothing


@dataclass(frozen=True)
class Place:
    """One situation: its paths, by whom, and the trajectories of what was learned, by the demonstration they start
    from."""

    environment: str
    pair: int
    rows: Sequence[KeptPath]
    learned: Mapping[str, Trajectory]

    @property
    def shown(self) -> dict[str, list[KeptPath]]:
        """Code -> the paths that are learned from; of many people all of them under no code."""
        people: dict[str, list[KeptPath]] = {}
        for row in self.rows:
            if row.counts:
                people.setdefault(row.person.code, []).append(row)
        return people if len(people) <= MOST_WITH_COLOURS else {EVERYBODY: list(chain.from_iterable(people.values()))}

    def groups(self, t: Catalogue) -> tuple[dict[str, list[ArrayLike]], dict[str, list[ArrayLike]]]:
        """Name -> paths (n, 3): what was drawn, and what was learned from it."""
        count = len({row.person.code for row in self.rows if row.counts})
        drawn: dict[str, list[ArrayLike]] = {
            t("paths.drawn_by", code=code) if code else t("paths.drawn_by_many", count=count): [
                path.demonstration.trajectory.poses for path in paths
            ]
            for code, paths in self.shown.items()
        }
        return drawn, {t("paths.learned"): [rollout.poses for rollout in self.learned.values()]} if self.learned else {}

    def figure(self, t: Catalogue) -> str:
        drawn, learned = self.groups(t)
        title = t("paths.place", environment=t(f"paths.environments.{self.environment}"), number=self.pair + 1)
        from desirepath.simulation.demonstration_scenes import demonstration_scene

        scene = demonstration_scene(self.environment, self.pair)
        return svg_figures.paths(scene, drawn, learned=learned, walked=self.walked(t), title=title)

    def walked(self, t: Catalogue) -> dict[str, list[ArrayLike]]:
        """Name -> the ways (n, 3) of people who walked while the robot drove a path that is learned from."""
        walks = [row.demonstration.scene.walk for row in self.rows if row.counts]
        ways: list[ArrayLike] = [np.column_stack([walk.x, walk.y, walk.yaw]) for walk in walks if walk is not None]
        return {t("paths.walked"): ways} if ways else {}

    def in_3d(self, t: Catalogue, watched: KeptPath) -> Replay:
        """All of it on a stage, with a robot that drives one path, and one that drives from there as was learned."""
        drawn, learned = self.groups(t)
        walked = self.walked(t)
        colours = chain(
            zip(drawn, svg_figures.DRAWN, strict=False),
            ((name, svg_figures.LEARNED) for name in learned),
            ((name, svg_figures.WALKED) for name in walked),
        )
        laid = drawn | learned | walked
        shown = {t("paths.robot_drawn", code=watched.person.code): watched.demonstration.trajectory}
        own = self.learned.get(watched.stroke.demonstration or "")
        if own is not None:
            shown[t("paths.robot_learned")] = own
        beside = tuple(Beside(name, _rgb(colour), laid[name]) for name, (colour, _) in colours)
        rollouts, names = tuple(shown.values()), tuple(shown)
        return Replay(rollouts, names, beside, camera_views(t, rollouts, names))


def _rgb(colour: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def _places(
    s: DatabaseSession,
    files: ArtefactStore,
    study: Study,
    who: Who,
    person: Participant | None,
    places: Collection[Placed],
    controllers: Sequence[Controller],
) -> list[Place]:
    newest = newest_of(controllers, person)
    environments = {environment for environment, _ in places}
    learned = {environment: newest[environment].trajectories(files) for environment in environments & set(newest)}
    found: dict[Placed, list[KeptPath]] = {}
    for path in find_drawn_paths(s, files, study, who, person, places):
        found.setdefault(path.place, []).append(path)
    return [Place(*place, rows, learned.get(place[0], {}).get(place[1], {})) for place, rows in sorted(found.items())]


def _opened(counts: Mapping[Placed, int], asked: str, watched: StrokeRow | None) -> list[Placed]:
    """Which places the page lays open: all of few paths; of many the one that is asked for, or watched, or the first.

    asked: as in the page's address, "corridor-1".
    """
    if sum(counts.values()) <= MOST_AT_ONCE:
        return list(counts)
    if watched is not None and (watched.environment, watched.pair) in counts:
        return [(watched.environment, watched.pair)]
    named = {_name_of(place): place for place in counts}
    return [named.get(asked, next(iter(counts)))]


def _name_of(place: Placed) -> str:
    """In addresses, like "corridor-1"."""
    environment, pair = place
    return f"{environment}-{pair + 1}"


@router.get("/lab/studies/{study_id}/paths")
def paths_page(
    request: Request,
    study_id: str,
    database: Db,
    files: Files,
    who: Who = "people",
    participant: str = "",
    place: str = "",
    watch: str = "",
) -> Response:
    """Every kept path of people or of simulated participants, or of one participant, place by place; where there are
    many, one place at a time. watch: of which stroke the place is shown in 3D.
    """
    services = services_of(request)
    t = services.texts.get(lab_language(request))
    with database.session() as s:
        study = the_study(s, study_id)
        chosen = the_participant(s, study, participant) if participant else None
        who = _who(who, chosen)
        counts = places_of(s, study, who, chosen)
        opened = _opened(counts, place, s.get(StrokeRow, watch) if watch else None)
        controllers = controllers_of(s, files, study, who)
        places = _places(s, files, study, who, chosen, opened, controllers)
        attempts = attempts_of(s, study, who)
        stage = None
        for shown in places:
            for one in shown.rows:
                if one.stroke.id == watch:
                    stage = services.replays.grant(shown.in_3d(t, one))
        return study_tab(
            request,
            study,
            "paths",
            who=who,
            places=[(place, Markup(place.figure(t))) for place in places],  # noqa: S704 - made by us, texts escaped
            counts=counts,
            attempts=attempts,
            others=not places and bool(attempts_of(s, study, "people" if who == "simulated" else "simulated")),
            chosen=participant,
            people=[row["code"] for row in attempts],
            environments=sorted({environment for environment, _ in counts} & set(demonstration_setups())),
            controllers=[one for one in controllers if not participant or participant in one.people],
            limits={flag: t.number(limit, digits) for flag, (limit, digits) in _limits().items()},
            watch=watch,
            stage=stage,
        )


@router.get("/lab/studies/{study_id}/paths/{environment}-{pair}.svg")
def place_svg(
    request: Request,
    study_id: str,
    environment: str,
    pair: int,
    database: Db,
    files: Files,
    who: Who = "people",
    participant: str = "",
) -> Response:
    """The figure of one place."""
    place = _place(study_id, environment, pair, database, files, who, participant)
    t = services_of(request).texts.get(lab_language(request))
    return Response(place.figure(t), media_type="image/svg+xml")


@router.get("/lab/studies/{study_id}/paths/{environment}-{pair}.csv")
def place_csv(
    study_id: str, environment: str, pair: int, database: Db, files: Files, who: Who = "people", participant: str = ""
) -> Response:
    """What the figure of one place is drawn from: every pose; `path` is the stroke drawn or started from."""
    place = _place(study_id, environment, pair, database, files, who, participant)
    shown = [("drawn", row, row.demonstration.trajectory) for row in place.rows if row.counts]
    learned = ((row, place.learned.get(row.stroke.demonstration or "")) for row in place.rows)
    shown += [("learned", one, trajectory) for one, trajectory in learned if trajectory is not None]
    rows = [
        [kind, one.person.code, one.stroke.id, f"{time:.1f}", *(f"{value:.4f}" for value in pose)]
        for kind, one, trajectory in shown
        for time, pose in zip(trajectory.times, trajectory.poses, strict=True)
    ]
    heads = ["kind", "participant", "path", "time_s", "x_m", "y_m", "yaw_rad"]
    return csv_response(heads, rows, f"paths_{environment}_{pair + 1}.csv")


@router.post("/lab/studies/{study_id}/paths/{stroke_id}/leave-out")
def leave_out(
    request: Request,
    study_id: str,
    stroke_id: str,
    database: Db,
    user: CheckedCsrf,
    reason: Annotated[str, Form()] = "",
    who: Annotated[Who, Form()] = "people",
    participant: Annotated[str, Form()] = EVERYBODY,
) -> Response:
    """Do not learn from a path, with a reason; it stays stored and is exported with the mark."""
    if not reason.strip():
        raise LabRefusal(422, "no_path_reason")
    with database.transaction() as s:
        stroke = _stroke(s, study_id, stroke_id)
        stroke.left_out_at, stroke.left_out_by = utc_now(), user.name
        stroke.left_out_reason = reason.strip()[:LONGEST_REASON]
        place = _name_of((stroke.environment, stroke.pair))
    audit_details(request, stroke=stroke_id)
    return _back(study_id, who, participant, place)


@router.post("/lab/studies/{study_id}/paths/{stroke_id}/take-back")
def take_back(
    request: Request,
    study_id: str,
    stroke_id: str,
    database: Db,
    user: CheckedCsrf,
    who: Annotated[Who, Form()] = "people",
    participant: Annotated[str, Form()] = EVERYBODY,
) -> Response:
    """Learn from a path again that was left out."""
    with database.transaction() as s:
        stroke = _stroke(s, study_id, stroke_id)
        stroke.left_out_at = stroke.left_out_by = stroke.left_out_reason = None
        place = _name_of((stroke.environment, stroke.pair))
    audit_details(request, stroke=stroke_id)
    return _back(study_id, who, participant, place)


@router.post("/lab/studies/{study_id}/paths/train")
def train(
    request: Request,
    study_id: str,
    database: Db,
    files: Files,
    user: CheckedCsrf,
    environment: Annotated[str, Form()],
    who: Annotated[Who, Form()] = "people",
    participant: Annotated[str, Form()] = EVERYBODY,
) -> Response:
    """Freeze the paths of one environment and learn from them: of one participant, of everybody together, or `each`, a
    controller for each participant. People's and simulated participants' are never mixed.
    """
    with database.transaction() as s:
        study = the_study(s, study_id)
        codes = [row["code"] for row in attempts_of(s, study, who)] if participant == EACH else [participant]
        people = [the_participant(s, study, code) if code else None for code in codes]
        jobs, problems = [], []
        for person in people:
            try:
                snapshot = take_demonstrations(
                    s,
                    files,
                    study_id=study.id,
                    environment=environment,
                    participant_id=person.id if person is not None else None,
                    whose=who,
                )
            except StrokeError as problem:
                problems.append(str(problem))
                continue
            params = get_kind(PATHS_JOB).parse({"snapshot": snapshot.id}).model_dump(mode="json", exclude_defaults=True)
            jobs.append(enqueue_job(s, PATHS_JOB, params, study_id=study.id, created_by=user.name))
        if not jobs:
            raise LabRefusal(422, "no_paths", problem=problems[0] if problems else environment)
    audit_details(request, job_id=jobs[0].id, jobs=len(jobs))
    if participant == EACH:
        return _back(study_id, who, EVERYBODY)
    return RedirectResponse(f"/lab/jobs/{jobs[0].id}", status_code=303)


def _who(who: Who, person: Participant | None) -> Who:
    """Whose paths are shown: a chosen participant's own kind."""
    if person is None:
        return who
    return "simulated" if person.simulated else "people"


def _place(
    study_id: str, environment: str, pair: int, database: Database, files: ArtefactStore, who: Who, participant: str
) -> Place:
    with database.session() as s:
        study = the_study(s, study_id)
        person = the_participant(s, study, participant) if participant else None
        who = _who(who, person)
        found = _places(s, files, study, who, person, [(environment, pair - 1)], controllers_of(s, files, study, who))
    if not found:
        raise LabRefusal(404, "no_figure")
    return found[0]


def _back(study_id: str, who: Who, participant: str, place: str = "") -> Response:
    """To the page as it was."""
    asked = {"who": who, "participant": participant, "place": place}
    given = urlencode({name: value for name, value in asked.items() if value})
    return RedirectResponse(f"/lab/studies/{study_id}/paths?{given}", status_code=303)


def _stroke(s: DatabaseSession, study_id: str, stroke_id: str) -> StrokeRow:
    stroke = s.get(StrokeRow, stroke_id, with_for_update=True)
    if stroke is None or s.get_one(Session, stroke.session_id).study_id != study_id:
        raise LabRefusal(404, "no_path")
    return stroke


def _limits() -> dict[str, tuple[float, int]]:
    """What the page says of the flags: m/s^2, then cm, with the digits that are shown."""
    from desirepath.demonstrations import demonstration_quality as quality

    return {
        "jerk": (quality.JERKY_M_S2, 2),
        "clearance": (100 * quality.TIGHT_M, 0),
        "duplicate": (100 * quality.SAME_M, 0),
        "outlier": (100 * quality.OUTLYING_M, 0),
    }

"""A study's robots: who lets one in, who starts and stops it, where it is, and its recordings.

The robot's own routes are `robot/robot_requests.py`'s; what stands in the database is `study/robots.py`'s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from desirepath.simulation.setups import preference_setups
from desirepath.store.models import Participant, RobotRun, Session, Study, StudyRobot, utc_now
from desirepath.study import robots
from desirepath.study.kinds.live import clean_weights, controls_of, in_triangle, objectives_on, three_corners
from desirepath.study.kinds.robot_drive import AROUND_M, empty_floor, known_walls
from desirepath.study.kinds.words import language_of
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.contract import storable
from desirepath.web.core.dependencies import Db, Files, TheServices
from desirepath.web.core.lab_frame import LabRefusal, lab_language
from desirepath.web.core.media import ANY_FILE
from desirepath.web.lab.study_tabs import study_tab, the_study
from desirepath.web.participant.live_requests import read_wish
from desirepath.web.participant.replies import WordsUnderstood
from desirepath.web.participant.sent import PersonPointed, RobotWeights, WordsRead
from desirepath.web.robot.mirror import mirrored
from desirepath_stage.stage import Stage

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])
LISTED_RUNS = 50


@dataclass(frozen=True)
class RunRow:
    """A run with whose it is."""

    run: RobotRun
    code: str | None
    robot: str | None
    wheels_after_s: float | None


@dataclass(frozen=True)
class Floor:
    """An empty floor with a robot, whose place comes from the page."""

    setup: str
    goal: tuple[float, float]

    def show(self, stage: Stage) -> None:
        stage.live(empty_floor(self.setup, self.goal), "top_down", around_m=AROUND_M)


@router.get("/lab/studies/{study_id}/robots")
def robots_page(request: Request, study_id: str, services: TheServices) -> Response:
    """The robots of a study, who waits for one, and what was driven."""
    with services.database.session() as s:
        return _robots_page(request, s, the_study(s, study_id))


def _robots_page(request: Request, s: DatabaseSession, study: Study, **more: Any) -> Response:
    return study_tab(request, study, "robots", robots=robots.robots_of(s, study.id), runs=_runs(s, study), **more)


def _runs(s: DatabaseSession, study: Study, *where: Any) -> list[RunRow]:
    rows = (
        select(RobotRun, Participant.code, StudyRobot.name)
        .outerjoin(Session, Session.id == RobotRun.session_id)
        .outerjoin(Participant, Participant.id == Session.participant_id)
        .outerjoin(StudyRobot, StudyRobot.id == RobotRun.robot_id)
        .where(RobotRun.study_id == study.id, *where)
        .order_by(RobotRun.created_at.desc())
        .limit(LISTED_RUNS)
    )
    return [RunRow(run, code, name, robots.wheels_after_s(run)) for run, code, name in s.execute(rows)]


@router.post("/lab/studies/{study_id}/robots")
def admit(
    request: Request, study_id: str, services: TheServices, user: CheckedCsrf, name: Annotated[str, Form()] = ""
) -> Response:
    """Let a robot in; its token is shown this once."""
    name = str(storable(name)).strip()
    if not 0 < len(name) <= 80:
        raise LabRefusal(422, "robot_name")
    with services.database.transaction() as s:
        study = the_study(s, study_id)
        robot, token = robots.admit_robot(s, study.id, name, user.name)
        audit_details(request, robot=robot.id)
        return _robots_page(request, s, study, token=token, admitted=robot)


@router.post("/lab/studies/{study_id}/robots/{robot_id}/revoke")
def revoke(request: Request, study_id: str, robot_id: str, services: TheServices, user: CheckedCsrf) -> Response:
    """Its token opens nothing any more; what it drives is over."""
    with services.database.transaction() as s:
        robots.revoke_robot(s, _the_robot(s, study_id, robot_id), user.name, utc_now())
    services.mirror.tell_orders(robot_id)
    return RedirectResponse(f"/lab/studies/{study_id}/robots?done=robot_revoked", status_code=303)


@router.get("/lab/studies/{study_id}/robots/{robot_id}")
def robot_page(request: Request, study_id: str, robot_id: str, services: TheServices) -> Response:
    """Where it is, what it sees and would do; its weights; who waits for it."""
    with services.database.session() as s:
        robot = _the_robot(s, study_id, robot_id)
        run = robots.run_of(s, robot)
        study = the_study(s, study_id)
        setup, goal = (run.setup, (run.goal[0], run.goal[1])) if run else (preference_setups()[0], (3.0, 0.0))
        corners, wrong = _corners(request, setup, _triangle_of(s, run))
        start = run.weights if run else {}
        shown = next(iter(_runs(s, study, RobotRun.id == run.id)), None) if run else None
        waiting = _runs(s, study, RobotRun.state == "waiting", RobotRun.id != (run.id if run else ""))
        return study_tab(
            request,
            study,
            "robots",
            "lab/study_robot.html",
            robot=robot,
            shown=shown,
            waiting=waiting,
            setups=preference_setups(),
            start=in_triangle(start, corners) if corners else start,
            payload={"controls": controls_of(setup), "triangle": corners},
            corners=corners,
            wrong_corners=wrong,
            all_objectives=objectives_on(setup),
            walls=known_walls(setup),
            lab_words=True,
            replay=services.replays.grant(Floor(setup, goal)),
        )


def _triangle_of(s: DatabaseSession, run: RobotRun | None) -> list[str] | None:
    """The three that the run's step weighs in a triangle, if it does."""
    session = s.get(Session, run.session_id) if run is not None and run.session_id else None
    if session is None or run is None:
        return None
    return next((step.get("objectives") for step in session.plan if step["key"] == run.step_key), None)


def _corners(request: Request, setup: str, usual: list[str] | None) -> tuple[list[str] | None, bool]:
    """The triangle's corners that the address names, else the usual ones, None for sliders; whether it names none that
    can be."""
    named = [corner for corner in request.query_params.getlist("corner") if corner]
    if "corner" not in request.query_params:
        return usual, False
    try:
        return (three_corners(named, objectives_on(setup)) if named else None), False
    except ValueError:
        return usual, True


@router.post("/lab/studies/{study_id}/robots/{robot_id}/drive")
def drive(
    request: Request,
    study_id: str,
    robot_id: str,
    services: TheServices,
    user: CheckedCsrf,
    run: Annotated[str, Form()] = "",
    setup: Annotated[str, Form()] = "",
    x: Annotated[float, Form(ge=-robots.REACH_M, le=robots.REACH_M, allow_inf_nan=False)] = 3.0,
    y: Annotated[float, Form(ge=-robots.REACH_M, le=robots.REACH_M, allow_inf_nan=False)] = 0.0,
) -> Response:
    """Let it drive now: the run that waits, or, without one, a drive of the lab's own with the policy of a setup."""
    now = utc_now()
    with services.database.transaction() as s:
        robot = _the_robot(s, study_id, robot_id)
        if run:
            wanted = select(RobotRun).where(RobotRun.id == run, RobotRun.study_id == study_id).with_for_update()
            found = s.scalars(wanted).one_or_none()
            if found is None:
                raise LabRefusal(404, "no_robot_run")
        else:
            if setup not in preference_setups():
                raise LabRefusal(422, "robot_setup", value=setup[:40])
            found = RobotRun(study_id=study_id, setup=setup, goal=[x, y], weights={})
            s.add(found)
            s.flush()
        robots.give_to(s, found, robot)
        robots.start_run(s, found, user.name, now)
        session_id = found.session_id
        audit_details(request, run=found.id)
    _told(services, robot_id, session_id)
    return _back(request, study_id, robot_id)


@router.post("/lab/studies/{study_id}/robots/{robot_id}/stop")
def stop(request: Request, study_id: str, robot_id: str, services: TheServices, user: CheckedCsrf) -> Response:
    """Stop it: its run is over, also one that was only waited for."""
    with services.database.transaction() as s:
        run = _its_run(s, _the_robot(s, study_id, robot_id))
        robots.stop_run(s, run, utc_now(), "experimenter")
        session_id = run.session_id
        audit_details(request, run=run.id)
    _told(services, robot_id, session_id)
    return _back(request, study_id, robot_id)


@router.post("/lab/studies/{study_id}/robot-runs/{run_id}/skip")
def skip(request: Request, study_id: str, run_id: str, services: TheServices, user: CheckedCsrf) -> Response:
    """Whoever waits goes on without a drive."""
    with services.database.transaction() as s:
        wanted = select(RobotRun).where(RobotRun.id == run_id, RobotRun.study_id == study_id).with_for_update()
        run = s.scalars(wanted).one_or_none()
        if run is None or run.state != "waiting":
            raise LabRefusal(404, "no_robot_run")
        robots.end_run(s, run, utc_now(), None)
        robot_id, session_id = run.robot_id, run.session_id
    _told(services, robot_id, session_id)
    return RedirectResponse(f"/lab/studies/{study_id}/robots", status_code=303)


@router.post("/api/lab/studies/{study_id}/robots/{robot_id}/weights", status_code=204)
def weights(study_id: str, robot_id: str, services: TheServices, body: RobotWeights) -> Response:
    """Drive by these from now on."""
    with services.database.transaction(durable=False) as s:
        run = _its_run(s, _the_robot(s, study_id, robot_id))
        robots.set_weights(s, run, clean_weights(body.weights, objectives_on(run.setup), "weights"))
    services.mirror.tell_orders(robot_id)
    return Response(status_code=204)


@router.post("/api/lab/studies/{study_id}/robots/{robot_id}/person", status_code=204)
def person(study_id: str, robot_id: str, services: TheServices, body: PersonPointed) -> Response:
    """Where a person stands, as somebody clicked on the stage."""
    with services.database.transaction(durable=False) as s:
        robot = _the_robot(s, study_id, robot_id)
        robots.point_person(robot, (body.place[0], body.place[1]) if body.place else None)
    services.mirror.tell_orders(robot_id)
    return Response(status_code=204)


@router.post("/api/lab/studies/{study_id}/robots/{robot_id}/words", response_model=WordsUnderstood)
def words(request: Request, study_id: str, robot_id: str, services: TheServices, body: WordsRead) -> Response:
    """What a sentence is read as, in the reader's language; the page then sends the weights."""
    with services.database.session() as s:
        _the_robot(s, study_id, robot_id)
    return read_wish(body.sentence, language_of(lab_language(request)))


@router.get(
    "/api/lab/studies/{study_id}/robots/{robot_id}/stream",
    response_class=Response,
    responses={200: {"content": {"text/event-stream": {}}}},
)
async def stream(study_id: str, robot_id: str, services: TheServices) -> Response:
    """Server-sent events: `robot`, as `POST /api/robot/state` was told; `away`: it was silent for long."""

    def find() -> str:
        with services.database.session() as s:
            return _the_robot(s, study_id, robot_id).id

    return mirrored(services.mirror, await run_in_threadpool(find), None)


@router.get("/lab/studies/{study_id}/robot-runs/{run_id}.mcap", response_class=Response)
def recording(study_id: str, run_id: str, database: Db, files: Files) -> Response:
    """A run's recording, for Foxglove, Rerun, or *Recordings*, where it becomes a trajectory."""
    with database.session() as s:
        run = s.scalars(select(RobotRun).where(RobotRun.id == run_id, RobotRun.study_id == study_id)).one_or_none()
        if run is None or run.recording is None:
            raise LabRefusal(404, "no_robot_run")
        content = files.get(run.recording)
    headers = {"Content-Disposition": f'attachment; filename="run-{run_id}.mcap"'}
    return Response(content, media_type=ANY_FILE, headers=headers)


def _back(request: Request, study_id: str, robot_id: str) -> Response:
    """To the robot's page, with the triangle that it had."""
    asked = f"?{request.url.query}" if request.url.query else ""
    return RedirectResponse(f"/lab/studies/{study_id}/robots/{robot_id}{asked}", status_code=303)


def _the_robot(s: DatabaseSession, study_id: str, robot_id: str) -> StudyRobot:
    robot = s.get(StudyRobot, robot_id)
    if robot is None or robot.study_id != study_id or robot.revoked_at is not None:
        raise LabRefusal(404, "no_robot")
    return robot


def _its_run(s: DatabaseSession, robot: StudyRobot) -> RobotRun:
    run = robots.run_of(s, robot)
    if run is None:
        raise LabRefusal(409, "no_robot_run")
    return s.get_one(RobotRun, run.id, with_for_update=True)


def _told(services: Any, robot_id: str | None, session_id: str | None) -> None:
    if robot_id is not None:
        services.mirror.tell_orders(robot_id)
    if session_id is not None:
        services.listeners.tell_changed(session_id)

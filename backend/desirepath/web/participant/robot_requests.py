"""The API of a step at which a real robot drives: its weights, where the person stands, an end to it, where it is.

The robot's own side is `robot/robot_requests.py`'s; who starts it, the lab's page's (`lab/robot_pages.py`).
"""

from __future__ import annotations

from fastapi import APIRouter
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from desirepath.store.models import StudyRobot, utc_now
from desirepath.study import robots
from desirepath.study.kinds.live import clean_weights
from desirepath.study.kinds.robot_drive import RobotDriveStep
from desirepath.study.refusals import Refused
from desirepath.study.session.finding import acting
from desirepath.web.core.dependencies import Services, TheServices
from desirepath.web.participant.sent import PersonPointed, RobotWeights
from desirepath.web.participant.session_view import current_step, looking
from desirepath.web.robot.mirror import mirrored

router = APIRouter()  # included in participant.router, which keeps guessers out


@router.post("/api/session/{token}/robot/{key}/weights", status_code=204)
def weights(token: str, key: str, services: TheServices, body: RobotWeights) -> Response:
    """Drive by these from now on."""
    with acting(services.database, token, request="robot", now=utc_now(), durable=False) as (s, session):
        step = current_step(session, key, RobotDriveStep)
        run = robots.lock_run(s, session, key)
        robots.set_weights(s, run, clean_weights(body.weights, step.named, "weights"))
        robot_id = run.robot_id
    if robot_id is not None:
        services.mirror.tell_orders(robot_id)
    return Response(status_code=204)


@router.post("/api/session/{token}/robot/{key}/person", status_code=204)
def person(token: str, key: str, services: TheServices, body: PersonPointed) -> Response:
    """Where the person stands, as somebody clicked on the stage."""
    with acting(services.database, token, request="robot", now=utc_now(), durable=False) as (s, session):
        current_step(session, key, RobotDriveStep)
        run = robots.lock_run(s, session, key)
        robot = s.get(StudyRobot, run.robot_id) if run.robot_id and run.state != "over" else None
        if robot is None:
            raise Refused(409, "no_robot", "No robot stands ready.", session_id=session.id, study_id=session.study_id)
        robots.point_person(robot, (body.place[0], body.place[1]) if body.place else None)
        robot_id = robot.id
    services.mirror.tell_orders(robot_id)
    return Response(status_code=204)


@router.post("/api/session/{token}/robot/{key}/stop", status_code=204)
def stop(token: str, key: str, services: TheServices) -> Response:
    """The participant wants it to stop: the drive is over."""
    now = utc_now()
    with acting(services.database, token, request="robot", now=now) as (s, session):
        current_step(session, key, RobotDriveStep)
        run = robots.lock_run(s, session, key)
        if run.state != "started":
            raise Refused(409, "not_driving", "It does not drive.", session_id=session.id, study_id=session.study_id)
        robots.stop_run(s, run, now, "participant")
        robot_id = run.robot_id
    if robot_id is not None:
        services.mirror.tell_orders(robot_id)
    services.listeners.tell_changed(session.id)
    return Response(status_code=204)


@router.get(
    "/api/session/{token}/robot/{key}/stream",
    response_class=Response,
    responses={200: {"content": {"text/event-stream": {}}}},
)
async def stream(token: str, key: str, services: TheServices) -> Response:
    """Server-sent events: `robot`, where the robot of this step's drive is, as it says itself; `away`: it was silent
    for long, or drives somebody else's."""
    robot_id, run_id = await run_in_threadpool(_driving, services, token, key)
    return mirrored(services.mirror, robot_id, run_id)


def _driving(services: Services, token: str, key: str) -> tuple[str, str]:
    with looking(services, token) as (s, session):
        current_step(session, key, RobotDriveStep)
        run = robots.run_at(s, session, key)
        if run is None or run.robot_id is None or run.state == "over":
            raise Refused(409, "no_robot", "No robot stands ready.", session_id=session.id, study_id=session.study_id)
        return run.robot_id, run.id

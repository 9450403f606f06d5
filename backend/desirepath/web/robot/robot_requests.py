"""A robot's own routes, opened by its token: its policy, what it is to do, where it is, and its recording.

What stands in the database is `study/robots.py`'s, who is shown it `mirror.py`'s. Places are metres in the run's frame:
from where the robot stood when the run began, x ahead.
"""

from __future__ import annotations

import asyncio
import tempfile
from typing import IO, Annotated, Any, Literal

from fastapi import APIRouter, Request
from pydantic import Field
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from desirepath.store.models import Participant, RobotRun, Session, StudyRobot, utc_now
from desirepath.study import robots
from desirepath.study.refusals import Refused
from desirepath.web.core.contract import Reply, Sent, reply_of
from desirepath.web.core.dependencies import Services, TheServices
from desirepath.web.core.media import ANY_FILE, answers_with
from desirepath.web.core.throttle import (
    LARGEST_RECORDING,
    RECORDINGS_PER_ROBOT,
    REFUSALS_PER_ADDRESS,
    REQUESTS_PER_ROBOT,
    count,
    network_of,
)

router = APIRouter(prefix="/api/robot", tags=["robot"])
LONGEST_WAIT_S = 20.0
LOOK_S = 2.0  # ours: what was changed without a notice (somebody was erased) is seen after that
MAGIC = b"\x89MCAP0\r\n"
LATE_S = 600.0  # ours: so long after a run's end its recording is still taken

Metre = Annotated[float, Field(allow_inf_nan=False, ge=-robots.REACH_M, le=robots.REACH_M)]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Place = Annotated[list[Metre], Field(min_length=2, max_length=2)]
Reason = Annotated[str, Field(max_length=120)]
Objective = Annotated[str, Field(max_length=40)]
Weight = Annotated[float, Field(allow_inf_nan=False, ge=0, le=1)]


class RobotSaid(Sent):
    """Where a robot is and what it does, at most a few times a second; everything beyond is left out."""

    run: str | None = Field(None, max_length=32)
    state: Literal["off", "armed", "driving", "stopped"]
    reason: Reason = ""
    pose: Annotated[list[Metre], Field(min_length=3, max_length=3)] = Field(description="x, y (m), yaw (rad)")
    speed: Annotated[list[Number], Field(min_length=2, max_length=2)] = Field(description="m/s, rad/s")
    goal: Place | None = None
    scan: Annotated[list[Place], Field(max_length=120)] = Field([], description="what its lidar hit")
    plan: Annotated[list[Place], Field(max_length=40)] = Field([], description="where it would go next")
    people: Annotated[list[Place], Field(max_length=20)] = []
    in_map: Annotated[list[Metre], Field(min_length=3, max_length=3)] | None = Field(
        None, description="where the run's frame is in the map of its setup: x, y (m), yaw (rad); null: nobody told it"
    )
    weights: Annotated[dict[Objective, Weight], Field(max_length=20)] | None = Field(
        None, description="by which it was last commanded, those above 0"
    )
    since_s: float | None = Field(
        None, ge=0, le=86_400, allow_inf_nan=False, description="seconds since its first command by these weights"
    )


class Stop(Sent):
    at_s: float = Field(ge=0, le=86_400, allow_inf_nan=False)
    reason: Reason


class RunOver(Sent):
    """A run is over. driven_s: since its wheels turned; way_m: how far; reached: whether it came to its goal."""

    run: str = Field(max_length=32)
    driven_s: float = Field(ge=0, le=86_400, allow_inf_nan=False)
    way_m: float = Field(ge=0, le=1e6, allow_inf_nan=False)
    reached: bool
    stops: Annotated[list[Stop], Field(max_length=200)] = []


class Orders(Reply):
    """What a robot is to do. number: rises whenever any of it changes; run: what it stands ready for; drive: whether
    it drives it now; goal: in the run's frame; policy: what `bundle` answers for this run, by name; person: where
    somebody clicked, in the run's frame."""

    number: int
    run: str | None
    drive: bool
    person: list[float] | None
    participant: str | None = None
    setup: str | None = None
    policy: str | None = None
    goal: list[float] | None = None
    weights: dict[str, float] | None = None


class AboutRobot(Reply):
    """Whose token this is."""

    robot: str
    study: str


class Kept(Reply):
    """sha256 of the recording's bytes."""

    recording: str


def token_of(request: Request) -> str:
    """The bearer token. Raises Refused 401 for none; counts whoever tries many."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else ""


def enter(request: Request, s: DatabaseSession, *, lock: bool = False) -> StudyRobot:
    """The robot that asks. Raises Refused: 401 for no token or one that opens nothing, 429 for too many of either."""
    try:
        robot = robots.find_robot(s, token_of(request), lock=lock)
    except Refused:
        if not count(request, REFUSALS_PER_ADDRESS, "robot", network_of(request)):
            raise Refused(429, "too_many", "Too many tokens that open nothing; wait a minute.") from None
        raise
    if not count(request, REQUESTS_PER_ROBOT, "robot", robot.id):
        raise Refused(
            429, "too_many", f"A robot may ask {REQUESTS_PER_ROBOT}; say where you are at most 5 times a second."
        )
    return robot


def _own_run(s: DatabaseSession, robot: StudyRobot, run_id: str) -> RobotRun:
    """A run of this very robot, locked. Raises Refused 404."""
    mine = select(RobotRun).where(RobotRun.id == run_id, RobotRun.robot_id == robot.id)
    run = s.scalars(mine.with_for_update()).one_or_none()
    if run is None:
        raise Refused(404, "no_run", "This robot has no such run.", field="run", value=run_id[:32])
    return run


@router.get("", response_model=AboutRobot)
def about(request: Request, services: TheServices) -> Response:
    """Whose token this is."""
    with services.database.session() as s:
        robot = enter(request, s)
        return reply_of(AboutRobot, {"robot": robot.name, "study": robot.study_id})


@router.get("/orders", response_model=Orders)
async def orders(request: Request, services: TheServices, after: int = -1, wait: float = LONGEST_WAIT_S) -> Response:
    """What the robot is to do, as soon as its number is another than `after`; after `wait` seconds at the latest."""
    robot_id, now = await run_in_threadpool(_first_orders, services, request)
    wait = min(max(wait, 0.0), LONGEST_WAIT_S)
    if now["number"] == after and wait > 0:
        mirror, key = services.mirror, f"orders {robot_id}"
        listener = mirror.listen(key)
        try:  # what changed between reading and listening is read once more
            until = asyncio.get_running_loop().time() + wait
            now = await run_in_threadpool(_orders, services, request)
            while now["number"] == after and (left := until - asyncio.get_running_loop().time()) > 0:
                await listener.wait(min(left, LOOK_S))
                now = await run_in_threadpool(_orders, services, request)
        finally:
            mirror.leave(key, listener)
    return reply_of(Orders, now)


def _first_orders(services: Services, request: Request) -> tuple[str, dict[str, Any]]:
    with services.database.session() as s:
        robot = enter(request, s)
        return robot.id, robots.orders_of(s, robot)


def _orders(services: Services, request: Request) -> dict[str, Any]:
    """The same for who waits since then; raises Refused where access was ended meanwhile."""
    with services.database.session() as s:
        return robots.orders_of(s, robots.find_robot(s, token_of(request)))


@router.get("/bundle", response_class=Response, responses=answers_with("zip"))
def bundle(request: Request, services: TheServices, participant: str = "") -> Response:
    """The policy that a participant of the robot's study has, or of the run that it stands ready for, as a bundle."""
    from desirepath.study.personalising.personal_bundle import bundle_for

    with services.database.session() as s:
        robot = enter(request, s)
        run = robots.run_of(s, robot)
        session = None
        if participant:
            theirs = select(Session).join(Participant, Participant.id == Session.participant_id)
            theirs = theirs.where(Participant.study_id == robot.study_id, Participant.code == participant[:16])
            session = s.scalars(theirs.order_by(Session.appointment.desc())).first()
        if participant and session is None:
            raise Refused(404, "no_participant", "This study has no such participant.", value=participant[:16])
        if session is None and run is None:
            raise Refused(409, "no_run", "Nobody is waiting; say participant=CODE, or wait for a run.")
        made = bundle_for(s, services.files, session, run)
    return Response(made(), media_type="application/zip")  # outside the transaction: it computes


@router.post("/state", status_code=204)
def state(request: Request, services: TheServices, body: RobotSaid) -> Response:
    """Where the robot is. Shown to whoever watches it; kept is only when its wheels first turned."""
    with services.database.session() as s:
        robot = enter(request, s)
        run = robots.run_of(s, robot)
        current = run is not None and run.id == body.run
        moves = run is not None and current and run.state == "started" and run.moved_at is None and _turns(body)
        said = body.model_dump(mode="json")
        robot_id, run_id = robot.id, run.id if run is not None else None
    if moves and run_id is not None:
        with services.database.transaction() as s:
            run = s.get_one(RobotRun, run_id, with_for_update=True)
            robots.note_moved(run, utc_now())
            after_s = robots.wheels_after_s(run)
            session_id = run.session_id
        said["wheels_after_s"] = after_s
        if session_id is not None:
            services.listeners.tell_changed(session_id)
    services.mirror.say(robot_id, said if current else said | {"run": None})
    return Response(status_code=204)


def _turns(said: RobotSaid) -> bool:
    return said.state == "driving" and (abs(said.speed[0]) > 0.01 or abs(said.speed[1]) > 0.05)


@router.post(
    "/recording",
    response_model=Kept,
    openapi_extra={"requestBody": {"content": {ANY_FILE: {"schema": {"type": "string", "format": "binary"}}}}},
)
async def recording(request: Request, services: TheServices, run: str) -> Response:
    """The MCAP of a run of this robot, as `application/octet-stream`; once, until a while after its end."""
    await run_in_threadpool(_may_record, services, request, run)  # before a byte of it is read
    with tempfile.SpooledTemporaryFile(max_size=2**20) as kept:
        size = 0
        async for part in request.stream():
            size += len(part)
            if size > LARGEST_RECORDING:
                raise Refused(413, "too_large", f"A recording has at most {LARGEST_RECORDING} bytes.")
            await run_in_threadpool(kept.write, part)
        sha = await run_in_threadpool(_keep, services, request, run, kept)
    return reply_of(Kept, {"recording": sha})


def _may_record(services: Services, request: Request, run_id: str) -> None:
    if request.headers.get("content-type") != ANY_FILE:
        raise Refused(415, "bad_value", f"must be sent as {ANY_FILE}", field="body")
    with services.database.session() as s:
        robot = enter(request, s)
        _without_recording(_own_run(s, robot, run_id))
        if not count(request, RECORDINGS_PER_ROBOT, "recording", robot.id):
            raise Refused(429, "too_many", f"A robot may send {RECORDINGS_PER_ROBOT} recordings.")


def _without_recording(run: RobotRun) -> None:
    if run.recording is not None:
        raise Refused(409, "recorded", "This run has its recording already.")
    ended = run.ended_at
    if run.state == "waiting" or (ended is not None and (utc_now() - ended).total_seconds() > LATE_S):
        raise Refused(409, "not_driven", "Only a run that drives, or just did, is recorded.")


def _keep(services: Services, request: Request, run_id: str, kept: IO[bytes]) -> str:
    kept.seek(0)
    content = kept.read()
    if not (content.startswith(MAGIC) and content.endswith(MAGIC)):
        raise Refused(422, "bad_value", "must be a whole MCAP file", field="body")
    with services.database.transaction() as s:
        run = _own_run(s, enter(request, s), run_id)
        _without_recording(run)
        run.recording = services.files.put(content)
        return run.recording


@router.post("/over", status_code=204)
def over(request: Request, services: TheServices, body: RunOver) -> Response:
    """A run of this robot is over. Told again it changes nothing."""
    with services.database.transaction() as s:
        run = _own_run(s, enter(request, s), body.run)
        if run.state == "waiting":
            raise Refused(409, "not_driven", "This run was not started.")
        robots.end_run(s, run, utc_now(), body.model_dump(mode="json", exclude={"run"}))
        robot_id, session_id = run.robot_id, run.session_id
    if robot_id is not None:
        services.mirror.tell_orders(robot_id)
    if session_id is not None:
        services.listeners.tell_changed(session_id)
    return Response(status_code=204)

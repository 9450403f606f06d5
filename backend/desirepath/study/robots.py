"""Robots of a study: who lets one in, what it is told, how its runs begin and end. Nothing here knows the web.

A robot's token opens its own study alone. What it is told (`orders_of`) is a number that counts, the run that it stands
ready for or drives, and the weights to drive by now.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.events import log_event
from desirepath.store.models import Participant, RobotRun, Session, StudyRobot
from desirepath.study.refusals import Refused

MOST_ROBOTS = 20  # of a study (ours), revoked ones apart
REACH_M = 50.0  # ours: farther from where a run begins neither a goal nor a person is taken


def hash_robot_token(token: str) -> str:
    """What is stored of a robot's token."""
    return hashlib.sha256(token.encode()).hexdigest()


def admit_robot(s: DatabaseSession, study_id: str, name: str, by: str) -> tuple[StudyRobot, str]:
    """A new robot of a study, and its token, which is told once. Raises Refused for one too many."""
    if len(robots_of(s, study_id)) >= MOST_ROBOTS:
        raise Refused(409, "too_many_robots", f"A study has at most {MOST_ROBOTS} robots; end one's access first.")
    token = secrets.token_urlsafe(32)
    robot = StudyRobot(study_id=study_id, name=name, token_hash=hash_robot_token(token), made_by=by)
    s.add(robot)
    s.flush()
    log_event(s, "robot_admitted", study_id=study_id, robot=robot.id, by=by)
    return robot, token


def robots_of(s: DatabaseSession, study_id: str) -> list[StudyRobot]:
    """Those that may still come, the oldest first."""
    mine = select(StudyRobot).where(StudyRobot.study_id == study_id, StudyRobot.revoked_at.is_(None))
    return list(s.scalars(mine.order_by(StudyRobot.created_at, StudyRobot.id)))


def find_robot(s: DatabaseSession, token: str, *, lock: bool = False) -> StudyRobot:
    """The robot of a token. Raises Refused 401 for one that is unknown or whose access was ended."""
    wanted = select(StudyRobot).where(StudyRobot.token_hash == hash_robot_token(token))
    robot = s.scalars(wanted.with_for_update() if lock else wanted).first()
    if robot is None or robot.revoked_at is not None:
        raise Refused(401, "no_robot", "This token opens nothing (any more); an experimenter makes one on Robots.")
    return robot


def revoke_robot(s: DatabaseSession, robot: StudyRobot, by: str, now: datetime) -> None:
    """End a robot's access: what it drives is over."""
    robot.revoked_at = robot.revoked_at or now
    run = run_of(s, robot)
    if run is not None:
        stop_run(s, run, now, "access_ended")
    log_event(s, "robot_revoked", study_id=robot.study_id, robot=robot.id, by=by)
    _count(robot)


# ---- runs ------------------------------------------------------------------------------------------------------------


def run_of(s: DatabaseSession, robot: StudyRobot) -> RobotRun | None:
    """What a robot stands ready for or drives."""
    open_runs = select(RobotRun).where(RobotRun.robot_id == robot.id, RobotRun.state != "over")
    return s.scalars(open_runs.order_by(RobotRun.created_at)).first()


def run_at(s: DatabaseSession, session: Session, step_key: str) -> RobotRun | None:
    """The run of a session's step."""
    return s.scalars(
        select(RobotRun).where(RobotRun.session_id == session.id, RobotRun.step_key == step_key)
    ).one_or_none()


def lock_run(s: DatabaseSession, session: Session, step_key: str) -> RobotRun:
    """The same, to be changed. Raises Refused where there is none."""
    mine = select(RobotRun).where(RobotRun.session_id == session.id, RobotRun.step_key == step_key)
    run = s.scalars(mine.with_for_update()).one_or_none()
    if run is None:
        raise Refused(409, "no_run", "There is no drive at this step.", session_id=session.id)
    return run


def give_to(s: DatabaseSession, run: RobotRun, robot: StudyRobot) -> None:
    """A robot that is free stands ready for a run. Raises Refused where it is not, or is another study's."""
    busy = run_of(s, robot)
    if robot.study_id != run.study_id or robot.revoked_at is not None:
        raise Refused(404, "no_robot", "This study has no such robot.")
    if busy is not None and busy.id != run.id:
        raise Refused(409, "robot_busy", f"{robot.name} still stands ready for another drive; end that one first.")
    before = s.get(StudyRobot, run.robot_id) if run.robot_id else None
    if before is not None and before.id != robot.id:
        _count(before)
    run.robot_id = robot.id
    _count(robot)


def offer(s: DatabaseSession, run: RobotRun) -> None:
    """Where the study has one robot and it is free, it stands ready at once, so that it has its policy in time."""
    robots = robots_of(s, run.study_id)
    if len(robots) == 1 and run_of(s, robots[0]) is None:
        give_to(s, run, robots[0])


def start_run(s: DatabaseSession, run: RobotRun, by: str, now: datetime) -> None:
    """Somebody of the lab lets it drive. Raises Refused where no robot stands ready, or it drove already."""
    if run.state != "waiting":
        raise Refused(409, "run_begun", "This drive was started already.")
    if run.robot_id is None:
        raise Refused(409, "no_robot", "Choose the robot first that drives.")
    run.state, run.started_by, run.started_at = "started", by, now
    _tell(s, run)
    log_event(s, "robot_started", study_id=run.study_id, session_id=run.session_id, run=run.id, by=by)


def end_run(s: DatabaseSession, run: RobotRun, now: datetime, summary: Mapping[str, Any] | None) -> None:
    """It drives no more. summary: what the robot said of it; None: it did not drive. A robot that was stopped from here
    says so afterwards: what it says is added, once."""
    if run.state == "over":
        if summary is not None and run.summary is not None and "driven_s" not in run.summary:
            run.summary = {**summary, "stops": [*summary.get("stops", ()), *run.summary["stops"]]}
        return
    run.state, run.ended_at = "over", now
    run.summary = dict(summary) if summary is not None else None
    _tell(s, run)
    log_event(s, "robot_run_over", study_id=run.study_id, session_id=run.session_id, run=run.id)


def stop_run(s: DatabaseSession, run: RobotRun, now: datetime, reason: str) -> None:
    """End a run from here; one that had not been started did not drive."""
    since = (now - run.started_at).total_seconds() if run.started_at is not None else 0.0
    stopped = {"stops": [{"at_s": round(since, 2), "reason": reason}]}
    end_run(s, run, now, stopped if run.state == "started" else None)


def end_runs_of(s: DatabaseSession, participant_id: str, now: datetime, reason: str) -> None:
    """Somebody leaves: no robot waits for them or drives on for them."""
    theirs = select(RobotRun).join(Session, Session.id == RobotRun.session_id)
    theirs = theirs.where(Session.participant_id == participant_id, RobotRun.state != "over")
    for run in s.scalars(theirs.with_for_update(of=RobotRun)):
        stop_run(s, run, now, reason)


def set_weights(s: DatabaseSession, run: RobotRun, weights: Mapping[str, float]) -> None:
    """Drive by these from now on. Raises Refused for a run that is over."""
    if run.state == "over":
        raise Refused(409, "run_over", "This drive is over.")
    run.weights = dict(weights)
    _tell(s, run)


def point_person(robot: StudyRobot, place: tuple[float, float] | None) -> None:
    """Somebody clicked where a person stands, m in the robot's odometry frame; None: nobody stands there any more."""
    robot.person = None if place is None else [round(place[0], 3), round(place[1], 3)]
    _count(robot)


def note_moved(run: RobotRun, now: datetime) -> None:
    """Its wheels turn."""
    if run.state == "started" and run.moved_at is None:
        run.moved_at = now


def wheels_after_s(run: RobotRun) -> float | None:
    """Seconds from the session's last answer to wheels turning; None where it never was, or nothing was answered."""
    if run.moved_at is None or run.asked_at is None:
        return None
    return round((run.moved_at - run.asked_at).total_seconds(), 2)


def orders_of(s: DatabaseSession, robot: StudyRobot) -> dict[str, Any]:
    """What the robot is to do now."""
    run = run_of(s, robot)
    orders: dict[str, Any] = {"number": robot.number, "run": None, "drive": False, "person": robot.person}
    if run is None:
        return orders
    code = None
    if run.session_id is not None:
        whose = select(Participant.code).join(Session, Session.participant_id == Participant.id)
        code = s.scalars(whose.where(Session.id == run.session_id)).one()
    orders |= {"run": run.id, "participant": code, "setup": run.setup, "goal": run.goal, "weights": run.weights}
    return orders | {"drive": run.state == "started"}


def _tell(s: DatabaseSession, run: RobotRun) -> None:
    if run.robot_id is not None:
        _count(s.get_one(StudyRobot, run.robot_id))


def _count(robot: StudyRobot) -> None:
    robot.number = StudyRobot.number + 1  # by the database, as several may change it at once

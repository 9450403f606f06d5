"""Looking at a session: what its pages and its API are told of where it stands. Lets a wait that is over go on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from fastapi import Request
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.texts import local
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Participant, Session, utc_now
from desirepath.store.sides import SIDES, Side
from desirepath.study.kind import KINDS, kind_of, read_plan
from desirepath.study.kinds.think_aloud import ThinkAloudStep
from desirepath.study.refusals import Refused, log_refusal
from desirepath.study.session import machine
from desirepath.study.session.finding import acting, find_session
from desirepath.study.session.leaving import LONGEST_PROBLEM
from desirepath.study.session.versions import protocol_of
from desirepath.study.simulated.known import tell_simulated
from desirepath.study.steps import Step
from desirepath.web.core.dependencies import Services, contact, public_url, services_of, stage_origin
from desirepath.web.core.videos import video_of
from desirepath.web.stage.admission import stage_token

S = TypeVar("S", bound=Step)
HELPED = ("words", "rules", "tuning", "feedback", "meet_your_robot", "robot_drive")
"""Kinds of step with a help of their own."""


def page_context(request: Request, s: DatabaseSession, session: Session, token: str) -> dict[str, Any]:
    frozen = protocol_of(s, session)
    view = machine.current(s, session)
    plan = read_plan(session.plan)
    return {
        "token": token,
        "study_title": frozen.title(session.language),
        "languages": frozen.protocol.languages,
        "contact": frozen.protocol.contact or contact(request),
        "payment": local(frozen.protocol.payment, session.language) if frozen.protocol.payment else None,
        "longest_problem": LONGEST_PROBLEM,
        "code": s.get_one(Participant, session.participant_id).code,
        "speaks": any(isinstance(step, ThinkAloudStep) for step in plan),
        "headset": frozen.protocol.asked_of_devices.headset,
        "head_pose": frozen.protocol.asked_of_devices.head_pose,
        "motor_sound": frozen.protocol.motor_sound,
        "looks_around": any(step.view not in (None, "top_down") for step in plan),
        "step": view,
        "next_kind": next_kind(plan, session.position),
        "leads_to": leads_to(plan, session.position),
        "helps_with": helps_with(leads_to(plan, session.position)),
        "state": state_of(request, s, session, view),
        "expires_at": session.expires_at,
        "address": public_url(request) if view.kind == "appointment" else None,
    }


def next_kind(plan: list[Step], position: int) -> str:
    """What kind of page follows, "other" where that depends on answers or there is none."""
    following = next((step for step in plan[position + 1 :] if not kind_of(step).goes_on), None)
    return "other" if following is None or following.when else following.kind


def leads_to(plan: list[Step], position: int) -> str | None:
    """The kind of what is done on the stage next, None where nothing more is."""
    return next((step.kind for step in plan[position:] if kind_of(step).shows != "page"), None)


def helps_with(kind: str | None) -> str:
    """Which help is shown on the way to, and during, that kind of step; "": that of the pairs."""
    return "page" if kind is None else kind if kind in HELPED else ""


def state_of(request: Request, s: DatabaseSession, session: Session, view: machine.StepView) -> dict[str, Any]:
    """What `GET /api/session/{token}` answers."""
    state: dict[str, Any] = {"state": session.state, "step": view.as_dict(), "language": session.language}
    if session.simulated:  # bots read no pages
        state["step"] |= tell_simulated(s, session, view)
    if (videos := videos_of(services_of(request).files, s, session, request)) is not None and view.trial is not None:
        state["step"]["trial"] = {**view.trial, "videos": videos}
    elif view.kind in KINDS and KINDS[view.kind].shows != "page":
        state["stage_url"] = f"{stage_origin(request)}/stage/{stage_token(session)}/"
    return state


def videos_of(files: ArtefactStore, s: DatabaseSession, session: Session, request: Request) -> dict[Side, str] | None:
    """Where the videos of the current trial are, None where the stage shows its trajectories."""
    step = machine.step_of(session)
    trial = machine.trial_of(s, session) if kind_of(step).shows == "trajectories" else None
    if trial is None or any(video_of(s, files, one) is None for one in (trial.trajectory_a, trial.trajectory_b)):
        return None
    here = f"/api/session/{request.path_params['token']}/trials/{step.key}/video"
    return {side: f"{here}/{side}" for side in SIDES}


def current_step(session: Session, key: str, kind: type[S]) -> S:
    """The session's current step, if it is that one and of that kind. Raises Refused."""
    step = machine.step_of(session)
    if session.state != "active" or step.key != key or not isinstance(step, kind):
        message = "The session is at another step."
        whose = {"session_id": session.id, "study_id": session.study_id}
        raise Refused(409, "not_current_step", message, **whose, step=key[:80])
    return step


@contextmanager
def looking(services: Services, token: str) -> Iterator[tuple[DatabaseSession, Session]]:
    """A reading transaction on the token's session, which first lets a waiting session go on. Refusals are logged."""
    try:
        with services.database.session() as s:
            session = find_session(s, token, now=utc_now(), lock=False)
            due = session.state == "expired" or _may_settle(s, session)
            if not due:
                yield s, session
        if due:
            _settle(services, token)
            with services.database.session() as s:
                yield s, find_session(s, token, now=utc_now(), lock=False)
    except Refused as refused:
        log_refusal(services.database, refused, request="look")
        raise


def _may_settle(s: DatabaseSession, session: Session) -> bool:
    return not machine.waits(s, session, now=utc_now())


def _settle(services: Services, token: str) -> None:
    now = utc_now()
    with acting(services.database, token, request="settle", now=now) as (s, session):
        moved = machine.settle(s, services.files, session, now=now)
    if moved:
        services.listeners.tell_changed(session.id)

"""The API of weights that are changed by hand: which way the robot would take from where it is, and in which place.

Nothing is changed or stored here: the final weights with their history are the step's answer (`session_pages.py`). The
rollouts are `study/personalising/live_rollouts.py`'s, what the stage shows `stage/presenting.py`'s.
"""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter, Request
from starlette.responses import Response

from desirepath.learning.words.lexicon import Language
from desirepath.store.models import utc_now
from desirepath.study.kind import Moment, kind_of
from desirepath.study.kinds.live import LiveKind, LiveStep, clean_weights
from desirepath.study.kinds.robot_drive import RobotDriveStep
from desirepath.study.kinds.rules import RulesStep, obeyed_side
from desirepath.study.kinds.words import MEANT, MOST_QUESTIONS, WordsStep, language_of, mark_stretches, understand
from desirepath.study.session.versions import protocol_of
from desirepath.study.wire import BadValue
from desirepath.web.core.contract import reply_of
from desirepath.web.core.dependencies import TheServices, services_of
from desirepath.web.participant.replies import LivePaths, PlaceShown, RulesReply, WordsUnderstood
from desirepath.web.participant.sent import LiveAsked, PlaceChosen, RulesAsked, WordsRead
from desirepath.web.participant.session_view import current_step, looking

router = APIRouter()  # included in participant.router, which keeps guessers out


@router.post("/api/session/{token}/live/{key}/paths", response_model=LivePaths)
def paths(token: str, key: str, services: TheServices, body: LiveAsked) -> Response:
    """The way of each robot of the step, in one of its places: at these weights, and of the usual robot beside it where
    two are shown. Robots that are under way say where they are."""
    from desirepath.simulation.scene import SceneError
    from desirepath.study.personalising import live_rollouts as live

    with looking(services, token) as (s, session):
        step = current_step(session, key, LiveStep)
        kind = kind_of(step)
        assert isinstance(kind, LiveKind)  # noqa: S101  its steps are of such kinds
        place = _place(step, body.place)
        policies = kind.policies(
            step,
            Moment(s, session, protocol_of(s, session), utc_now()),
            services.files,
            clean_weights(body.weights, step.named, "weights") if body.weights is not None else None,
        )
    scene = live.scenes_of(step.setup)[place]  # outside the transaction: it computes
    poses: list[list[float] | None] = list(body.poses) if body.poses else [None] * len(policies)
    since = body.since if body.since and body.poses else [0.0] * len(policies)
    for field, given in (("poses", poses), ("since", since)):
        if len(given) != len(policies):
            raise BadValue(field, len(given), f"must be one per robot, which are {len(policies)}")
    try:
        trajectories = [
            live.roll_out(policy, scene, pose, seconds)
            for policy, pose, seconds in zip(policies, poses, since, strict=True)
        ]
    except SceneError as wrong:  # it has arrived, or brushes past something between two steps
        raise BadValue("poses", None, f"must be where a robot can go on from; {wrong}") from None
    rolled_out = [live.path_of(trajectory) for trajectory in trajectories]
    looks_at: list[list[str]] = [[] for _ in rolled_out]
    if step.reasons and not body.poses:
        looks_at = [live.looks_at(policy, one) for policy, one in zip(policies, trajectories, strict=True)]
    why = kind.why(policies, trajectories) if body.weights is None and not body.poses else []
    return reply_of(
        LivePaths,
        {
            "place": place,
            "why": [asdict(reason) for reason in why],
            "paths": [
                {"track": one.track, "arrives": one.arrives, "looks_at": things}
                for one, things in zip(rolled_out, looks_at, strict=True)
            ],
        },
    )


@router.post("/api/session/{token}/live/{key}/words", response_model=WordsUnderstood)
def words(token: str, key: str, services: TheServices, body: WordsRead) -> Response:
    """What a sentence is read as, in the session's language, or in the other one where it clearly is in that.
    Nothing of it is stored or logged here."""
    with looking(services, token) as (_, session):
        step = current_step(session, key, LiveStep)
        language = language_of(session.language)
        if not isinstance(step, WordsStep | RobotDriveStep):
            raise BadValue("key", key[:80], "must be a step at which a wish is written down")
    return read_wish(body.sentence, language)  # outside the transaction: it computes


@router.post("/api/session/{token}/live/{key}/rules", response_model=RulesReply)
def rules(token: str, key: str, services: TheServices, body: RulesAsked) -> Response:
    """What the robot does by these rules in one of the step's places, where they apply, and which collide. Nothing of
    it is stored or logged here."""
    from desirepath.study.personalising import rule_pictures

    with looking(services, token) as (_, session):
        step = current_step(session, key, LiveStep)
        if not isinstance(step, RulesStep):
            raise BadValue("key", key[:80], "must be a step at which rules are told")
        language, session_id, place = language_of(session.language), session.id, _place(step, body.place)
    if body.check is not None and body.check >= len(body.rules):
        raise BadValue("check", body.check, "must be one of the rules")
    reply = rule_pictures.picture(body.rules, place)  # outside the transaction: it computes
    if body.sentence is not None:
        reply["read"] = rule_pictures.read(body.sentence, language)
    if body.check is not None:
        rule = body.rules[body.check]
        pair = rule_pictures.paths_of(rule, place)
        if pair is not None:
            own_first = obeyed_side(session_id, rule, place) == "a"
            reply["pair"] = [rule_pictures.told(one) for one in (pair if own_first else pair[::-1])]
    return reply_of(RulesReply, reply)


def read_wish(sentence: str, language: Language) -> Response:
    """What it is read as, as the reply `WordsUnderstood`."""
    got = understand(sentence, language)
    questions = [
        {"text": sentence[question.start : question.end], "offered": list(question.offered), "about": question.about}
        for question in got.questions[:MOST_QUESTIONS]
    ]
    parts = mark_stretches(sentence, got)
    reply = {"parts": parts, "weights": got.weights, "questions": questions, "meant_weight": MEANT}
    reply |= {"language": got.language} if got.language != language else {}
    return reply_of(WordsUnderstood, reply)


@router.post("/api/session/{token}/live/{key}/place", response_model=PlaceShown)
def place(token: str, key: str, request: Request, body: PlaceChosen) -> Response:
    """Show another of the step's places on the stage."""
    services = services_of(request)
    with looking(services, token) as (_, session):
        step = current_step(session, key, LiveStep)
        chosen = _place(step, body.place)
        session_id = session.id
    services.presenter.show_place(session_id, chosen)
    return reply_of(PlaceShown, {"place": chosen})


def _place(step: LiveStep, place: int) -> int:
    if place >= step.scenes:
        raise BadValue("place", place, f"must be below {step.scenes}, the step's number of scenes")
    return place

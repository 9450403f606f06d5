"""Which step comes next, and whom a study cannot go on with: skip logic, comprehension checks, quotas. Moves nobody."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.artefacts import ArtefactStore
from backend.store.events import log_event
from backend.store.models import Participant, Response, Session, Study, Trial
from backend.study.drawing import paths
from backend.study.grammar.questionnaires import Questionnaire
from backend.study.grammar.skipping import Earlier, When, asks_anything, may_ask_something
from backend.study.grammar.words import DRAWN_KINDS
from backend.study.personalising import next_query
from backend.study.plan.assignment import places_held_by
from backend.study.plan.planning import Step
from backend.study.protocol.schema import Protocol
from backend.study.session import evaluating
from backend.study.session.versions import protocol_of


def next_position(s: DatabaseSession, files: ArtefactStore, session: Session) -> int:
    """The index of the step after the current one; passed over are steps whose `when` is not met, further attempts at a
    check that was passed, comparisons that could not be made, queries after the stopping rule has ended them, and
    probes of these.
    """
    to = session.position + 1
    if session.plan[to].get("choose") and next_query.little_left(s, files, session, session.plan[to]):
        log_event(s, "queries_ended", session_id=session.id, step=session.plan[to]["key"])
        while session.plan[to].get("choose") and "again" not in session.plan[to]:
            to += 1
    return first_asked(s, session, to)


def first_asked(s: DatabaseSession, session: Session, to: int) -> int:
    """The index of the first step from `to` on that this person is asked."""
    while not _can_be_asked(s, session, session.plan[to]):
        to += 1
    return to


def _can_be_asked(s: DatabaseSession, session: Session, step: Step) -> bool:
    """What its `when` allows; comparisons need the trial that was made for them, probes of chosen queries the one that
    they repeat."""
    if "when" in step and not _is_met(s, session, step["when"]):
        return False
    if "questionnaire" in step and not asks_anything(*_questions(s, session, step)):
        return False
    if step["kind"] == "comparison":
        return _has_trial(s, session, step["key"])
    if step["kind"] == "wait":
        return True
    if step["stage"] == "evaluation":
        return evaluating.can_be_shown(s, session, step)
    if step["kind"] in DRAWN_KINDS:
        return paths.wanted(s, session, step)
    if step["kind"] == "comprehension" and step["attempt"] > 1:
        return not _passed_before(s, session, step)
    return "again" not in step or _has_trial(s, session, step["again"])


def _has_trial(s: DatabaseSession, session: Session, key: str) -> bool:
    found = select(Trial.id).where(Trial.session_id == session.id, Trial.step_key == key)
    return s.scalars(found).first() is not None


def may_come(s: DatabaseSession, session: Session, step: Step) -> bool:
    """Whether a later step counts as ahead, for the progress: not what waits by itself, what an answer has ruled out,
    or what is only for those who err or want more.
    """
    if step["kind"] == "wait" or step.get("optional") or (step["kind"] == "comprehension" and step["attempt"] > 1):
        return False
    answered = "when" in step and answer_to(s, session, step["when"]["questionnaire"]) is not None
    if answered and not _is_met(s, session, step["when"]):
        return False
    return "questionnaire" not in step or may_ask_something(*_questions(s, session, step))


def _questions(s: DatabaseSession, session: Session, step: Step) -> tuple[Questionnaire, Earlier]:
    """The step's questionnaire, and what this participant answered to others."""
    asked = protocol_of(s, session).questionnaires[step["questionnaire"]]
    return asked, lambda name: answer_to(s, session, name)


def _passed_before(s: DatabaseSession, session: Session, step: Step) -> bool:
    earlier = [one["key"] for one in session.plan if one["stage"] == step["stage"] and one["key"] != step["key"]]
    given = s.scalars(select(Response).where(Response.session_id == session.id, Response.step_key.in_(earlier)))
    return any(response.value.get("passed") for response in given)


def _is_met(s: DatabaseSession, session: Session, when: dict[str, Any]) -> bool:
    value = answer_to(s, session, when["questionnaire"]) or {}
    return When.model_validate(when).fits(value.get(when["item"]))


def answer_to(s: DatabaseSession, session: Session, questionnaire: str) -> dict[str, Any] | None:
    """The participant's newest answers to that questionnaire, in whichever appointment, None if it was not answered."""
    keys = [step["key"] for step in session.plan if step.get("questionnaire") == questionnaire]
    given = (
        select(Response.value)
        .join(Session, Session.id == Response.session_id)
        .where(Session.participant_id == session.participant_id, Response.step_key.in_(keys))
        .order_by(Response.created_at.desc())
    )
    return s.scalars(given).first()


# ---- who cannot go on ------------------------------------------------------------------------------------------------


def ends_here(
    s: DatabaseSession, session: Session, study: Study, protocol: Protocol, step: Step, value: dict[str, Any]
) -> str | None:
    """Why the study ends for somebody with that answer: comprehension, quota; None if it does not."""
    if step["kind"] == "comprehension":
        failed = not value["passed"] and step["attempt"] == step["attempts"]
        return "comprehension" if failed and step["on_failure"] == "end" else None
    if step["kind"] != "questionnaire":
        return None
    for quota in protocol.quotas:
        if quota.questionnaire == step["questionnaire"] and str(value.get(quota.item)) == quota.is_:
            keys = [one["key"] for one in session.plan if one.get("questionnaire") == quota.questionnaire]
            if _others(s, session, study, protocol, keys, quota.item, quota.is_) >= quota.most:
                return "quota"
    return None


def _others(
    s: DatabaseSession, session: Session, study: Study, protocol: Protocol, keys: list[str], item: str, answer: str
) -> int:
    """How many others gave that answer and still count. The study is locked, so that two cannot take the last place."""
    s.execute(select(Study.id).where(Study.id == study.id).with_for_update())
    given = s.execute(
        select(Participant.id, Response.value)
        .join(Session, Session.participant_id == Participant.id)
        .join(Response, Response.session_id == Session.id)
        .where(
            Participant.study_id == study.id,
            Participant.id != session.participant_id,
            Response.step_key.in_(keys),
        )
    )
    same = {person for person, value in given if str(value.get(item)) == answer}
    me = s.get_one(Participant, session.participant_id)
    return len(same & places_held_by(s, study, protocol, simulated=me.simulated, pilot=me.pilot))

"""What a simulated session is told of its step beside what pages show: a bot reads no pages and has to know what about.

Nobody else is told this: it names queries, right answers and conditions.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy.orm import Session as DatabaseSession

from backend.store.models import Session
from backend.study.drawing import paths, walks
from backend.study.grammar.words import DRAWN_KINDS, TRIAL_KINDS
from backend.study.session import machine
from backend.study.session.versions import protocol_of

FIELDS = ("block", "view", "role", "questionnaire", "instructed")


def told_to_bots(s: DatabaseSession, session: Session, view: machine.StepView) -> dict[str, Any]:
    """What the current step is about, for a bot: condition, role, query; items with their right answers (`answer`); a
    consent's purposes, so that what bots answered may be learned from."""
    if session.state != "active":
        return {}
    step = machine.step_of(session)
    told: dict[str, Any] = {name: step[name] for name in FIELDS if name in step}
    if view.kind in DRAWN_KINDS:
        scene = paths.scene_of(step)
        walked = [walks.scene_with(scene, walk).as_dict() for walk in walks.offered(step)]
        return told | {"scenes": walked or [scene.as_dict()]}
    if view.kind in TRIAL_KINDS:
        trial = machine.trial_of(s, session)
        return told | {"query": trial.query_id if trial is not None else None}
    if view.kind == "consent":
        return told | {"purposes": [purpose["key"] for purpose in view.payload["purposes"]]}
    if "questionnaire" not in step:
        return told
    asked = protocol_of(s, session).questionnaires[step["questionnaire"]].items
    right = {item.key: item.correct or item.instructed for item in asked}
    items = [item for block in view.payload["blocks"] for item in block["items"]]
    return told | {"items": [item | {"answer": right[item["key"]]} for item in items]}

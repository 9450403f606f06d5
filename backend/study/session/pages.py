"""What the pages show of a step: its texts in the participant's language. Never says which drive is whose.

The shapes are the ones of frontend/README.md.
"""

from __future__ import annotations

import re
from typing import Any

from backend.study.drawing import walks
from backend.study.grammar.questionnaires import Item, Questionnaire
from backend.study.grammar.skipping import Earlier, may_ask
from backend.study.grammar.words import DRAWN_KINDS, SINGLE_KINDS, TRIAL_KINDS
from backend.study.personalising.training import train_stage
from backend.study.plan.planning import Step
from backend.study.protocol.blocks import Viewing
from backend.study.protocol.freezing import POINT, FrozenProtocol
from backend.study.protocol.stages import stage_keys
from backend.study.protocol.texts import local

_POINT_LINES = re.compile(r"^- \[ \] +.+\n?", re.MULTILINE)


def payload_of(
    frozen: FrozenProtocol,
    step: Step,
    language: str,
    *,
    completion_code: str | None = None,
    earlier: Earlier | None = None,
) -> dict[str, Any]:
    """The payload of a step for its template. earlier: answers by which items are left out; None: none is."""
    kind = step["kind"]
    if kind in TRIAL_KINDS:
        return trial_payload(step)
    if kind in DRAWN_KINDS:
        return drawing_payload(step)
    if kind in ("wait", "guess"):
        return {"learns_from": "paths" if train_stage(frozen.protocol).job == "demonstrations" else "answers"}
    if kind == "attention":
        return {"instructed": step["instructed"]}
    if kind in ("questionnaire", "comprehension"):
        asked = _questionnaire(frozen.questionnaires[step["questionnaire"]], language, earlier)
        return asked | _rules(frozen, step, language)
    title, text = frozen.text(_text_of(frozen, step), language)
    shown = {"title": title, "text": text}
    if kind == "consent":
        consent = frozen.consent
        return shown | {
            "text": _POINT_LINES.sub("", text).strip(),
            "points": [match.group(1).strip() for match in POINT.finditer(text)],
            "purposes": [{"key": key, "text": local(said, language)} for key, said in consent.purposes.items()],
            "version": consent.version,
        }
    if kind == "debriefing":
        url = next(entry.debriefing.return_url for entry in frozen.protocol.stages if entry.debriefing)
        return shown | _code_and_way(completion_code, url)
    if kind == "break":
        return shown | {"at_least_s": step["at_least_s"]}
    return shown


def drawing_payload(step: Step) -> dict[str, Any]:
    """The payload of a drawing, whose words are the catalogues'."""
    shown = {name: step[name] for name in ("view", "place", "places", "number", "of", "optional")}
    person = walks.mode_of(step)
    return shown | {"person": person, "walks": len(walks.PLANNED) if person == "recorded" else 0}


def ending_payload(frozen: FrozenProtocol, language: str, completion_code: str | None) -> dict[str, Any]:
    """The payload of the page for somebody whom the study cannot go on with; no title where its words are the
    catalogue's."""
    page = frozen.protocol.screen_out
    if page is None:
        return {"title": None, "text": None} | _code_and_way(completion_code, None)
    title, text = frozen.text(page.text, language)
    return {"title": title, "text": text} | _code_and_way(completion_code, page.return_url)


def _code_and_way(completion_code: str | None, url: str | None) -> dict[str, Any]:
    return {
        "completion_code": completion_code,
        "return_url": url.replace("{code}", completion_code or "") if url else None,
    }


def trial_payload(step: Step) -> dict[str, Any]:
    """The payload of a trial, comparison or evaluation, whose words are the catalogues' and not the study's. Of an
    evaluation it tells the robot's place, not its name."""
    if step["kind"] in SINGLE_KINDS:
        return {name: step[name] for name in ("role", "view", "robot", "number", "of")}
    viewing = Viewing.model_validate(step.get("viewing", {}))
    return {
        "role": step.get("role", "regular"),
        "view": step["view"],
        "number": step["number"],
        "of": step["of"],
        **viewing.model_dump(),
    }


def _text_of(frozen: FrozenProtocol, step: Step) -> str:
    """Name of the step's text; plans of before name only the stage."""
    if "text" in step:
        return str(step["text"])
    stages = frozen.protocol.stages
    return str(getattr(stages[stage_keys(stages).index(step["stage"])].stage, "text"))  # noqa: B009


def _questionnaire(questionnaire: Questionnaire, language: str, earlier: Earlier | None) -> dict[str, Any]:
    asked = [(block, [item for item in block.items if may_ask(item, earlier)]) for block in questionnaire.blocks]
    return {
        "title": local(questionnaire.title, language),
        "text": local(questionnaire.text, language) if questionnaire.text else "",
        "blocks": [
            {
                "title": local(block.title, language) if block.title else None,
                "items": [_item(item, language) for item in items],
            }
            for block, items in asked
            if items
        ],
    }


def _rules(frozen: FrozenProtocol, step: Step, language: str) -> dict[str, Any]:
    """What is special about this asking: its time limit; a comprehension check's attempts and text."""
    rules: dict[str, Any] = {"time_limit_s": step.get("time_limit_s")}
    if step["kind"] == "comprehension":
        again = frozen.text(step["text"], language)[1] if "text" in step and step["attempt"] > 1 else None
        rules |= {"attempt": step["attempt"], "attempts": step["attempts"], "again": again}
    return rules


def _item(item: Item, language: str) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "key": item.key,
        "type": item.type,
        "text": local(item.text, language),
        "required": item.required,
    }
    if here := [one for one in item.when if one.questionnaire is None]:
        shown["when"] = [one.model_dump(by_alias=True, exclude_none=True) for one in here]
    if item.low and item.high:
        shown |= {"low": local(item.low, language), "high": local(item.high, language)}
    if item.type == "scale":
        shown["points"] = item.points
    elif item.type in ("choice", "ranking"):
        shown["options"] = [{"value": option.value, "label": local(option.label, language)} for option in item.options]
    elif item.type == "number":
        shown |= {"min": item.min, "max": item.max}
    return shown

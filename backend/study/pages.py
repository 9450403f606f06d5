"""What the pages show of a step: its texts in the participant's language. Never says which drive is whose.

The shapes are the ones of frontend/README.md.
"""

from __future__ import annotations

import re
from typing import Any

from backend.study.planning import Step
from backend.study.protocol import POINT, FrozenProtocol, local, stage_keys
from backend.study.schema import ConsentStage, DebriefingStage, Item, Questionnaire, TextStage
from backend.study.words import TRIAL_KINDS

_POINT_LINES = re.compile(r"^- \[ \] +.+\n?", re.MULTILINE)


def payload_of(
    frozen: FrozenProtocol, step: Step, language: str, *, completion_code: str | None = None
) -> dict[str, Any]:
    """The payload of a step for its template."""
    kind = step["kind"]
    if kind in TRIAL_KINDS:
        return trial_payload(step)
    if kind in ("wait", "guess"):
        return {}  # their words are the same in every study: the catalogues'
    if kind == "questionnaire":
        return _questionnaire(frozen.questionnaires[step["questionnaire"]], language)
    stage = _stage(frozen, step)
    title, text = frozen.text(stage.text, language)
    if isinstance(stage, ConsentStage):
        points = [match.group(1).strip() for match in POINT.finditer(text)]
        return {
            "title": title,
            "text": _POINT_LINES.sub("", text).strip(),
            "points": points,
            "version": stage.version,
        }
    if isinstance(stage, DebriefingStage):
        url = stage.return_url
        return {
            "title": title,
            "text": text,
            "completion_code": completion_code,
            "return_url": url.replace("{code}", completion_code or "") if url else None,
        }
    return {"title": title, "text": text}


def trial_payload(step: Step) -> dict[str, Any]:
    """The payload of a trial or comparison, whose words are the catalogues' and not the study's."""
    return {"role": step.get("role", "regular"), "view": step["view"], "number": step["number"], "of": step["of"]}


def _stage(frozen: FrozenProtocol, step: Step) -> TextStage | ConsentStage | DebriefingStage:
    stages = frozen.protocol.stages
    entry = stages[stage_keys(stages).index(step["stage"])]
    assert isinstance(entry.stage, TextStage | ConsentStage | DebriefingStage)  # noqa: S101  by the step's kind
    return entry.stage


def _questionnaire(questionnaire: Questionnaire, language: str) -> dict[str, Any]:
    return {
        "title": local(questionnaire.title, language),
        "text": local(questionnaire.text, language) if questionnaire.text else "",
        "blocks": [
            {
                "title": local(block.title, language) if block.title else None,
                "items": [_item(item, language) for item in block.items],
            }
            for block in questionnaire.blocks
        ],
    }


def _item(item: Item, language: str) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "key": item.key,
        "type": item.type,
        "text": local(item.text, language),
        "required": item.required,
    }
    if item.type == "scale" and item.low and item.high:
        shown |= {"points": item.points, "low": local(item.low, language), "high": local(item.high, language)}
    elif item.type == "choice":
        shown["options"] = [{"value": option.value, "label": local(option.label, language)} for option in item.options]
    elif item.type == "number":
        shown |= {"min": item.min, "max": item.max}
    return shown

"""Checks what participants send: is this value an answer to this step? Storing it is the machine's."""

from __future__ import annotations

from typing import Any

from backend.study.protocol import FrozenProtocol
from backend.study.refusals import Refused
from backend.study.schema import Item

CONFIRMED = ("information", "instruction", "wait", "debriefing")  # steps that are read, with nothing to answer


class BadValue(Refused):
    """A value that is no answer; names the field and what would work."""

    def __init__(self, field: str, value: Any, message: str) -> None:
        super().__init__(422, "bad_value", message, field=field, value=value)


def checked_value(frozen: FrozenProtocol, step: dict[str, Any], value: Any) -> dict[str, Any]:
    """The answer to store for a step. Raises BadValue."""
    if not isinstance(value, dict):
        raise BadValue("value", value, "must be an object")
    kind = step["kind"]
    if kind in CONFIRMED:
        return {}
    if kind in ("trial", "comparison", "guess"):
        if value.get("choice") not in ("a", "b"):
            raise BadValue("value.choice", value.get("choice"), "must be 'a' or 'b'")
        return {"choice": value["choice"]}
    if kind == "consent":
        version = next(e.consent.version for e in frozen.protocol.stages if e.consent)
        if value.get("given") is not True:
            raise BadValue("value.given", value.get("given"), "must be true; who does not agree leaves the study")
        if str(value.get("version", version)) != version:
            raise BadValue("value.version", value.get("version"), f"must be {version}, the version that was shown")
        return {"given": True, "version": version}
    questionnaire = frozen.questionnaires[step["questionnaire"]]
    known = {item.key: item for item in questionnaire.items}
    for key in value:
        if key not in known:
            raise BadValue(f"value.{key}", value[key], f"is no item of this questionnaire; items: {', '.join(known)}")
    return {key: _item(item, value[key]) for key, item in known.items() if _given(item, value)}


def _given(item: Item, value: dict[str, Any]) -> bool:
    if value.get(item.key) not in (None, ""):
        return True
    if item.required:
        raise BadValue(f"value.{item.key}", None, "has no answer yet")
    return False


def _item(item: Item, given: Any) -> Any:
    field = f"value.{item.key}"
    if item.type == "choice":
        allowed = [option.value for option in item.options]
        if given not in allowed:
            raise BadValue(field, given, f"must be one of {', '.join(allowed)}")
        return given
    if item.type == "text":
        if not isinstance(given, str) or len(given) > item.max_length:
            raise BadValue(field, None, f"must be a text of at most {item.max_length} characters")
        return given
    if isinstance(given, str) and given.strip().lstrip("-").isdigit() and len(given) < 12:
        given = int(given)
    if isinstance(given, bool) or not isinstance(given, int):
        raise BadValue(field, given, "must be a whole number")
    low, high = (1, item.points) if item.type == "scale" else (item.min, item.max)
    if (low is not None and given < low) or (high is not None and given > high):
        raise BadValue(field, given, f"must be a whole number from {low} to {high}")
    return given

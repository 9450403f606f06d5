"""Checks what participants send: is this value an answer to this step? Storing it is the machine's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from backend.study.grammar.questionnaires import Item, Questionnaire
from backend.study.grammar.skipping import Earlier, is_asked
from backend.study.grammar.words import DRAWN_KINDS, SINGLE_KINDS
from backend.study.protocol.freezing import FrozenProtocol
from backend.study.refusals import Refused

LARGEST_NUMBER = 10**12  # ours; beyond 2^53 no table holds it exactly, and beyond 10^308 none holds it at all
CONFIRMED = ("information", "instruction", "break", "wait", "appointment", "debriefing")  # read, nothing to answer


class BadValue(Refused):
    """A value that is no answer; names the field and what would work."""

    def __init__(self, field: str, value: Any, message: str) -> None:
        super().__init__(422, "bad_value", message, field=field, value=value)


def timed_out(value: Mapping[str, Any]) -> bool:
    """Whether the page says that the protocol's time for the step was over."""
    return value.get("timed_out") is True


def checked_value(
    frozen: FrozenProtocol, step: dict[str, Any], value: Any, earlier: Earlier | None = None
) -> dict[str, Any]:
    """The answer to store for a step. earlier: answers by which items are left out. Raises BadValue."""
    if not isinstance(value, dict):
        raise BadValue("value", value, "must be an object")
    kind = step["kind"]
    if kind in (*CONFIRMED, *SINGLE_KINDS):
        return {}
    if kind == "trial" and timed_out(value) and "choice_limit_s" in step.get("viewing", {}):
        return {"timed_out": True}
    if kind in ("trial", "comparison", "guess", "attention"):
        if value.get("choice") not in ("a", "b"):
            raise BadValue("value.choice", value.get("choice"), "must be 'a' or 'b'")
        if kind == "attention":
            instructed = step["instructed"]
            return {"choice": value["choice"], "instructed": instructed, "passed": value["choice"] == instructed}
        return {"choice": value["choice"]}
    if kind in DRAWN_KINDS:
        return _drawing(step, value)
    if kind == "consent":
        return _consent(frozen, value)
    questionnaire = frozen.questionnaires[step["questionnaire"]]
    over = timed_out(value) and step.get("time_limit_s") is not None
    given = {key: answer for key, answer in value.items() if key != "timed_out"}
    answers = _answers(questionnaire, given, earlier, over=over)
    if kind == "comprehension":
        checks = [one for one in questionnaire.items if one.correct is not None and is_asked(one, answers, earlier)]
        answers["passed"] = all(str(answers.get(item.key)) == item.correct for item in checks)
    told = [one for one in questionnaire.items if one.instructed is not None and one.key in answers]
    if told:  # attention checks: marked, never refused
        answers["passed"] = answers.get("passed", True) and all(str(answers[one.key]) == one.instructed for one in told)
    return answers | ({"timed_out": True} if over else {})


def _drawing(step: dict[str, Any], value: dict[str, Any]) -> dict[str, Any]:
    """Which stroke is kept, or that a further path is not wanted."""
    if value.get("skipped") is True and step["optional"]:
        return {"skipped": True}
    if not isinstance(value.get("stroke"), str):
        raise BadValue("value.stroke", value.get("stroke"), "must be the id of the stroke that is kept")
    return {"stroke": value["stroke"][:32]}


def _consent(frozen: FrozenProtocol, value: dict[str, Any]) -> dict[str, Any]:
    version, asked = frozen.consent.version, frozen.consent.purposes
    if value.get("given") is not True:
        raise BadValue("value.given", value.get("given"), "must be true; who does not agree leaves the study")
    if str(value.get("version", version)) != version:
        raise BadValue("value.version", value.get("version"), f"must be {version}, the version that was shown")
    purposes = value.get("purposes") or {}
    if not isinstance(purposes, dict) or not set(purposes) <= set(asked):
        raise BadValue("value.purposes", None, f"must be an object with true or false for {', '.join(asked) or 'none'}")
    # what was not ticked was not agreed to
    agreed = {"purposes": {key: purposes.get(key) is True for key in asked}} if asked else {}
    return {"given": True, "version": version, **agreed}


def _answers(
    questionnaire: Questionnaire, value: dict[str, Any], earlier: Earlier | None, *, over: bool
) -> dict[str, Any]:
    """The answers by item. over: the time was over, so what is missing is left out instead of asked for."""
    known = {item.key: item for item in questionnaire.items}
    for key in value:
        if key not in known:
            raise BadValue(f"value.{key}", value[key], f"is no item of this questionnaire; items: {', '.join(known)}")
    answers: dict[str, Any] = {}
    for key, item in known.items():
        if not is_asked(item, answers, earlier):
            if value.get(key) not in (None, "", []):
                raise BadValue(f"value.{key}", None, "is not asked after the other answers")
        elif value.get(key) not in (None, "", []):
            answers[key] = _item(item, value[key])
        elif item.required and not over:
            raise BadValue(f"value.{key}", None, "has no answer yet")
    return answers


def _item(item: Item, given: Any) -> Any:
    field = f"value.{item.key}"
    allowed = [option.value for option in item.options]
    if item.type == "choice":
        if given not in allowed:
            raise BadValue(field, given, f"must be one of {', '.join(allowed)}")
        return given
    if item.type == "ranking":
        if not isinstance(given, list) or sorted(map(str, given)) != sorted(allowed):
            raise BadValue(
                field, str(given)[:200], f"must be a list of all of {', '.join(allowed)}, best first, no ties"
            )
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
    low, high = -LARGEST_NUMBER if low is None else low, LARGEST_NUMBER if high is None else high
    if not low <= given <= high:
        raise BadValue(field, str(given)[:40], f"must be a whole number from {low} to {high}")
    return given

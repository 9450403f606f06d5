"""Pydantic's errors in words: for who wrote a file where it stands, what is allowed and what was meant, for who sent
JSON what would have worked.
"""

from __future__ import annotations

import difflib
import re
import types
import typing
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from backend.grammar import source as yaml_source
from backend.grammar.parts import PATTERNS
from backend.grammar.source import ProtocolError, Source

M = TypeVar("M", bound=BaseModel)


def parsed(source: Source, model: type[M]) -> M:
    """The file as that model. Raises ProtocolError with every problem."""
    try:
        return model.model_validate(source.data)
    except ValidationError as wrong:
        problems = [
            source.problem(_in_file(error["loc"]), _in_words(error, model))
            for error in wrong.errors(include_url=False, include_context=True)
        ]
        raise ProtocolError(problems) from None


def _in_file(location: tuple[int | str, ...]) -> yaml_source.Path:
    return tuple(part for part in location if not str(part).startswith("function-"))


def _in_words(error: Any, model: type[BaseModel]) -> str:
    context: dict[str, Any] = error.get("ctx", {})
    given = error.get("input")
    match error["type"]:
        case "missing":
            return "is missing"
        case "extra_forbidden":
            allowed = _allowed_keys(model, error["loc"][:-1])
            return f"is not a key that is known here; allowed: {', '.join(allowed)}{meant(error['loc'][-1], allowed)}"
        case "literal_error":
            allowed = [word.strip("' ") for word in context["expected"].replace(" or ", ", ").split(",")]
            if len(allowed) == 1:
                return f"must be {allowed[0]}, the only value there is"
            return f"must be one of {', '.join(allowed)}{meant(given, allowed)}"
        case "greater_than_equal":
            return f"must be at least {context['ge']}"
        case "less_than_equal":
            return f"must be at most {context['le']}"
        case "too_short" | "string_too_short":
            return "must not be empty"
        case "int_parsing" | "int_type" | "int_from_float":
            return "must be a whole number"
        case "string_pattern_mismatch":
            return PATTERNS[context["pattern"]]
        case "value_error":
            return str(context["error"])
        case "model_type" | "dict_type" | "model_attributes_type":
            return "must be a mapping of keys to values"
    said: str = error["msg"]
    return said[0].lower() + said[1:]


def wanted_in_json(error: Any) -> str:
    """What a value in JSON would have to be, of one of Pydantic's errors."""
    if error["type"] == "missing":
        return "must be given"
    said = re.sub(r"^(Input|String|List|Value|Dictionary|Number|Tuple) should", "must", str(error["msg"]))
    return said.removeprefix("Value error, ").replace("a valid dictionary", "an object")


def meant(given: object, allowed: list[str]) -> str:
    """ "; did you mean X?", or nothing where nothing is close."""
    close = difflib.get_close_matches(str(given), allowed, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def _allowed_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    here: type[BaseModel] = model
    for part in location:
        if isinstance(part, int):
            continue
        fields = {field.alias or name: field for name, field in here.model_fields.items()}
        inner = _model_in(fields[part].annotation) if part in fields else None
        if inner is None:
            break
        here = inner
    return [field.alias or name for name, field in here.model_fields.items()]


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (list, tuple, typing.Union, types.UnionType, typing.Annotated):
        for inner in typing.get_args(annotation):
            found = _model_in(inner)
            if found:
                return found
    return None

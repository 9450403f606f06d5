"""Pydantic's errors in words: for who wrote a file where it stands, what is allowed and what was meant, for who sent
JSON what would have worked.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from functools import lru_cache
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from desirepath.grammar import source as yaml_source
from desirepath.grammar.parts import PATTERNS
from desirepath.grammar.source import Problem, ProtocolError, Source

M = TypeVar("M", bound=BaseModel)
Schema = dict[str, Any]
MOST_PROBLEMS = 200  # of a file (ours); nobody reads more


def parse(source: Source, model: type[M], *, strict: bool = True) -> M:
    """The file as that model. Raises ProtocolError with every problem. strict: a number in quotes is none, nor is `yes`
    true; otherwise they are, as in files of before."""
    parsed, problems = read_as(source, model, strict=strict)
    if parsed is None or problems:
        raise ProtocolError(problems)
    return parsed


def read_as(source: Source, model: type[M], *, strict: bool = True) -> tuple[M | None, list[Problem]]:
    """The same with its problems; None where the model cannot be made of it. `source.data` then has numbers that stand
    for a text as they were written: a version 1.10 stays 1.10."""
    for again in (True, False):
        try:
            return model.model_validate_json(json.dumps(source.data), strict=strict), source.twice
        except ValidationError as wrong:
            errors = [
                (_in_file(error["loc"], source), error)
                for error in wrong.errors(include_url=False, include_context=True)
            ]
        texts = {path: source.written(path) for path, error in errors if error["type"] == "string_type"}
        if not (again and any(text is not None for text in texts.values())):
            break
        source.data = json.loads(json.dumps(source.data))  # what an alias shares may be a text here and a number there
        for path, text in texts.items():
            if text is not None:
                source.value(path[:-1])[path[-1]] = text
    return None, source.twice + [
        source.problem(path, _in_words(error, path, model)) for path, error in errors[:MOST_PROBLEMS]
    ]


def _in_file(location: tuple[int | str, ...], source: Source) -> yaml_source.Path:
    """Where in the file an error stands; validators may have put a list around what stands alone there."""
    path: yaml_source.Path = ()
    for part in location:
        here = source.value(path)
        wrapped = isinstance(here, dict) if isinstance(part, int) else isinstance(here, list)
        if not (wrapped or str(part).startswith("function-")):
            path = (*path, part)
    return path


def _in_words(error: Any, path: yaml_source.Path, model: type[BaseModel]) -> str:
    context: dict[str, Any] = error.get("ctx", {})
    given = error.get("input")
    match error["type"]:
        case "missing":
            return "is missing"
        case "extra_forbidden" | "unexpected_keyword_argument":
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
            return f"must be a whole number{_without_quotes(given)}"
        case "float_parsing" | "float_type":
            return f"must be a number{_without_quotes(given)}"
        case "bool_parsing" | "bool_type":
            return "must be true or false, without quotes"
        case "string_type" if given is None:
            return f"must be text, is empty; if the word is meant, write it in quotes: {_form(path, 'null')}"
        case "string_type":
            return f"must be text, such as {_form(path, '...')}"
        case "list_type" | "tuple_type":
            example = example_in(schema_at(model, error["loc"]), schema_of(model))
            return f"must be a list, such as {_form(path, example if isinstance(given, dict) else [given])}"
        case "string_pattern_mismatch":
            return PATTERNS[context["pattern"]]
        case "value_error":
            return str(context["error"])
        case "model_type" | "dataclass_type" | "dict_type" | "model_attributes_type":
            example = example_in(schema_at(model, error["loc"]), schema_of(model), given)
            return f"must be a mapping of keys to values, such as {_form(path, example)}"
    message: str = error["msg"]
    return message[0].lower() + message[1:]


def describe_expected_json(error: Any) -> str:
    """What a value in JSON would have to be, of one of Pydantic's errors."""
    if error["type"] == "missing":
        return "must be given"
    message = re.sub(r"^(Input|String|List|Value|Dictionary|Number|Tuple) should", "must", str(error["msg"]))
    return message.removeprefix("Value error, ").replace("a valid dictionary", "an object")


def _without_quotes(given: object) -> str:
    """What is asked of a number that was written as a text."""
    return ", without quotes" if isinstance(given, str) and re.fullmatch(r"[-+0-9.]{1,40}", given) else ""


def meant(given: object, allowed: list[str]) -> str:
    """ "; did you mean X?", or nothing where nothing is close."""
    close = difflib.get_close_matches(str(given), allowed, n=1)
    return f"; did you mean {close[0]}?" if close else ""


# ---- what a model allows -------------------------------------------------------------------------------------------


@lru_cache
def schema_of(model: type[BaseModel]) -> Schema:
    return model.model_json_schema(by_alias=True)


def variants(schema: Schema, whole: Schema) -> list[Schema]:
    """What may stand there, references followed, without null."""
    if "$ref" in schema:
        return variants(whole["$defs"][schema["$ref"].rpartition("/")[2]], whole)
    several = schema.get("anyOf") or schema.get("oneOf") or ([schema] if schema.get("type") != "null" else [])
    return several if several == [schema] else [variant for inner in several for variant in variants(inner, whole)]


def schema_at(model: type[BaseModel], location: tuple[int | str, ...]) -> Schema:
    """Of the deepest part of a location that the model knows."""
    whole = here = schema_of(model)
    for part in location:
        for variant in variants(here, whole):
            inner = variant.get("items") if isinstance(part, int) else variant.get("properties", {}).get(part)
            inner = inner or (variant.get("additionalProperties") or None if isinstance(part, str) else None)
            if inner:
                here = inner
                break
    return here


def _allowed_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    known = variants(schema_at(model, location), schema_of(model))
    return [key for variant in known for key in variant.get("properties", {})]


_BY_PATTERN = dict(zip(PATTERNS, ("a_name", "random", "https://example.org", "en"), strict=True))


def example_in(schema: Schema, whole: Schema, given: object = None) -> Any:
    """A value that would do. given: a text that stands there; the first text that is needed is that."""
    variant = (variants(schema, whole) or [{}])[0]
    if isinstance(given, str) and variant.get("type") == "string" and "pattern" not in variant:
        return given
    if "examples" in variant:
        return variant["examples"][0]
    match variant.get("const", (variant.get("enum") or [None])[0]), variant.get("type"):
        case None, "object" if "properties" in variant:
            fields = variant["properties"]
            explicit = [key for key, of in fields.items() if of.get("default") is not None]
            needed = variant.get("required") or explicit[:1] or list(fields)[:1]
            return {
                key: fields[key].get("default") or example_in(fields[key], whole, given if key == needed[0] else None)
                for key in needed
            }
        case None, "object":
            of = variant.get("additionalProperties") or {}
            return {"en" if of.get("type") == "string" else "a_name": example_in(of, whole)}
        case None, "array":
            return [example_in(variant.get("items", {}), whole)] * max(variant.get("minItems", 1), 1)
        case None, "integer" | "number":
            return variant.get("minimum", 1)
        case None, "boolean":
            return True
        case None, _:
            return _BY_PATTERN.get(variant.get("pattern", ""), "...")
        case word, _:
            return word


def example_of(model: type[BaseModel]) -> Any:
    """What a mapping that is this model may hold."""
    return example_in(schema_of(model), schema_of(model))


def _form(path: yaml_source.Path, value: Any) -> str:
    """How a field with that value is written."""
    name = next((part for part in reversed(path) if isinstance(part, str)), None)
    value = [value] if path and isinstance(path[-1], int) else value
    return _in_yaml(value if name is None else {name: value}).removeprefix("{").removesuffix("}")


def _in_yaml(value: Any) -> str:
    return str(
        yaml.safe_dump(value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=math.inf)
    ).strip()

"""A protocol as forms: its stages in order, each with fields by its published JSON Schema and what its YAML says there.

Nothing is changed here (`grammar/editing.py`), no route lives here (`protocol_editor.py`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import ValidationError

from desirepath.grammar.error_words import Schema, example_in, schema_of, variants
from desirepath.grammar.source import Path, Problem, Source
from desirepath.study.protocol.schema import Protocol
from desirepath.study.protocol.stages import STAGES, StageEntry
from desirepath.study.steps import PACE

Kind = Literal["text", "number", "choice", "flag", "several", "words", "localized", "group", "list", "yaml"]
Suggested = Mapping[str, Sequence[str]]
"""Key -> what there is to name under it: texts, questionnaires, query sets."""
SECTIONS = ("title", "languages", "query_set", "minutes", "participants")
"""Of the protocol itself, what is shown first; the other keys are below."""
_AT = re.compile(r"stages\[(\d+)\]")


@dataclass(frozen=True)
class FormField:
    """One key of a mapping, or one item of a list. given: it stands in the YAML; needed: it has to. options: of a
    choice, or what may be added to a list; fields: of a group; one per language; one per item of a list."""

    name: str
    path: Path
    kind: Kind
    value: Any = None
    given: bool = False
    needed: bool = False
    default: Any = None
    options: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None
    whole: bool = False
    longest: int | None = None
    fields: tuple[FormField, ...] = ()

    @property
    def first(self) -> bool:
        """Whether it is shown at once."""
        return self.given or self.needed


@dataclass(frozen=True)
class StageForm:
    """One entry of `stages`. kind: None where it is no stage that there is; seconds: None where it is not valid."""

    index: int
    kind: str | None
    line: int
    fields: tuple[FormField, ...]
    problems: tuple[Problem, ...]
    seconds: float | None

    @property
    def about(self) -> str:
        """What it is about in a word: the first text of its fields."""
        return next((str(field.value) for field in self.fields if field.kind in ("text", "choice") and field.given), "")


def stage_forms(source: Source, problems: Sequence[Problem], suggested: Suggested) -> list[StageForm]:
    """A form per stage. problems: of the whole file."""
    given = source.data.get("stages")
    entries = given if isinstance(given, list) else []
    valid = [_valid(entry) for entry in entries]
    stages = [entry.stage for entry in valid if entry is not None]
    forms = []
    for index, (written, entry) in enumerate(zip(entries, valid, strict=True)):
        path: Path = ("stages", index)
        kind = next((key for key in written if key in STAGES), None) if isinstance(written, dict) else None
        own = [problem for problem in problems if (at := _AT.match(problem.field)) and int(at[1]) == index]
        fields = _Forms(source, suggested).stage(path, kind) if kind else ()
        seconds = entry.stage.seconds(PACE, stages) if entry is not None else None
        forms.append(StageForm(index, kind, source.line(path), fields, tuple(own), seconds))
    return forms


def protocol_form(source: Source, suggested: Suggested) -> tuple[FormField, ...]:
    """What stands beside the stages."""
    forms = _Forms(source, suggested)
    fields = {field.name: field for field in forms.fields(schema_of(Protocol), ()) if field.name != "stages"}
    return (*(fields.pop(name) for name in SECTIONS), *fields.values())


def example_at(path: Path, kind: str | None, languages: Sequence[str]) -> Any:
    """What may be added to the list at `path`: of entries that are one of several things, that `kind`. Raises KeyError
    where there is no such list."""
    whole = here = schema_of(Protocol)
    for part in (*path, 0):
        found = None
        for variant in variants(here, whole):
            inner = variant.get("items") if isinstance(part, int) else variant.get("properties", {}).get(part)
            found = found or inner
        if not found:
            raise KeyError(part)
        here = found
    (variant,) = variants(here, whole)
    if kind in _one_of(variant):
        (inner,) = variants(variant["properties"][kind], whole)
        written = example_in(inner, whole)
        value = {kind: {key: written[key] for key in inner["properties"] if key in written}}  # a schema sorts examples
    else:
        value = example_in(here, whole)
    return _in_languages(value, languages)


def _in_languages(value: Any, languages: Sequence[str]) -> Any:
    """Texts per language in those that the protocol has."""
    if isinstance(value, list):
        return [_in_languages(inner, languages) for inner in value]
    if not isinstance(value, dict):
        return value
    if languages and value.keys() <= {"en", "de"} and value:
        text = value.get("en", next(iter(value.values())))
        return {language: value.get(language, text) for language in languages}
    return {key: _in_languages(inner, languages) for key, inner in value.items()}


def _valid(entry: Any) -> StageEntry | None:
    try:
        return StageEntry.model_validate(entry)
    except (ValidationError, RecursionError):
        return None


def _one_of(schema: Schema) -> list[str]:
    """The keys of an entry that is one of several things, `when` apart; none of other mappings."""
    keys = {key: of for key, of in schema.get("properties", {}).items() if key != "when"}
    single = keys and all(of.get("default", "") is None and "$ref" in str(of) for of in keys.values())
    return [*keys] if single else []


class _Forms:
    """Fields of one YAML file."""

    def __init__(self, source: Source, suggested: Suggested) -> None:
        self.source, self.suggested = source, suggested
        self.whole = schema_of(Protocol)
        languages = source.data.get("languages")
        self.languages = [str(code) for code in languages] if isinstance(languages, list) else []

    def stage(self, path: Path, kind: str) -> tuple[FormField, ...]:
        (entry,) = variants(self.whole["properties"]["stages"]["items"], self.whole)
        (schema,) = variants(entry["properties"][kind], self.whole)
        own = [*self.fields(schema, (*path, kind))]
        if not STAGES[kind].for_everybody:
            own.append(self.field("when", entry["properties"]["when"], (*path, "when"), needed=False))
        return tuple(own)

    def fields(self, schema: Schema, path: Path) -> Iterator[FormField]:
        needed = schema.get("required", ())
        for name, of in schema.get("properties", {}).items():
            yield self.field(name, of, (*path, name), needed=name in needed)

    def field(self, name: str, schema: Schema, path: Path, *, needed: bool) -> FormField:
        value, written = self.source.value(path), self.source.written(path)
        parent = self.source.value(path[:-1])
        given = isinstance(parent, list) or (isinstance(parent, dict) and path[-1] in parent and value is not None)
        common: dict[str, Any] = {"name": name, "path": path, "given": given, "needed": needed}
        common["default"] = schema.get("default")
        several = variants(schema, self.whole)
        of = several[0] if len(several) == 1 else {}
        words = of.get("enum") or ([of["const"]] if "const" in of else None)
        options = self.suggested.get(name)
        match of.get("type"):
            case "boolean":
                return FormField(kind="flag", value=value, **common)
            case "integer" | "number" if not isinstance(value, dict | list):
                low, high = of.get("minimum", of.get("exclusiveMinimum")), of.get("maximum")
                whole = of["type"] == "integer"
                return FormField(kind="number", value=value, low=low, high=high, whole=whole, **common)
            case _ if words and not isinstance(value, dict | list):
                return FormField(kind="choice", value=value, options=tuple(map(str, words)), **common)
            case "string" if options and not isinstance(value, dict | list):
                there = dict.fromkeys([*options, *([str(value)] if given else [])])
                return FormField(kind="choice", value=written or value, options=tuple(there), **common)
            case "string" if not isinstance(value, dict | list):
                return FormField(kind="text", value=written or value, longest=of.get("maxLength"), **common)
            case "object" if "properties" in of and (value is None or isinstance(value, dict)):
                return FormField(kind="group", fields=tuple(self.fields(of, path)), **common)
            case "object" if self._is_localized(of) and (value is None or isinstance(value, dict)):
                texts = (
                    FormField(code, (*path, code), "text", (value or {}).get(code), code in (value or {}), needed)
                    for code in dict.fromkeys([*self.languages, *(value or {})])
                )
                return FormField(kind="localized", fields=tuple(texts), **common)
            case "array" if value is None or isinstance(value, list):
                return self._list(of, path, value or [], common)
        return FormField(kind="yaml", **common)

    def _list(self, schema: Schema, path: Path, value: list[Any], common: dict[str, Any]) -> FormField:
        items = variants(schema.get("items", {}), self.whole)
        of = items[0] if len(items) == 1 else {}
        if "enum" in of:
            return FormField(kind="several", value=value, options=tuple(map(str, of["enum"])), **common)
        if of.get("type") in ("string", "integer", "number") and all(isinstance(one, str | int) for one in value):
            return FormField(kind="words", value=", ".join(map(str, value)), **common)
        if "properties" in of:
            return FormField(
                kind="list", options=tuple(_one_of(of)), fields=tuple(self._items(of, path, value)), **common
            )
        return FormField(kind="yaml", **common)

    def _items(self, schema: Schema, path: Path, value: list[Any]) -> Iterator[FormField]:
        kinds = _one_of(schema)
        for index, one in enumerate(value):
            here, kind = (
                (*path, index),
                next((key for key in one if key in kinds), None) if isinstance(one, dict) else None,
            )
            if kind is not None:
                (inner,) = variants(schema["properties"][kind], self.whole)
                yield FormField(kind, here, "group", given=True, fields=tuple(self.fields(inner, (*here, kind))))
            elif isinstance(one, dict) and not kinds:
                yield FormField("", here, "group", given=True, fields=tuple(self.fields(schema, here)))
            else:
                yield FormField("", here, "yaml", given=True)

    @staticmethod
    def _is_localized(schema: Schema) -> bool:
        more = schema.get("additionalProperties")
        return isinstance(more, dict) and more.get("type") == "string" and "propertyNames" not in schema

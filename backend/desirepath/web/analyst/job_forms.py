"""Forms made from a kind of job's parameters: which fields there are, what was typed, what is wrong with it."""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from sqlalchemy import select
from sqlalchemy.orm import Session
from starlette.datastructures import FormData

from desirepath.grammar.parts import OneOf
from desirepath.jobs.alignment import RECIPE
from desirepath.jobs.kinds import JobParamsError, Kind
from desirepath.store.artefact_upkeep import is_offered
from desirepath.store.models import Artefact
from desirepath.web.core.permits import seen_artefacts
from desirepath.web.core.roles import Right, Rights

EXPLAINED_PROBLEMS = {
    "missing": "missing",
    "string_too_short": "missing",
    "too_short": "too_few",
    "too_long": "too_many",
    "int_parsing": "whole_number",
    "int_from_float": "whole_number",
    "float_parsing": "number",
    "greater_than_equal": "at_least",
    "greater_than": "above",
    "less_than_equal": "at_most",
    "less_than": "below",
    "literal_error": "choice",
    "setups": "setups",
    "opposites": "opposites",
}


@dataclass(frozen=True)
class FormField:
    """One field as the template draws it. control: number, choice, artefact, artefacts or weights."""

    name: str
    control: str
    value: Any
    default: Any
    source: str
    required: bool
    advanced: bool
    choices: tuple[str, ...] = ()
    artefacts: tuple[Artefact, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    step: str = "any"
    problem: str | None = None  # a key below `problems` in analyst.yaml
    problem_values: Mapping[str, Any] = field(default_factory=dict)


def form_fields(
    s: Session, kind: Kind, values: Mapping[str, Any], rights: Rights, wrong: JobParamsError | None = None
) -> list[FormField]:
    """The fields of a kind (of the algorithm that `values` name), filled with `values` (else the defaults), with what
    is wrong at each. Nothing is asked that has only one answer, nothing offered that `rights` keep from a job."""
    setup = _setup_of(s, kind, values)
    problems = {problem["field"].split(".")[0]: problem for problem in wrong.problems} if wrong else {}
    fields = kind.model_for(values).model_fields.items()
    return [
        _field(s, rights, name, info, values.get(name), problems.get(name), setup)
        for name, info in fields
        if not _is_given(info)
    ]


def read_values(kind: Kind, form: FormData) -> dict[str, Any]:
    """What was typed, blank fields left out, so that their defaults hold."""
    values: dict[str, Any] = {}
    algorithm = {RECIPE: str(form[RECIPE])} if form.get(RECIPE) else {}
    for name, info in kind.model_for(algorithm).model_fields.items():
        if _is_many(info):
            values[name] = [str(value) for value in form.getlist(name) if value]
        elif str(form.get(name) or "").strip():
            values[name] = str(form[name]).strip()
    return {**values, **algorithm}


def _field(
    s: Session,
    rights: Rights,
    name: str,
    info: FieldInfo,
    value: Any,
    wrong: Mapping[str, Any] | None,
    of: tuple[str, str] | None,
) -> FormField:
    extra = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
    default = None if info.is_required() else info.get_default()
    inner = _without_none(info.annotation)
    artefact_kind = str(extra.get("artefact", ""))
    shown = default if value is None else value
    choices = _choices(inner, info.metadata)
    limits = {
        bound: float(getattr(rule, bound)) for rule in info.metadata for bound in ("ge", "gt", "le", "lt")
        if hasattr(rule, bound)
    }  # fmt: skip
    control = "number"
    artefacts: tuple[Artefact, ...] = ()
    if artefact_kind:
        control = "artefacts" if _is_many(info) else "artefact"
        artefacts = tuple(_usable(s, rights, artefact_kind))
        if of is not None and of[0] != name:
            artefacts = tuple(artefact for artefact in artefacts if artefact.setup == of[1])
        shown = _as_ids(artefacts, shown)
    elif choices:
        control = "choice"
    elif "weights_of" in extra:
        control = "weights"
    problem = wrong["type"] if wrong else None
    return FormField(
        name=name,
        control=control,
        value=shown,
        default=default,
        source=str(extra["source"]),
        required=info.is_required(),
        advanced=bool(extra.get("advanced")) and wrong is None,
        choices=choices,
        artefacts=artefacts,
        limits=limits,
        step="1" if inner is int else "any",
        problem=EXPLAINED_PROBLEMS.get(problem, "other") if problem else None,
        problem_values=_explained(wrong) if wrong else {},
    )


def _explained(wrong: Mapping[str, Any]) -> dict[str, Any]:
    limits = dict(wrong.get("limits", {}))
    bounds = ("ge", "gt", "le", "lt", "min_length", "max_length")
    limit = next((limits[bound] for bound in bounds if bound in limits), "")
    return {
        "value": wrong["value"],
        "limit": limit,
        "expected": limits.get("expected", ""),
        "message": wrong["message"],
    }


def _setup_of(s: Session, kind: Kind, values: Mapping[str, Any]) -> tuple[str, str] | None:
    """(field, setup) of the first artefact that is chosen: what else is offered has to fit it. None: nothing yet."""
    for name, info in kind.model_for(values).model_fields.items():
        given = values.get(name)
        if isinstance(info.json_schema_extra, dict) and "artefact" in info.json_schema_extra and given:
            first = s.get(Artefact, str(given[0] if isinstance(given, list | tuple) else given))
            return (name, first.setup) if first is not None else None
    return None


def _usable(s: Session, rights: Rights, kind: str) -> Sequence[Artefact]:
    """Artefacts that a new job may work on: shipped ones first, then the newest."""
    rows = select(Artefact).where(
        Artefact.kind.in_(kind.split("|")), is_offered(), seen_artefacts(rights, Right.ANALYSE)
    )
    found = list(s.scalars(rows.order_by(Artefact.created_at.desc())))
    return sorted(found, key=lambda one: (one.job_id is not None, one.name if one.job_id is None else ""))


def _as_ids(artefacts: Sequence[Artefact], given: Any) -> Any:
    """Names of shipped artefacts become the ids that the lists offer."""
    id_of = {artefact.name: artefact.id for artefact in artefacts if artefact.job_id is None}
    if isinstance(given, list | tuple):
        return [id_of.get(named, named) for named in given]
    return id_of.get(given, given)


def _choices(annotation: Any, metadata: Sequence[Any]) -> tuple[str, ...]:
    """The names that a field takes, of those that are one of some."""
    if get_origin(annotation) is Literal:
        return tuple(get_args(annotation))
    rules = (*metadata, *getattr(annotation, "__metadata__", ()))
    return tuple(name for rule in rules if isinstance(rule, OneOf) for name in rule.names())


def _without_none(annotation: Any) -> Any:
    if get_origin(annotation) in (Union, types.UnionType):
        return next(arg for arg in get_args(annotation) if arg is not type(None))
    return annotation


def _is_given(info: FieldInfo) -> bool:
    return get_origin(info.annotation) is Literal and len(get_args(info.annotation)) == 1


def _is_many(info: FieldInfo) -> bool:
    return get_origin(_without_none(info.annotation)) is tuple

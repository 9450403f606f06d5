"""What the fields of a configuration class say of themselves, for whatever offers them: options of commands, forms."""

from __future__ import annotations

from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_type_hints

from annotated_types import Ge, Le
from pydantic import BaseModel
from pydantic.fields import FieldInfo


def read_fields(made: type[Any]) -> dict[str, FieldInfo]:
    """Type, default, limits and description of each field of a Pydantic model or a dataclass, whose fields give the
    last two as `Annotated[float, Field(ge=0, description="...")]`. Raises TypeError for another class."""
    if issubclass(made, BaseModel):
        return made.model_fields
    if not is_dataclass(made):
        raise TypeError(f"{made!r} is neither a dataclass nor a Pydantic model")
    hints = get_type_hints(made, include_extras=True)
    described = {}
    for item in fields(made):
        default = item.default if item.default_factory is MISSING else item.default_factory()
        missing = default is MISSING
        hint = hints[item.name]
        described[item.name] = (
            FieldInfo.from_annotation(hint) if missing else FieldInfo.from_annotated_attribute(hint, default)
        )
    return described


def limits_of(field: FieldInfo) -> tuple[Any, Any]:
    """The least and the largest number that it takes; None where it names none."""
    least = [bound.ge for bound in field.metadata if isinstance(bound, Ge)]
    most = [bound.le for bound in field.metadata if isinstance(bound, Le)]
    return least[0] if least else None, most[0] if most else None

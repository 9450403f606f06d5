"""The contract's part that the kinds of step make: the current step as it is told, an answer as it is sent.

Both are unions discriminated by `kind`, put together of what each kind says (`study/kinds`); no kind is named here.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import ConfigDict, Field, GetJsonSchemaHandler, TypeAdapter, create_model
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema
from typing_extensions import TypeAliasType

from desirepath.study.kind import KINDS, Kind
from desirepath.web.core.contract import AnswerValue, Clock, Reply, Sent

RequestId = Annotated[
    str, Field(min_length=8, max_length=64, description="another one per answer; the same again counts once")
]


class StepReply(Reply):
    """The current step without its texts. Simulated sessions are told more, as bots read no pages."""

    model_config = ConfigDict(extra="forbid")

    key: str
    kind: str
    index: int = Field(description="counted from 0 over the steps that this person meets in this appointment")
    total: int = Field(description="how many these will be, as far as it is known")
    trial: Any = None
    block: str | None = Field(None, description="simulated sessions: the condition")
    view: str | None = Field(None, description="simulated sessions: the condition's")


class StandingStill(StepReply):
    """What the page shows instead of a step of the plan."""

    kind: Literal["paused", "withdrawn", "expired", "screened_out", "too_soon"]
    trial: None


def _named(kind: Kind[Any, Any]) -> str:
    return "".join(part.capitalize() for part in kind.name.split("_"))


def _step(kind: Kind[Any, Any]) -> Any:
    progress: Any = kind.progress_model
    name: Any = Literal[kind.name]
    bases: Any = (kind.besides, StepReply)
    return create_model(
        f"{_named(kind)}Step",
        __base__=bases,
        __doc__=f"A step of kind `{kind.name}`.",
        kind=(name, ...),
        trial=(progress | None if progress else None, ...),
    )


def _answer(kind: Kind[Any, Any]) -> Any:
    name: Any = Literal[kind.name]
    empty = not any(field.is_required() for field in kind.answers.model_fields.values())
    return create_model(
        f"{_named(kind)}AnswerSent",
        __base__=Sent,
        __doc__=f"An answer to a step of kind `{kind.name}`.",
        request_id=(RequestId, ...),
        kind=(name, kind.name),
        value=(kind.answers, {} if empty else ...),
        client_time=(Clock, None),
    )


def _union(models: Iterable[Any]) -> Any:
    return Annotated[reduce(or_, models), Field(discriminator="kind")]


_STEPS = {kind.name: _step(kind) for kind in KINDS.values()}
_ANSWERS = {kind.name: _answer(kind) for kind in KINDS.values()}
_ANY_ANSWER: TypeAdapter[Any] = TypeAdapter(_union(_ANSWERS.values()))

if TYPE_CHECKING:
    StepNow = StepReply
else:
    StepNow = TypeAliasType("StepNow", _union([*_STEPS.values(), StandingStill]))
    """Whichever step it is; its kind says what it tells."""


class AnswerSent(Sent):
    """An answer to the current step. Published as the union that it is; read by the step's own kind, which alone knows
    what may be answered there (`study/session/machine.py`)."""

    request_id: RequestId
    kind: str | None = Field(None, max_length=64)
    value: AnswerValue = {}
    client_time: Clock = None

    @classmethod
    def __get_pydantic_json_schema__(cls, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler(_ANY_ANSWER.core_schema)
        return schema | {"description": "An answer to the current step; `kind` left out means the step's own."}

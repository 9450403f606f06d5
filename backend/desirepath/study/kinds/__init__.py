"""The kinds of step, one file each: found by looking, or by an entry point of `desirepath.kinds` in another package, so
that whoever adds one touches no list.

`Step` is the union of what plans hold, discriminated by `kind`; stored plans are read with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any

from pydantic import Field, TypeAdapter

from desirepath.registries import Registry
from desirepath.study.kinds.base import Acting, BlockPart, Kind, Stage, Step

__all__ = [
    "KINDS",
    "BlockPart",
    "Kind",
    "Stage",
    "Step",
    "begin",
    "block_parts",
    "kind_of",
    "read_plan",
    "read_step",
    "stage_kinds",
    "stored",
]


REGISTRY: Registry[Kind[Any, Any]] = Registry("desirepath.kinds", __name__, "KIND")
KINDS: Mapping[str, Kind[Any, Any]] = {name: REGISTRY[name] for name in REGISTRY}
"""name -> kind, of all that there are."""
_ANY: Any = Annotated[reduce(or_, (kind.step for kind in KINDS.values())), Field(discriminator="kind")]
_STEP: TypeAdapter[Step] = TypeAdapter(_ANY)
_PLAN: TypeAdapter[list[Step]] = TypeAdapter(list[_ANY])


def kind_of(step: Step) -> Kind[Any, Any]:
    """The kind of a step."""
    return KINDS[step.kind]


def begin(then: str, acting: Acting) -> None:
    """What the answer to a step begins that says so."""
    for kind in KINDS.values():
        if then in kind.begun:
            kind.begun[then](acting)


def read_step(stored: Mapping[str, Any]) -> Step:
    """A step as plans hold it, also those that older versions made."""
    return _STEP.validate_python(stored)


def read_plan(stored: Sequence[Mapping[str, Any]]) -> list[Step]:
    """A whole plan, likewise."""
    return _PLAN.validate_python(stored)


def stored(plan: Iterable[Step]) -> list[dict[str, Any]]:
    """A plan as sessions hold it."""
    return [step.as_stored() for step in plan]


@cache
def stage_kinds() -> Mapping[str, type[Stage]]:
    """Key in the protocol's `stages` -> what it may say."""
    return {name: stage for kind in KINDS.values() for name, stage in kind.stages.items()}


@cache
def block_parts() -> Mapping[str, type[BlockPart]]:
    """Key in a block's `before`, `after` and `between` -> what it may say."""
    return {name: part for kind in KINDS.values() for name, part in kind.block_parts.items()}

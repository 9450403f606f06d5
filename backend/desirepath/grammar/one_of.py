"""Entries of a file that say exactly one of several things, named by their key: stages, a block's pages."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, TypeVar

from pydantic import Field, create_model, model_validator

from desirepath.grammar.parts import Part

P = TypeVar("P", bound="OneOf")


class OneOf(Part):
    """Base of such an entry; `with_keys` makes the model that knows the keys."""

    keys: ClassVar[tuple[str, ...]] = ()
    noun: ClassVar[str] = ""
    """What is said once: `stage`."""

    @model_validator(mode="after")
    def _exactly_one(self) -> OneOf:
        given = [key for key in self.keys if self._of(key) is not None]
        if len(given) != 1:
            what, once = " and ".join(given) or "nothing", f"one {self.noun}" if self.noun else "one"
            raise ValueError(f"must be exactly {once}, has {what}; one of {', '.join(self.keys)}")
        return self

    def _of(self, key: str) -> Any:
        return getattr(self, _field(key))

    @cached_property
    def kind(self) -> str:
        """The key that is given."""
        return next(key for key in self.keys if self._of(key) is not None)

    @property
    def said(self) -> Any:
        """What stands under it."""
        return self._of(self.kind)


def _field(key: str) -> str:
    """The field of a key; `break` is a word of Python's."""
    return key + "_" * (key == "break")


def with_keys(base: type[P], name: str, keys: Mapping[str, type[Part]]) -> type[P]:
    """`base` with one optional field per key, in their order."""
    fields: dict[str, Any] = {
        _field(key): (model | None, Field(None, alias=key if key != _field(key) else None))
        for key, model in keys.items()
    }
    made = create_model(name, __base__=base, __doc__=base.__doc__, **fields)
    made.keys = tuple(keys)
    return made

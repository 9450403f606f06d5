"""Conditions of a stage: factors that everybody meets in all combinations (`each`), or one combination of (`one_of`).

Who meets which order is `plan/counterbalancing.py`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Annotated, Literal, Protocol, Self, runtime_checkable

from pydantic import BeforeValidator, Field, model_validator

from desirepath.grammar.parts import Part, Slug
from desirepath.grammar.words import IN_HEADSET, VIEWS, View

Levels = Annotated[list[Slug], Field(min_length=2, max_length=8)]


def _as_factors(given: object) -> object:
    return {"view": given} if isinstance(given, list) else given


Factors = Annotated[dict[Slug, Levels], BeforeValidator(_as_factors), Field(min_length=1, max_length=3)]
"""factor -> its levels; a plain list stands for {view: list}. `view` is a view or `headset`, every other factor a word
of the protocol's own that names of texts may hold in braces."""


class Condition(Part):
    """One cell of a crossing: what its trials are shown in. `name` is what trials carry as `block`. worn: whether the
    immersive view is to be seen with a headset there, where conditions differ in that."""

    name: str
    view: View
    levels: dict[str, str]
    worn: bool | None = None

    @property
    def shown(self) -> dict[str, object]:
        """What its steps say of it."""
        return {"view": self.view} | ({} if self.worn is None else {"worn": self.worn})

    def filled(self, text: str) -> str:
        """A text's name with this condition's levels in place of `{view}` and the stage's other factors."""
        for factor, level in {"view": self.view, **self.levels}.items():
            text = text.replace(f"{{{factor}}}", level)
        return text


@runtime_checkable
class Ordered(Protocol):
    """What has conditions in an order: a block, ratings, or an evaluation with its three controllers."""

    @property
    def each(self) -> Mapping[str, Sequence[str]] | None: ...
    @property
    def one_of(self) -> Mapping[str, Sequence[str]] | None: ...
    @property
    def groups(self) -> list[dict[str, str]]: ...
    def conditions(self, group: int) -> list[Condition]: ...


class Crossed(Part):
    """Base of stages in one view, or with the same trials once per condition.

    view: without conditions. each: factors that every participant meets in all combinations, in the order of the
    assignment. one_of: factors of which each participant meets one combination (between participants), balanced by the
    assignment as well.
    """

    view: View | None = None
    each: Factors | None = None
    one_of: Factors | None = None

    @model_validator(mode="after")
    def _has_one_view_everywhere(self) -> Self:
        given = [
            "view" if self.view else "",
            "each" if self._varies("each") else "",
            "one_of" if self._varies("one_of") else "",
        ]
        declared = [name for name in given if name]
        if len(declared) != 1:
            listed = " and ".join(declared) or "nothing"
            raise ValueError(f"must say the view once, as 'view', in 'each' or in 'one_of'; has {listed}")
        twice = set(self.each or ()) & set(self.one_of or ())
        if twice:
            raise ValueError(f"has the factor {', '.join(sorted(twice))} in 'each' and in 'one_of'; keep one")
        for name, levels in [*(self.each or {}).items(), *(self.one_of or {}).items()]:
            if len(set(levels)) != len(levels):
                raise ValueError(f"the factor {name} has a level twice: {', '.join(levels)}")
            known = (*VIEWS, IN_HEADSET)
            if name == "view" and (wrong := [level for level in levels if level not in known]):
                raise ValueError(f"{wrong[0]!r} is no view; views: {', '.join(known)}")
        return self

    def _varies(self, where: Literal["each", "one_of"]) -> bool:
        return "view" in (getattr(self, where) or {})

    @property
    def groups(self) -> list[dict[str, str]]:
        """The combinations of `one_of`: a participant gets one of them. One empty one where there is none."""
        return _combinations(self.one_of)

    def conditions(self, group: int) -> list[Condition]:
        """What somebody of that group meets, in the order in which the protocol names them."""
        mine = self.groups[group]
        combinations = []
        for cell in _combinations(self.each):
            levels = {**cell, **mine}
            name = "-".join((cell or mine).values())
            level = levels.get("view") or self.view
            view = "immersive" if level == IN_HEADSET else level
            worn = level == IN_HEADSET if view == "immersive" and self.in_headset else None
            fields = {"name": name, "view": view, "levels": levels, "worn": worn}
            combinations.append(Condition.model_validate(fields))
        return combinations

    @property
    def in_headset(self) -> bool:
        """Whether some of its conditions are seen with a headset, and others are not."""
        return any(IN_HEADSET in (factors or {}).get("view", ()) for factors in (self.each, self.one_of))


def _combinations(factors: dict[str, list[str]] | None) -> list[dict[str, str]]:
    if not factors:
        return [{}]
    return [dict(zip(factors, cell, strict=True)) for cell in product(*factors.values())]

"""What stages of several conditions share: pages before, after and between what is asked in each of them.

What is asked there is the stage's own.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any

from desirepath.grammar.conditions import Condition
from desirepath.grammar.one_of import OneOf, with_keys
from desirepath.grammar.source import Path
from desirepath.study.kind import block_parts
from desirepath.study.steps import BlockPart, Planning, Stage, Step


class BlockEntryBase(OneOf):
    """One entry of a block's `before`, `after` or `between`: exactly one of these keys."""

    @property
    def part(self) -> BlockPart:
        part: BlockPart = self.said
        return part


if TYPE_CHECKING:
    BlockEntry = BlockEntryBase
else:
    BlockEntry = with_keys(BlockEntryBase, "BlockEntry", block_parts())

PLACES = ("before", "after", "between")


class PagesAround(Stage):
    """Base of such stages. Their fields `before`, `after` and `between` are lists of entries; they say their conditions
    (`grammar/conditions.py`) and what is asked in each."""

    @property
    @abstractmethod
    def groups(self) -> list[dict[str, str]]: ...

    @abstractmethod
    def conditions(self, group: int) -> list[Condition]: ...

    @abstractmethod
    def plan_condition(
        self, prefix: str, condition: Condition, where: Mapping[str, Any], at: Planning
    ) -> Iterable[Step]:
        """The steps of one condition, between its pages. prefix: of their keys; where: their stage, block and view."""

    def plan(self, at: Planning) -> list[Step]:
        """Condition by condition; the only one, without a name, is called as its stage."""
        steps: list[Step] = []
        for turn, condition in enumerate(at.conditions):
            prefix = f"{at.key}.{condition.name}" if condition.name else at.key
            where = {"stage": at.key, "block": condition.name or at.key, **condition.shown}
            for place in ("between", "before") if turn else ("before",):
                steps += self._pages(place, prefix, condition, where)
            steps += self.plan_condition(prefix, condition, where, at)
            steps += self._pages("after", prefix, condition, where)
        return steps

    def _pages(self, place: str, prefix: str, condition: Condition, where: Mapping[str, Any]) -> Iterator[Step]:
        for n, entry in enumerate(getattr(self, place), 1):
            yield entry.part.step(prefix, f"{place}_{n}", condition, where)

    def pages(self) -> int:
        """How many there are, over all conditions that somebody meets."""
        before, after, between = (len(getattr(self, place)) for place in PLACES)
        met = len(self.conditions(0))
        return met * (before + after) + (met - 1) * between

    def texts(self) -> Iterator[tuple[str, Path]]:
        conditions = list(chain.from_iterable(self.conditions(group) for group in range(len(self.groups))))
        for where, entry in self._entries():
            for name, field in entry.part.texts(conditions):
                yield name, (*where, field)

    def questionnaires(self) -> Iterator[tuple[str, Path]]:
        for where, entry in self._entries():
            for name, field in entry.part.questionnaires():
                yield name, (*where, field)

    def _entries(self) -> Iterator[tuple[Path, BlockEntry]]:
        for place in PLACES:
            for n, entry in enumerate(getattr(self, place)):
                yield (place, n, entry.kind), entry

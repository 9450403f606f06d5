"""The list `stages` of a protocol: one entry per stage, of any kind that there is. What each may say is its kind's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, TypeVar

from desirepath.grammar.one_of import OneOf, with_keys
from desirepath.grammar.parts import an_example
from desirepath.grammar.when import When
from desirepath.study.kind import stage_kinds
from desirepath.study.protocol.block import BlockStage
from desirepath.study.protocol.methods import MethodsStage
from desirepath.study.steps import Stage

T = TypeVar("T", bound=Stage)

_ALL: dict[str, type[Stage]] = {**stage_kinds(), "block": BlockStage, "methods": MethodsStage}
STAGES: Mapping[str, type[Stage]] = dict(sorted(_ALL.items()))
"""Key in `stages` -> what may stand under it."""


class StageEntryBase(OneOf):
    """One entry of `stages`: exactly one of these keys, and `when` if not everybody shall meet it."""

    model_config = an_example({"information": {"text": "texts/information.md"}})

    noun = "stage"

    when: When | None = None

    @property
    def stage(self) -> Stage:
        stage: Stage = self.said
        return stage


if TYPE_CHECKING:
    StageEntry = StageEntryBase
else:
    StageEntry = with_keys(StageEntryBase, "StageEntry", STAGES)


def stage_keys(stages: Iterable[StageEntry]) -> list[str]:
    """A short name for every stage, unique within the protocol; plan steps carry it as `stage`."""
    keys: list[str] = []
    for entry in stages:
        name = entry.stage.own_name() or entry.kind
        same = sum(1 for key in keys if key == name or key.startswith(f"{name}_"))
        keys.append(f"{name}_{same + 1}" if same else name)
    return keys

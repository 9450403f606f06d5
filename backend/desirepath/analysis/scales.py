"""What a validated questionnaire scale is, how it is scored, and how a reworded copy is told from it.

Which scales there are, word by word: `scale_wordings.py`; which study asks them is not known here.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any


@dataclass(frozen=True)
class ScaleItem:
    """One item, answered 1 to the scale's `points`; texts and ends by language. reversed: agreeing lowers the score."""

    key: str
    text: Mapping[str, str]
    low: Mapping[str, str]
    high: Mapping[str, str]
    reversed: bool = False


@dataclass(frozen=True)
class Scale:
    """A validated scale. `names`: what only an unchanged copy may be called. The score is `lowest` to `highest`.

    Items without texts: of a scale whose words may not be shipped; who asks it supplies them (`with_words`).
    subscales: what each measures, in words -> its items; overall: whether all items together have a score.
    """

    name: str
    names: tuple[str, ...]
    points: int
    items: tuple[ScaleItem, ...]
    lowest: float
    highest: float
    scoring: str
    source: str
    licence: str
    subscales: Mapping[str, Sequence[str]] = field(default_factory=dict)
    overall: bool = True

    @property
    def scored(self) -> tuple[Scale, ...]:
        """What has a score of its own: the scale, or each subscale, then all items together where that is a score."""
        parts = [
            replace(
                self,
                name=f"{self.name}_{words.replace(' ', '_')}",
                names=(f"{self.names[0]}: {words}",),
                items=tuple(item for item in self.items if item.key in keys),
                subscales={},
            )
            for words, keys in self.subscales.items()
        ]
        return (*parts, replace(self, subscales={})) if self.overall else tuple(parts)

    @property
    def languages(self) -> tuple[str, ...]:
        """The languages it can be asked in."""
        return tuple(self.items[0].text)

    def with_words(self, items: Sequence[ScaleItem]) -> Scale:
        """The scale with the words that somebody supplies. ValueError: items that are not built as the scale's own."""
        built = [(item.key, item.reversed) for item in self.items]
        if [(item.key, item.reversed) for item in items] != built:
            turned = [key for key, is_reversed in built if is_reversed]
            raise ValueError(
                f"{self.name} has the items {', '.join(key for key, _ in built)}, in this order"
                + (f", reversed: {', '.join(turned)}" if turned else ", none of them reversed")
            )
        return replace(self, items=tuple(items))

    def digest(self, language: str) -> str:
        """sha256 over the wording in that language: texts, ends, points, order."""
        return wording_digest(
            [(item.text[language], item.low[language], item.high[language]) for item in self.items], self.points
        )

    def score(self, answers: Mapping[str, int]) -> float:
        """The score of one person. answers: item key -> 1 to `points`. ValueError: one is missing or impossible."""
        counted = []
        for item in self.items:
            answer = answers.get(item.key)
            if answer is None or not 1 <= answer <= self.points:
                raise ValueError(f"{item.key} = {answer!r}: {self.name} needs an answer from 1 to {self.points}")
            counted.append(self.points - answer if item.reversed else answer - 1)
        share = sum(counted) / (len(counted) * (self.points - 1))
        return self.lowest + share * (self.highest - self.lowest)


def frozen_scale(frozen: str) -> Scale:
    """A scale from a study's copy of it: a `Scale` as JSON."""
    stored = json.loads(frozen)
    items = tuple(ScaleItem(**item) for item in stored.pop("items"))
    return Scale(items=items, **{**stored, "names": tuple(stored["names"])})


def frozen_items(frozen: str) -> list[dict[str, Any]]:
    """The items of a scale, as a questionnaire writes its own ones, from a study's copy of it: a `Scale` as JSON."""
    scale = json.loads(frozen)
    return [{"type": "scale", "points": scale["points"], **item} for item in scale["items"]]


def wording_digest(items: Sequence[tuple[str, str, str]], points: int) -> str:
    """sha256 over (text, low end, high end) of items in their order."""
    return hashlib.sha256(json.dumps([points, items], ensure_ascii=False).encode()).hexdigest()

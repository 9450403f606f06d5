"""Validated questionnaire scales, word by word, with their scoring and source. Which study asks them is not known here.

Only scales that are free to use, each in the languages whose wording we could check. The words are the scales' own and
are never changed: `digest` tells a reworded copy from the scale.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    """A validated scale. `names`: what only an unchanged copy may be called. The score is `lowest` to `highest`."""

    name: str
    names: tuple[str, ...]
    points: int
    items: tuple[ScaleItem, ...]
    lowest: float
    highest: float
    scoring: str
    source: str
    licence: str

    @property
    def languages(self) -> tuple[str, ...]:
        """The languages it can be asked in."""
        return tuple(self.items[0].text)

    def digest(self, language: str) -> str:
        """sha256 over the wording in that language: texts, ends, points, order."""
        return wording_digest(
            [(item.text[language], item.low[language], item.high[language]) for item in self.items], self.points
        )

    def score(self, answers: Mapping[str, int]) -> float:
        """The score of one person. answers: item key -> 1 to `points`. ValueError: one is missing or impossible."""
        counted = []
        for item in self.items:
            given = answers.get(item.key)
            if given is None or not 1 <= given <= self.points:
                raise ValueError(f"{item.key} = {given!r}: {self.name} needs an answer from 1 to {self.points}")
            counted.append(self.points - given if item.reversed else given - 1)
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


_AGREE_LOW = {"en": "Strongly disagree", "de": "Stimme überhaupt nicht zu"}
_AGREE_HIGH = {"en": "Strongly agree", "de": "Stimme voll zu"}
_SUS = (
    (
        "I think that I would like to use this system frequently.",
        "Ich kann mir sehr gut vorstellen, das System regelmäßig zu nutzen.",
    ),
    ("I found the system unnecessarily complex.", "Ich empfinde das System als unnötig komplex."),
    ("I thought the system was easy to use.", "Ich empfinde das System als einfach zu nutzen."),
    (
        "I think that I would need the support of a technical person to be able to use this system.",
        "Ich denke, dass ich technischen Support brauchen würde, um das System zu nutzen.",
    ),
    (
        "I found the various functions in this system were well integrated.",
        "Ich finde, dass die verschiedenen Funktionen des Systems gut integriert sind.",
    ),
    (
        "I thought there was too much inconsistency in this system.",
        "Ich finde, dass es im System zu viele Inkonsistenzen gibt.",
    ),
    (
        "I would imagine that most people would learn to use this system very quickly.",
        "Ich kann mir vorstellen, dass die meisten Leute das System schnell zu beherrschen lernen.",
    ),
    ("I found the system very cumbersome to use.", "Ich empfinde die Bedienung als sehr umständlich."),
    (
        "I felt very confident using the system.",
        "Ich habe mich bei der Nutzung des Systems sehr sicher gefühlt.",
    ),
    (
        "I needed to learn a lot of things before I could get going with this system.",
        "Ich musste eine Menge Dinge lernen, bevor ich mit dem System arbeiten konnte.",
    ),
)
_TLX = (
    ("mental_demand", "How mentally demanding was the task?", "Very Low", "Very High"),
    ("physical_demand", "How physically demanding was the task?", "Very Low", "Very High"),
    ("temporal_demand", "How hurried or rushed was the pace of the task?", "Very Low", "Very High"),
    (
        "performance",
        "How successful were you in accomplishing what you were asked to do?",
        "Perfect",
        "Failure",
    ),
    ("effort", "How hard did you have to work to accomplish your level of performance?", "Very Low", "Very High"),
    (
        "frustration",
        "How insecure, discouraged, irritated, stressed, and annoyed were you?",
        "Very Low",
        "Very High",
    ),
)

SCALES: dict[str, Scale] = {
    scale.name: scale
    for scale in (
        Scale(
            name="sus",
            names=("SUS", "System Usability Scale"),
            points=5,
            items=tuple(
                ScaleItem(f"sus_{n}", {"en": en, "de": de}, _AGREE_LOW, _AGREE_HIGH, reversed=n % 2 == 0)
                for n, (en, de) in enumerate(_SUS, 1)
            ),
            lowest=0.0,
            highest=100.0,
            scoring="odd items: answer - 1, even items: 5 - answer; the sum times 2.5: 0 to 100",
            source="Brooke, J. (1996). SUS: a 'quick and dirty' usability scale. In Usability Evaluation in Industry, "
            "189-194; German: Rummel, B. (2015), System Usability Scale - jetzt auch auf Deutsch",
            licence="free to use where the source is named",
        ),
        Scale(
            name="raw_tlx",
            names=("TLX", "RTLX", "NASA-TLX", "NASA TLX", "Task Load Index"),
            points=21,
            items=tuple(
                ScaleItem(f"tlx_{key}", {"en": text}, {"en": low}, {"en": high}) for key, text, low, high in _TLX
            ),
            lowest=0.0,
            highest=100.0,
            scoring="each of 21 gradations is 5 points, 0 to 100; the mean of the six, unweighted: 0 to 100",
            source="Hart, S. G. and Staveland, L. E. (1988). Development of NASA-TLX. In Human Mental Workload, "
            "139-183; unweighted: Hart, S. G. (2006), NASA-Task Load Index: 20 years later",
            licence="a work of the United States government, free to use",
        ),
    )
}

"""Sentences labelled with what is wished, objectives and directions, and how a reading of one is judged.

What the labels mean, and the command that measures a file: `tests/learning/words/measure.py`.
"""

from __future__ import annotations

import csv
import gzip
from dataclasses import dataclass
from pathlib import Path

from desirepath.learning.preferences.objectives import NAMES
from desirepath.learning.words.second_reader import Wish, one_end
from desirepath.learning.words.understanding import Understood

KINDS = ("right", "asked", "missed", "wrong_direction", "wrong_otherwise")
Wanted = frozenset[Wish]


@dataclass(frozen=True)
class Case:
    """wanted: objectives with their direction; None: it must be asked back."""

    sentence: str
    wanted: Wanted | None


def read_cases(file: Path) -> list[Case]:
    """The labelled sentences of a CSV, or of one in gzip. Raises ValueError for a label that is none."""
    with (gzip.open if file.suffix == ".gz" else open)(file, "rt", encoding="utf-8", newline="") as opened:
        return [Case(row["sentence"], _parse(row["expected"], row["sentence"])) for row in csv.DictReader(opened)]


def _parse(expected: str, sentence: str) -> Wanted | None:
    if expected.strip() == "ask":
        return None
    ends = set()
    for item in expected.split(";") if expected.strip() != "none" else []:
        name, _, direction = item.strip().partition(":")
        if name not in NAMES or direction not in ("+", "-"):
            raise ValueError(f"{sentence!r}: {item!r} is no label; it is an objective with :+ or :-, `ask` or `none`")
        ends.add(one_end(name, direction == "+"))
    return frozenset(ends)


def judge(case: Case, got: Understood) -> str:
    """One of KINDS."""
    wishes = {one_end(mark.objective, mark.wanted) for mark in got.marks if not mark.waived}
    waived = {(mark.objective, not mark.wanted) for mark in got.marks if mark.waived}
    if case.wanted is None:
        if wishes and not got.questions:
            return "wrong_otherwise"
        return "right" if got.questions else "missed"
    if ("slower_near_person", True) in case.wanted and any(question.about == "slowness" for question in got.questions):
        wishes -= {("faster", False)}  # slowness, of which it is asked back whether it is meant near the person
    opposite = {one_end(name, not wanted) for name, wanted in case.wanted}
    if wishes & opposite:
        return "wrong_direction"
    if wishes - case.wanted:
        return "wrong_otherwise"
    if case.wanted <= wishes | waived:
        only_slowness = all(question.about == "slowness" for question in got.questions)
        return "right" if only_slowness or not got.questions else "asked"
    return "asked" if got.questions else "missed"

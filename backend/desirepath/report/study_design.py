"""What a study compares: the factors of its blocks, which of them everybody meets and which groups do, and who is in
which cell. Read from the frozen protocol, else from who met what. Pure.

How a design is tested is `rating_findings.py`'s.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from desirepath.report.study_data import StudyData

Levels = Mapping[str, Sequence[str]]
CROSSED = ("block", "rating", "importance_ranking")  # stages whose trials can stand under several conditions
CONDITION = "condition"  # the one factor of a study whose protocol does not name one


@dataclass(frozen=True)
class StudyDesign:
    """One comparison, of a block or of what is rated. within, between: factor -> levels, at least two: what has one
    level is not compared. cells: conditions within, as
    answers carry them; of a design without factors within the one of each group. groups: person -> cell of the factors
    between."""

    within: Levels
    between: Levels
    cells: Sequence[str]
    groups: Mapping[str, int] = field(default_factory=dict)

    @property
    def group_names(self) -> list[str]:
        """The cells between people; one empty name where everybody meets the same."""
        return ["-".join(cell) for cell in product(*self.between.values())]

    @property
    def factorial(self) -> bool:
        """Whether there is more than one factor."""
        return len(self.within) + len(self.between) > 1

    @property
    def words(self) -> str:
        """The design as papers name it."""
        sizes = " × ".join(str(len(levels)) for levels in (*self.within.values(), *self.between.values()))
        where = [
            f"{', '.join(factors)} {words}"
            for factors, words in ((self.within, "within people"), (self.between, "between people"))
            if factors
        ]
        return f"{sizes} conditions ({'; '.join(where)})".replace("_", " ")

    def values(self, rated: Mapping[str, Mapping[str, float]]) -> tuple[list[str], list[list[float]]]:
        """The people who rated every cell that they met, with their ratings of the cells in order. rated: person ->
        condition -> rating. A design without factors within has one column."""
        people, rows = [], []
        for person, of in rated.items():
            if self.between and person not in self.groups:
                continue
            cells = self.cells if self.within else [self.cells[self.groups[person]]]
            if all(cell in of for cell in cells):
                people.append(person)
                rows.append([of[cell] for cell in cells])
        return people, rows


def designs_of(data: StudyData) -> list[StudyDesign]:
    """Every comparison of a study: one per stage with factors, the same ones once; without such a stage all conditions
    that were met."""
    conditions = data.conditions
    seen = {name for names in _conditions_met(data).values() for name in names}
    met: list[StudyDesign] = []
    for design in _declared_designs(data):
        if (design.within or design.between) and seen & set(design.cells) and design not in met:
            met.append(design)
    if met:
        return met
    if len(conditions) < 2:
        return []
    of = {person: [name for name in conditions if name in names] for person, names in _conditions_met(data).items()}
    levels = {CONDITION: tuple(conditions)}
    if all(len(names) == 1 for names in of.values()):
        groups = {person: conditions.index(names[0]) for person, names in of.items()}
        return [StudyDesign({}, levels, conditions, groups)]
    return [StudyDesign(levels, {}, conditions)]


def _conditions_met(data: StudyData) -> dict[str, set[str]]:
    """Person -> conditions that they answered something under."""
    met: dict[str, set[str]] = {}
    rated = [(rating.person, rating.condition) for rating in data.ratings if rating.condition]
    known = {*data.conditions, *(condition for _, condition in rated)}
    for person, condition in [(choice.person, choice.condition) for choice in data.choices] + rated:
        if condition in known:
            met.setdefault(person, set()).add(condition)
    return met


def _declared_designs(data: StudyData) -> Iterator[StudyDesign]:
    newest = data.newest or data.protocol
    for key, block in _stages_with_factors(newest):
        within, between = block.get("each") or {}, block.get("one_of") or {}
        within = {"view": within} if isinstance(within, list) else within
        between = {"view": between} if isinstance(between, list) else between
        names = ["-".join(cell) for cell in product(*between.values())]
        cells = ["-".join(cell) for cell in product(*within.values())] if within else names
        if not within:  # a group's one condition is called as the group
            levels = {person: next(iter(of & set(names)), "") for person, of in _conditions_met(data).items()}
        else:
            levels = {row.code: row.groups.get(key, "") for row in data.people}
        groups = {person: names.index(name) for person, name in levels.items() if between and name in names}
        varied, of_groups = ({f: levels for f, levels in some.items() if len(levels) > 1} for some in (within, between))
        if within and not varied:  # one condition for everybody: the groups are compared in it
            cells = cells * max(1, len(names))
        yield StudyDesign(varied, of_groups, cells, groups)


def _stages_with_factors(protocol: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The stages of a protocol that can have factors, by their keys: `block`, `block_2`, `rating`, ..."""
    numbers: Counter[str] = Counter()
    for entry in protocol.get("stages", ()):
        for kind in CROSSED:
            if entry.get(kind):
                numbers[kind] += 1
                yield f"{kind}_{numbers[kind]}" if numbers[kind] > 1 else kind, entry[kind]
        if entry.get("methods"):  # ways of telling the robot, each of which everybody meets
            yield "methods", {"each": {"method": entry["methods"]["methods"]}}

"""What a rule is: conditions that must all hold, and wishes or zones of the floor for as long as they do.

Rules stand in an order: where two that hold ask for opposites, the first one counts. All ours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator

from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.objectives import NAMES, OPPOSITES

RoomName = Literal["kitchen", "living_room", "bedroom", "bathroom", "dining_room", "study", "corridor", "doorway"]
Thing = Literal["sofa", "table", "chair", "bed", "cupboard", "lamp", "box", "pillar", "wall", "furniture", "person"]
Plain = Literal["sitting", "standing", "walking", "others", "hurry"]
ZoneKind = Literal["front", "behind", "between", "thing", "room", "here"]
Wished = Annotated[str, Field(max_length=40)]
Metres = Annotated[float, Field(ge=-500, le=500, allow_inf_nan=False)]
MOST_CONDITIONS, MOST_CHANGES, MOST_RULES = 3, 4, 12
OPPOSITE = {NAMES[a]: NAMES[b] for a, b in OPPOSITES} | {NAMES[b]: NAMES[a] for a, b in OPPOSITES}
_CONTRARY = {"alone": ("others", False), "no_hurry": ("hurry", False)}
_STRICT = ConfigDict(frozen=True, extra="forbid")


class Condition(BaseModel):
    """kind: sitting, standing, walking: what the person does; others: more people are there; hurry: somebody is short
    of time; room, near: the robot is in that room, comes near that thing. holds: false: while it does not."""

    model_config = _STRICT

    kind: Literal["sitting", "standing", "walking", "others", "hurry", "room", "near"]
    of: RoomName | Thing | None = None
    holds: bool = True

    @model_validator(mode="after")
    def _of_what(self) -> Condition:
        known = {"room": get_args(RoomName), "near": get_args(Thing)}.get(self.kind, (None,))
        if self.of not in known:
            raise ValueError(f"{self.kind} of {self.of!r}: must be of {', '.join(map(str, known))}")
        return self

    @property
    def label(self) -> str:
        """As the test sentences are labelled: `not:room:kitchen`; `alone` and `no_hurry` by name."""
        for name, contrary in _CONTRARY.items():
            if (self.kind, self.holds) == contrary:
                return name
        return ("" if self.holds else "not:") + self.kind + (f":{self.of}" if self.of else "")


class Wish(BaseModel):
    """More of an objective, or less. Less of `faster` keeps to half the speed; less of another is no weight for it."""

    model_config = _STRICT

    objective: Wished
    more: bool = True

    @model_validator(mode="after")
    def _known(self) -> Wish:
        if self.objective not in NAMES:
            raise ValueError(f"objective {self.objective!r} is unknown; known are {', '.join(NAMES)}")
        return self

    @property
    def label(self) -> str:
        return f"{self.objective}:{'+' if self.more else '-'}"


class Rectangle(BaseModel):
    """On the floor: its middle (m), heading (rad), length along it and width (m). place: in which of the scenes."""

    model_config = _STRICT

    x: Metres
    y: Metres
    yaw: Annotated[float, Field(ge=-7, le=7)] = 0.0
    length: Annotated[float, Field(gt=0, le=50)]
    width: Annotated[float, Field(gt=0, le=50)]
    place: Annotated[int, Field(ge=0, le=100)] = 0


class Zone(BaseModel):
    """Where the robot must not drive: before or behind the person, between them and a thing, at a thing, in a room, or
    where somebody drew it (`here`; drawn: None: not yet)."""

    model_config = _STRICT

    kind: ZoneKind
    of: RoomName | Thing | None = None
    drawn: Rectangle | None = None

    @model_validator(mode="after")
    def _of_what(self) -> Zone:
        things = tuple(thing for thing in get_args(Thing) if thing != "person")
        known = {"between": things, "thing": things, "room": get_args(RoomName)}.get(self.kind, (None,))
        if self.of not in known:
            raise ValueError(f"zone {self.kind} of {self.of!r}: must be of {', '.join(map(str, known))}")
        if self.drawn is not None and self.kind != "here":
            raise ValueError(f"zone {self.kind}: only `here` is drawn")
        return self

    @property
    def label(self) -> str:
        words = ("zone", None if self.kind == "thing" else self.kind, self.of)
        return ":".join(word for word in words if word)


class Rule(BaseModel):
    """words: the sentence that it was told in. on: false: switched off, and kept."""

    model_config = _STRICT

    words: str = Field("", max_length=300)
    when: tuple[Condition, ...] = Field((), max_length=MOST_CONDITIONS)
    wishes: tuple[Wish, ...] = Field((), max_length=MOST_CHANGES)
    zones: tuple[Zone, ...] = Field((), max_length=MOST_CHANGES)
    on: bool = True

    @property
    def context(self) -> frozenset[str]:
        """Labels of its conditions, `always` where there is none."""
        return frozenset(condition.label for condition in self.when) or frozenset({"always"})

    @property
    def changes(self) -> frozenset[str]:
        return frozenset([wish.label for wish in self.wishes] + [zone.label for zone in self.zones])

    @property
    def complete(self) -> bool:
        """Whether a robot can drive by it: something is wished, and every zone is somewhere."""
        return bool(self.changes) and all(zone.kind != "here" or zone.drawn for zone in self.zones)


def acted_on(rules: Sequence[Rule]) -> tuple[Rule, ...]:
    """What a robot drives by: those that are on, whatever words they were told in."""
    return tuple(rule.model_copy(update={"words": ""}) for rule in rules if rule.on)


def check_rules(rules: Sequence[Rule]) -> None:
    """Raises LearningError for more than a robot is told."""
    if len(rules) > MOST_RULES:
        raise LearningError(f"rules: {len(rules)} given, at most {MOST_RULES}")


def collisions(rules: Sequence[Rule]) -> Iterator[tuple[int, int, str]]:
    """Pairs of rules, by their places, that may hold at once and ask for opposites, with the objective of the first."""
    on = [(place, rule) for place, rule in enumerate(rules) if rule.on]
    for n, (i, first) in enumerate(on):
        for j, second in on[n + 1 :]:
            if not _exclude_each_other(first, second):
                clash = next(
                    (one for one in first.wishes if any(_against(one, other) for other in second.wishes)), None
                )
                zones = {zone.kind for zone in (*first.zones, *second.zones)} >= {"front", "behind"}
                both = {zone.kind for zone in first.zones} != {zone.kind for zone in second.zones}
                if clash is not None:
                    yield i, j, clash.objective
                elif zones and both:
                    yield i, j, "zone"


def _against(one: Wish, other: Wish) -> bool:
    if one.objective == other.objective:
        return one.more != other.more
    slower = {("faster", True), ("slower_near_person", True)}
    if {(one.objective, one.more), (other.objective, other.more)} == slower:
        return False  # fast, and slow beside me
    return one.more and other.more and OPPOSITE.get(one.objective) == other.objective


def _exclude_each_other(first: Rule, second: Rule) -> bool:
    """Whether the conditions of both can never hold at once."""
    postures = {"sitting", "standing", "walking"}
    for one in first.when:
        for other in second.when:
            if (one.kind, one.of) == (other.kind, other.of) and one.holds != other.holds:
                return True
            if one.holds and other.holds and one.kind != other.kind and {one.kind, other.kind} <= postures:
                return True
            if one.holds and other.holds and one.kind == other.kind == "room" and one.of != other.of:
                return True
    return False


def weights_by(base: dict[str, float], rules: Sequence[Rule]) -> tuple[dict[str, float], float]:
    """The preference weights, and the share of its speed that a robot drives with, while these rules hold: of opposites
    the first told counts, and what is wished less of weighs nothing."""
    weights, decided, share = dict(base), set[str](), 1.0
    for wish in (one for rule in rules for one in rule.wishes):
        pair = {wish.objective, OPPOSITE.get(wish.objective, wish.objective)}
        if wish.objective in decided or (wish.more and pair & decided):
            continue
        decided |= pair if wish.more else {wish.objective}
        for name in pair if wish.more else {wish.objective}:
            weights.pop(name, None)
        if wish.more:
            weights[wish.objective] = 1.0
        elif wish.objective == "faster":
            share = SLOW
    return weights, share


SLOW = 0.5
"""Of full speed at most, in a situation in which somebody wishes it slower."""

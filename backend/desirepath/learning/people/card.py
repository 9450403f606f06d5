"""The card of simulated people outside the list, and its members by name: `network:3`, `thresholds:0`, ..."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from desirepath.grammar.source import Source, file_text
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.steps import reference
from desirepath.learning.people.families.base import Family, FamilyMember, StepFamilyMember
from desirepath.learning.people.families.changing import ChangingFamily
from desirepath.learning.people.families.context import ContextFamily
from desirepath.learning.people.families.deep_network import DeepNetworkFamily, DeepNetworkMember
from desirepath.learning.people.families.last_third import LastThirdFamily
from desirepath.learning.people.families.lexicographic import LexicographicFamily
from desirepath.learning.people.families.look import LookFamily
from desirepath.learning.people.families.mixture import MixtureFamily
from desirepath.learning.people.families.network import NetworkFamily, NetworkMember
from desirepath.learning.people.families.saturated import SaturatedFamily
from desirepath.learning.people.families.thresholds import ThresholdsFamily

CARD = Path(__file__).parent / "card.yaml"
FAMILIES: dict[str, type[Family]] = {
    "network": NetworkFamily,
    "deep_network": DeepNetworkFamily,
    "thresholds": ThresholdsFamily,
    "lexicographic": LexicographicFamily,
    "context": ContextFamily,
    "mixture": MixtureFamily,
    "changing": ChangingFamily,
    "saturated": SaturatedFamily,
    "look": LookFamily,
    "last_third": LastThirdFamily,
}
MOST_MEMBERS = 10_000
WITH_NETWORK = ("mixture", "changing", "last_third")


class NoSingleInput(BaseModel):
    """alone: the largest share of the reference pairs that one group of inputs may decide alone; without: the largest
    share of choices that may stay without one; tries: drawings of a member until that is so."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    alone: float
    without: float
    tries: int


class Card(BaseModel):
    """The card as it is read. families: by name; held_out, unseen: `kept_apart`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    version: int
    held_out: tuple[str, ...]
    unseen: tuple[str, ...]
    families: dict[str, Any]
    no_single_input: NoSingleInput
    response_models: dict[str, dict[str, Any]]

    def family(self, name: str) -> Family:
        """Raises LearningError for an unknown one."""
        if name not in self.families:
            raise LearningError(f"family = {name!r}: known are {', '.join(self.families)}")
        more = {"network": self.families["network"]} if name in WITH_NETWORK else {}
        return FAMILIES[name].model_validate({**self.families[name], **more})

    @property
    def kept_apart(self) -> tuple[str, ...]:
        """Families that nothing may be chosen on."""
        return (*self.held_out, *self.unseen)

    @property
    def tuning(self) -> tuple[str, ...]:
        """Families that something may be chosen on."""
        return tuple(name for name in self.families if name not in self.kept_apart)


@lru_cache(maxsize=1)
def people_card() -> Card:
    """The card that comes with the code. Raises LearningError naming the field that cannot be."""
    try:
        card = Card.model_validate(Source(CARD.name, file_text(CARD)).data)
        for name in card.families:
            card.family(name)
    except (ValidationError, KeyError) as problem:
        raise LearningError(f"{CARD.name}: {problem}") from None
    unknown = [name for name in card.kept_apart if name not in card.families]
    if unknown:
        raise LearningError(f"{CARD.name}: {unknown[0]!r} is no family; families are {list(card.families)}")
    return card


def is_member(name: str) -> bool:
    """Whether a name is of this card: a family, or a family and a number."""
    return name.partition(":")[0] in FAMILIES


def parse_person(name: str) -> tuple[str, int]:
    """(family, number) of `network:3`; a family alone is its member 0. Raises LearningError for anything else."""
    family, colon, number = name.partition(":")
    if family not in FAMILIES or (colon and not (number.isdecimal() and int(number) < MOST_MEMBERS)):
        raise LearningError(
            f"simulated person {name!r}: write it as family:number with a number below {MOST_MEMBERS:,}, e.g. "
            f"network:3; families are {', '.join(FAMILIES)}"
        )
    return family, int(number or 0)


@lru_cache(maxsize=512)
def member(name: str, setup: str) -> FamilyMember:
    """The member of that name in a setup, always the same. Raises LearningError for an unknown name or setup."""
    family, number = parse_person(name)
    card = people_card()
    place = tuple(FAMILIES).index(family)
    settings = card.family(family)
    drawn = settings.draw(setup, np.random.default_rng([card.version, place, number, 0]))
    for again in range(1, card.no_single_input.tries):
        if not isinstance(drawn, NetworkMember | DeepNetworkMember) or _is_balanced(drawn, setup, card.no_single_input):
            break
        drawn = settings.draw(setup, np.random.default_rng([card.version, place, number, again]))
    return drawn


def members(family: str, count: int, setup: str, first: int = 0) -> Mapping[str, FamilyMember]:
    """`count` members of a family by name, from a number on."""
    return {name: member(name, setup) for name in (f"{family}:{k}" for k in range(first, first + count))}


def _is_balanced(drawn: NetworkMember | DeepNetworkMember, setup: str, rule: NoSingleInput) -> bool:
    """Whether no group of inputs decides by itself, and each has a say."""
    groups = frozenset(drawn.first if isinstance(drawn, NetworkMember) else drawn.scale)
    usual = _choices(drawn, setup)

    def agreement(muted: frozenset[str]) -> float:
        return float((_choices(replace(drawn, muted=muted), setup) == usual).mean())

    return all(
        max(alone := agreement(groups - {group}), 1 - alone) <= rule.alone
        and agreement(frozenset({group})) <= rule.without
        for group in groups
    )


def _choices(drawn: StepFamilyMember, setup: str) -> NDArray[np.bool_]:
    steps = reference(setup).steps
    scores = steps.means(drawn.step_scores(steps))
    return np.asarray(scores[0::2] > scores[1::2])


def response_models(names: Sequence[str] | None = None) -> dict[str, dict[str, Any]]:
    """The card's response models by name. Raises LearningError for an unknown one."""
    known = people_card().response_models
    for name in names or ():
        if name not in known:
            raise LearningError(f"response model = {name!r}: known are {', '.join(known)}")
    return {name: known[name] for name in (names or known)}

"""Three choices among three things: whether they go round in a circle. Needs no statistics; tests of choices are
`choices.py`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TypeVar

Answer = TypeVar("Answer")

CHANCE_CIRCULAR = 0.25  # of three choices by three coins: two of the eight outcomes go round


def whole_triads(answers: Mapping[frozenset[str], Answer]) -> list[list[Answer]]:
    """The triads that were answered whole: the three answers about all pairs of three. answers: by the pair they are
    about, one person's under one condition."""
    triads: dict[frozenset[str], list[Answer]] = {}
    for first, other in combinations(answers, 2):
        three = first | other
        if len(three) == 3 and first ^ other in answers:
            triads.setdefault(three, [answers[pair] for pair in answers if pair <= three])
    return list(triads.values())


def is_circular(choices: Sequence[tuple[str, str]]) -> bool:
    """Whether three choices (chosen, rejected) among three go round: each was chosen once (Kendall and Babington Smith
    1940). Raises ValueError unless they are the three pairs of three."""
    pairs = {frozenset(pair) for pair in choices}
    if len(choices) != 3 or len(pairs) != 3 or len(set().union(*pairs)) != 3:
        raise ValueError(f"choices = {list(choices)}: needs the three pairs of three")
    return len({chosen for chosen, _ in choices}) == 3

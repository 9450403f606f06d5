"""The orders of conditions that a protocol's scheme has, and which one comes next. Pure; who holds which place now is
`assignment.py`'s.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from math import factorial, prod
from typing import Any, Literal, Protocol

import numpy as np
from pydantic import Field

from desirepath.grammar.conditions import Condition, Ordered
from desirepath.grammar.parts import Part

MOST_ROWS = 5040  # ours: 7!; a protocol with more orders than that can never be balanced


class Assignment(Part):
    """How participants differ. Queries and sides are always each participant's own, from `seed` and their code.

    scheme: the orders of a block's conditions. `random` draws each one's by lot; `all_orders` (every permutation),
    `williams` (every condition follows every other equally often) and `latin_square` (every condition stands in every
    place equally often) fill their orders evenly, by completed and active sessions.
    lease_hours: an unfinished session holds its place so long after its last sign of life. excluded: whether excluding
    somebody frees their place; it must be declared before the study.
    """

    scheme: Literal["random", "all_orders", "williams", "latin_square"] = "random"
    seed: int = Field(0, ge=0)
    lease_hours: float = Field(24.0, gt=0, le=24 * 365)  # ours
    excluded: Literal["keep_place", "free_place"] = "keep_place"


class Assigning(Protocol):
    """What of a study protocol says who meets what; the whole is `protocol/schema.py`'s."""

    @property
    def assignment(self) -> Assignment: ...
    @property
    def participants(self) -> int | None: ...
    @property
    def keyed_stages(self) -> Sequence[tuple[str, Part]]: ...


@dataclass(frozen=True)
class Placement:
    """What one participant meets in a block or evaluation: the group of `one_of` and the order of its conditions."""

    group: int
    order: tuple[int, ...]

    def conditions(self, block: Ordered) -> list[Condition]:
        """The conditions in this order."""
        possible = block.conditions(self.group)
        return [possible[i] for i in self.order]


Place = Mapping[str, Placement]
"""Stage key of a block or an evaluation -> its placement."""


@dataclass(frozen=True)
class Design:
    """All places there are: one row each. `digest` tells two protocols with the same places from others."""

    scheme: str
    blocks: Mapping[str, Ordered]
    rows: tuple[Place, ...]
    digest: str

    def place_by_lot(self, random: np.random.Generator) -> Place:
        """A place drawn without regard to others: scheme `random`, previews."""
        return {
            key: Placement(
                int(random.integers(len(block.groups))), tuple(random.permutation(len(block.conditions(0))).tolist())
            )
            for key, block in self.blocks.items()
        }

    def describe(self, place: Place, row: int | None) -> dict[str, Any]:
        """What a session keeps as its `assignment`."""
        blocks = {
            key: [condition.name for condition in place[key].conditions(block)] for key, block in self.blocks.items()
        }
        return {
            "scheme": self.scheme,
            "row": row,
            "rows": len(self.rows),
            "order": next((names for names in blocks.values() if len(names) > 1), []),
            "blocks": blocks,
            "groups": {
                key: "-".join(block.groups[place[key].group].values())
                for key, block in self.blocks.items()
                if block.one_of
            },
            "design": self.digest,
        }


def design_of(protocol: Assigning) -> Design:
    """The places of a protocol; none where nothing has conditions. ValueError: more than `MOST_ROWS`."""
    keyed = protocol.keyed_stages
    blocks = {key: stage for key, stage in keyed if isinstance(stage, Ordered) and (stage.each or stage.one_of)}
    scheme = protocol.assignment.scheme
    count = prod(len(block.groups) * _how_many(len(block.conditions(0)), scheme) for block in blocks.values())
    if count > MOST_ROWS:  # counted before they are made: ten conditions have 3.6 million
        raise ValueError(
            f"has {count} different orders, more than {MOST_ROWS}; use latin_square or williams, or random"
        )
    choices = [
        [
            Placement(group, order)
            for group in range(len(block.groups))
            for order in orders(len(block.conditions(0)), scheme)
        ]
        for block in blocks.values()
    ]
    rows = tuple(dict(zip(blocks, row, strict=True)) for row in product(*choices)) if blocks and count else ()
    factors = {key: [block.each, block.one_of] for key, block in blocks.items()}
    digest = hashlib.sha256(json.dumps([scheme, factors]).encode()).hexdigest()[:16]
    return Design(scheme, blocks, rows, digest)


def _how_many(n: int, scheme: str) -> int:
    """How many orders of n conditions `orders` makes."""
    return {"all_orders": factorial(n), "williams": n if n % 2 == 0 else 2 * n, "latin_square": n}.get(scheme, 0)


def orders(n: int, scheme: str) -> list[tuple[int, ...]]:
    """The orders of n conditions. Empty for `random`.

    williams: every condition follows every other one equally often; n orders for even n, 2n for odd n (Williams 1949,
    Australian Journal of Scientific Research A 2, 149-168).
    """
    if scheme == "all_orders":
        return list(permutations(range(n)))
    if scheme == "latin_square":
        return [tuple((start + i) % n for i in range(n)) for start in range(n)]
    if scheme == "williams":
        zigzag = [(i + 1) // 2 if i % 2 else (n - i // 2) % n for i in range(n)]  # 0, 1, n-1, 2, n-2, ...
        square = [tuple((start + i) % n for i in zigzag) for start in range(n)]
        return square if n % 2 == 0 else square + [order[::-1] for order in square]
    return []


def next_row(held: Sequence[int], seed: int) -> int:
    """The row for whoever comes now: one of the least held, by lot. held: places held per row; seed: the study's.

    Between any two rows the number held differs by at most one as long as nobody gives a place up; whoever comes next
    fills a place that was given up first.
    """
    least = [row for row, count in enumerate(held) if count == min(held)]
    return int(np.random.default_rng([seed, 17, sum(held)]).choice(least))

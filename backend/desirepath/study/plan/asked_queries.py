"""Which queries a participant is asked, and which of each one's trajectories is A. Pure; steps are the kinds' own."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np
from pydantic import Field

from desirepath.grammar.parts import Part

PREVIEW_DURATION_S = 9.0  # a usual trajectory of the study room, ch. 7


class PlanError(ValueError):
    """A query set that cannot fill the protocol."""


class Sample(Part):
    """Which queries of the set a participant may get. different_scenes: no scene twice. longest_s, shortest_s: of both
    trajectories.
    """

    different_scenes: bool = False
    longest_s: float | None = Field(None, gt=0)
    shortest_s: float | None = Field(None, gt=0)


@dataclass(frozen=True)
class Needs:
    """What stages need of the query set. shared: queries that all of them show; own: further ones; triads: scenes with
    three trajectories, which all of them share; ranked: explained rollouts of a ranking set, practised: others of them
    for practice.
    """

    shared: int = 0
    own: int = 0
    triads: int = 0
    ranked: int = 0
    practised: int = 0

    def __add__(self, other: Needs) -> Needs:
        return Needs(
            max(self.shared, other.shared),
            self.own + other.own,
            max(self.triads, other.triads),
            self.ranked + other.ranked,
            self.practised + other.practised,
        )

    @property
    def queries(self) -> int:
        """How many different queries one participant is shown, not counting triads."""
        return self.shared + self.own


class AnyQuery(Protocol):
    """What a plan needs to know of a query."""

    @property
    def id(self) -> str: ...
    @property
    def setup(self) -> str: ...
    @property
    def scene_hash(self) -> str: ...
    @property
    def trajectory_a(self) -> str: ...
    @property
    def trajectory_b(self) -> str: ...
    @property
    def duration_a_s(self) -> float: ...
    @property
    def duration_b_s(self) -> float: ...


@dataclass(frozen=True)
class Placeholder:
    """A query of which a plan only needs that it exists, for previews."""

    id: str
    scene_hash: str
    trajectory_a: str
    trajectory_b: str
    duration_a_s: float
    duration_b_s: float
    setup: str = ""


def placeholders(needs: Needs, sample: Sample) -> list[Placeholder]:
    """Queries that fill any plan of a protocol with these needs."""
    long_s = sample.longest_s or max(sample.shortest_s or 0.0, PREVIEW_DURATION_S)

    def query(scene: int, a: str, b: str) -> Placeholder:
        return Placeholder(f"preview-{scene}{a}{b}", f"scene-{scene}", f"{scene}{a}", f"{scene}{b}", long_s, long_s)

    beside = [query(needs.queries + n, *sides) for n in range(needs.triads) for sides in (("a", "b"), ("b", "c"))]
    ranked = [query(-1 - n, "a", "b") for n in range(needs.ranked + needs.practised)]
    return [query(n, "a", "b") for n in range(needs.queries)] + beside + ranked


@dataclass(frozen=True)
class Pair:
    """A query as it is shown to this participant: sides drawn. One of the set, or made of two of its trajectories."""

    query: str
    trajectory_a: str
    trajectory_b: str
    duration_a_s: float
    duration_b_s: float
    sides_swapped: bool

    def swap(self) -> Pair:
        """The same pair with A and B exchanged."""
        a, b = (self.trajectory_a, self.duration_a_s), (self.trajectory_b, self.duration_b_s)
        return Pair(self.query, b[0], a[0], b[1], a[1], not self.sides_swapped)


class DrawnQueries:
    """What was drawn for one participant: pairs that stages share, further ones for those that do not, triads, and
    what is ranked.
    """

    def __init__(
        self,
        shared: list[Pair],
        own: list[Pair],
        triads: list[tuple[Pair, Pair, Pair]],
        ranked: Sequence[Pair] = (),
        practised: Sequence[Pair] = (),
    ) -> None:
        self.shared, self.triads = shared, triads
        self._own, self._ranked, self._practised = iter(own), iter(ranked), iter(practised)

    def pairs(self, count: int, *, shared: bool) -> list[Pair]:
        """The next `count` pairs of one condition; shared: the first ones that all conditions show."""
        return self.shared[:count] if shared else [next(self._own) for _ in range(count)]

    def rankings(self, count: int, *, practice: bool) -> list[Pair]:
        """The next `count` rollouts to rank, none of them twice; practice: of those for practice."""
        return [next(self._practised if practice else self._ranked) for _ in range(count)]


def draw(needs: Needs, sample: Sample, queries: Sequence[AnyQuery], random: np.random.Generator) -> DrawnQueries:
    """Draw one participant's queries, without replacement, within the protocol's `sample`. PlanError: too few."""
    allowed = [query for query in queries if _fits(query, sample)]
    ranked, practised = _rankings(allowed, needs, random)
    taken_for_ranking = {pair.query for pair in (*ranked, *practised)}
    if taken_for_ranking:
        allowed = [query for query in allowed if query.id not in taken_for_ranking]
    drawn_triads = _triads(allowed, needs.triads, random)
    in_triads = {scene for scene, _ in drawn_triads}
    rest = [query for query in allowed if query.scene_hash not in in_triads] if drawn_triads else allowed
    chosen = _draw(rest, needs.queries, sample.different_scenes, random)
    if len(chosen) < needs.queries:
        limits = f"; {len(rest)} of its {len(queries)} may be drawn" if len(rest) < len(queries) else ""
        scenes = " in different scenes" if sample.different_scenes else ""
        raise PlanError(
            f"the query set has {len(chosen) if scenes else len(rest)} queries{scenes}{limits}, "
            f"one session of this protocol needs {needs.queries}"
        )
    pairs = [_swap_if(_pair(query), bool(random.integers(2))) for query in chosen]
    sided = [tuple(_swap_if(pair, bool(random.integers(2))) for pair in three) for _, three in drawn_triads]
    triads = [(a, b, c) for a, b, c in sided]
    return DrawnQueries(pairs[: needs.shared], pairs[needs.shared :], triads, ranked, practised)


def _rankings(queries: Sequence[AnyQuery], needs: Needs, random: np.random.Generator) -> tuple[list[Pair], list[Pair]]:
    """(ranked, practised), in random order; a set's own rollouts for practice first. PlanError: too few."""
    if not needs.ranked + needs.practised:
        return [], []
    order = [queries[i] for i in random.permutation(len(queries))]
    practice = [query for query in order if getattr(query, "practice", False)]
    others = [query for query in order if not getattr(query, "practice", False)]
    short = max(0, needs.practised - len(practice))
    if len(others) < needs.ranked + short:
        raise PlanError(
            f"the ranking set has {len(others)} rollouts and {len(practice)} for practice, one session of this "
            f"protocol ranks {needs.ranked} and practises with {needs.practised}"
        )
    practised = (practice + others[needs.ranked :])[: needs.practised]
    return [_pair(query) for query in others[: needs.ranked]], [_pair(query) for query in practised]


def _fits(query: AnyQuery, sample: Sample) -> bool:
    durations = (query.duration_a_s, query.duration_b_s)
    return (sample.longest_s is None or max(durations) <= sample.longest_s) and (
        sample.shortest_s is None or min(durations) >= sample.shortest_s
    )


def _draw(queries: list[AnyQuery], count: int, different: bool, random: np.random.Generator) -> list[AnyQuery]:
    if not different:
        places = random.choice(len(queries), size=min(count, len(queries)), replace=False)
        return [queries[i] for i in places]
    chosen: dict[str, AnyQuery] = {}
    for i in random.permutation(len(queries)):
        chosen.setdefault(queries[i].scene_hash, queries[i])
        if len(chosen) == count:
            break
    return list(chosen.values())


def _pair(query: AnyQuery) -> Pair:
    return Pair(
        query.id, query.trajectory_a, query.trajectory_b, query.duration_a_s, query.duration_b_s, sides_swapped=False
    )


def _swap_if(pair: Pair, swapped: bool) -> Pair:
    return pair.swap() if swapped else pair


def _triads(
    queries: list[AnyQuery], count: int, random: np.random.Generator
) -> list[tuple[str, tuple[Pair, Pair, Pair]]]:
    """`count` scenes with three of their trajectories in all three pairs. PlanError: too few of these."""
    if not count:
        return []
    seen: dict[str, dict[str, float]] = defaultdict(dict)
    for query in queries:
        seen[query.scene_hash][query.trajectory_a] = query.duration_a_s
        seen[query.scene_hash][query.trajectory_b] = query.duration_b_s
    scenes = [scene for scene, trajectories in seen.items() if len(trajectories) >= 3]
    if len(scenes) < count:
        raise PlanError(
            f"the query set has {len(scenes)} scenes with three trajectories, probes of transitivity need {count}; "
            "use a set with several queries per scene"
        )
    known = {frozenset((query.trajectory_a, query.trajectory_b)): _pair(query) for query in queries}
    triads = []
    for i in random.choice(len(scenes), size=count, replace=False):
        of_scene = seen[scenes[i]]
        three = [sorted(of_scene)[k] for k in random.choice(len(of_scene), size=3, replace=False)]
        pairs = [
            known.get(frozenset((a, b)))
            # as Query.digest() names a query: by its two trajectories
            or Pair(hashlib.sha256(f"{a}{b}".encode()).hexdigest(), a, b, of_scene[a], of_scene[b], sides_swapped=False)
            for a, b in combinations(three, 2)
        ]
        triads.append((scenes[i], (pairs[0], pairs[1], pairs[2])))
    return triads

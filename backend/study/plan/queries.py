"""Which queries a participant is asked, with which sides, in which order. Pure; other steps are `planning.py`'s."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Protocol

import numpy as np

from backend.study.protocol import schema
from backend.study.protocol.blocks import BlockStage, Queries

Step = dict[str, Any]
PREVIEW_DRIVE_S = 9.0  # a usual drive of the study room, spec 07


class PlanError(ValueError):
    """A query set that cannot fill the protocol."""


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


def placeholders(protocol: schema.Protocol) -> list[Placeholder]:
    """Queries that fill any plan of the protocol."""
    sample = protocol.sample
    long_s = sample.longest_s or max(sample.shortest_s or 0.0, PREVIEW_DRIVE_S)

    def query(scene: int, a: str, b: str) -> Placeholder:
        return Placeholder(f"preview-{scene}{a}{b}", f"scene-{scene}", f"{scene}{a}", f"{scene}{b}", long_s, long_s)

    needed, triads = queries_needed(protocol), _triads_needed(protocol)
    beside = [query(needed + n, *sides) for n in range(triads) for sides in (("a", "b"), ("b", "c"))]
    return [query(n, "a", "b") for n in range(needed)] + beside


@dataclass(frozen=True)
class Pair:
    """A query as it is shown to this participant: sides drawn. It is one of the set, or made of two of its drives."""

    query: str
    trajectory_a: str
    trajectory_b: str
    duration_a_s: float
    duration_b_s: float
    turned: bool

    def changed(self) -> Pair:
        """The same pair with A and B exchanged."""
        a, b = (self.trajectory_a, self.duration_a_s), (self.trajectory_b, self.duration_b_s)
        return Pair(self.query, b[0], a[0], b[1], a[1], not self.turned)


class Drawn:
    """What was drawn for one participant: queries that all blocks share, further ones for those that do not, triads."""

    def __init__(self, shared: list[Pair], own: list[Pair], triads: list[tuple[Pair, Pair, Pair]]) -> None:
        self.shared, self.triads = shared, triads
        self._own = iter(own)

    def pairs(self, stage: BlockStage) -> list[Pair]:
        """The pairs of one condition of a block."""
        count = _asked(stage)
        return self.shared[:count] if stage.same_queries else [next(self._own) for _ in range(count)]


def queries_needed(protocol: schema.Protocol) -> int:
    """How many different queries of the set one participant is shown, not counting triads."""
    shared, own = _counts(protocol)
    return shared + own


def _counts(protocol: schema.Protocol) -> tuple[int, int]:
    blocks = [entry.block for entry in protocol.stages if entry.block]
    shared = max((_asked(block) for block in blocks if block.same_queries), default=0)
    own = sum(_asked(block) * len(block.conditions(0)) for block in blocks if not block.same_queries)
    return shared, own


def _triads_needed(protocol: schema.Protocol) -> int:
    """How many scenes with three drives; all blocks share them."""
    blocks = [entry.block for entry in protocol.stages if entry.block]
    return max((sum(one.queries.probes.transitivity for one in block.trials) for block in blocks), default=0)


def _asked(stage: BlockStage) -> int:
    return sum(entry.queries.count for entry in stage.trials)


def draw(protocol: schema.Protocol, queries: Sequence[AnyQuery], random: np.random.Generator) -> Drawn:
    """Draw one participant's queries, without replacement, within the protocol's `sample`. PlanError: too few."""
    shared, own = _counts(protocol)
    sample = protocol.sample
    allowed = [query for query in queries if _fits(query, sample)]
    made = _triads(allowed, _triads_needed(protocol), random)
    taken = {scene for scene, _ in made}
    rest = [query for query in allowed if query.scene_hash not in taken] if made else allowed
    chosen = _drawn(rest, shared + own, sample.different_scenes, random)
    if len(chosen) < shared + own:
        limits = f"; {len(rest)} of its {len(queries)} may be drawn" if len(rest) < len(queries) else ""
        scenes = " in different scenes" if sample.different_scenes else ""
        raise PlanError(
            f"the query set has {len(chosen) if scenes else len(rest)} queries{scenes}{limits}, "
            f"one session of this protocol needs {shared + own}"
        )
    pairs = [_sided(_pair(query), bool(random.integers(2))) for query in chosen]
    sided = [tuple(_sided(pair, bool(random.integers(2))) for pair in three) for _, three in made]
    return Drawn(pairs[:shared], pairs[shared:], [(a, b, c) for a, b, c in sided])


def _fits(query: AnyQuery, sample: schema.Sample) -> bool:
    durations = (query.duration_a_s, query.duration_b_s)
    return (sample.longest_s is None or max(durations) <= sample.longest_s) and (
        sample.shortest_s is None or min(durations) >= sample.shortest_s
    )


def _drawn(queries: list[AnyQuery], count: int, different: bool, random: np.random.Generator) -> list[AnyQuery]:
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
    return Pair(query.id, query.trajectory_a, query.trajectory_b, query.duration_a_s, query.duration_b_s, turned=False)


def _sided(pair: Pair, turned: bool) -> Pair:
    return pair.changed() if turned else pair


def _triads(
    queries: list[AnyQuery], count: int, random: np.random.Generator
) -> list[tuple[str, tuple[Pair, Pair, Pair]]]:
    """`count` scenes with three of their drives in all three pairs. PlanError: too few scenes with three drives."""
    if not count:
        return []
    drives: dict[str, dict[str, float]] = defaultdict(dict)
    for query in queries:
        drives[query.scene_hash][query.trajectory_a] = query.duration_a_s
        drives[query.scene_hash][query.trajectory_b] = query.duration_b_s
    scenes = [scene for scene, found in drives.items() if len(found) >= 3]
    if len(scenes) < count:
        raise PlanError(
            f"the query set has {len(scenes)} scenes with three drives, probes of transitivity need {count}; use a set "
            "with several queries per scene"
        )
    known = {frozenset((query.trajectory_a, query.trajectory_b)): _pair(query) for query in queries}
    made = []
    for i in random.choice(len(scenes), size=count, replace=False):
        here = drives[scenes[i]]
        three = [sorted(here)[k] for k in random.choice(len(here), size=3, replace=False)]
        pairs = [
            known.get(frozenset((a, b)))
            # as Query.digest() names a query: by its two drives
            or Pair(hashlib.sha256(f"{a}{b}".encode()).hexdigest(), a, b, here[a], here[b], turned=False)
            for a, b in combinations(three, 2)
        ]
        made.append((scenes[i], (pairs[0], pairs[1], pairs[2])))
    return made


# ---- the trials of one condition -------------------------------------------------------------------------------------


def block_trials(prefix: str, stage: BlockStage, drawn: Drawn, random: np.random.Generator) -> list[Step]:
    """The trials of one condition of a block, in the order in which they are shown; `stage`, `block`, `view` are left
    to the caller.
    """
    asked: dict[str, list[Step]] = {"learning": [], "regular": [], "probe": []}
    pairs = iter(drawn.pairs(stage))
    triads = iter(drawn.triads)
    for entry in stage.trials:
        wanted = entry.queries
        mine = [next(pairs) for _ in range(wanted.count)]
        if wanted.role == "learning":
            asked["learning"] += [_fixed("learning", pair) for pair in mine]
            continue
        place = len(asked["regular"])
        asked["regular"] += _regular(wanted, mine, random)
        asked["probe"] += _repeats(wanted, asked["regular"], place, random)
        for three in (next(triads) for _ in range(wanted.probes.transitivity)):
            asked["probe"] += [_fixed("transitivity", pair) for pair in three]
    asked["probe"] = [asked["probe"][i] for i in random.permutation(len(asked["probe"]))]
    counted = len(asked["regular"]) + len(asked["probe"])
    learning = len(asked["learning"])
    steps: list[Step] = []
    for number, step in enumerate(asked["learning"] + asked["regular"] + asked["probe"], 1):
        practice = step["role"] == "learning"
        if "again" in step:
            step["again"] = f"{prefix}.{learning + step['again'] + 1:02d}"
        shown = {"number": number if practice else number - learning, "of": learning if practice else counted}
        steps.append({"key": f"{prefix}.{number:02d}", "kind": "trial", **shown, **_viewing(stage), **step})
    return steps


def _viewing(stage: BlockStage) -> Step:
    """The block's view rules that are not the defaults."""
    said = stage.viewing.model_dump(exclude_defaults=True)
    return {"viewing": said} if said else {}


def _regular(wanted: Queries, mine: list[Pair], random: np.random.Generator) -> list[Step]:
    if wanted.choose == "random":
        return [_fixed("regular", mine[i]) for i in random.permutation(len(mine))]
    rule = {"choose": wanted.choose} | ({"stop": wanted.stop.model_dump()} if wanted.stop else {})
    return [{"role": "regular", "turned": bool(random.integers(2)), **rule} for _ in mine]


def _repeats(wanted: Queries, regular: list[Step], place: int, random: np.random.Generator) -> list[Step]:
    """Probes of the regular steps from `place` on; `again` is the index of the step that they repeat."""
    probes = []
    for n, i in enumerate(random.choice(wanted.count, wanted.probes.repeat + wanted.probes.swap, False)):
        step = regular[place + int(i)]
        role = "repeat" if n < wanted.probes.repeat else "swap"
        probe = {**step, "role": role, "again": place + int(i)}
        if role == "swap":
            probe["turned"] = not step["turned"]
            if "query" in step:
                for name in ("trajectory_{}", "duration_{}_s"):
                    probe[name.format("a")], probe[name.format("b")] = step[name.format("b")], step[name.format("a")]
        probe.pop("stop", None)
        probes.append(probe)
    return probes


def _fixed(role: str, pair: Pair) -> Step:
    """A query that is known before the session; `turned`: its second trajectory is shown as A."""
    return {
        "role": role,
        "query": pair.query,
        "turned": pair.turned,
        "trajectory_a": pair.trajectory_a,
        "trajectory_b": pair.trajectory_b,
        "duration_a_s": pair.duration_a_s,
        "duration_b_s": pair.duration_b_s,
    }

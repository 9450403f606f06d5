"""A search among what a policy library can be mixed to: parts of its trained policies, and settings between settings.

Nothing is trained: every candidate is rolled out in the fast engine and judged by whoever asks (a posterior; in
benchmarks a simulated person's true score). An evolution strategy with recombination (Beyer & Schwefel 2002), small.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.alignment.policy_library import PolicyLibrary, mix_policies
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.objectives import OPPOSITES
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.simulation.fast import evaluate
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Judge = Callable[[Sequence[Policy], Sequence[Scene]], Doubles]
"""(n,) what each policy gains over the base policy in these scenes."""
LARGEST_PART = 1.5
ENOUGH_SUCCESS = 0.975
ASIDE = 0.5  # of the children go another way than between their parents, too
SCENES_SEED = 7_400  # of no library and no training


@dataclass(frozen=True)
class MixSearchConfig:
    """first: of the library, begun with; kept: after each generation of so many children. scenes: in which they are
    judged; arriving: in which success and duration are counted before that."""

    seed: int = 0
    first: int = 12
    kept: int = 8
    generations: int = 6
    children: int = 12
    scenes: int = 60
    arriving: int = 400


@dataclass(frozen=True)
class Candidate:
    """values: the setting (9,) of the conditioned policy, or the parts (k,) of the library's trained ones."""

    setting: bool
    values: Floats

    def policy(self, library: PolicyLibrary, conditioned: ConditionedPolicy, base: Policy) -> Policy:
        """conditioned: as trained."""
        return conditioned.at(self.values) if self.setting else mix_policies(base, library.actors, self.values)


def candidate_at(library: PolicyLibrary, place: int) -> Candidate:
    """The library's policy of that place."""
    first = len(library.settings)
    return Candidate(place < first, library.settings[place] if place < first else library.mixes[place - first])


def search_mixes(
    library: PolicyLibrary,
    conditioned: ConditionedPolicy,
    base: Policy,
    expected: Doubles,
    judge: Judge,
    config: MixSearchConfig,
    on_progress: OnProgress = no_progress,
) -> list[tuple[Candidate, float]]:
    """The best found with what the judge says of each, best first. expected (n,): of each of the library's, what it
    may gain; the search begins with the best of these that are allowed."""
    random, trained = np.random.default_rng([config.seed, 67]), conditioned.as_trained()
    scenes = scene_set(base.setup, config.scenes, purpose=Purpose.ALIGN_SELECT, seed=SCENES_SEED + config.seed)
    many = scene_set(base.setup, config.arriving, purpose=Purpose.ALIGN_SELECT, seed=SCENES_SEED + 50 + config.seed)
    usual_s = _arriving(base, many)[1]
    places = np.argsort(-np.where(library.allowed, expected, -np.inf))[: config.first]
    candidates = [candidate_at(library, int(place)) for place in places if library.allowed[place]]
    values = judge([candidate.policy(library, trained, base) for candidate in candidates], scenes)
    known = sorted(zip(candidates, values.tolist(), strict=True), key=lambda scored: -scored[1])[: config.kept]
    for generation in range(config.generations):
        children = []
        for _ in range(2 * config.children):
            child = _child([candidate for candidate, _ in known], random)
            success, longer = _arriving(child.policy(library, trained, base), many)
            if success >= ENOUGH_SUCCESS and longer - usual_s <= library.longest_s:
                children.append(child)
            if len(children) == config.children:
                break
        if children:
            values = judge([candidate.policy(library, trained, base) for candidate in children], scenes)
            known = sorted([*known, *zip(children, values.tolist(), strict=True)], key=lambda scored: -scored[1])
            known = known[: config.kept]
        on_progress((generation + 1) / config.generations, {"gain": known[0][1]})
    return known


def _arriving(policy: Policy, scenes: Sequence[Scene]) -> tuple[float, float]:
    """Share that arrives, and mean seconds of those."""
    table = evaluate(policy.rollout_policy, get_setup(policy.setup), list(scenes))
    arrived = np.asarray(table.outcome) == Outcome.SUCCESS
    return float(arrived.mean()), float(np.asarray(table.time)[arrived].mean()) if arrived.any() else np.inf


def _child(parents: Sequence[Candidate], random: np.random.Generator) -> Candidate:
    """Between two of a kind, or beyond, and a little aside."""
    first = parents[int(random.integers(len(parents)))]
    alike = [second for second in parents if second.setting == first.setting]
    second, way = alike[int(random.integers(len(alike)))], np.float32(random.uniform(-0.25, 1.25))
    values = first.values + way * (second.values - first.values)
    if random.random() < ASIDE:
        moved = random.integers(len(values), size=2)
        values[moved] += random.normal(0, 0.25, 2).astype(np.float32)
    if not first.setting:
        longer = np.float32(np.exp(random.normal(0, 0.1)))
        return Candidate(False, np.clip(longer * values, -0.5, LARGEST_PART).astype(np.float32))
    values = np.clip(values, 0, 1).astype(np.float32)
    for a, b in OPPOSITES:
        values[a if values[a] < values[b] else b] = 0
    return Candidate(True, values)

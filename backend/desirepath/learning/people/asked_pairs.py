"""What simulated people are asked and shown (`asked_people.py`): pairs of policies that differ in more than the nine
objectives, and candidate policies in the same scenes. Made once for all people of a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_ensemble, load_policy
from desirepath.learning.preferences.objectives import NAMES, preference_weights
from desirepath.learning.preferences.setup_settings import longest_simulated_s
from desirepath.learning.queries.manner_queries import MannerConfig, manner_pairs, separating
from desirepath.learning.queries.queries import QueryConfig, flaw, look_alike
from desirepath.learning.queries.varied_queries import draw_weights
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory, arrived

FIRST_SEED = 900  # of query scenes and reporting scenes: of no shipped set, no card and no other benchmark
MANNER_SEED = 2_900
MANNERS_PER_SCENE = 4
SETTINGS = 14
PER_SCENE = 2


@dataclass(frozen=True)
class AskedPairs:
    """Pairs to ask about and others, in other scenes, to be predicted. manners: how many to ask about, the first ones,
    are of policies in many manners."""

    trajectories: tuple[tuple[Trajectory, Trajectory], ...]
    differences: PairDifferences
    asked: NDArray[np.int64]
    test: NDArray[np.int64]
    manners: int = 0

    def better(self, scores: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) first minus second of scores of all trajectories in turn."""
        return scores[0::2] - scores[1::2]

    def with_manners(self, setup: str, seed: int, manners: int, others: int) -> AskedPairs:
        """Asked about are `others` of these pairs and the `manners` most telling ones of policies in many manners; what
        is predicted stays."""
        config = MannerConfig(QueryConfig(seed=FIRST_SEED + seed, max_duration_s=longest_simulated_s(setup)))
        scenes = scene_set(setup, manners, purpose=Purpose.QUERIES, seed=MANNER_SEED + seed)
        pairs = manner_pairs(setup, scenes, replace(config, pairs_per_scene=MANNERS_PER_SCENE))
        differences = PairDifferences.of(setup, pairs)
        chosen = separating(differences, list(range(len(pairs))), manners)
        old = [*self.asked[:others], *self.test]
        trajectories = [*(pairs[k] for k in chosen), *(self.trajectories[k] for k in old)]
        count = manners + len(self.asked[:others])
        together = differences[chosen].joined(self.differences[old])
        return AskedPairs(tuple(trajectories), together, np.arange(count), np.arange(count, len(trajectories)), manners)

    @cached_property
    def to_predict(self) -> PairDifferences:
        """What the answer to a question should tell about: pairs to ask about of policies as they are, evenly spread;
        of those in many manners where there are no others."""
        return self.differences[self.asked[self.manners :] if self.manners < len(self.asked) else self.asked].thinned()

    @property
    def in_turn(self) -> list[Trajectory]:
        return [trajectory for pair in self.trajectories for trajectory in pair]


def asked_pairs(setup: str, seed: int, *, asked: int, test: int) -> AskedPairs:
    """Conditioned policies at drawn weights, the ensemble and the base policy drive the same scenes; pairs of any two
    that arrive and look different."""
    scenes = scene_set(setup, (asked + test) // PER_SCENE * 2, purpose=Purpose.QUERIES, seed=FIRST_SEED + seed)
    conditioned = load_conditioned(f"{setup}/conditioned").as_trained()
    policies = [conditioned.at(weights) for weights in draw_weights(SETTINGS, FIRST_SEED + seed)]
    policies += [*load_ensemble(setup), load_policy(f"{setup}/base")]
    rolled_out = [_roll_out(policy, scenes) for policy in policies]
    rules = QueryConfig(max_duration_s=longest_simulated_s(setup))
    random = np.random.default_rng([seed, 51])
    pairs: list[tuple[Trajectory, Trajectory]] = []
    for row in range(len(scenes)):
        good = [k for k in range(len(policies)) if flaw(rolled_out[k][row], rules) is None]
        in_scene = 0
        for _ in range(3 * PER_SCENE if len(good) > 1 else 0):
            a, b = (rolled_out[k][row] for k in random.choice(good, 2, replace=False))
            if in_scene < PER_SCENE and not look_alike(a, b, rules):
                pairs.append((a, b))
                in_scene += 1
        if len(pairs) >= asked + test:
            break
    # The last scenes are never asked about: no scene is in both.
    borders = [k for k in range(1, len(pairs)) if pairs[k][0].scene.seed != pairs[k - 1][0].scene.seed]
    border = min(borders, key=lambda k: abs(k - (len(pairs) - test)))
    differences = PairDifferences.of(setup, pairs)
    return AskedPairs(tuple(pairs), differences, np.arange(border), np.arange(border, len(pairs)))


@dataclass(frozen=True)
class Candidates:
    """The base and the conditioned policy at settings, in the same scenes. rolled_out: by setting, then by scene."""

    setup: str
    scenes: tuple[Scene, ...]
    base: tuple[Trajectory, ...]
    rolled_out: tuple[tuple[Trajectory, ...], ...]

    @cached_property
    def arrived(self) -> NDArray[np.bool_]:
        """(settings, scenes) both the candidate and the base policy arrive."""
        return np.asarray(np.array([arrived(of) for of in self.rolled_out]) & arrived(self.base))

    @cached_property
    def differences(self) -> tuple[PairDifferences, ...]:
        """By setting, candidate minus base in every scene."""
        return tuple(PairDifferences.of(self.setup, list(zip(of, self.base, strict=True))) for of in self.rolled_out)


def candidate_settings() -> list[NDArray[np.float32]]:
    """No weight, each objective at a half and at full strength."""
    named: list[dict[str, float]] = [{}]
    named += [{name: strength} for strength in (0.5, 1.0) for name in NAMES]
    return [preference_weights(weights) for weights in named]


def candidates(setup: str, count: int, *, purpose: Purpose, seed: int) -> Candidates:
    """All candidates in `count` scenes of that purpose."""
    scenes = scene_set(setup, count, purpose=purpose, seed=FIRST_SEED + seed)
    conditioned = load_conditioned(f"{setup}/conditioned")
    rolled_out = tuple(tuple(_roll_out(conditioned.at(weights), scenes)) for weights in candidate_settings())
    return Candidates(setup, tuple(scenes), tuple(_roll_out(load_policy(f"{setup}/base"), scenes)), rolled_out)


def _roll_out(policy: Policy, scenes: Sequence[Scene]) -> list[Trajectory]:
    return list(rollout(get_setup(policy.setup), policy.rollout_policy, list(scenes)))

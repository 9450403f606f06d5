"""How policies differ from the base policy on average: what a choice among them by somebody's posterior sees."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from desirepath.learning.alignment.policy_library import LibraryMeasures
from desirepath.learning.measures.pairs import PairDifferences, measured
from desirepath.learning.measures.step_basis import Doubles, StepBasis
from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.step_weights import step_differences
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import arrived


def measure_against(
    base: Policy, policies: Iterable[Policy], basis: StepBasis, scenes: Sequence[Scene]
) -> LibraryMeasures:
    """All of them in the same scenes; means over those in which both arrive."""
    setup = get_setup(base.setup)
    usual = list(rollout(setup, base.rollout_policy, list(scenes)))
    known = {symmetry: measured(setup.name, usual, left_right_symmetry=symmetry) for symmetry in (False, True)}
    parts: dict[str, list[Doubles]] = {}
    for policy in policies:
        own = list(rollout(setup, policy.rollout_policy, list(scenes)))
        arrives = arrived(own)
        both = np.flatnonzero(arrives & arrived(usual))
        if not len(both):  # what never arrives gains nothing
            own, both = usual, np.arange(1)
        firsts, pairs = [own[k] for k in both], [(own[k], usual[k]) for k in both]
        measured_parts = {"steps": step_differences(basis, pairs).mean(0), "success": np.array(arrives.mean())}
        for symmetry, prefix in ((False, ""), (True, "mirrored_")):
            of_own = measured(setup.name, firsts, left_right_symmetry=symmetry)
            differences = PairDifferences.between(setup.name, of_own, known[symmetry][both])
            measured_parts |= {
                f"{prefix}seen": differences.seen.mean(0),
                f"{prefix}named": differences.named.mean(0),
                f"{prefix}embedding": differences.embedding.mean(0),
            }
        for key, value in measured_parts.items():
            parts.setdefault(key, []).append(value)
    of = {key: np.stack(values) for key, values in parts.items()}
    return LibraryMeasures(
        PairDifferences(setup.name, of["seen"], of["named"], of["embedding"]),
        PairDifferences(setup.name, of["seen"], of["mirrored_named"], of["mirrored_embedding"]),
        of["steps"],
        of["success"],
    )

"""From one person's answers to a policy that chooses per scene: which of the library's policies it has to choose from.

All ours; nothing is trained. Whether it is better for this person is asked afterwards, directly: it drives beside the
base policy, blind.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.alignment.policy_library import PolicyLibrary, expected_by_posterior, expected_gains
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.policies.choosing import Answers, ChoosingPolicy
from desirepath.learning.policies.shipped import load_conditioned, load_policy, load_policy_library, load_step_basis
from desirepath.learning.preferences.preferences import Preference, usable
from desirepath.learning.rewards.step_weights import step_differences

KEPT = 24
"""Policies to choose from beside the base policy: those of which most is expected on average. On 20 people of the
tuning families, nine answers each, 12 of them gain 69 % (median) of what all 99 do, 24 88 %; those that are worth most
together by their rollouts in 30 scenes gain less, 50 %, from 12 on."""


def answers_of(preferences: Sequence[Preference], *, left_right_symmetry: bool = False) -> Answers:
    """What one person chose. Raises LearningError without answers about two different trajectories of one setup, and
    where no step basis is shipped for it."""
    setup, kept = usable(preferences)
    pairs = [(one.chosen, one.rejected) for one in kept]
    basis = load_step_basis(setup.name)
    if basis is None:
        raise LearningError(f"setup = {setup.name!r}: no step basis is shipped for it")
    return Answers(
        PairDifferences.of(setup.name, pairs, left_right_symmetry=left_right_symmetry),
        step_differences(basis, pairs),
        np.ones(len(pairs), dtype=np.bool_),
        left_right_symmetry,
    )


def choose_each_scene(answers: Answers, *, kept: int = KEPT) -> ChoosingPolicy:
    """Of the setup's library the policies that are expected to gain most over the base policy, on average over scenes.

    Raises LearningError where the setup comes without policy library or step basis.
    """
    setup = answers.pairs.setup
    basis, library = load_step_basis(setup), load_policy_library(setup)
    if basis is None or library is None:
        raise LearningError(f"setup = {setup!r}: no policy library or no step basis is shipped for it")
    base, conditioned = load_policy(f"{setup}/base").without_critic(), load_conditioned(f"{setup}/conditioned")
    places = favourites(library, answers, kept)
    policies = (base, *(library.policy(int(place), conditioned, base).without_critic() for place in places))
    return ChoosingPolicy(setup, policies, basis, answers, scales_of(library, answers))


def scales_of(library: PolicyLibrary, answers: Answers) -> Doubles:
    """(2,) the largest gain that each posterior expects of any policy on average: in these, both count alike."""
    gains = expected_by_posterior(library.measures, *answers.believed)
    return np.array([max(float(np.abs(mean).max()), 1e-9) for mean, _ in gains])


def favourites(library: PolicyLibrary, answers: Answers, kept: int) -> NDArray[np.int64]:
    """Places of the policies that are expected to gain most on average, of those that are allowed, the best first."""
    gains = np.where(library.allowed, expected_gains(library.measures, *answers.believed), -np.inf)
    return np.argsort(-gains, kind="stable")[: min(kept, int(library.allowed.sum()))]

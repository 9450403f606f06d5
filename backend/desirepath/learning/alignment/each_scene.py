"""From one person's answers, or from those of several, to a policy that chooses per scene: which of the library's
policies it has to choose from.

All ours; nothing is trained. Whether it is better for a person is asked afterwards, directly: it drives beside the base
policy, blind. What several people want is tried on each of them before, who is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from desirepath.learning.alignment.policy_library import PolicyLibrary, expected_by_posterior, expected_gains
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.policies.choosing import Answers, Before, ChoosingPolicy, PeopleInGeneral
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy, load_policy_library, load_step_basis
from desirepath.learning.preferences.population_prior import EarlierPerson, fit_people, prior_of_earlier
from desirepath.learning.preferences.preferences import Preference, usable
from desirepath.learning.rewards.step_weights import step_differences

KEPT = 24
"""Policies to choose from beside the base policy: those of which most is expected on average. On 20 people of the
tuning families, nine answers each, 12 of them gain 69 % (median) of what all 99 do, 24 88 %; those that are worth most
together by their rollouts in 30 scenes gain less, 50 %, from 12 on."""


FEWEST_PEOPLE, MOST_PEOPLE = 5, 30
PREDICTED_FROM = 0.6
"""Of the answers of who is left out the others must predict so large a share, surely (95 %, over people): on the tuning
families people who have something in common mostly reach it (0.63 to 0.69 of 30), and those who have nothing, or want
one of three things, do not (at most 0.54). It was 0.55 until that had let people through who have nothing in common."""


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


def what_they_weigh(people: Sequence[Answers]) -> Before | None:
    """For the next one; None of nobody."""
    if not people:
        return None
    free = prior_of_earlier(people[0].setup, [EarlierPerson(one.pairs, one.chosen) for one in people])
    steps = fit_people([(one.steps, one.chosen) for one in people])
    return Before(free, steps) if free is not None else None


def choose_each_scene(
    answers: Answers | PeopleInGeneral, *, kept: int = KEPT, beside: Sequence[Policy] = ()
) -> ChoosingPolicy:
    """Of the setup's library the policies that are expected to gain most over the base policy, on average over scenes.
    beside: further ones to choose from, in their place (`kept` in all).

    Raises LearningError where the setup comes without policy library or step basis.
    """
    setup = answers.setup
    basis, library = load_step_basis(setup), load_policy_library(setup)
    if basis is None or library is None:
        raise LearningError(f"setup = {setup!r}: no policy library or no step basis is shipped for it")
    base, conditioned = load_policy(f"{setup}/base").without_critic(), load_conditioned(f"{setup}/conditioned")
    places = favourites(library, answers, kept - len(beside))
    policies = (base, *(library.policy(int(place), conditioned, base).without_critic() for place in places), *beside)
    return ChoosingPolicy(setup, policies, basis, answers, scales_of(library, answers))


def scales_of(library: PolicyLibrary, answers: Answers | PeopleInGeneral) -> Doubles:
    """(2,) the largest gain that each posterior expects of any policy on average: in these, both count alike."""
    gains = expected_by_posterior(library.measures, *answers.believed)
    return np.array([max(float(np.abs(mean).max()), 1e-9) for mean, _ in gains])


def favourites(library: PolicyLibrary, answers: Answers | PeopleInGeneral, kept: int) -> NDArray[np.int64]:
    """Places of the policies that are expected to gain most on average, of those that are allowed, the best first."""
    expected = expected_gains(library.measures, *answers.believed)
    gains = np.where(library.allowed, expected, -np.inf)
    return np.argsort(-gains, kind="stable")[: min(kept, int(library.allowed.sum()))]


def people_in_general(people: Sequence[Answers]) -> PeopleInGeneral:
    """Several people of one setup, each on their own scale. Raises LearningError where it has no policy library."""
    library = load_policy_library(people[0].setup)
    if library is None:
        raise LearningError(f"setup = {people[0].setup!r}: no policy library is shipped for it")
    return PeopleInGeneral(tuple(people), np.array([scales_of(library, one) for one in people]))


@dataclass(frozen=True)
class LeftOut:
    """What the others tell of each of several people. predicted: share of the answers of who is left out that the mean
    over the others predicts; at_least: its lower end, over people (95 %, one-sided)."""

    people: int
    predicted: float
    at_least: float

    @property
    def in_common(self) -> bool:
        return self.at_least >= PREDICTED_FROM


def leave_each_out(everybody: PeopleInGeneral) -> LeftOut:
    """Whether several people have so much in common that the others tell what one wants. Needs two people."""
    people, pairs = everybody.people, everybody.people[0].pairs
    for one in people[1:]:
        pairs = pairs.joined(one.pairs)
    steps = np.concatenate([one.steps for one in people])
    expected = np.stack(
        [
            free.advantages(pairs)[0] / scales[0] + by_steps.advantages(steps)[0] / scales[1]
            for (free, by_steps), scales in zip((one.believed for one in people), everybody.of_people, strict=True)
        ]
    )
    of = np.repeat(np.arange(len(people)), [len(one) for one in people])
    others = expected.sum(0) - expected[of, np.arange(len(of))]
    right = (others > 0) == np.concatenate([one.chosen for one in people])
    shares = np.array([right[of == k].mean() for k in range(len(people))])
    error = float(shares.std(ddof=1)) / math.sqrt(len(shares))
    mean = float(shares.mean())
    return LeftOut(len(people), mean, mean - float(student_t.ppf(0.95, len(shares) - 1)) * error)

"""What converged training on a simulated person's true reward gains: the yardstick of `benchmark people-policies`.

The library's best by the truth, then a search among its mixes by the truth, then training by the true reward from what
is best so far, in rounds, until a round gains nothing more. All is chosen in scenes that measure nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.alignment.mix_search import MixSearchConfig, search_mixes
from desirepath.learning.alignment.policy_library import PolicyLibrary
from desirepath.learning.measures.step_basis import Doubles
from desirepath.learning.measures.steps import SeenSteps
from desirepath.learning.people.families.base import FamilyMember, StepFamilyMember
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath_experiments.training.own_reward import OwnRewardConfig, tune_to_reward

SELECT_SEED = 7_700  # of no other
ENOUGH_SUCCESS = 0.96
NO_BETTER = 0.03
"""Of what is gained so far: a round that gains less more has converged."""


@dataclass(frozen=True)
class YardstickConfig:
    """rounds: at most so many, of so many updates each. scenes: in which the best so far is chosen."""

    seed: int = 0
    rounds: int = 3
    updates: int = 4_000
    scenes: int = 200
    generations: int = 10


@dataclass(frozen=True)
class Converged:
    """policy: what is best by the truth. steps: what each step of the way gained in the selection scenes."""

    policy: Policy
    steps: dict[str, float]


def true_scores(person: FamilyMember, trajectories: Sequence[Trajectory]) -> Doubles:
    """(n,) of whoever values steps or whole trajectories."""
    if isinstance(person, StepFamilyMember):
        steps = SeenSteps.of_trajectories(trajectories)
        return steps.means(person.step_scores(steps))
    return person.scores(trajectories)


def converged_on_the_truth(
    person: FamilyMember,
    reward: RewardModel | None,
    library: PolicyLibrary,
    conditioned: ConditionedPolicy,
    base: Policy,
    gains: Doubles,
    config: YardstickConfig,
) -> Converged:
    """gains (n,): what each of the library's truly gains. reward: of a step; None where they value no steps, then only
    the search is made."""
    setup, unit = get_setup(base.setup), person.unit(base.setup)

    def judged(policies: Sequence[Policy], scenes: Sequence[Scene]) -> tuple[Doubles, Doubles, Doubles]:
        usual = list(rollout(setup, base.rollout_policy, list(scenes)))
        at_base, rows = true_scores(person, usual), []
        for policy in policies:
            own = list(rollout(setup, policy.rollout_policy, list(scenes)))
            arrived = np.array([one.outcome == Outcome.SUCCESS for one in own])
            both = arrived & np.array([one.outcome == Outcome.SUCCESS for one in usual])
            if not both.any():
                rows.append((-np.inf, 0.0, np.inf))
                continue
            longer = np.array([a.duration_s - b.duration_s for a, b in zip(own, usual, strict=True)])[both].mean()
            gained = (true_scores(person, own) - at_base)[both].mean() / unit
            rows.append((float(gained), float(arrived.mean()), float(longer)))
        gained, success, longer_s = np.array(rows).T
        return gained, success, longer_s

    def best(policies: Sequence[Policy]) -> tuple[int, float]:
        gained, success, longer_s = judged(policies, selection)
        allowed = (success >= ENOUGH_SUCCESS) & (longer_s <= library.longest_s)
        gained = np.where(allowed, gained, -np.inf)
        return int(gained.argmax()), float(gained.max())

    selection = scene_set(base.setup, config.scenes, purpose=Purpose.ALIGN_SELECT, seed=SELECT_SEED + config.seed)
    search = MixSearchConfig(seed=config.seed, generations=config.generations)
    known = search_mixes(library, conditioned, base, gains, lambda p, scenes: judged(p, scenes)[0], search)
    first = library.policy(int(np.where(library.allowed, gains, -np.inf).argmax()), conditioned, base)
    found = [first, *(one.policy(library, conditioned.as_trained(), base) for one, _ in known[:4])]
    place, gained = best(found)
    policy, steps = found[place], {"library": best([first])[1], "search": gained}
    for turn in range(config.rounds if reward is not None else 0):
        settings = OwnRewardConfig(
            updates=config.updates,
            checkpoints=max(2, config.updates // 1_000),
            seed=config.seed + 10 * turn,
            gate=GateRule(scenes=50),
        )
        start = replace(policy, critic=base.critic, recovery_policies=(base.actor,), slowing=None)
        tuned = tune_to_reward(base, reward, settings, start=start).policy if reward is not None else start
        parts = (0.5, 1.0)
        along = [
            replace(
                tuned,
                actor=tuple(a + np.float32(part) * (b - a) for a, b in zip(policy.actor, tuned.actor, strict=True)),
            )
            for part in parts
        ]
        place, more = best([policy, *along])
        steps[f"trained_{turn + 1}"] = more
        if place:
            policy = along[place - 1]
        if more - gained < NO_BETTER * max(gained, 0.1):
            break
        gained = more
    return Converged(policy.without_critic(), steps)

"""What simulated people of one seed share: the pairs that they are asked about, pairs that are predicted, and what
every policy of the setup's library does in fresh scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.alignment.never_worse import JUDGING_SEED, SCENES
from desirepath.learning.alignment.policy_library import PolicyLibrary
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.measures.step_basis import StepBasis
from desirepath.learning.measures.steps import SeenSteps
from desirepath.learning.people.asked_pairs import FIRST_SEED, AskedPairs, asked_pairs
from desirepath.learning.people.families.base import FamilyMember, StepFamilyMember
from desirepath.learning.policies.choosing import Answers, Before, RolloutDifferences
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import (
    load_conditioned,
    load_policy,
    load_policy_library,
    load_queries,
    load_step_basis,
)
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.oracles import ResponseModel, judged
from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.preferences.spans import seen_in
from desirepath.learning.queries.choosing import STRATEGIES, Candidates
from desirepath.learning.queries.queries import Query
from desirepath.learning.rewards.step_weights import step_differences
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory, arrived

Doubles = NDArray[np.float64]
SELECT_SEED = 7_500  # of scenes of direct comparisons, of no card
COMPARED_SCENES = 30  # of which some are compared
REPORT_SEED = 50  # of fresh scenes


@dataclass(frozen=True)
class RobotOfLibrary:
    """What a setup's robot has without training: its base policy, the conditioned one, and the library of others."""

    setup: str
    base: Policy
    conditioned: ConditionedPolicy
    library: PolicyLibrary
    basis: StepBasis

    @classmethod
    def load(cls, setup: str, pretraining: str = "") -> RobotOfLibrary:
        """pretraining: a folder with the setup's folder in it; empty: what is shipped. Raises LearningError where the
        setup has no step basis or no policy library."""
        basis, library = load_step_basis(setup), load_policy_library(setup)
        if basis is None or library is None:
            raise LearningError(f"setup = {setup!r}: no step basis or no policy library is shipped for it")
        if not pretraining:
            return cls(setup, load_policy(f"{setup}/base"), load_conditioned(f"{setup}/conditioned"), library, basis)
        folder = Path(pretraining) / setup
        return cls(
            setup,
            Policy.load(folder / "base.npz"),
            ConditionedPolicy.load(folder / "conditioned.npz"),
            PolicyLibrary.load(folder / "policy_library.npz"),
            basis,
        )

    def policy(self, place: int) -> Policy:
        return self.library.policy(place, self.conditioned, self.base)

    def roll_out_library(self, scenes: Sequence[Scene]) -> Rollouts:
        """All policies in the same scenes."""
        usual = roll_out(self.base, scenes)
        own = [roll_out(self.policy(place), scenes) for place in range(len(self.library))]
        return Rollouts.of(self.basis, usual, own)


@dataclass(frozen=True)
class Rollouts:
    """What each of n policies does in the same scenes. trajectories: policy by policy, scene by scene; differences:
    from what the base policy does."""

    usual: list[Trajectory]
    trajectories: list[list[Trajectory]]
    differences: RolloutDifferences

    @classmethod
    def of(cls, basis: StepBasis, usual: list[Trajectory], own: list[list[Trajectory]]) -> Rollouts:
        return cls(usual, own, RolloutDifferences.of(basis, usual, own))

    def joined(self, basis: StepBasis, more: list[list[Trajectory]]) -> Rollouts:
        """With those of further policies."""
        ours, theirs = self.differences, RolloutDifferences.of(basis, self.usual, more)
        differences = RolloutDifferences(
            np.concatenate([ours.usable, theirs.usable]),
            ours.pairs.joined(theirs.pairs),
            np.concatenate([ours.steps, theirs.steps]),
        )
        return Rollouts(self.usual, [*self.trajectories, *more], differences)

    @property
    def everything(self) -> list[Trajectory]:
        """The base policy's first."""
        return [*self.usual, *(trajectory for own in self.trajectories for trajectory in own)]


@dataclass(frozen=True)
class QueryPool:
    """Recorded pairs to ask about, and how they differ by everything that answers are read by."""

    queries: Sequence[Query]
    seen: Doubles
    pairs: PairDifferences
    steps: Doubles

    @classmethod
    def load(cls, name: str, basis: StepBasis) -> QueryPool:
        """Of a query set by its name or file."""
        queries = load_queries(name)
        both = [(query.trajectory_a, query.trajectory_b) for query in queries.queries]
        differences = PairDifferences.of(basis.setup, both)
        return cls(queries.queries, seen_in(queries.queries), differences, step_differences(basis, both))

    @property
    def in_turn(self) -> list[Trajectory]:
        return [trajectory for query in self.queries for trajectory in (query.trajectory_a, query.trajectory_b)]

    def answers(self, asked: Sequence[int], chosen: Sequence[bool], before: Before | None = None) -> Answers:
        """What somebody said to some of them; chosen: A, of each. before: by the light of what others weigh."""
        rows = list(asked)
        return Answers(self.pairs[rows], self.steps[rows], np.array(chosen, dtype=np.bool_), before=before)


@dataclass(frozen=True)
class Asked:
    """Everything that one person answered to recorded pairs. answers: after how many of them what was known."""

    after: Mapping[int, Answers]

    @property
    def whole(self) -> Answers:
        return self.after[max(self.after)]


@dataclass(frozen=True)
class PeopleRoom:
    """What is made once for everybody of a seed."""

    seed: int
    robot: RobotOfLibrary
    pool: QueryPool
    predicted: AskedPairs
    rollouts: Rollouts
    judged: dict[int, tuple[PairDifferences | None, list[Trajectory]]] = field(default_factory=dict)

    @classmethod
    def open(cls, seed: int, robot: RobotOfLibrary, pool: QueryPool, *, test: int, scenes: int) -> PeopleRoom:
        setup = robot.setup
        predicted = asked_pairs(setup, seed, asked=test // 2, test=test)
        fresh = scene_set(setup, scenes, purpose=Purpose.REPORT, seed=FIRST_SEED + REPORT_SEED + seed)
        return cls(seed, robot, pool, predicted, robot.roll_out_library(fresh))

    @property
    def setup(self) -> str:
        return self.robot.setup

    @property
    def usual(self) -> list[Trajectory]:
        """The base policy in the fresh scenes."""
        return self.rollouts.usual

    @property
    def scenes(self) -> list[Scene]:
        return [trajectory.scene for trajectory in self.usual]

    @cached_property
    def compared(self) -> Rollouts:
        """The library in scenes that are shown and report nothing."""
        return self.robot.roll_out_library(
            scene_set(self.setup, COMPARED_SCENES, purpose=Purpose.ALIGN_SELECT, seed=SELECT_SEED + self.seed)
        )

    @cached_property
    def usual_at_gate(self) -> list[Trajectory]:
        """The base policy where it is judged whether a policy is surely better for somebody."""
        scenes = scene_set(self.setup, SCENES, purpose=Purpose.GATE, seed=JUDGING_SEED + self.seed)
        return roll_out(self.robot.base, scenes)

    def judge(self, policy: Policy) -> tuple[PairDifferences | None, list[Trajectory]]:
        """What the policy's rollouts differ by from the base policy's where both arrive, as `better_for_person` sees
        it (None where it is the same policy), and its rollouts in the fresh scenes."""
        own = roll_out(policy, [trajectory.scene for trajectory in self.usual_at_gate])
        rows = np.flatnonzero(arrived(own) & arrived(self.usual_at_gate))
        both = [(own[k], self.usual_at_gate[k]) for k in rows]
        moved = any(not np.array_equal(mine.poses, usual.poses) for mine, usual in both)
        return PairDifferences.of(self.setup, both) if moved else None, roll_out(policy, self.scenes)

    def judge_place(self, place: int) -> tuple[PairDifferences | None, list[Trajectory]]:
        """The same of a policy of the library, which many have."""
        if place not in self.judged:
            self.judged[place] = self.judge(self.robot.policy(place))
        return self.judged[place]

    def ask(
        self,
        person: FamilyMember,
        choose: str,
        answering: ResponseModel,
        after: Sequence[int],
        before: Before | None = None,
    ) -> Asked:
        """As a study does: each question is the one that the strategy asks after the answers before."""
        strategy, pool = STRATEGIES[choose], self.pool
        scores = [answers_of(one, pool.in_turn, answering, self.setup, self.seed) for one in (person.after(0), person)]
        random = np.random.default_rng([self.seed, 61])
        posterior: Any = Posterior.prior(self.setup)
        if strategy.beyond:
            posterior = FreePosterior.prior(self.setup, FreeConfig(), before.free if before else None)
        differences: Any = pool.pairs if strategy.beyond else pool.seen
        left = [int(k) for k in random.permutation(len(pool.queries))]
        asked: list[int] = []
        chosen: list[bool] = []
        for n in range(max(after)):
            candidates = Candidates(differences, left)
            asked.append(left.pop(strategy.ask_next(posterior, candidates, random).index))
            now = person.after(n) is person
            chosen.append(bool(scores[int(now)][asked[-1]]))
            row = asked[-1:] if strategy.beyond else asked[-1]
            posterior = posterior.updated(differences[row], chosen[-1])
        return Asked({n: pool.answers(asked[:n], chosen[:n], before) for n in after})


def answers_of(
    person: FamilyMember, in_turn: Sequence[Trajectory], answering: ResponseModel, setup: str, seed: int, which: int = 0
) -> NDArray[np.bool_]:
    """(n,) whether the first of each pair would be chosen, as the response model strays. in_turn: first, second, first,
    ...; which: of several such series of one person."""
    unit = person.unit(setup)
    scores = judged(lambda some: person.scores(some) / unit, list(in_turn), answering)
    better = scores[0::2] - scores[1::2]
    random = np.random.default_rng([seed, 62, which])
    strays, coin = random.random(len(better)) < answering.lapse_rate, random.random(len(better)) < 0.5
    undecided = (better == 0) | (np.abs(better) < answering.indifference)
    return np.where(undecided, coin, (better > 0) != strays)


def true_scores(person: FamilyMember, trajectories: Sequence[Trajectory]) -> Doubles:
    """(n,) of whoever values steps or whole trajectories."""
    if isinstance(person, StepFamilyMember):
        steps = SeenSteps.of_trajectories(trajectories)
        return steps.means(person.step_scores(steps))
    return person.scores(trajectories)


def roll_out(policy: Policy, scenes: Sequence[Scene]) -> list[Trajectory]:
    return list(rollout(get_setup(policy.setup), policy.rollout_policy, list(scenes)))

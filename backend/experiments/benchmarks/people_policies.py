"""`benchmark people-policies`: what the robot of somebody outside the list gains, at once and after fine-tuning.

Everybody here is simulated. The yardstick is the same training on their true reward.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.experiments.benchmarks.people_rooms import FIRST_SEED, AskedPairs, asked_pairs
from backend.jobs.free_form import UPDATES
from backend.learning.alignment.gate import GateRule
from backend.learning.alignment.never_worse import better_for_person
from backend.learning.alignment.own_reward import OwnRewardConfig, tune_to_reward
from backend.learning.errors import LearningError
from backend.learning.measures.step_basis import seen_steps
from backend.learning.people.card import member, people_card
from backend.learning.people.families.base import FamilyMember, StepFamilyMember
from backend.learning.people.families.changing import ChangingMember
from backend.learning.people.families.thresholds import ThresholdsMember
from backend.learning.policies.evaluate import wilson
from backend.learning.policies.policy import Policy
from backend.learning.policies.shipped import load_policy, load_step_basis
from backend.learning.preferences.free_posterior import FreePosterior
from backend.learning.preferences.step_posterior import StepPosterior
from backend.learning.rewards.reward_model import Floats, RewardModel
from backend.learning.rewards.step_weights import StepWeightsRewardModel, step_differences
from backend.learning.scene_sets import Purpose, scene_set
from backend.simulation.fast import rollout
from backend.simulation.setups import get_setup
from backend.simulation.trajectory import Outcome, Trajectory

Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class PeoplePoliciesConfig:
    """families: of the card; people: of each, from number `first` on. answers: asked, each the one that tells most.
    scenes: fresh ones in which gains are measured. trained: updates of the yardstick's training."""

    families: tuple[str, ...]
    people: int = 4
    first: int = 0
    answers: int = 15
    seed: int = 0
    pool: int = 200
    test: int = 200
    scenes: int = 400
    trained: int = UPDATES["conditioning_search"]


@dataclass(frozen=True)
class TrueReward(RewardModel):
    """A simulated person's own reward of every step; stored nowhere."""

    kind = "true"

    setup: str
    person: StepFamilyMember
    reduction = "mean"

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        steps = seen_steps(get_setup(self.setup), observations, actions, next_observations)
        return self.person.step_scores(steps).astype(np.float32)

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        raise LearningError("a simulated person's reward is not stored")

    @classmethod
    def from_arrays(cls, meta: dict[str, Any], arrays: dict[str, Floats]) -> TrueReward:
        raise LearningError("a simulated person's reward is not stored")


def benchmark_people_policies(
    setup: str,
    config: PeoplePoliciesConfig,
    on_person: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Result: {"simulated": True, "setup", "people", "persons"}, and for `at_once` and `refined`: "raised_at_once" and
    "harmed_at_once" (shown and truly worse) with Wilson intervals, "share_at_once" (median over people whom the
    yardstick helps), "success_at_once", "shown_at_once", "seconds_at_once" (of processor), ... A person's gains are in
    typical differences of a pair, in fresh scenes in which both policies arrive; their share is null where they value
    no steps: nothing can be trained on such a truth. Raises LearningError for unknown families, and where the setup has
    no step basis."""
    card = people_card()
    unknown = [name for name in config.families if name not in card.families]
    if unknown:
        raise LearningError(f"family = {unknown[0]!r}: families are {', '.join(card.families)}")
    room = _Room.of(setup, config)
    persons = []
    for name in (
        f"{family}:{k}" for family in config.families for k in range(config.first, config.first + config.people)
    ):
        persons.append({"person": name} | _measured(member(name, setup), room, config))
        if on_person:
            on_person(persons[-1])
    return {"simulated": True, "setup": setup, "config": asdict(config), **summary_of(persons), "persons": persons}


def summary_of(persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Over all people."""
    found: dict[str, Any] = {"people": len(persons)}
    for when in ("at_once", "refined"):
        raised = wilson(sum(one[f"gain_{when}"] > 0 for one in persons), len(persons))
        shares = [one[f"share_{when}"] for one in persons if one[f"share_{when}"] is not None]
        shown = [one for one in persons if one[f"shown_{when}"]]
        harmed = wilson(sum(one[f"gain_{when}"] < 0 for one in shown), len(persons))
        found |= {
            f"raised_{when}": raised.value,
            f"raised_{when}_interval": [raised.low, raised.high],
            f"gain_{when}": float(np.median([one[f"gain_{when}"] for one in persons])),
            f"share_{when}": float(np.median(shares)) if shares else None,
            f"success_{when}": float(np.mean([one[f"success_{when}"] for one in persons])),
            f"shown_{when}": len(shown) / len(persons),
            f"harmed_{when}": harmed.value,
            f"harmed_{when}_interval": [harmed.low, harmed.high],
            f"seconds_{when}": float(np.median([one[f"seconds_{when}"] for one in persons])),
        }
    trained = [one["gain_trained"] for one in persons if one["gain_trained"] is not None]
    return found | {
        "gain_trained": float(np.median(trained)) if trained else None,
        "accuracy": float(np.mean([one["accuracy"] for one in persons])),
    }


@dataclass(frozen=True)
class _Room:
    """What all people share."""

    setup: str
    pairs: AskedPairs
    seen: Doubles
    base: Policy
    rolled_out: tuple[Trajectory, ...]

    @classmethod
    def of(cls, setup: str, config: PeoplePoliciesConfig) -> _Room:
        basis = load_step_basis(setup)
        if basis is None:
            raise LearningError(f"setup = {setup!r}: no step basis is shipped for it")
        base = load_policy(f"{setup}/base")
        scenes = scene_set(setup, config.scenes, purpose=Purpose.REPORT, seed=FIRST_SEED + 50 + config.seed)
        pairs = asked_pairs(setup, config.seed, asked=config.pool, test=config.test)
        seen = step_differences(basis, pairs.trajectories)
        return cls(setup, pairs, seen, base, tuple(rollout(get_setup(setup), base.rollout_policy, scenes)))


def _measured(person: FamilyMember, room: _Room, config: PeoplePoliciesConfig) -> dict[str, Any]:
    person = person.after(config.answers)  # who it is when all is answered
    better = room.pairs.better(person.scores(room.pairs.in_turn)) > 0
    posterior, asked = _asked(better, room, config)
    basis = load_step_basis(room.setup)
    assert basis is not None  # noqa: S101  the room has seen it
    model = StepWeightsRewardModel(room.setup, basis, posterior.mean.astype(np.float32))
    believed = FreePosterior.from_answers(room.pairs.differences[asked], better[asked])
    test = room.pairs.test
    result: dict[str, Any] = {
        "accuracy": float(((posterior.predict(room.seen[test]) > 0.5) == better[test]).mean()),
        "something_else": believed.something_else(),
    }
    rewards: list[tuple[str, RewardModel | None, int]] = [
        ("at_once", model, UPDATES["instant"]),
        ("refined", model, UPDATES["conditioning_search"]),
        ("trained", _true_reward(person, room.setup), config.trained),
    ]
    for when, reward, updates in rewards:
        if reward is None:
            result |= {f"gain_{when}": None}
            continue
        began = time.process_time()
        settings = OwnRewardConfig(updates=updates, checkpoints=max(3, updates // 1_000), seed=config.seed)
        policy = tune_to_reward(room.base, reward, replace(settings, gate=GateRule(scenes=100))).policy
        result |= {f"seconds_{when}": round(time.process_time() - began, 1)}
        result |= {f"{key}_{when}": value for key, value in _gained(person, policy, room).items()}
        if when != "trained":
            verdict = better_for_person(believed, policy, room.base, seed=config.seed)
            result |= {f"probability_{when}": verdict.probability_better, f"shown_{when}": verdict.passed}
    whole = result["gain_trained"]
    for when in ("at_once", "refined"):
        result[f"share_{when}"] = result[f"gain_{when}"] / whole if whole is not None and whole > 0.05 else None
    return result


def _asked(better: NDArray[np.bool_], room: _Room, config: PeoplePoliciesConfig) -> tuple[StepPosterior, list[int]]:
    """The posterior after `answers` right answers, each to the pair whose answer tells most."""
    left = list(np.random.default_rng([config.seed, 61]).permutation(room.pairs.asked))
    asked: list[int] = []
    posterior = StepPosterior.from_answers(room.seen[:0], [])
    for _ in range(config.answers):
        asked.append(int(left.pop(int(posterior.information_bits(room.seen[left]).argmax()))))
        posterior = StepPosterior.from_answers(room.seen[asked], better[asked])
    return posterior, asked


def _true_reward(person: FamilyMember, setup: str) -> TrueReward | None:
    """What each step is worth to them; None for people who value no steps."""
    one = person.at_first if isinstance(person, ChangingMember) else person
    if isinstance(one, ThresholdsMember):
        one = replace(one, tie_breaker=0.0)  # which counts the trajectory's steps
    return TrueReward(setup, one) if isinstance(one, StepFamilyMember) else None


def _gained(person: FamilyMember, policy: Policy, room: _Room) -> dict[str, float]:
    own = rollout(get_setup(room.setup), policy.rollout_policy, [one.scene for one in room.rolled_out])
    arrived = np.array([one.outcome == Outcome.SUCCESS for one in own])
    both = arrived & np.array([one.outcome == Outcome.SUCCESS for one in room.rolled_out])
    gained = (person.scores(own) - person.scores(room.rolled_out))[both] / person.unit(room.setup)
    return {
        "gain": float(gained.mean()) if len(gained) else -1.0,
        "preferred": float(((gained > 0) + 0.5 * (gained == 0)).mean()) if len(gained) else 0.0,
        "success": float(arrived.mean()),
    }

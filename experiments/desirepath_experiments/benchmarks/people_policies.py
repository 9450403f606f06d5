"""`benchmark people-policies`: what the robot of somebody outside the list gains, at once and after fine-tuning.

Everybody here is simulated. The yardstick knows their true reward: the library's best by it, trained on by it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import interval, resampled_rows, wilson
from desirepath.learning.alignment.mix_search import MixSearchConfig
from desirepath.learning.alignment.never_worse import better_for_person
from desirepath.learning.alignment.own_policy import search_policy
from desirepath.learning.alignment.policy_library import PolicyLibrary, best_of
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.step_basis import StepBasis, seen_steps
from desirepath.learning.people.asked_pairs import FIRST_SEED, AskedPairs, asked_pairs
from desirepath.learning.people.card import member, people_card
from desirepath.learning.people.families.base import FamilyMember, StepFamilyMember
from desirepath.learning.people.families.changing import ChangingMember
from desirepath.learning.people.families.thresholds import ThresholdsMember
from desirepath.learning.people.rows import bins_of, calibration_error
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy, load_policy_library, load_step_basis
from desirepath.learning.preferences.free_posterior import FreePosterior
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.rewards.reward_model import Floats, RewardModel
from desirepath.learning.rewards.step_weights import step_differences
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath_experiments.benchmarks.successor_features import SuccessorFeatures
from desirepath_experiments.benchmarks.true_yardstick import YardstickConfig, converged_on_the_truth, true_scores

Doubles = NDArray[np.float64]
TRUE_SCENES = 30  # in which the library's best by somebody's true score is looked for
SELECT_SEED = 7_500  # of these, of no card
SHOWN = ("at_once", "refined")
BESIDE = "successor"


@dataclass(frozen=True)
class PeoplePoliciesConfig:
    """families: of the card; people: of each, from number `first` on, for each seed others. answers: asked, each the
    one that tells most. scenes: fresh ones in which gains are measured. fine_tuning: whether the search behind it
    is made; trained: updates of a round of the yardstick's training; 0: none. pretraining: a folder with base,
    conditioned and library of the setup's folder in it; empty: what is shipped.
    successors: policies of the library whose successor features are measured beside it; 0: none."""

    families: tuple[str, ...]
    people: int = 4
    first: int = 0
    answers: int = 15
    seeds: tuple[int, ...] = (0,)
    pool: int = 200
    test: int = 200
    scenes: int = 400
    fine_tuning: bool = True
    trained: int = 4_000
    pretraining: str = ""
    successors: int = 0


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


def benchmark_seeds(
    setup: str,
    config: PeoplePoliciesConfig,
    on_person: Callable[[dict[str, Any]], None] | None = None,
    known: Sequence[dict[str, Any]] = (),
    more: Mapping[str, FamilyMember] | None = None,
) -> dict[str, Any]:
    """Result: {"simulated": True, "setup", "people", "families", "persons"}, and for `at_once` and `refined`:
    "raised_at_once" and "harmed_at_once" (shown and truly worse) with Wilson intervals, "share_at_once" (median over
    people whom the yardstick helps), "success_at_once", "shown_at_once", "seconds_at_once" (of processor), ... A
    person's gains are in typical differences of a pair, in fresh scenes in which both policies arrive. The yardstick is
    what converged training on their true reward gains (`trained`, `true_yardstick.py`), or, where nothing is trained,
    the library's best by their true score (`best`). known: persons of a run of the same settings that was stopped;
    families take turns, so that what there is then is of all of them. more: further people by name, such as a reward
    file's. Raises LearningError for unknown families, and where the setup has no step basis or no policy library."""
    card = people_card()
    unknown = [name for name in config.families if name not in card.families]
    if unknown:
        raise LearningError(f"family = {unknown[0]!r}: families are {', '.join(card.families)}")
    persons, done = [], {(one["seed"], one["person"]): one for one in known}
    for seed in config.seeds:
        first, room = config.first + seed * config.people, None
        names = [f"{family}:{k}" for k in range(first, first + config.people) for family in config.families]
        for name in [*names, *(more or {})]:
            if (seed, name) not in done:
                room = room or _Room.of(setup, config, seed)
                person = (more or {}).get(name) or member(name, setup)
                done[seed, name] = {"person": name, "seed": seed} | _measured(person, room, config)
                if on_person:
                    on_person(done[seed, name])
            persons.append(done[seed, name])
    return result_of(setup, config, persons)


def with_shares(
    result: dict[str, Any], setup: str, config: PeoplePoliciesConfig, more: Mapping[str, FamilyMember]
) -> dict[str, Any]:
    """A result of `benchmark people` with `share_at_once`, `success_at_once` and `gain_at_once` of every family: of the
    policy that a library has for the same people at once, against the library's best by their true score."""
    persons = benchmark_seeds(setup, config, more=more)["persons"]
    keys = ("share_at_once", "success_at_once", "gain_at_once")

    def of(*names: str) -> dict[str, Any]:
        found = summary_of([one for one in persons if one["person"].startswith(names)])
        return {key: found[key] for key in keys}

    everybody = tuple(dict.fromkeys(one["person"].partition(":")[0] for one in persons))
    rows = [row | (of(*more) if row["family"] == "file" else of(f"{row['family']}:")) for row in result["rows"]]
    return result | of(*everybody) | {"rows": rows}


def result_of(setup: str, config: PeoplePoliciesConfig, persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of so many persons; of a run that is not through, too."""
    summary = {"simulated": True, "setup": setup, "config": asdict(config), **summary_of(persons)}
    families = {
        family: summary_of([one for one in persons if one["person"].startswith(f"{family}:")])
        for family in config.families
    }
    return {**summary, "families": families, "persons": list(persons)}


def known_persons(path: Path, setup: str, config: PeoplePoliciesConfig) -> list[dict[str, Any]]:
    """Of a file that a run of the same settings left; none where there is no such file."""
    if not path.is_file():
        return []
    found = json.loads(path.read_text())
    same = found.get("setup") == setup and found.get("config") == json.loads(json.dumps(asdict(config)))
    return list(found["persons"]) if same else []


def summary_of(persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Over all people; only how many there are where there is nobody."""
    found: dict[str, Any] = {"people": len(persons)}
    if not persons:
        return found
    for when in SHOWN:
        if persons[0][f"gain_{when}"] is None:
            continue
        raised = wilson(sum(one[f"gain_{when}"] > 0 for one in persons), len(persons))
        shares = [one[f"share_{when}"] for one in persons if one[f"share_{when}"] is not None]
        shown = [one for one in persons if one[f"shown_{when}"]]
        harmed = wilson(sum(one[f"gain_{when}"] < 0 for one in shown), len(persons))
        middle = _median_interval(shares) if shares else (None, None)
        found |= {
            f"raised_{when}": raised.value,
            f"raised_{when}_interval": [raised.low, raised.high],
            f"gain_{when}": float(np.median([one[f"gain_{when}"] for one in persons])),
            f"share_{when}": float(np.median(shares)) if shares else None,
            f"share_{when}_interval": middle,
            f"longer_s_{when}": float(np.mean([one[f"longer_s_{when}"] for one in persons])),
            f"success_{when}": float(np.mean([one[f"success_{when}"] for one in persons])),
            f"shown_{when}": len(shown) / len(persons),
            f"harmed_{when}": harmed.value,
            f"harmed_{when}_interval": [harmed.low, harmed.high],
            f"seconds_{when}": float(np.median([one[f"seconds_{when}"] for one in persons])),
        }
    if f"gain_{BESIDE}" in persons[0]:
        raised = wilson(sum(one[f"gain_{BESIDE}"] > 0 for one in persons), len(persons))
        shares = [one[f"share_{BESIDE}"] for one in persons if one[f"share_{BESIDE}"] is not None]
        found |= {
            f"raised_{BESIDE}": raised.value,
            f"raised_{BESIDE}_interval": [raised.low, raised.high],
            f"gain_{BESIDE}": float(np.median([one[f"gain_{BESIDE}"] for one in persons])),
            f"share_{BESIDE}": float(np.median(shares)) if shares else None,
            f"success_{BESIDE}": float(np.mean([one[f"success_{BESIDE}"] for one in persons])),
            f"longer_s_{BESIDE}": float(np.mean([one[f"longer_s_{BESIDE}"] for one in persons])),
        }
    trained = [one["gain_trained"] for one in persons if one["gain_trained"] is not None]
    bins = [one["bins"] for one in persons if "bins" in one]  # files of before have none
    return found | {
        "gain_best": float(np.median([one["gain_best"] for one in persons])),
        "gain_trained": float(np.median(trained)) if trained else None,
        "success_base": _mean_of(persons, "success_base"),
        "accuracy": float(np.mean([one["accuracy"] for one in persons])),
        "claimed": float(np.mean([one["claimed"] for one in persons])),
        "calibration_error": calibration_error(bins) if bins else None,
    }


def _mean_of(persons: Sequence[dict[str, Any]], key: str) -> float | None:
    """None where a file of before does not say it."""
    found = [one[key] for one in persons if key in one]
    return float(np.mean(found)) if found else None


def _median_interval(values: Sequence[float]) -> tuple[float, float]:
    """95 % of the median over people, by resampling them."""
    found = np.asarray(values)
    estimate = interval(float(np.median(found)), np.median(found[resampled_rows(len(found))], axis=1))
    return estimate.low, estimate.high


@dataclass(frozen=True)
class _Room:
    """What all people share. by_policy: the library's rollouts, of the base policy first, in the same few scenes."""

    setup: str
    seed: int
    pairs: AskedPairs
    seen: Doubles
    base: Policy
    basis: StepBasis
    library: PolicyLibrary
    conditioned: ConditionedPolicy
    rolled_out: tuple[Trajectory, ...]
    by_policy: tuple[Trajectory, ...]
    fresh: dict[int, list[Trajectory]]
    successors: SuccessorFeatures | None

    @classmethod
    def of(cls, setup: str, config: PeoplePoliciesConfig, seed: int) -> _Room:
        basis, library = load_step_basis(setup), load_policy_library(setup)
        if basis is None or library is None:
            raise LearningError(f"setup = {setup!r}: no step basis or no policy library is shipped for it")
        base, conditioned = load_policy(f"{setup}/base"), load_conditioned(f"{setup}/conditioned")
        if config.pretraining:
            folder = Path(config.pretraining) / setup
            base, conditioned = Policy.load(folder / "base.npz"), ConditionedPolicy.load(folder / "conditioned.npz")
            library = PolicyLibrary.load(folder / "policy_library.npz")
        scenes = scene_set(setup, config.scenes, purpose=Purpose.REPORT, seed=FIRST_SEED + 50 + seed)
        pairs = asked_pairs(setup, seed, asked=config.pool, test=config.test)
        seen = step_differences(basis, pairs.trajectories)
        few = scene_set(setup, TRUE_SCENES, purpose=Purpose.ALIGN_SELECT, seed=SELECT_SEED + seed)
        policies = [base, *(library.policy(place, conditioned, base) for place in range(len(library)))]
        by_policy = tuple(one for policy in policies for one in _rolled_out(policy, few))
        usual = tuple(_rolled_out(base, scenes))
        spread = np.flatnonzero(library.allowed)
        spread = spread[np.linspace(0, len(spread) - 1, config.successors).astype(int)]
        of = [library.policy(int(place), conditioned, base) for place in spread]
        successors = SuccessorFeatures.fitted([base, *of], base, basis) if config.successors else None
        return cls(setup, seed, pairs, seen, base, basis, library, conditioned, usual, by_policy, {}, successors)

    @property
    def scenes(self) -> list[Scene]:
        """The fresh ones."""
        return [one.scene for one in self.rolled_out]

    def policy(self, place: int) -> Policy:
        return self.library.policy(place, self.conditioned, self.base)

    def in_fresh_scenes(self, place: int) -> list[Trajectory]:
        """What the library's policy of that place does; many people have the same one."""
        if place not in self.fresh:
            self.fresh[place] = _rolled_out(self.policy(place), self.scenes)
        return self.fresh[place]


def _rolled_out(policy: Policy, scenes: Sequence[Scene]) -> list[Trajectory]:
    return list(rollout(get_setup(policy.setup), policy.rollout_policy, list(scenes)))


def _measured(person: FamilyMember, room: _Room, config: PeoplePoliciesConfig) -> dict[str, Any]:
    person = person.after(config.answers)  # who it is when all is answered
    better = room.pairs.better(person.scores(room.pairs.in_turn)) > 0
    posterior, asked = _asked(better, room, config)
    believed = FreePosterior.from_answers(room.pairs.differences[asked], better[asked])
    test = room.pairs.test
    claimed = posterior.predict(room.seen[test])
    result: dict[str, Any] = {
        "accuracy": float(((claimed > 0.5) == better[test]).mean()),
        "claimed": float(np.maximum(claimed, 1 - claimed).mean()),
        "something_else": believed.something_else(),
        "bins": bins_of(np.maximum(claimed, 1 - claimed), (claimed > 0.5) == better[test]),
    }
    began = time.process_time()
    place = best_of(room.library, believed, posterior)
    result |= {"place": place, "seconds_at_once": round(time.process_time() - began, 1)}
    did = {"at_once": room.in_fresh_scenes(place)}
    policies = {"at_once": room.policy(place)}
    if config.fine_tuning:
        began = time.process_time()
        settings, both = MixSearchConfig(seed=room.seed), (room.conditioned, room.base)
        own = search_policy(room.library, place, both, room.basis, (believed, posterior), settings)
        policies["refined"], did["refined"] = own.policy, _rolled_out(own.policy, room.scenes)
        result |= {"chosen": own.chosen, "seconds_refined": round(time.process_time() - began, 1)}
    if room.successors is not None:
        acting = room.successors.at(posterior.mean)
        did[BESIDE] = list(rollout(get_setup(room.setup), acting, room.scenes))
    by_truth = _gains_by_the_truth(person, room)
    did["best"] = room.in_fresh_scenes(int(by_truth.argmax()))
    if config.trained:
        yardstick = YardstickConfig(seed=room.seed, updates=config.trained)
        true = converged_on_the_truth(
            person, _true_reward(person, room.setup), room.library, room.conditioned, room.base, by_truth, yardstick
        )
        did["trained"] = _rolled_out(true.policy, room.scenes)
        result["yardstick"] = true.steps
    for when in ("at_once", "refined", BESIDE, "best", "trained"):
        if when not in did and when == BESIDE:
            continue
        if when not in did:
            result |= {f"gain_{when}": None}
            continue
        result |= {
            f"{key}_{when}": value for key, value in _compared(person, did[when], room.rolled_out, room.setup).items()
        }
        if when in SHOWN:
            verdict = better_for_person(believed, policies[when], room.base, seed=room.seed)
            result |= {f"probability_{when}": verdict.probability_better, f"shown_{when}": verdict.passed}
    result["success_base"] = float(np.mean([one.outcome == Outcome.SUCCESS for one in room.rolled_out]))
    whole = result["gain_best"] if result["gain_trained"] is None else result["gain_trained"]
    for when in (*SHOWN, BESIDE):
        gain = result.get(f"gain_{when}")
        result[f"share_{when}"] = gain / whole if gain is not None and whole > 0.05 else None
    return result


def _gains_by_the_truth(person: FamilyMember, room: _Room) -> Doubles:
    """(n,) of the library; minus infinity for those that are nobody's."""
    scores = true_scores(person, room.by_policy).reshape(-1, TRUE_SCENES)
    arrived = np.array([one.outcome == Outcome.SUCCESS for one in room.by_policy]).reshape(-1, TRUE_SCENES)
    both = arrived[1:] & arrived[0]
    gains = np.where(both, scores[1:] - scores[0], 0.0).sum(1) / np.maximum(both.sum(1), 1)
    return np.where(room.library.allowed, gains, -np.inf)


def _asked(better: NDArray[np.bool_], room: _Room, config: PeoplePoliciesConfig) -> tuple[StepPosterior, list[int]]:
    """The posterior after `answers` right answers, each to the pair whose answer tells most."""
    left = list(np.random.default_rng([room.seed, 61]).permutation(room.pairs.asked))
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


def _compared(
    person: FamilyMember, own: Sequence[Trajectory], usual: Sequence[Trajectory], setup: str
) -> dict[str, float]:
    """In typical differences of a pair, against what the base policy did in the same scenes."""
    arrived = np.array([one.outcome == Outcome.SUCCESS for one in own])
    both = arrived & np.array([one.outcome == Outcome.SUCCESS for one in usual])
    gained = (true_scores(person, own) - true_scores(person, usual))[both] / person.unit(setup)
    longer = np.array([one.duration_s - other.duration_s for one, other in zip(own, usual, strict=True)])[both]
    return {
        "gain": float(gained.mean()) if len(gained) else -1.0,
        "preferred": float(((gained > 0) + 0.5 * (gained == 0)).mean()) if len(gained) else 0.0,
        "success": float(arrived.mean()),
        "longer_s": float(longer.mean()) if len(longer) else 0.0,
    }

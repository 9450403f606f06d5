"""`desirepath benchmark people-policies`: what the robot of somebody outside the list gains.

Everybody here is simulated. The yardstick knows their true score: the library's best by it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from desirepath.analysis.estimates import interval, resample_rows, wilson
from desirepath.learning.alignment.each_scene import KEPT, choose_each_scene, scales_of
from desirepath.learning.alignment.never_worse import better_for_person
from desirepath.learning.alignment.policy_library import best_of
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.steps import SeenSteps
from desirepath.learning.people.asked_pairs import FIRST_SEED, AskedPairs, asked_pairs
from desirepath.learning.people.card import member, people_card
from desirepath.learning.people.families.base import FamilyMember, StepFamilyMember
from desirepath.learning.people.reward_file import read_reward
from desirepath.learning.people.rows import bins_of, calibration_error
from desirepath.learning.policies.choosing import Answers
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.rewards.step_weights import step_differences
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory, arrived
from desirepath_experiments.benchmarks.own_senses import (
    Driven,
    by_true_score,
    drive_by_senses,
    jerk,
    shares,
    train_on_true_score,
)
from desirepath_experiments.benchmarks.people import (
    FAMILY,
    REWARD,
    Doubles,
    RobotOfLibrary,
    measure_everybody,
    read_families,
    roll_out,
)
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.benchmarks.scene_choice import BASE, SceneCandidates

NEEDED = 5
"""In so many of up to six direct comparisons with the base policy a choice per scene must have been preferred for it to
be shown. Four while its caution was 0.4. With 0.2, which tuning families chose, three of 120 shown robots were truly
worse with four, one with five: so five, set after 60 people of families that nothing was tuned on, confirmed on 60
others."""
NOTHING = 0.01  # typical differences: a mean gain within this is none
TRUE_SCENES = 30  # in which the library's best by somebody's true score is looked for
SELECT_SEED = 7_500  # of these, of no card
IN_EACH_SCENE = ("each_scene", "best_in_each", "direct_before", "direct_after")


@pydantic.dataclasses.dataclass(frozen=True)
class PeoplePoliciesConfig:
    """Who is asked, what their robot is given, and where it is measured."""

    setup: Annotated[str, Field(description="study_room or open_field: with step basis and library.")] = "study_room"
    family: Annotated[str, Field(description=FAMILY)] = "tuning"
    people: Annotated[int, Field(ge=1, le=1_000, description="Of each family and seed.")] = 4
    first: Annotated[int, Field(ge=0, description="Number of the first person of each family.")] = 0
    answers: Annotated[int, Field(ge=2, description="Each to the pair that tells most, right but for lapses.")] = 15
    seeds: Annotated[
        tuple[int, ...], Field(min_length=1, description="FIRST-LAST; each has pairs, scenes and people of its own.")
    ] = (0,)
    reward: Annotated[Path | None, Field(description=REWARD)] = None
    each_scene: Annotated[bool, Field(description="Also a choice per scene among all rollouts.")] = False
    kept: Annotated[int, Field(ge=1, description="Policies that a choice per scene has to choose from.")] = KEPT
    direct: Annotated[
        int, Field(ge=0, description="So many of the answers, the last, compare the choice per scene with the base.")
    ] = 0
    own_senses: Annotated[
        int, Field(ge=0, description="In so many of the scenes the choice per scene also drives by the robot's senses.")
    ] = 0
    trained_s: Annotated[
        float, Field(ge=0, description="Beside it the base policy, trained so long on their true score of every step.")
    ] = 0.0
    lapses: Annotated[float, Field(ge=0, le=1, description="Share of answers that are drawn by lot.")] = 0.0
    pretraining: Annotated[
        str,
        Field(description="A folder with SETUP/base.npz, conditioned.npz and policy_library.npz; default shipped."),
    ] = ""
    pool: Annotated[int, Field(ge=2, description="Pairs to ask about.")] = 200
    test: Annotated[int, Field(ge=1, description="Pairs that are predicted.")] = 200
    scenes: Annotated[int, Field(ge=1, description="Fresh ones in which gains are measured.")] = 400

    @property
    def families(self) -> tuple[str, ...]:
        return () if self.reward is not None else read_families(self.family)


@dataclass(frozen=True)
class _Room:
    """What all people share. by_policy: the library's rollouts, of the base policy first, in the same few scenes."""

    seed: int
    pairs: AskedPairs
    seen: Doubles
    robot: RobotOfLibrary
    usual: list[Trajectory]
    by_policy: list[Trajectory]
    fresh: dict[int, list[Trajectory]] = field(default_factory=dict)

    @cached_property
    def candidates(self) -> SceneCandidates:
        """The whole library in the fresh scenes."""
        own = [self.in_fresh_scenes(place) for place in range(len(self.robot.library))]
        return SceneCandidates.of(self.robot, self.usual, own, FreeConfig().posterior.left_right_symmetry)

    @cached_property
    def asked_directly(self) -> SceneCandidates:
        """The same in scenes that are shown and report nothing."""
        n = TRUE_SCENES
        by_policy = [self.by_policy[first : first + n] for first in range(0, len(self.by_policy), n)]
        return SceneCandidates.of(self.robot, by_policy[0], by_policy[1:], FreeConfig().posterior.left_right_symmetry)

    @classmethod
    def open(cls, seed: int, config: PeoplePoliciesConfig, robot: RobotOfLibrary) -> _Room:
        setup = config.setup
        scenes = scene_set(setup, config.scenes, purpose=Purpose.REPORT, seed=FIRST_SEED + 50 + seed)
        pairs = asked_pairs(setup, seed, asked=config.pool, test=config.test)
        few = scene_set(setup, TRUE_SCENES, purpose=Purpose.ALIGN_SELECT, seed=SELECT_SEED + seed)
        policies = [robot.base, *map(robot.policy, range(len(robot.library)))]
        by_policy = [trajectory for policy in policies for trajectory in roll_out(policy, few)]
        seen = step_differences(robot.basis, pairs.trajectories)
        return cls(seed, pairs, seen, robot, roll_out(robot.base, scenes), by_policy)

    def in_fresh_scenes(self, place: int) -> list[Trajectory]:
        """What the library's policy of that place does; many people have the same one."""
        if place not in self.fresh:
            self.fresh[place] = roll_out(self.robot.policy(place), [trajectory.scene for trajectory in self.usual])
        return self.fresh[place]


def benchmark_people_policies(
    config: PeoplePoliciesConfig, progress: Progress, more: Mapping[str, FamilyMember] | None = None
) -> dict[str, Any]:
    """As `measure_everybody`; over all and by family in "families", of the library's policy that they have at once:
    "raised_at_once" and "harmed_at_once" (shown and truly worse) with Wilson intervals, "share_at_once" (of what the
    library's best by their true score gains, median over people whom that helps), "success_at_once", "shown_at_once",
    "seconds_at_once" (of processor), ... With `each_scene` the same of a choice per scene (`scene_choice.py`), without
    any gate, and of "best_in_each", by the true score. A person's gains are in typical differences of a pair, in fresh
    scenes in which both policies arrive. more: further people by name. Raises LearningError for unknown families, and
    where the setup has no step basis or no policy library."""
    card = people_card()
    unknown = [name for name in config.families if name not in card.families]
    if unknown:
        raise LearningError(f"family = {unknown[0]!r}: families are {', '.join(card.families)}")
    robot, further = RobotOfLibrary.load(config.setup, config.pretraining), dict(more or {})
    if config.reward is not None:
        further[config.reward.stem] = read_reward(config.reward, config.setup)

    def everybody(seed: int) -> Iterator[tuple[str, str, FamilyMember]]:
        first = config.first + seed * config.people
        for number in range(first, first + config.people):
            for family in config.families:
                yield family, f"{family}:{number}", member(f"{family}:{number}", config.setup)
        yield from (("file", name, person) for name, person in further.items())

    def summarise(persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
        families = {name: _summarise([row for row in persons if row["family"] == name]) for name in config.families}
        return _summarise(persons) | {"families": families}

    return measure_everybody(
        config,
        everybody,
        lambda seed: _Room.open(seed, config, robot),
        lambda person, room: _measure(person, room, config),
        summarise,
        progress,
    )


def with_shares(
    result: dict[str, Any], config: PeoplePoliciesConfig, more: Mapping[str, FamilyMember]
) -> dict[str, Any]:
    """A result of `benchmark people` with `share_at_once`, `success_at_once` and `gain_at_once` of every family: of the
    policy that a library has for the same people at once, against the library's best by their true score."""
    persons = benchmark_people_policies(config, Progress(), more)["persons"]

    def of(family: str | None) -> dict[str, Any]:
        summary = _summarise([person for person in persons if family in (None, person["family"])])
        return {key: summary[key] for key in ("share_at_once", "success_at_once", "gain_at_once")}

    return result | of(None) | {"rows": [row | of(row["family"]) for row in result["rows"]]}


def true_scores(person: FamilyMember, trajectories: Sequence[Trajectory]) -> Doubles:
    """(n,) of whoever values steps or whole trajectories."""
    if isinstance(person, StepFamilyMember):
        steps = SeenSteps.of_trajectories(trajectories)
        return steps.means(person.step_scores(steps))
    return person.scores(trajectories)


def _measure(person: FamilyMember, room: _Room, config: PeoplePoliciesConfig) -> dict[str, Any]:
    """One person, as they are when all is answered."""
    person, robot = person.after(config.answers), room.robot
    truly = room.pairs.better(person.scores(room.pairs.in_turn)) > 0
    better = _with_lapses(truly, room, config.lapses)
    posterior, answered = _ask(better, room, config.answers)
    believed = FreePosterior.from_answers(room.pairs.differences[answered], better[answered])
    test = room.pairs.test
    claimed = posterior.predict(room.seen[test])
    sure, right = np.maximum(claimed, 1 - claimed), (claimed > 0.5) == truly[test]
    began = time.process_time()
    place = best_of(robot.library, believed, posterior)
    result: dict[str, Any] = {
        "accuracy": float(right.mean()),
        "claimed": float(sure.mean()),
        "something_else": believed.something_else(),
        "bins": bins_of(sure, right),
        "place": place,
        "seconds_at_once": round(time.process_time() - began, 1),
        "success_base": float(arrived(room.usual).mean()),
    }
    did = {"at_once": room.in_fresh_scenes(place)}
    did["best"] = room.in_fresh_scenes(int(_true_gains(person, room).argmax()))
    if config.each_scene:
        some = room.candidates
        every = [*some.usual, *(trajectory for own in some.trajectories for trajectory in own)]
        answers = Answers(room.pairs.differences[answered], room.seen[answered], better[answered])
        did["each_scene"] = some.driven(_places(some, answers, config))
        did["best_in_each"] = some.driven(some.true_best(true_scores(person, every)))
    if config.direct:
        judged = _ask_directly(person, better, room, config)
        result["direct_wins"], result["direct_asked"] = judged.wins, judged.asked
        did |= {
            when: room.candidates.driven(_places(room.candidates, known, config))
            for when, known in judged.known.items()
        }
    if config.own_senses:
        result |= _by_senses(
            person, Answers(room.pairs.differences[answered], room.seen[answered], better[answered]), room, config
        )
    for when, trajectories in did.items():
        result |= {f"{key}_{when}": value for key, value in _compare(person, trajectories, room.usual).items()}
    verdict = better_for_person(believed, robot.policy(place), robot.base, seed=room.seed)
    result |= {"probability_at_once": verdict.probability_better, "shown_at_once": verdict.passed}
    whole = result["gain_best"]
    result["share_at_once"] = result["gain_at_once"] / whole if whole > 0.05 else None
    return result


def _by_senses(person: FamilyMember, answers: Answers, room: _Room, config: PeoplePoliciesConfig) -> dict[str, Any]:
    """The choice by what the robot knows there: its gains, and what training gains in the same scenes."""
    usual, base = room.usual[: config.own_senses], room.robot.base
    scenes = [trajectory.scene for trajectory in usual]
    policy = choose_each_scene(answers, kept=config.kept)
    driven = {
        "at_start": Driven(rollout(get_setup(config.setup), policy.rollout_policy, scenes), {}),
        "by_senses": drive_by_senses(policy, scenes),
        "by_senses_truly": drive_by_senses(policy, scenes, by_true_score(person)),
    }
    trained = train_on_true_score(person, base, config.trained_s, room.seed) if config.trained_s else None
    if trained is not None:
        driven["trained"] = Driven(roll_out(trained, scenes), {})
    result: dict[str, Any] = {"jerk_base": jerk(usual)}
    for when, one in driven.items():
        compared = _compare(person, one.trajectories, usual) | one.told
        result |= {f"{key}_{when}": value for key, value in compared.items()}
    return result


def _with_lapses(better: NDArray[np.bool_], room: _Room, share: float, which: int = 0) -> NDArray[np.bool_]:
    """What is answered where a share of the answers is drawn by lot, another one for whoever answers otherwise."""
    random = np.random.default_rng([room.seed, 73, which, int(better.sum())])
    return np.where(random.random(len(better)) < share, random.random(len(better)) < 0.5, better)


def _places(some: SceneCandidates, answers: Answers, config: PeoplePoliciesConfig) -> NDArray[np.int64]:
    return some.places(answers, scales_of(some.robot.library, answers), config.kept)


def _true_gains(person: FamilyMember, room: _Room) -> Doubles:
    """(n,) of the library; minus infinity for those that are nobody's."""
    scores = true_scores(person, room.by_policy).reshape(-1, TRUE_SCENES)
    in_time = arrived(room.by_policy).reshape(-1, TRUE_SCENES)
    both = in_time[1:] & in_time[0]
    gains = np.where(both, scores[1:] - scores[0], 0.0).sum(1) / np.maximum(both.sum(1), 1)
    return np.where(room.robot.library.allowed, gains, -np.inf)


def _ask(better: NDArray[np.bool_], room: _Room, answers: int) -> tuple[StepPosterior, list[int]]:
    """The posterior after right answers, each to the pair whose answer tells most."""
    left = list(np.random.default_rng([room.seed, 61]).permutation(room.pairs.asked))
    answered: list[int] = []
    posterior = StepPosterior.from_answers(room.seen[:0], [])
    for _ in range(answers):
        answered.append(int(left.pop(int(posterior.information_bits(room.seen[left]).argmax()))))
        posterior = StepPosterior.from_answers(room.seen[answered], better[answered])
    return posterior, answered


@dataclass(frozen=True)
class _Directly:
    """asked, wins: comparisons of the choice per scene with the base policy, and in how many it was chosen. known: the
    answers before them and with them, by the names that the result has for these."""

    asked: int
    wins: int
    known: dict[str, Answers]


def _ask_directly(
    person: FamilyMember, better: NDArray[np.bool_], room: _Room, config: PeoplePoliciesConfig
) -> _Directly:
    """The last answers are about what would be shown: by what the first ones tell, in scenes of their own, drawn by lot
    among those in which it drives otherwise."""
    _, answered = _ask(better, room, config.answers - config.direct)
    before = Answers(room.pairs.differences[answered], room.seen[answered], better[answered])
    some = room.asked_directly
    places = _places(some, before, config)
    otherwise = np.random.default_rng([room.seed, 67]).permutation(np.flatnonzero(places != BASE))[: config.direct]
    own, usual = some.driven(places), some.usual
    asked = [trajectory for k in otherwise for trajectory in (own[k], usual[k])]
    scores = person.scores(asked) if asked else np.zeros(0)
    chosen = _with_lapses(scores[0::2] > scores[1::2], room, config.lapses, 1)
    rows = some.rows(places, otherwise)
    after = Answers(
        before.pairs.joined(some.differences.pairs[rows]),
        np.concatenate([before.steps, some.differences.steps[rows]]),
        np.concatenate([before.chosen, chosen]),
    )
    return _Directly(len(otherwise), int(chosen.sum()), {"direct_before": before, "direct_after": after})


def _compare(person: FamilyMember, own: Sequence[Trajectory], usual: Sequence[Trajectory]) -> dict[str, float]:
    """In typical differences of a pair, against what the base policy did in the same scenes."""
    both = arrived(own) & arrived(usual)
    gained = (true_scores(person, own) - true_scores(person, usual))[both] / person.unit(own[0].scene.setup)
    longer = np.array([first.duration_s - other.duration_s for first, other in zip(own, usual, strict=True)])[both]
    return {
        "gain": float(gained.mean()) if len(gained) else -1.0,
        "changed": float((gained != 0).mean()) if len(gained) else 0.0,
        "worse": float((gained < 0).mean()) if len(gained) else 0.0,
        "preferred": float(((gained > 0) + 0.5 * (gained == 0)).mean()) if len(gained) else 0.0,
        "success": float(arrived(own).mean()),
        "longer_s": float(longer.mean()) if len(longer) else 0.0,
    }


def _summarise(persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Over all people; only how many there are where there is nobody."""
    summary: dict[str, Any] = {"people": len(persons)}
    if not persons:
        return summary
    raised = wilson(sum(person["gain_at_once"] > 0 for person in persons), len(persons))
    shares = [person["share_at_once"] for person in persons if person["share_at_once"] is not None]
    shown = [person for person in persons if person["shown_at_once"]]
    harmed = wilson(sum(person["gain_at_once"] < 0 for person in shown), len(persons))
    summary |= {
        "raised_at_once": raised.value,
        "raised_at_once_interval": [raised.low, raised.high],
        "gain_at_once": float(np.median([person["gain_at_once"] for person in persons])),
        "share_at_once": float(np.median(shares)) if shares else None,
        "share_at_once_interval": _median_interval(shares) if shares else (None, None),
        "longer_s_at_once": float(np.mean([person["longer_s_at_once"] for person in persons])),
        "success_at_once": float(np.mean([person["success_at_once"] for person in persons])),
        "shown_at_once": len(shown) / len(persons),
        "harmed_at_once": harmed.value,
        "harmed_at_once_interval": [harmed.low, harmed.high],
        "seconds_at_once": float(np.median([person["seconds_at_once"] for person in persons])),
    }
    for when in (one for one in IN_EACH_SCENE if f"gain_{one}" in persons[0]):
        gains = [person[f"gain_{when}"] for person in persons]
        harmed = wilson(sum(gain < -NOTHING for gain in gains), len(gains))
        summary |= {
            f"gain_{when}": float(np.median(gains)),
            f"gain_{when}_interval": _median_interval(gains),
            f"gain_{when}_quarter": float(np.quantile(gains, 0.25)),
            f"gain_{when}_least": min(gains),
            f"raised_{when}": float(np.mean([gain > NOTHING for gain in gains])),
            f"harmed_{when}": harmed.value,
            f"harmed_{when}_interval": [harmed.low, harmed.high],
            f"worse_{when}": float(np.mean([person[f"worse_{when}"] for person in persons])),
            f"changed_{when}": float(np.mean([person[f"changed_{when}"] for person in persons])),
            f"success_{when}": float(np.mean([person[f"success_{when}"] for person in persons])),
        }
    if "direct_wins" in persons[0]:
        summary |= _shown_directly(persons)
    if "gain_by_senses" in persons[0]:
        summary |= _of_senses(persons)
    return summary | {
        "gain_best": float(np.median([person["gain_best"] for person in persons])),
        **{key: float(np.mean([person[key] for person in persons])) for key in ("success_base", "accuracy", "claimed")},
        "calibration_error": calibration_error([person["bins"] for person in persons]),
    }


def _of_senses(persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of each way of driving, over people; shares: of what training on their true score gains, where that is some."""
    found: dict[str, Any] = {"success_of_base": float(np.mean([person["success_base"] for person in persons]))}
    for when in ("at_start", "by_senses", "by_senses_truly", "trained"):
        driven = [person for person in persons if f"gain_{when}" in person]
        if not driven:
            continue
        gains = [person[f"gain_{when}"] for person in driven]
        found |= {
            f"gain_{when}": float(np.median(gains)),
            f"gain_{when}_interval": _median_interval(gains),
            f"gain_{when}_quarter": float(np.quantile(gains, 0.25)),
            f"gain_{when}_least": min(gains),
            f"success_{when}": float(np.mean([person[f"success_{when}"] for person in driven])),
        }
        for key in ("switches", "jerk", "decision_ms"):
            if f"{key}_{when}" in driven[0]:
                found[f"{key}_{when}"] = float(np.median([person[f"{key}_{when}"] for person in driven]))
        of_training = shares(driven, f"gain_{when}", "gain_trained")
        if of_training and when != "trained":
            found[f"share_{when}"] = float(np.median(of_training))
            found[f"share_{when}_interval"] = _median_interval(of_training)
            found[f"share_{when}_quarter"] = float(np.quantile(of_training, 0.25))
    return found


def _shown_directly(persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is shown, and whom it harms, where those direct answers decide it that did not choose it."""
    shown = [person for person in persons if person["direct_wins"] >= NEEDED]
    found: dict[str, Any] = {"shown_directly": len(shown) / len(persons)}
    for when in ("direct_before", "direct_after"):
        gains = [person[f"gain_{when}"] for person in shown]
        harmed = sum(gain < -NOTHING for gain in gains)
        for among, count in (("all", len(persons)), ("shown", len(shown))):
            of = wilson(harmed, count) if count else None
            found[f"harmed_{when}_of_{among}"] = [of.value, of.low, of.high] if of else None
        found[f"raised_{when}_of_shown"] = float(np.mean([gain > NOTHING for gain in gains])) if gains else None
    return found


def _median_interval(values: Sequence[float]) -> tuple[float, float]:
    """95 % of the median over people, by resampling them."""
    numbers = np.asarray(values)
    estimate = interval(float(np.median(numbers)), np.median(numbers[resample_rows(len(numbers))], axis=1))
    return estimate.low, estimate.high

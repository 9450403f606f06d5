"""`desirepath benchmark people-harm`: how many people are shown a policy as theirs that is worse for them.

The same steps as an alignment job takes (`jobs/aligning.py`, `jobs/free_form.py`), without training: the policy
conditioned on the nine objectives, else the library's best, each only where it is surely better. All are simulated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import pydantic
from pydantic import Field
from scipy.stats import beta

from desirepath.jobs.free_form import SOMETHING_ELSE
from desirepath.learning.alignment.gate import surely_better
from desirepath.learning.alignment.never_worse import JUDGING_SEED, SCENES
from desirepath.learning.alignment.policy_library import best_of
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.people.asked_pairs import FIRST_SEED, AskedPairs, asked_pairs
from desirepath.learning.people.asked_people import NINE, answers_of, people_of
from desirepath.learning.people.card import people_card, response_models
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.oracles import ResponseModel
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.learning.preferences.sureness import Sureness
from desirepath.learning.rewards.step_weights import step_differences
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.scene import Scene
from desirepath.simulation.trajectory import Trajectory, arrived
from desirepath_experiments.benchmarks.people import (
    Doubles,
    RobotOfLibrary,
    measure_everybody,
    read_families,
    roll_out,
)
from desirepath_experiments.benchmarks.results import Progress

REPORT_SEED = 400  # of fresh scenes, beyond those of the other benchmarks of people


@pydantic.dataclasses.dataclass(frozen=True)
class PeopleHarmConfig:
    """Who is asked, and where their true gain is measured."""

    setup: Annotated[str, Field(description="study_room or open_field: with step basis and library.")] = "study_room"
    family: Annotated[str, Field(description="Families of the card and nine, comma-separated; or all.")] = "all"
    people: Annotated[int, Field(ge=1, le=1_000, description="Of each family and seed.")] = 15
    first: Annotated[int, Field(ge=0, description="Number of the first person of each family.")] = 200
    seeds: Annotated[
        tuple[int, ...], Field(min_length=1, description="FIRST-LAST; each has pairs and scenes of its own.")
    ] = (0, 1, 2, 3)
    response_model: Annotated[str, Field(description="How they answer: right, lapses, ... of the card.")] = "right"
    answers: Annotated[int, Field(ge=2, description="Each to the pair that tells most.")] = 15
    pool: Annotated[int, Field(ge=2, description="Pairs to ask about.")] = 300
    manners: Annotated[int, Field(ge=0, description="Of these, of policies in many manners.")] = 150
    test: Annotated[int, Field(ge=1, description="Pairs that are predicted.")] = 200
    scenes: Annotated[int, Field(ge=1, description="Fresh ones in which the true gain is measured.")] = 300
    particles: Annotated[int, Field(ge=1, description="Of the posterior over the nine.")] = 20_000

    @property
    def families(self) -> tuple[str, ...]:
        named = read_families(self.family)
        return (*named, NINE) if self.family == "all" else named


@dataclass
class _Room:
    """What all people of one seed share. by_place: what a library's policy did, kept once somebody had it chosen."""

    seed: int
    pairs: AskedPairs
    seen: Doubles
    robot: RobotOfLibrary
    judge: list[Scene]
    report: list[Scene]
    usual: tuple[list[Trajectory], list[Trajectory]]
    by_place: dict[int, tuple[PairDifferences | None, list[Trajectory]]] = field(default_factory=dict)

    @classmethod
    def open(cls, seed: int, config: PeopleHarmConfig, robot: RobotOfLibrary) -> _Room:
        setup = config.setup
        pairs = asked_pairs(setup, seed, asked=config.pool, test=config.test)
        pairs = pairs.with_manners(setup, seed, config.manners, config.pool - config.manners)
        judge = list(scene_set(setup, SCENES, purpose=Purpose.GATE, seed=JUDGING_SEED + seed))
        report = list(scene_set(setup, config.scenes, purpose=Purpose.REPORT, seed=FIRST_SEED + REPORT_SEED + seed))
        usual = roll_out(robot.base, judge), roll_out(robot.base, report)
        return cls(seed, pairs, step_differences(robot.basis, pairs.trajectories), robot, judge, report, usual)

    def compare(self, policy: Policy) -> tuple[PairDifferences | None, list[Trajectory]]:
        """What the policy's rollouts differ by from the base policy's where both arrive, as `better_for_person` sees
        it (None where it is the same policy), and its rollouts in fresh scenes."""
        own = roll_out(policy, self.judge)
        rows = np.flatnonzero(arrived(own) & arrived(self.usual[0]))
        both = [(own[k], self.usual[0][k]) for k in rows]
        moved = any(not np.array_equal(mine.poses, usual.poses) for mine, usual in both)
        return PairDifferences.of(self.robot.setup, both) if moved else None, roll_out(policy, self.report)

    def compare_place(self, place: int) -> tuple[PairDifferences | None, list[Trajectory]]:
        """The same of a policy of the library."""
        if place not in self.by_place:
            self.by_place[place] = self.compare(self.robot.policy(place))
        return self.by_place[place]


def benchmark_people_harm(config: PeopleHarmConfig, progress: Progress) -> dict[str, Any]:
    """As `measure_everybody`; over all, by family in "families" and by seed in "seeds": "people", "shown", "harmed"
    (shown, and worse by their true score in fresh scenes), "harmed_rate" of all people and "harmed_of_shown" with exact
    95 % intervals (Clopper-Pearson), "gain" (median of the shown, typical differences), "withheld_better" (shown
    nothing, though better for them), "accuracy", "claimed". Raises LearningError for unknown names, and where the setup
    has no step basis or no policy library."""
    robot = RobotOfLibrary.load(config.setup)
    answering = ResponseModel(**response_models([config.response_model])[config.response_model])
    for family in config.families:
        if family != NINE:
            people_card().family(family)

    def everybody(seed: int) -> Iterator[tuple[str, str, FamilyMember]]:
        first = config.first + seed * config.people
        people = {family: people_of(family, config.people, config.setup, first) for family in config.families}
        for turn in zip(*(of.items() for of in people.values()), strict=True):
            for family, (name, person) in zip(people, turn, strict=True):
                yield family, name, person

    def summarise(persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
        families = {name: [row for row in persons if row["family"] == name] for name in config.families}
        seeds = {str(seed): [row for row in persons if row["seed"] == seed] for seed in config.seeds}
        return {
            **_summarise(persons),
            "families": {name: _summarise(of) for name, of in families.items()},
            "seeds": {name: _summarise(of) for name, of in seeds.items()},
        }

    return measure_everybody(
        config,
        everybody,
        lambda seed: _Room.open(seed, config, robot),
        lambda person, room: _measure(person, room, answering, config),
        summarise,
        progress,
    )


def _measure(person: FamilyMember, room: _Room, answering: ResponseModel, config: PeopleHarmConfig) -> dict[str, Any]:
    """One person: asked, predicted, judged, shown or not."""
    pairs, now, setup = room.pairs, person.after(config.answers), config.setup
    answers = {
        False: answers_of(person.after(0), pairs, answering, setup, room.seed),
        True: answers_of(now, pairs, answering, setup, room.seed),
    }
    believed = FreePosterior.prior(setup, FreeConfig(posterior=PosteriorConfig(particles=config.particles)))
    left, answered = list(pairs.asked), []
    for n in range(config.answers):
        answered.append(left.pop(int(believed.bits_about(pairs.differences[left], pairs.to_predict).argmax())))
        first_chosen = bool(answers[person.after(n) is now][answered[-1]] > 0)
        believed = believed.updated(pairs.differences[[answered[-1]]], first_chosen)
    probable = believed.predict(pairs.differences[pairs.test])
    truth = pairs.better(now.scores(pairs.in_turn))[pairs.test] > 0
    something_else = believed.something_else()
    way, (differences, own) = "nine", room.compare(room.robot.conditioned.at(believed.objectives.mean_weights()))
    sure = Sureness.of(believed, differences)
    if not surely_better(sure) and something_else >= SOMETHING_ELSE:
        place = best_of(room.robot.library, believed, StepPosterior.from_answers(room.seen[answered], believed.chosen))
        way, (differences, own) = "library", room.compare_place(place)
        sure = Sureness.of(believed, differences)
    both = arrived(own) & arrived(room.usual[1])
    gained = (now.scores(own) - now.scores(room.usual[1]))[both] / now.unit(setup)
    return {
        "accuracy": float(((probable > 0.5) == truth).mean()),
        "claimed": float(np.maximum(probable, 1 - probable).mean()),
        "something_else": something_else,
        "way": way,
        "probability_better": sure.better,
        "probability_clearly_better": sure.clearly,
        "shown": surely_better(sure),
        "gain": float(gained.mean()),
        "gain_error": float(gained.std() / np.sqrt(len(gained))),
        "success": float(arrived(own).mean()),
    }


def _summarise(persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    if not persons:
        return {"people": 0}
    shown = [person for person in persons if person["shown"]]
    harmed = [person for person in shown if person["gain"] < 0]
    return {
        "people": len(persons),
        "shown": len(shown),
        "shown_rate": round(len(shown) / len(persons), 4),
        "harmed": len(harmed),
        "harmed_rate": round(len(harmed) / len(persons), 4),
        "harmed_rate_interval": clopper_pearson(len(harmed), len(persons)),
        "harmed_of_shown_interval": clopper_pearson(len(harmed), len(shown)) if shown else None,
        "worst": round(min((person["gain"] for person in shown), default=0.0), 4),
        "gain": round(float(np.median([person["gain"] for person in shown])), 4) if shown else None,
        "withheld_better": sum(person["gain"] > 0 for person in persons if not person["shown"]),
        "success": round(float(np.mean([person["success"] for person in shown])), 4) if shown else None,
        "accuracy": round(float(np.mean([person["accuracy"] for person in persons])), 4),
        "claimed": round(float(np.mean([person["claimed"] for person in persons])), 4),
    }


def clopper_pearson(hits: int, n: int) -> list[float]:
    """The exact 95 % interval of a share (Clopper and Pearson 1934)."""
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0
    return [round(low, 4), round(high, 4)]

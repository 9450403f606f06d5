"""What a choice per scene by everybody before gives to somebody new: `python -m
desirepath_experiments.benchmarks.people_in_general OUT SEED...`. A settled question's script; its result stays."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logsumexp

from desirepath.learning.alignment.each_scene import leave_each_out
from desirepath.learning.alignment.policy_library import DOUBT, expected_by_posterior
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.people.card import member
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.people.families.mixture import mix_members
from desirepath.learning.policies.choosing import CAUTION, Answers, PeopleInGeneral
from desirepath.learning.preferences.advantage_process import AdvantageProcess
from desirepath.learning.preferences.population_prior import EarlierPerson, prior_of_earlier
from desirepath.learning.preferences.step_posterior import STRENGTHS
from desirepath_experiments.benchmarks.people import RobotOfLibrary
from desirepath_experiments.benchmarks.people_before import fit_hierarchy
from desirepath_experiments.benchmarks.people_policies import (
    PeoplePoliciesConfig,
    _ask,
    _compare,
    _places,
    _Room,
)

SETUP = "study_room"
BEFORE, NEW = (5, 10, 30), 10
SCENES, ANSWERED, KEPT = 40, 15, 24
MIXED = ("network", "deep_network", "thresholds", "lexicographic", "context", "mixture")
MIXED_TUNING = ("network", "thresholds", "lexicographic", "mixture")
TUNING = ("common:network", "common:mixture", "family:thresholds", "family:lexicographic", "mixed_tuning", "tastes:network")
HELD_OUT = (
    "common:deep_network", "mixed", "common:context", "common:saturated", "common:look", "common:last_third",
    "tastes:deep_network",
)
CAUTIONS = (0.1, 0.2, 0.3, 0.4)


def person(population: str, number: int, seed: int) -> FamilyMember:
    kind, _, family = population.partition(":")
    if kind in ("mixed", "mixed_tuning"):
        among = MIXED if kind == "mixed" else MIXED_TUNING
        return member(f"{among[number % len(among)]}:{number + 1000 * seed}", SETUP)
    own = member(f"{family}:{number + 1000 * seed}", SETUP)
    if kind == "family":
        return own
    all_have = member(f"{family}:{9000 + 10 * seed + (number % 3 if kind == 'tastes' else 0)}", SETUP)
    return mix_members(SETUP, (all_have, 0.5), (own, 0.5))


class StepsBefore:
    """A step posterior that expects what earlier people weigh."""

    def __init__(self, answers: Answers, prior: tuple[np.ndarray, np.ndarray]) -> None:
        self.prior = prior
        signs = np.where(answers.chosen, 1.0, -1.0)
        self.fits = [AdvantageProcess.after(s, self.see(answers.steps), signs) for s in STRENGTHS]
        evidence = np.array([fit.log_evidence for fit in self.fits])
        self.masses = np.exp(evidence - logsumexp(evidence))

    def see(self, steps: np.ndarray) -> Any:
        return steps @ self.prior[0], steps @ self.prior[1]

    def advantages(self, steps: np.ndarray) -> Any:
        means, variances = map(np.array, zip(*(fit.advantages(self.see(steps)) for fit in self.fits), strict=True))
        expected = self.masses @ means
        return expected, np.sqrt(self.masses @ (variances + np.square(means - expected)))


def before(earlier: list[Answers]) -> Any:
    """What these answers say by the light of those before."""
    people = [EarlierPerson(one.pairs, one.chosen) for one in earlier]
    steps = fit_hierarchy([one.steps for one in earlier], [np.where(one.chosen, 1.0, -1.0) for one in earlier])
    prior = prior_of_earlier(SETUP, people)
    return lambda mine: (replace(mine.believed[0], before=prior), StepsBefore(mine, steps))


@dataclass
class Known:
    """One person's answers and what they expect: of the library on average, of every rollout (means, deviations by
    both posteriors, in the largest of the library)."""

    answers: Answers
    library: Any
    rollouts: Any
    scales: list[float]

    @classmethod
    def of(cls, who: FamilyMember, room: _Room) -> Known:
        truly = room.pairs.better(who.scores(room.pairs.in_turn)) > 0
        _, answered = _ask(truly, room, ANSWERED)
        answers = Answers(room.pairs.differences[answered], room.seen[answered], truly[answered])
        return cls.by(answers, room)

    @classmethod
    def by(cls, answers: Answers, room: _Room, believed: Any = None) -> Known:
        measures, believed = room.robot.library.measures, believed or answers.believed
        library = expected_by_posterior(measures, *believed)
        scales = [max(float(np.abs(mean).max()), 1e-9) for mean, _ in library]
        differences = room.candidates.differences
        rollouts = (believed[0].advantages(differences.pairs), believed[1].advantages(differences.steps))
        scaled = lambda both: np.array(  # noqa: E731
            [[mean / scale, deviation / scale] for (mean, deviation), scale in zip(both, scales, strict=True)]
        )
        return cls(answers, scaled(library), scaled(rollouts), scales)


def in_general(some: list[Known], room: _Room) -> np.ndarray:
    """As `choose_each_scene(people_in_general(...))`, from what is known of everybody."""
    library = together(np.stack([one.library for one in some]), "of_person")
    rollouts = together(np.stack([one.rollouts for one in some]), "of_person")
    scales = np.abs(library[:, 0]).max(1)
    of_library = ((library[:, 0] - DOUBT * library[:, 1]) / scales[:, None]).sum(0)
    allowed = room.robot.library.allowed
    among = np.argsort(-np.where(allowed, of_library, -np.inf), kind="stable")[: min(KEPT, int(allowed.sum()))]
    gains = ((rollouts[:, 0] - PeopleInGeneral.caution * rollouts[:, 1]) / scales[:, None]).sum(0)
    usable = room.candidates.differences.usable
    return room.candidates._best(np.where(usable, gains.reshape(usable.shape), -np.inf), among)


def of_first(answers: Answers, count: int) -> Answers:
    return Answers(answers.pairs[:count], answers.steps[:count], answers.chosen[:count])


def places(library: np.ndarray, rollouts: np.ndarray, room: _Room, caution: float) -> np.ndarray:
    """library, rollouts (2, 2, n): by posterior mean and deviation."""
    some = room.candidates
    of_library = (library[:, 0] - caution * library[:, 1]).sum(0)
    among = np.argsort(-np.where(room.robot.library.allowed, of_library, -np.inf), kind="stable")[:KEPT]
    gains = (rollouts[:, 0] - caution * rollouts[:, 1]).sum(0).reshape(some.differences.usable.shape)
    return some._best(np.where(some.differences.usable, gains, -np.inf), among)


def together(parts: np.ndarray, spread: str) -> np.ndarray:
    """(people, 2, 2, n) -> (2, 2, n): the mean over people; how unsure: of that mean, or of what one more wants."""
    mean = parts[:, :, 0].mean(0)
    between = parts[:, :, 0].var(0, ddof=1)
    if spread == "of_mean":
        return np.stack([mean, np.sqrt(between / len(parts))], 1)
    if spread == "within":
        return np.stack([mean, np.sqrt(between / len(parts) + np.square(parts[:, :, 1]).mean(0))], 1)
    if spread == "between":
        return np.stack([mean, np.sqrt(between)], 1)
    return np.stack([mean, np.sqrt(between + np.square(parts[:, :, 1]).mean(0))], 1)


def pooled(answers: list[Answers]) -> Answers:
    pairs = answers[0].pairs
    for one in answers[1:]:
        pairs = pairs.joined(one.pairs)
    return Answers(
        pairs, np.concatenate([one.steps for one in answers]), np.concatenate([one.chosen for one in answers])
    )


def left_out(earlier: list[Known]) -> list[float]:
    """Of each, the share of answers that the mean over the others predicts."""
    pairs, steps = earlier[0].answers.pairs, [one.answers.steps for one in earlier]
    for one in earlier[1:]:
        pairs = pairs.joined(one.answers.pairs)
    seen = np.concatenate(steps)
    votes = []
    for one in earlier:
        free, by_steps = one.answers.believed
        votes.append(sum(m / np.abs(m).mean() for m in (free.advantages(pairs)[0], by_steps.advantages(seen)[0])))
    ends = np.cumsum([len(one.answers.chosen) for one in earlier])
    accuracies = []
    for k, one in enumerate(earlier):
        rows = slice(ends[k] - len(one.answers.chosen), ends[k])
        others = np.mean([vote[rows] for j, vote in enumerate(votes) if j != k], axis=0)
        accuracies.append(float(((others > 0) == one.answers.chosen).mean()))
    return accuracies


def left_out_gains(earlier: list[Known], room: _Room, spread: str, caution: float) -> list[float]:
    """Of each, what their own answers expect of the choice by the others, by both posteriors, scaled."""
    found = []
    for k, one in enumerate(earlier):
        others = [other for j, other in enumerate(earlier) if j != k]
        chosen = places(
            together(np.stack([o.library for o in others]), spread),
            together(np.stack([o.rollouts for o in others]), spread),
            room,
            caution,
        )
        at = np.flatnonzero(chosen >= 0)
        rows = room.candidates.rows(chosen, at)
        found.append(float(one.rollouts[:, 0, rows].sum() / len(chosen)))
    return found


def main(out: Path, populations: tuple[str, ...], seeds: list[int]) -> None:
    rows: list[dict[str, Any]] = json.loads(out.read_text()) if out.exists() else []
    done = {(row["population"], row["seed"]) for row in rows}
    config = PeoplePoliciesConfig(SETUP, answers=ANSWERED, each_scene=True, scenes=SCENES, at_once=True)
    robot = RobotOfLibrary.load(SETUP)
    for seed in seeds:
        began = time.time()
        room = _Room.open(seed, config, robot)
        room.candidates  # noqa: B018
        print("room", seed, round(time.time() - began), flush=True)
        for population in populations:
            if (population, seed) in done:
                continue
            began = time.time()
            earlier = [Known.of(person(population, 100 + k, seed), room) for k in range(max(BEFORE))]
            print(population, "earlier", round(time.time() - began), flush=True)
            choices: dict[str, Any] = {}
            gates: dict[str, Any] = {}
            for n in BEFORE:
                everybody = PeopleInGeneral(
                    tuple(o.answers for o in earlier[:n]), np.array([o.scales for o in earlier[:n]])
                )
                choices[f"in_general_{n}"] = in_general(earlier[:n], room)
                gates[str(n)] = asdict(leave_each_out(everybody))
            lights = {0: None} | {n: before([o.answers for o in earlier[:n]]) for n in (30,)}
            print(population, "chosen", round(time.time() - began), flush=True)
            for k in range(NEW):
                who = person(population, k, seed)
                own = Known.of(who, room)
                mine = {}
                for m in (9, 15):
                    some = of_first(own.answers, m)
                    for n, light in lights.items():
                        if n or m:
                            known = Known.by(some, room, light(some) if light else None)
                            mine[f"own_{m}_before_{n}"] = places(known.library, known.rollouts, room, CAUTION)
                gains = {
                    name: _compare(who, room.candidates.driven(chosen), room.usual)
                    for name, chosen in {**choices, **mine}.items()
                }
                rows.append(
                    {
                        "population": population,
                        "seed": seed,
                        "person": k,
                        "gains": {name: round(found["gain"], 4) for name, found in gains.items()},
                        "changed": {name: round(found["changed"], 3) for name, found in gains.items()},
                        "success": {name: round(found["success"], 3) for name, found in gains.items()},
                        **({"gates": gates} if k == 0 else {}),
                    }
                )
            out.write_text(json.dumps(rows))
            mine = [row for row in rows if (row["population"], row["seed"]) == (population, seed)]
            for name in mine[0]["gains"]:
                values = np.array([row["gains"][name] for row in mine])
                print(f"{population:22s} {name:12s} median {np.median(values):.2f} quarter {np.quantile(values, .25):.2f} "
                      f"least {values.min():.2f} worse {np.mean(values < -0.01):.2f}", flush=True)
            print(gates, flush=True)
            print(round(time.time() - began), "s", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), {"tuning": TUNING, "held_out": HELD_OUT}[sys.argv[2]], [int(seed) for seed in sys.argv[3:]])

"""How well people outside the list are predicted, how sure that is, and what their robot gains: the job
that asks a reward file.

Everybody here is simulated. Accuracy is agreement with the preference itself; claims are held against the answers that
this person would give, lapses included. What is asked and shown is `asked_pairs.py`'s.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.alignment.gate import surely_better
from desirepath.learning.errors import LearningError
from desirepath.learning.people.asked_pairs import AskedPairs, Candidates, asked_pairs, candidates
from desirepath.learning.people.card import members, people_card, response_models
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.people.families.mixture import ObjectiveMember, mix_members
from desirepath.learning.people.rows import bins_of, row_of
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.objectives import NAMES, OPPOSITES
from desirepath.learning.preferences.oracles import ResponseModel, judged
from desirepath.learning.preferences.people_in_general import comfort, people_in_general, rater_weights
from desirepath.learning.preferences.population_prior import WeightPrior
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.sureness import Sureness
from desirepath.learning.scene_sets import Purpose
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory

Doubles = NDArray[np.float64]
CHOSEN = 50  # answers; after these questions are drawn
NINE, RATERS = "nine", "raters"


@dataclass(frozen=True)
class PeopleConfig:
    """What is measured. families: of the card; people: of each, from number `first` on, for each seed others. answers:
    after how many it is measured; shown_after: after how many a policy is made. choose: random, or information (the
    next pair is the one whose answer tells most about the others', for the first CHOSEN answers). queries: what is
    asked about, pairs of policies as they are, of policies in many manners, or half of each. test: pairs of policies as
    they are that are predicted; scenes: in which a policy is chosen, in which it is judged by the posterior, and in
    which its true gain is measured. particles: of the posterior over the nine."""

    families: tuple[str, ...]
    people: int = 5
    first: int = 0
    answers: tuple[int, ...] = (8, 15, 50)
    shown_after: int = 15
    seeds: tuple[int, ...] = (0,)
    response_model: str = "right"
    choose: str = "random"
    queries: str = "policies"
    pool: int = 400
    test: int = 300
    scenes: tuple[int, int, int] = (150, 200, 300)
    particles: int = 20_000


@dataclass(frozen=True)
class _Room:
    """What all people of one seed share."""

    setup: str
    seed: int
    pairs: AskedPairs
    select: Candidates
    judge: Candidates
    report: Candidates

    @classmethod
    def of(cls, setup: str, seed: int, config: PeopleConfig) -> _Room:
        select, judge, report = (
            candidates(setup, count, purpose=purpose, seed=seed)
            for count, purpose in zip(config.scenes, (Purpose.ALIGN_SELECT, Purpose.GATE, Purpose.REPORT), strict=True)
        )
        pairs = asked_pairs(setup, seed, asked=config.pool, test=config.test)
        if config.queries != "policies":
            others = config.pool // 2 if config.queries == "both" else 0
            pairs = pairs.with_manners(setup, seed, config.pool - others, others)
        return cls(setup, seed, pairs, select, judge, report)


def benchmark_people(
    setup: str,
    config: PeopleConfig,
    more: Mapping[str, FamilyMember] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """more: further people by name, such as a reward file's.

    Result: {"simulated": True, "setup", "family", "people", "answers", "accuracy" (after the last of `answers` ...),
    "rows": one per family, "persons": one per person}. A row has, by number of answers, `accuracy`, `claimed`,
    `calibration_error` and the same of the posterior over the nine alone; and of the policy after `shown_after`
    answers: `shown_rate`, `gain` (mean own score over the base policy in typical differences, fresh scenes in which
    both arrive), `preferred_rate`, `success_rate`, `harmed_rate` with its Wilson interval; `today_*`: the same of the
    policy conditioned on the posterior over the nine, shown to everybody. What studies show people gains is
    `desirepath benchmark people`'s. Raises LearningError for unknown names.
    """
    if config.choose not in ("random", "information"):
        raise LearningError(f"choose = {config.choose!r}: random or information")
    if config.queries not in ("policies", "manners", "both"):
        raise LearningError(f"queries = {config.queries!r}: policies, manners or both")
    if max(config.answers) > config.pool:
        raise LearningError(f"answers = {max(config.answers)}: at most the pool of {config.pool} pairs")
    answering = ResponseModel(**response_models([config.response_model])[config.response_model])
    measured_people: list[dict[str, Any]] = []
    total = len(config.seeds) * (len(config.families) * config.people + len(more or {}))
    for seed in config.seeds:
        first = config.first + seed * config.people
        by_family = [
            [(family, *member) for member in people_of(family, config.people, setup, first).items()]
            for family in config.families
        ]
        room = _Room.of(setup, seed, config)
        everybody = [entry for turn in zip(*by_family, strict=True) for entry in turn]
        for family, name, person in [*everybody, *(("file", *entry) for entry in (more or {}).items())]:
            measured = _measure(person, room, answering, config)
            measured_people.append({"family": family, "person": name, "seed": seed} | measured)
            if on_progress:
                on_progress(len(measured_people) / total)
    return _result_of(setup, config, measured_people)


def _result_of(setup: str, config: PeopleConfig, persons: Sequence[dict[str, Any]]) -> dict[str, Any]:
    card = people_card()
    names = list(dict.fromkeys(str(person["family"]) for person in persons))
    rows = [
        {"family": name, "held_out": name in card.kept_apart}
        | row_of([person for person in persons if person["family"] == name], config.answers, config.shown_after)
        for name in names
    ]
    return {
        "simulated": True,
        "setup": setup,
        "family": ",".join(names),
        "config": asdict(config),
        "card_version": card.version,
        **row_of(persons, config.answers, config.shown_after),
        "rows": rows,
        "persons": list(persons),
    }


def people_of(family: str, count: int, setup: str, first: int) -> Mapping[str, FamilyMember]:
    """Of the card's families, of `nine`: each objective alone, then two at equal shares, again and again; or `raters`:
    those of whom the prior people_in_general is, six in turn."""
    if family == RATERS:
        raters = list(rater_weights())
        return {f"{RATERS}:{k}": Rater(raters[k % len(raters)]) for k in range(first, first + count)}
    if family != NINE:
        return members(family, count, setup, first)
    alone = [(name,) for name in NAMES]
    both = [
        pair for pair in combinations(NAMES, 2) if tuple(NAMES.index(objective) for objective in pair) not in OPPOSITES
    ]
    wanted = [*alone, *both]
    people: dict[str, FamilyMember] = {}
    for k in range(first, first + count):
        names = wanted[k % len(wanted)]
        parts = [(ObjectiveMember(name), 1 / len(names)) for name in names]
        people[f"{NINE}:{k}"] = mix_members(setup, *parts)
    return people


@dataclass(frozen=True)
class Rater(FamilyMember):
    """Somebody who wants of whole trajectories what this rater of still moments found comfortable."""

    name: str

    def scores(self, trajectories: Sequence[Trajectory]) -> Doubles:
        (found,) = comfort(rater_weights()[self.name][None], trajectories)
        return np.asarray(found)


def prior_for(person: FamilyMember, setup: str) -> WeightPrior:
    """Of people in general; a rater is not among them."""
    return people_in_general(setup, without=person.name if isinstance(person, Rater) else "")


def _measure(person: FamilyMember, room: _Room, answering: ResponseModel, config: PeopleConfig) -> dict[str, Any]:
    """One person: asked, predicted, shown."""
    random = np.random.default_rng([room.seed, 61])
    pairs = room.pairs
    now = person.after(max(config.answers))  # who it is when all is answered
    truth = pairs.better(now.scores(pairs.in_turn))
    answers = {
        False: answers_of(person.after(0), pairs, answering, room.setup, room.seed),
        True: answers_of(now, pairs, answering, room.setup, room.seed),
    }
    posterior = FreePosterior.prior(room.setup, FreeConfig(posterior=PosteriorConfig(particles=config.particles)))
    left = list(random.permutation(pairs.asked))
    result: dict[str, Any] = {"accuracy": {}, "claimed": {}, "nine_accuracy": {}, "nine_claimed": {}}
    result |= {"bins": {}, "nine_bins": {}}
    choosing: list[float] = []
    for n in range(1, max(config.answers) + 1):
        if config.choose == "information" and n <= CHOSEN:
            began = time.process_time()
            k = left.pop(int(posterior.bits_about(pairs.differences[left], pairs.to_predict).argmax()))
            choosing.append(round(1000 * (time.process_time() - began), 1))
        else:
            k = left.pop()
        changed = person.after(n - 1) is now
        posterior = posterior.updated(pairs.differences[[k]], bool(answers[changed][k] > 0))
        if n in config.answers:
            test = pairs.differences[pairs.test]
            for prefix, probable in (
                ("", posterior.predict(test)),
                ("nine_", posterior.objectives.sample(2_000).predict(test.seen)),
            ):
                sure = np.maximum(probable, 1 - probable)
                right = (probable > 0.5) == (answers[True][pairs.test] > 0)
                result[f"{prefix}accuracy"][n] = float(((probable > 0.5) == (truth[pairs.test] > 0)).mean())
                result[f"{prefix}claimed"][n] = float(sure.mean())
                result[f"{prefix}bins"][n] = bins_of(sure, right)
        if n == config.shown_after:
            result |= _show_policy(posterior, person.after(n), room)
    return result | ({"choosing_ms": choosing} if choosing else {})


def answers_of(person: FamilyMember, pairs: AskedPairs, answering: ResponseModel, setup: str, seed: int) -> Doubles:
    """(n,) +1 where the first would be chosen, else -1, of all pairs, as the response model strays."""
    unit = person.unit(setup)
    scores = judged(lambda some: person.scores(some) / unit, pairs.in_turn, answering)
    better = pairs.better(scores)
    random = np.random.default_rng([seed, 62])
    wrong, coin = random.random(len(better)) < answering.lapse_rate, random.choice([-1.0, 1.0], len(better))
    answers = np.where(better > 0, 1.0, -1.0) * np.where(wrong, -1.0, 1.0)
    return np.where((better == 0) | (np.abs(better) < answering.indifference), coin, answers)


def _show_policy(posterior: FreePosterior, person: FamilyMember, room: _Room) -> dict[str, Any]:
    """The candidate that is most probably better, chosen, judged and measured in three sets of scenes; and today's."""
    probable = [posterior.probability_better(_both(room.select, k)) for k in range(len(room.select.rolled_out))]
    best = int(np.argmax(probable))
    sure = Sureness.of(posterior, _both(room.judge, best))
    unit = person.unit(room.setup)
    base = person.scores(room.report.base) / unit
    weights = posterior.objectives.mean_weights()
    today = rollout(
        get_setup(room.setup),
        load_conditioned(f"{room.setup}/conditioned").at(weights).rollout_policy,
        list(room.report.scenes),
    )
    return {
        "setting": best,
        "probability_better": sure.better,
        "probability_clearly_better": sure.clearly,
        "shown": surely_better(sure),
        **_measure_gain(person, room.report.rolled_out[best], room, base, unit, ""),
        **_measure_gain(person, today, room, base, unit, "today_"),
        "something_else": posterior.something_else(),
    }


def _both(some: Candidates, k: int) -> Any:
    return some.differences[k][np.flatnonzero(some.arrived[k])]


def _measure_gain(
    person: FamilyMember, own: Sequence[Trajectory], room: _Room, base: Doubles, unit: float, prefix: str
) -> dict[str, Any]:
    arrived = np.array([trajectory.outcome == Outcome.SUCCESS for trajectory in own])
    both = arrived & np.array([trajectory.outcome == Outcome.SUCCESS for trajectory in room.report.base])
    gained = (person.scores(list(own)) / unit - base)[both]
    return {
        f"{prefix}gain": float(gained.mean()),
        f"{prefix}preferred_rate": float(((gained > 0) + 0.5 * (gained == 0)).mean()),
        f"{prefix}success_rate": float(arrived.mean()),
    }

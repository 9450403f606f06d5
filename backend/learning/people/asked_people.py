"""How well people outside the list are foretold, how sure that is, and what their robot gains: `benchmark people`, and
the job of that name.

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

from backend.learning.errors import LearningError
from backend.learning.people.asked_pairs import AskedPairs, Candidates, asked_pairs, candidates
from backend.learning.people.card import members, people_card, response_models
from backend.learning.people.families.base import FamilyMember
from backend.learning.people.families.mixture import ObjectiveMember, mixed
from backend.learning.policies.evaluate import wilson
from backend.learning.policies.shipped import load_conditioned
from backend.learning.preferences.free_posterior import FreeConfig, FreePosterior
from backend.learning.preferences.objectives import NAMES, OPPOSITES
from backend.learning.preferences.oracles import ResponseModel, judged
from backend.learning.preferences.posterior import PosteriorConfig
from backend.learning.scene_sets import Purpose
from backend.simulation.fast import rollout
from backend.simulation.setups import get_setup
from backend.simulation.trajectory import Outcome, Trajectory

Doubles = NDArray[np.float64]
SURE = 0.9
BINS = 10
CHOSEN = 50  # answers; after these questions are drawn
NINE = "nine"
RESAMPLES = 2_000


@dataclass(frozen=True)
class PeopleConfig:
    """What is measured. families: of the card; people: of each, from number `first` on, for each seed others. answers:
    after how many it is measured; shown_after: after how many a policy is made. choose: random, or information (the
    next pair is the one whose answer tells most about the others', for the first CHOSEN answers). queries: what is
    asked about, pairs of policies as they are, of policies in many manners, or half of each. test: pairs of policies as
    they are that are foretold; scenes: in which a policy is chosen, in which it is judged by the posterior, and in
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
            kept = config.pool // 2 if config.queries == "both" else 0
            pairs = pairs.with_manners(setup, seed, config.pool - kept, kept)
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
    policy conditioned on the posterior over the nine, shown to everybody. What the policies of a library gain is
    `benchmark people-policies`'s. Raises LearningError for unknown names.
    """
    if config.choose not in ("random", "information"):
        raise LearningError(f"choose = {config.choose!r}: random or information")
    if config.queries not in ("policies", "manners", "both"):
        raise LearningError(f"queries = {config.queries!r}: policies, manners or both")
    if max(config.answers) > config.pool:
        raise LearningError(f"answers = {max(config.answers)}: at most the pool of {config.pool} pairs")
    answering = ResponseModel(**response_models([config.response_model])[config.response_model])
    card, found = people_card(), []
    total = len(config.seeds) * (len(config.families) * config.people + len(more or {}))
    for seed in config.seeds:
        room = _Room.of(setup, seed, config)
        first = config.first + seed * config.people
        everybody = {
            name: (family, one)
            for family in config.families
            for name, one in people_of(family, config.people, setup, first).items()
        } | {name: ("file", one) for name, one in (more or {}).items()}
        for name, (family, one) in everybody.items():
            found.append({"family": family, "person": name, "seed": seed} | _measured(one, room, answering, config))
            if on_progress:
                on_progress(len(found) / total)
    names = list(dict.fromkeys(str(one["family"]) for one in found))
    rows = [
        {"family": name, "held_out": name in card.held_out} | _row([p for p in found if p["family"] == name], config)
        for name in names
    ]
    overall = _row(found, config)
    persons = [{key: value for key, value in one.items() if not key.startswith("_")} for one in found]
    return {
        "simulated": True,
        "setup": setup,
        "family": ",".join(names),
        "config": asdict(config),
        "card_version": card.version,
        **overall,
        "rows": rows,
        "persons": persons,
    }


def people_of(family: str, count: int, setup: str, first: int) -> Mapping[str, FamilyMember]:
    """Of the card's families, or of `nine`: each objective alone, then two at equal shares, again and again."""
    if family != NINE:
        return members(family, count, setup, first)
    alone = [(name,) for name in NAMES]
    both = [pair for pair in combinations(NAMES, 2) if tuple(NAMES.index(one) for one in pair) not in OPPOSITES]
    wanted = [*alone, *both]
    found: dict[str, FamilyMember] = {}
    for k in range(first, first + count):
        names = wanted[k % len(wanted)]
        parts = [(ObjectiveMember(name), 1 / len(names)) for name in names]
        found[f"{NINE}:{k}"] = mixed(setup, *parts)
    return found


def _measured(person: FamilyMember, room: _Room, answering: ResponseModel, config: PeopleConfig) -> dict[str, Any]:
    """One person: asked, foretold, shown. Keys with an underscore are for pooling only."""
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
    result |= {"_pairs": {}, "_nine_pairs": {}, "_seconds": []}
    for n in range(1, max(config.answers) + 1):
        if config.choose == "information" and n <= CHOSEN:
            began = time.process_time()
            k = left.pop(int(posterior.bits_about(pairs.differences[left], pairs.foretold).argmax()))
            result["_seconds"].append(time.process_time() - began)
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
                result[f"_{prefix}pairs"][n] = (sure, right)
        if n == config.shown_after:
            result |= _shown(posterior, person.after(n), room)
    return result


def answers_of(person: FamilyMember, pairs: AskedPairs, answering: ResponseModel, setup: str, seed: int) -> Doubles:
    """(n,) +1 where the first would be chosen, else -1, of all pairs, as the response model strays."""
    unit = person.unit(setup)
    scores = judged(lambda some: person.scores(some) / unit, pairs.in_turn, answering)
    better = pairs.better(scores)
    random = np.random.default_rng([seed, 62])
    wrong, coin = random.random(len(better)) < answering.lapse_rate, random.choice([-1.0, 1.0], len(better))
    given = np.where(better > 0, 1.0, -1.0) * np.where(wrong, -1.0, 1.0)
    return np.where((better == 0) | (np.abs(better) < answering.indifference), coin, given)


def _shown(posterior: FreePosterior, person: FamilyMember, room: _Room) -> dict[str, Any]:
    """The candidate that is most probably better, chosen, judged and measured in three sets of scenes; and today's."""
    probable = [posterior.probability_better(_both(room.select, k)) for k in range(len(room.select.rolled_out))]
    best = int(np.argmax(probable))
    sure = posterior.probability_better(_both(room.judge, best))
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
        "probability_better": sure,
        "shown": sure >= SURE,
        **_gained(person, room.report.rolled_out[best], room, base, unit, ""),
        **_gained(person, today, room, base, unit, "today_"),
        "something_else": posterior.something_else(),
    }


def _both(some: Candidates, k: int) -> Any:
    return some.differences[k][np.flatnonzero(some.arrived[k])]


def _gained(
    person: FamilyMember, own: Sequence[Trajectory], room: _Room, base: Doubles, unit: float, prefix: str
) -> dict[str, Any]:
    arrived = np.array([one.outcome == Outcome.SUCCESS for one in own])
    both = arrived & np.array([one.outcome == Outcome.SUCCESS for one in room.report.base])
    gained = (person.scores(list(own)) / unit - base)[both]
    return {
        f"{prefix}gain": float(gained.mean()),
        f"{prefix}preferred_rate": float(((gained > 0) + 0.5 * (gained == 0)).mean()),
        f"{prefix}success_rate": float(arrived.mean()),
    }


def _row(found: list[dict[str, Any]], config: PeopleConfig) -> dict[str, Any]:
    """Means over people, with the least and the worst; rates of harm with their intervals."""
    row: dict[str, Any] = {"people": len(found), "answers": list(config.answers)}
    for prefix in ("", "nine_"):
        each = {n: [one[f"{prefix}accuracy"][n] for one in found] for n in config.answers}
        row[f"{prefix}accuracy"] = {n: round(float(np.mean(of)), 4) for n, of in each.items()}
        row[f"{prefix}accuracy_low"] = {n: round(_interval(of)[0], 4) for n, of in each.items()}
        row[f"{prefix}accuracy_high"] = {n: round(_interval(of)[1], 4) for n, of in each.items()}
        row[f"{prefix}accuracy_worst"] = {n: round(min(of), 4) for n, of in each.items()}
        row[f"{prefix}claimed"] = {
            n: round(float(np.mean([one[f"{prefix}claimed"][n] for one in found])), 4) for n in config.answers
        }
        row[f"{prefix}calibration_error"] = {
            n: round(calibration_error([one[f"_{prefix}pairs"][n] for one in found]), 4) for n in config.answers
        }
    seconds = [second for one in found for second in one["_seconds"]]
    if seconds:
        row["choosing_p95_ms"] = round(1000 * float(np.quantile(seconds, 0.95)), 1)
    if config.shown_after > max(config.answers):
        return row
    shown = [one for one in found if one["shown"]]
    harmed, today = sum(one["gain"] < 0 for one in shown), sum(one["today_gain"] < 0 for one in found)
    rate, rate_today = wilson(harmed, len(found)), wilson(today, len(found))
    return row | {
        "shown_rate": len(shown) / len(found),
        "gain": _mean([one["gain"] for one in shown]),
        "gain_worst": min((one["gain"] for one in shown), default=None),
        "preferred_rate": _mean([one["preferred_rate"] for one in shown]),
        "success_rate": _mean([one["success_rate"] for one in shown]),
        "harmed": harmed,
        "harmed_rate": rate.value,
        "harmed_rate_low": rate.low,
        "harmed_rate_high": rate.high,
        "today_gain": _mean([one["today_gain"] for one in found]),
        "today_gain_worst": min(one["today_gain"] for one in found),
        "today_success_rate": _mean([one["today_success_rate"] for one in found]),
        "today_harmed_rate": rate_today.value,
        "today_harmed_rate_low": rate_today.low,
        "today_harmed_rate_high": rate_today.high,
    }


def calibration_error(pairs: Sequence[tuple[Doubles, NDArray[np.bool_]]]) -> float:
    """Expected calibration error: over ten bins of what was claimed (0.5 to 1), how far claimed and right are apart."""
    sure, right = (np.concatenate(of) for of in zip(*pairs, strict=True))
    places = np.minimum(((sure - 0.5) * 2 * BINS).astype(int), BINS - 1)
    return float(
        sum(abs(sure[places == k].mean() - right[places == k].mean()) * (places == k).mean() for k in np.unique(places))
    )


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _interval(values: Sequence[float]) -> tuple[float, float]:
    """95 % of the mean over people, by resampling them."""
    random = np.random.default_rng(95)
    means = random.choice(np.asarray(values), (RESAMPLES, len(values))).mean(1)
    return float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))

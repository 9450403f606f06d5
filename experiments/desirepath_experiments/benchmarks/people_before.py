"""`benchmark people --before`: how much earlier participants of a study help to predict the next one.

Everybody is simulated. People of one population have something in common: each is half the population's own preference,
half one of their own, both random reward networks. Those before are of the same population, or of another one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from desirepath.learning.people.asked_pairs import AskedPairs, asked_pairs
from desirepath.learning.people.card import member
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.people.families.mixture import mix_members
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.population_prior import EarlierPerson, WeightPrior, prior_of_earlier
from desirepath.learning.preferences.posterior import PosteriorConfig

COMMON = 0.5
OF_EARLIER = 15  # answers of everybody before
FIRST_COMMON, FIRST_OWN = 500, 600  # numbers of networks that nobody else is measured with
POPULATIONS = ("same", "shifted")


@dataclass(frozen=True)
class BeforeConfig:
    """before: how many earlier participants. answers: after how many own ones it is measured. people: who are predicted
    of each seed; each seed has pairs and populations of its own."""

    before: tuple[int, ...] = (0, 10, 30, 100)
    answers: tuple[int, ...] = (3, 5, 8, 15)
    people: int = 10
    seeds: tuple[int, ...] = (0,)
    pool: int = 400
    test: int = 300
    particles: int = 4_000


def benchmark_before(
    setup: str, config: BeforeConfig, on_progress: Callable[[float], None] | None = None
) -> dict[str, Any]:
    """{"simulated": True, "setup", "before": [{"population", "people_before", "people", "accuracy", "accuracy_low",
    "accuracy_high" (by number of answers)}]}. Random questions, answers right; a person's questions are the same
    whoever was there before."""
    found: dict[tuple[str, int, int], list[float]] = {}
    for place, seed in enumerate(config.seeds):
        pairs = asked_pairs(setup, seed, asked=config.pool, test=config.test)
        common = [member(f"network:{FIRST_COMMON + 2 * seed + k}", setup) for k in range(2)]
        most = max(config.before)
        earlier = {
            population: [
                _answered(
                    _of_population(setup, common[k], seed, number), pairs, np.random.default_rng([seed, 81, number])
                )
                for number in range(most)
            ]
            for k, population in enumerate(POPULATIONS)
        }
        priors: dict[tuple[str, int], WeightPrior | None] = {
            (population, count): prior_of_earlier(setup, earlier[population][:count])
            for population in POPULATIONS
            for count in config.before
        }
        for number in range(config.people):
            person = _of_population(setup, common[0], seed, most + number)
            for key, prior in priors.items():
                if key == ("shifted", 0):
                    continue
                for n, accuracy in _predict(person, pairs, prior, config, np.random.default_rng([seed, 82, number])):
                    found.setdefault((*key, n), []).append(accuracy)
            if on_progress:
                on_progress((place + (number + 1) / config.people) / len(config.seeds))
    rows = []
    for population, count in dict.fromkeys(key[:2] for key in found):
        each = {n: found[population, count, n] for n in config.answers}
        rows.append(
            {
                "population": population,
                "people_before": count,
                "people": len(next(iter(each.values()))),
                "accuracy": {n: round(float(np.mean(of)), 4) for n, of in each.items()},
                "standard_error": {n: round(float(np.std(of) / np.sqrt(len(of))), 4) for n, of in each.items()},
            }
        )
    return {"simulated": True, "setup": setup, "config": asdict(config), "common": COMMON, "before": rows}


def _of_population(setup: str, common: FamilyMember, seed: int, number: int) -> FamilyMember:
    own = member(f"network:{FIRST_OWN + 200 * seed + number}", setup)
    return mix_members(setup, (common, COMMON), (own, 1 - COMMON))


def _answered(person: FamilyMember, pairs: AskedPairs, random: np.random.Generator) -> EarlierPerson:
    asked = random.choice(pairs.asked, OF_EARLIER, replace=False)
    better = pairs.better(person.scores(pairs.in_turn))
    return EarlierPerson(pairs.differences[asked], better[asked] > 0)


def _predict(
    person: FamilyMember,
    pairs: AskedPairs,
    prior: WeightPrior | None,
    config: BeforeConfig,
    random: np.random.Generator,
) -> list[tuple[int, float]]:
    """(own answers, accuracy) on pairs in other scenes."""
    better = pairs.better(person.scores(pairs.in_turn))
    asked = random.choice(pairs.asked, max(config.answers), replace=False)
    posterior = FreePosterior.prior(
        pairs.differences.setup, FreeConfig(posterior=PosteriorConfig(particles=config.particles)), prior
    )
    found = []
    for n, k in enumerate(asked, start=1):
        posterior = posterior.updated(pairs.differences[[k]], bool(better[k] > 0))
        if n in config.answers:
            right = (posterior.predict(pairs.differences[pairs.test]) > 0.5) == (better[pairs.test] > 0)
            found.append((n, float(right.mean())))
    return found

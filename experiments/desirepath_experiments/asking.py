"""A simulation study of asking: how well weights are known after 1, 2, ... answers, by how queries are chosen.

Who answers lives in `oracles.py`, what is chosen in `choosing.py`, what answers say in `posterior.py`. Everything here
is simulated and says so; an oracle's answer to a query is drawn once per repetition, so that strategies differ in
nothing but the choice. Every preference has answers and test queries of its own, so that means over preferences are of
independent repetitions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import wilson
from desirepath.learning.errors import LearningError
from desirepath.learning.preferences.oracles import HELD_OUT, ORACLE_PREFERENCES, TUNING, ResponseModel, make_oracle
from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig
from desirepath.learning.preferences.spans import seen_in
from desirepath.learning.queries.choosing import PARTICLES, STRATEGIES, Candidates
from desirepath.learning.queries.queries import QuerySet
from desirepath.simulation.setups import require_same

Doubles = NDArray[np.float64]
Flags = NDArray[np.bool_]
T_95 = 1.96
SEEDS_APART = 1_000_000  # more than a study has repetitions over all preferences

RESPONSE_MODELS: dict[str, ResponseModel] = {
    "right": ResponseModel(),
    "lapses": ResponseModel(lapse_rate=0.1),
    "indifference": ResponseModel(indifference=0.25),
    "myopia": ResponseModel(myopia_s=3.0),
}
"""How answers stray: 10 % wrong; a quarter of a typical difference unnoticed; the first three seconds judged. Ours."""
RENAMED = {"mistakes": "lapses"}  # on old command lines


@dataclass(frozen=True)
class AskingConfig:
    """What is simulated. test_share: of the queries, drawn anew per repetition; accuracy is measured on these."""

    oracles: tuple[str, ...] = tuple(ORACLE_PREFERENCES)
    response_models: tuple[str, ...] = tuple(RESPONSE_MODELS)
    strategies: tuple[str, ...] = ("random", "disagreement", "information")
    answers: int = 30
    repetitions: int = 20
    test_share: float = 0.4
    seed: int = 0
    posterior: PosteriorConfig = PosteriorConfig(particles=6_000)  # noqa: RUF009, frozen


PLAIN = "random_plain"


def by_objectives() -> tuple[str, ...]:
    """The strategies of choosing that go by the objectives alone."""
    return tuple(name for name in STRATEGIES if not STRATEGIES[name].beyond)


def asked_in_turn(
    posterior: Posterior,
    differences: Doubles,
    answers: Sequence[bool] | Flags,
    candidates: Sequence[int],
    count: int,
    strategy: str,
    random: np.random.Generator,
) -> Iterator[tuple[int, Posterior]]:
    """Ask `count` of the candidates one after the other, each chosen on the answers before it.

    differences: (n, spans, 7) A minus B of all queries. answers: whether A is preferred, of all. Yields each query's
    number and the posterior after its answer.
    """
    left = list(candidates)
    for _ in range(count):
        k = left.pop(STRATEGIES[strategy].ask_next(posterior, Candidates(differences, left), random).index)
        posterior = posterior.updated(differences[k], bool(answers[k]))
        yield k, posterior


def asking_study(
    query_set: QuerySet,
    config: AskingConfig | None = None,
    on_progress: Callable[[float], None] | None = None,
    plain: QuerySet | None = None,
) -> dict[str, Any]:
    """Accuracy on queries that were not asked and the share of repetitions in which the dominant objective was found.

    Result: {"simulated": True, "config", "curves": [{oracle, held_out, response_model, strategy, accuracy, low, high
    (95 %, of the mean), dominant, dominant_low, dominant_high (Wilson)}]}, each a list by number of answers from 1 on;
    dominant is null for a preference outside the vocabulary. Accuracy is agreement with the preference itself, without
    lapses. The test queries and the random stream of a repetition are the same for all strategies. plain: another set
    of the setup to compare with, such as an ensemble's: its queries are asked at random (strategy `random_plain`) and
    what was learned is tested on those of `query_set`. Raises LearningError for unknown names or too few queries,
    SetupError.
    """
    config = config or AskingConfig()
    models = tuple(RENAMED.get(name, name) for name in config.response_models)
    config = replace(config, response_models=models)
    for name, known in (
        ("oracles", ORACLE_PREFERENCES),
        ("response_models", RESPONSE_MODELS),
        ("strategies", by_objectives()),
    ):
        unknown = [value for value in getattr(config, name) if value not in known]
        if unknown:
            raise LearningError(f"{name} = {', '.join(unknown)}: known are {', '.join(known)}")
    test = round(len(query_set) * config.test_share)
    if test < 1 or len(query_set) - test < config.answers:
        raise LearningError(f"queries = {len(query_set)}: too few to ask {config.answers} and test on {test} others")
    if plain is not None:
        require_same(queries=query_set.setup, plain=plain.setup)
    sets = [_Measured.of(asked) for asked in (query_set, plain) if asked is not None]
    cells = [(oracle, model) for oracle in config.oracles for model in config.response_models]
    curves: list[dict[str, Any]] = []
    for number, (oracle, model) in enumerate(cells):
        curves += _curves_of(sets, oracle, model, config)
        if on_progress:
            on_progress((number + 1) / len(cells))
    return {"simulated": True, "setup": query_set.setup, "config": asdict(config), "curves": curves}


@dataclass(frozen=True)
class _Measured:
    """A query set and how its pairs differ, (n, spans, 7)."""

    queries: QuerySet
    differences: Doubles

    @classmethod
    def of(cls, queries: QuerySet) -> _Measured:
        return cls(queries, seen_in(queries.queries))


def _curves_of(sets: Sequence[_Measured], oracle: str, model: str, config: AskingConfig) -> list[dict[str, Any]]:
    """sets: the first is tested on; a second one is asked at random, too."""
    tested = sets[0]
    truth = make_oracle(oracle).advantages(tested.queries.queries) < 0
    seen = [make_oracle(oracle, **asdict(RESPONSE_MODELS[model])).advantages(one.queries.queries) for one in sets]
    curves = []
    place = tuple(ORACLE_PREFERENCES).index(oracle)
    ways = [(strategy, strategy, 0) for strategy in config.strategies] + [(PLAIN, "random", 1)] * (len(sets) - 1)
    for name, strategy, which in ways:
        differences = sets[which].differences
        accuracy = np.zeros((config.repetitions, config.answers))
        found = np.zeros((config.repetitions, config.answers), dtype=np.bool_)
        for repetition in range(config.repetitions):
            drawn = (place * config.repetitions + repetition) + 1
            answerer = make_oracle(oracle, **asdict(RESPONSE_MODELS[model]), seed=SEEDS_APART * config.seed + drawn)
            answers = np.equal(answerer.decide(seen[which]), 0)
            random = np.random.default_rng([config.seed, drawn, 41])
            order = random.permutation(len(tested.differences))
            test = order[: round(len(order) * config.test_share)]
            open_ones = list(order[len(test) :] if which == 0 else random.permutation(len(differences)))
            prior = Posterior.prior(tested.queries.setup, config.posterior)
            turns = asked_in_turn(prior, differences, answers, open_ones, config.answers, strategy, random)
            for asked, (_, posterior) in enumerate(turns):
                accuracy[repetition, asked] = _agreement(posterior, tested.differences[test, 0], truth[test])
                found[repetition, asked] = posterior.dominant() in ORACLE_PREFERENCES[oracle].objectives[:1]
        curves.append(
            {
                "oracle": oracle,
                "held_out": oracle in HELD_OUT,
                "response_model": model,
                "strategy": name,
                **_with_intervals(accuracy),
                **(_shares(found) if ORACLE_PREFERENCES[oracle].objectives else {"dominant": None}),
            }
        )
    return curves


def _agreement(posterior: Posterior, differences: Doubles, truth: Flags) -> float:
    """Share of pairs that are predicted as the preference itself would answer. differences: (n, 7), of whole pairs."""
    predicted = posterior.sample(PARTICLES).predict(differences) > 0.5
    return float((predicted == truth).mean())


def _with_intervals(values: Doubles) -> dict[str, list[float]]:
    mean = values.mean(axis=0)
    half = T_95 * values.std(axis=0, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.zeros_like(mean)
    return {"accuracy": mean.tolist(), "low": (mean - half).tolist(), "high": (mean + half).tolist()}


def _shares(found: Flags) -> dict[str, list[float]]:
    intervals = [wilson(int(column.sum()), len(column)) for column in found.T]
    return {
        "dominant": found.mean(axis=0).tolist(),
        "dominant_low": [interval.low for interval in intervals],
        "dominant_high": [interval.high for interval in intervals],
    }


def _dominant_row(curves: Sequence[dict[str, Any]], answers: int, repetitions: int) -> dict[str, Any]:
    """Over the preferences of the vocabulary, as `dominant_N`; null if there are none."""
    name, found = f"dominant_{answers}", [curve["dominant"][answers - 1] for curve in curves if curve["dominant"]]
    if not found:
        return {name: None}
    of_all = wilson(round(sum(found) * repetitions), repetitions * len(found))
    return {name: float(np.mean(found)), f"{name}_low": of_all.low, f"{name}_high": of_all.high}


def summarise(result: dict[str, Any]) -> dict[str, Any]:
    """The study in a few numbers, by response model and strategy, over the tuning and the held-out
    preferences apart.

    dominant_15: share of repetitions in which 15 answers found it, with its Wilson interval over all of them; accuracy:
    mean after 8, 15 and the last answer, with the 95 % interval for these very preferences.
    """
    rows = []
    last = result["config"]["answers"]
    for split, names in (("tuning", TUNING), ("held_out", HELD_OUT)):
        for model in result["config"]["response_models"]:
            for strategy in dict.fromkeys(curve["strategy"] for curve in result["curves"]):
                of = [
                    curve
                    for curve in result["curves"]
                    if curve["oracle"] in names and (curve["response_model"], curve["strategy"]) == (model, strategy)
                ]
                if not of:
                    continue
                row: dict[str, Any] = {"oracles": split, "response_model": model, "strategy": strategy}
                for n in sorted({min(8, last), min(15, last), last}):
                    mean = float(np.mean([curve["accuracy"][n - 1] for curve in of]))
                    halves = np.array([curve["accuracy"][n - 1] - curve["low"][n - 1] for curve in of])
                    half = float(np.sqrt(np.square(halves).sum()) / len(of))
                    row |= {f"accuracy_{n}": mean, f"accuracy_{n}_low": mean - half, f"accuracy_{n}_high": mean + half}
                row |= _dominant_row(of, min(15, last), result["config"]["repetitions"])
                rows.append(row)
    return {"simulated": True, "setup": result["setup"], "repetitions": result["config"]["repetitions"], "rows": rows}

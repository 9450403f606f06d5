"""`benchmark people --yardstick N`: what a linear model on all measures reaches with N answers to pairs of policies in
many manners, beside the posterior and the model after the answers to a shipped query set. Everybody is simulated."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.people.asked_pairs import asked_pairs
from desirepath.learning.people.card import members
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.advantage_process import AdvantageProcess
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.population_prior import columns_of
from desirepath.learning.preferences.posterior import PosteriorConfig

Doubles = NDArray[np.float64]
STRENGTHS = (8.0, 64.0, 512.0, 4096.0)
FEW = 2_000  # particles of the posterior over the nine, which says little of such people


@dataclass(frozen=True)
class YardstickConfig:
    """families: of the card; people: of each. answers: of the linear model, each to a pair of its own; shown: the
    shipped query set whose every pair is answered once. test: pairs of policies as they are, in other scenes."""

    families: tuple[str, ...]
    people: int = 5
    answers: int = 700
    shown: str = "queries_manners_200"
    seed: int = 0
    test: int = 300


def benchmark_yardstick(
    setup: str, config: YardstickConfig, on_progress: Callable[[float], None] | None = None
) -> dict[str, Any]:
    """Result: by family and over all, mean `accuracy` on the test pairs of a linear model (Bradley-Terry, normal prior,
    the strength by evidence) on `named` measures or `all` (with the embedding), after `answers` and after the shipped
    set's; and of the posterior after the shipped set's, in its order, with the p95 of choosing one of its questions."""
    pairs = asked_pairs(setup, config.seed, asked=2, test=config.test).with_manners(
        setup, config.seed, config.answers, 0
    )
    queries = load_queries(f"{setup}/{config.shown}").queries
    shown = [(query.trajectory_a, query.trajectory_b) for query in queries]
    differences, of_shown = pairs.differences, PairDifferences.of(setup, shown)
    test = differences[pairs.test]
    rows: list[dict[str, Any]] = []
    seconds: list[float] = []
    everybody = [(family, one) for family in config.families for one in members(family, config.people, setup).values()]
    for done, (family, person) in enumerate(everybody):
        person = person.after(config.answers)
        truth = pairs.better(person.scores(pairs.in_turn))
        liked = person.scores([one for pair in shown for one in pair])
        answered = liked[0::2] > liked[1::2]
        right = truth[pairs.test] > 0
        row: dict[str, Any] = {"family": family}
        for name, columns in (("named", lambda of: of.named), ("all", columns_of)):
            asked = columns(differences[pairs.asked]), truth[pairs.asked] > 0
            row[f"linear_{name}"] = _agrees(*asked, columns(test), right)
            row[f"linear_{name}_shown"] = _agrees(columns(of_shown), answered, columns(test), right)
        posterior = FreePosterior.prior(setup, FreeConfig(posterior=PosteriorConfig(particles=FEW)))
        for k in range(len(shown)):
            if k and k % 20 == 0 and k <= 60:
                began = time.process_time()
                posterior.information_bits(of_shown[list(range(k, len(shown)))])
                seconds.append(time.process_time() - began)
            posterior = posterior.updated(of_shown[[k]], bool(answered[k]))
        row["posterior_shown"] = float(((posterior.predict(test) > 0.5) == right).mean())
        rows.append(row)
        if on_progress:
            on_progress((done + 1) / len(everybody))
    names = [name for name in rows[0] if name != "family"]
    return {
        "simulated": True,
        "setup": setup,
        "config": asdict(config),
        "people": len(rows),
        "answers_shown": len(shown),
        "accuracy": {name: _summary([row[name] for row in rows]) for name in names},
        "rows": [
            {"family": family} | {n: _summary([row[n] for row in rows if row["family"] == family]) for n in names}
            for family in config.families
        ],
        "choosing_p95_ms": round(1000 * float(np.quantile(seconds, 0.95)), 1),
    }


def _agrees(columns: Doubles, chosen: NDArray[np.bool_], test: Doubles, right: NDArray[np.bool_]) -> float:
    """Share of the test pairs that a linear model of these answers predicts."""
    signs = np.where(chosen, 1.0, -1.0)
    fitted = [AdvantageProcess.after(strength, (np.zeros(len(signs)), columns), signs) for strength in STRENGTHS]
    best = max(fitted, key=lambda process: process.log_evidence)
    return float(((test @ best.weights() > 0) == right).mean())


def _summary(values: list[float]) -> list[float]:
    """Mean over people and its standard error."""
    error = float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
    return [round(float(np.mean(values)), 4), round(error, 4)]

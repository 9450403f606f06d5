"""Do somebody's answers look like what is believed of them? Each answer predicted from those before it, against how
many should have been correct by what was claimed, and against a coin (`predictive_power.py`). A posterior predictive
check, one step ahead; own choice.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.measures.named import NAMES as NAMED
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.population_prior import WeightPrior
from desirepath.learning.preferences.predictive_power import better_than_chance, odds_against_chance

Doubles = NDArray[np.float64]
FEWEST = 5
MOST_CHECKED = 60  # answers; each is predicted by a posterior of its own
SUSPICIOUS = 0.05


@dataclass(frozen=True)
class PredictiveCheck:
    """answers: how many were predicted; correct: of them how many were; claimed: how many should have been, by what was
    claimed; p_value: probability of so few by that. log_score: mean natural log probability of an answer, a coin has
    -0.69. something_else: probability that what they are about is not among the nine objectives; words: named measures
    that weigh most, more (above 0) or less preferred, the largest 1 or -1; agreeing: by measure, of how many answers
    that is true (the chosen trajectory has more, or less, of it than the other); odds: how many times more probable the
    answers are by what was predicted than by a coin."""

    answers: int
    correct: int
    claimed: float
    p_value: float
    log_score: float
    something_else: float
    words: dict[str, float]
    agreeing: dict[str, int] = field(default_factory=dict)
    odds: float = 1.0

    @property
    def verdict(self) -> str:
        """`too_few_answers`; `overclaimed`, where fewer came true than claims allow; else `as_claimed`."""
        if self.answers < FEWEST:
            return "too_few_answers"
        return "overclaimed" if self.p_value < SUSPICIOUS else "as_claimed"

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "verdict": self.verdict, "better_than_chance": better_than_chance(self.odds)}


def check_answers(
    differences: PairDifferences,
    chosen: NDArray[np.bool_],
    config: FreeConfig | None = None,
    before: WeightPrior | None = None,
) -> tuple[FreePosterior, PredictiveCheck]:
    """The posterior after all answers, and the check of the first MOST_CHECKED of them in their order."""
    posterior = FreePosterior.prior(differences.setup, config, before)
    probable = []
    for k, choice in enumerate(chosen):
        if k < MOST_CHECKED:
            predicted = float(posterior.predict(differences[[k]])[0])
            probable.append(predicted if choice else 1 - predicted)
        posterior = posterior.updated(differences[[k]], bool(choice))
    likelihoods = np.clip(np.array(probable), 1e-9, 1.0)
    sure = np.maximum(likelihoods, 1 - likelihoods)
    right = int((likelihoods > 0.5).sum())
    weights = posterior.named_weights()
    most = sorted(weights, key=lambda name: -abs(weights[name]))[:3]
    towards = (differences.named * np.where(chosen, 1, -1)[:, None])[:MOST_CHECKED]  # chosen minus rejected
    return posterior, PredictiveCheck(
        answers=len(likelihoods),
        correct=right,
        claimed=float(sure.sum()),
        p_value=float(_so_many(sure)[: right + 1].sum()),
        log_score=float(np.log(likelihoods).mean()) if len(likelihoods) else 0.0,
        something_else=posterior.something_else(),
        words={name: round(weights[name], 3) for name in most},
        agreeing={name: int((towards[:, NAMED.index(name)] * weights[name] > 0).sum()) for name in most},
        odds=odds_against_chance(likelihoods),
    )


def _so_many(probabilities: Doubles) -> Doubles:
    """(n + 1,) probability that so many of independent events come true (Poisson binomial, exact)."""
    chances = np.ones(1)
    for probability in probabilities:
        chances = np.convolve(chances, [1 - probability, probability])
    return chances

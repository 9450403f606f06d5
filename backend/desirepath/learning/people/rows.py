"""What is said of some people together: means with their intervals, how far claims are from what came true, who is
harmed. How each is measured is `asked_people.py`'s."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.estimates import mean_estimate, wilson

Doubles = NDArray[np.float64]
BINS = 10
Bins = list[list[float]]
"""By tenth of what was claimed (0.5 to 1): how many answers, the sum of the claims, how many came true."""


def row_of(people: Sequence[dict[str, Any]], answers: Sequence[int], shown_after: int) -> dict[str, Any]:
    """Means over people, with the least and the worst; rates of harm with their intervals."""
    row: dict[str, Any] = {"people": len(people), "answers": list(answers)}
    for prefix in ("", "nine_"):
        each = {n: [person[f"{prefix}accuracy"][n] for person in people] for n in answers}
        means = {n: mean_estimate(of) for n, of in each.items()}
        row[f"{prefix}accuracy"] = {n: round(mean.value, 4) for n, mean in means.items()}
        row[f"{prefix}accuracy_low"] = {n: round(mean.low, 4) for n, mean in means.items()}
        row[f"{prefix}accuracy_high"] = {n: round(mean.high, 4) for n, mean in means.items()}
        row[f"{prefix}accuracy_worst"] = {n: round(min(of), 4) for n, of in each.items()}
        row[f"{prefix}claimed"] = {
            n: round(float(np.mean([person[f"{prefix}claimed"][n] for person in people])), 4) for n in answers
        }
        row[f"{prefix}calibration_error"] = {
            n: round(calibration_error([person[f"{prefix}bins"][n] for person in people]), 4) for n in answers
        }
    choosing = [ms for person in people for ms in person.get("choosing_ms", [])]
    if choosing:
        row["choosing_p95_ms"] = round(float(np.quantile(choosing, 0.95)), 1)
    if shown_after > max(answers):
        return row
    shown = [person for person in people if person["shown"]]
    harmed, today = sum(person["gain"] < 0 for person in shown), sum(person["today_gain"] < 0 for person in people)
    rate, rate_today = wilson(harmed, len(people)), wilson(today, len(people))
    return row | {
        "shown_rate": len(shown) / len(people),
        "gain": _mean([person["gain"] for person in shown]),
        "gain_worst": min((person["gain"] for person in shown), default=None),
        "preferred_rate": _mean([person["preferred_rate"] for person in shown]),
        "success_rate": _mean([person["success_rate"] for person in shown]),
        "harmed": harmed,
        "harmed_rate": rate.value,
        "harmed_rate_low": rate.low,
        "harmed_rate_high": rate.high,
        "today_gain": _mean([person["today_gain"] for person in people]),
        "today_gain_worst": min(person["today_gain"] for person in people),
        "today_success_rate": _mean([person["today_success_rate"] for person in people]),
        "today_harmed_rate": rate_today.value,
        "today_harmed_rate_low": rate_today.low,
        "today_harmed_rate_high": rate_today.high,
    }


def bins_of(sure: Doubles, right: NDArray[np.bool_]) -> Bins:
    """Of what was claimed (0.5 to 1) of each answer, and whether it came true."""
    places = np.minimum(((sure - 0.5) * 2 * BINS).astype(int), BINS - 1)
    sums = [np.bincount(places, of, BINS) for of in (np.ones(len(sure)), sure, right.astype(np.float64))]
    return [[round(float(value), 3) for value in row] for row in np.stack(sums, axis=1)]


def calibration_error(bins: Sequence[Bins]) -> float:
    """Expected calibration error over everybody's answers: over ten bins of what was claimed, how far claimed and right
    are apart."""
    count, claimed, right = np.sum(np.array(bins), axis=0).T
    return float(np.abs(claimed - right).sum() / count.sum())


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None

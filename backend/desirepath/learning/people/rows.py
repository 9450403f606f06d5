"""What `benchmark people` says of some people together: means with their intervals, how far claims are from what came
true, who is harmed. How each is measured is `asked_people.py`'s."""

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


def row_of(found: Sequence[dict[str, Any]], answers: Sequence[int], shown_after: int) -> dict[str, Any]:
    """Means over people, with the least and the worst; rates of harm with their intervals."""
    row: dict[str, Any] = {"people": len(found), "answers": list(answers)}
    for prefix in ("", "nine_"):
        each = {n: [one[f"{prefix}accuracy"][n] for one in found] for n in answers}
        means = {n: mean_estimate(of) for n, of in each.items()}
        row[f"{prefix}accuracy"] = {n: round(mean.value, 4) for n, mean in means.items()}
        row[f"{prefix}accuracy_low"] = {n: round(mean.low, 4) for n, mean in means.items()}
        row[f"{prefix}accuracy_high"] = {n: round(mean.high, 4) for n, mean in means.items()}
        row[f"{prefix}accuracy_worst"] = {n: round(min(of), 4) for n, of in each.items()}
        row[f"{prefix}claimed"] = {
            n: round(float(np.mean([one[f"{prefix}claimed"][n] for one in found])), 4) for n in answers
        }
        row[f"{prefix}calibration_error"] = {
            n: round(calibration_error([one[f"{prefix}bins"][n] for one in found]), 4) for n in answers
        }
    choosing = [ms for one in found for ms in one.get("choosing_ms", [])]
    if choosing:
        row["choosing_p95_ms"] = round(float(np.quantile(choosing, 0.95)), 1)
    if shown_after > max(answers):
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


def bins_of(sure: Doubles, right: NDArray[np.bool_]) -> Bins:
    """Of what was claimed (0.5 to 1) of each answer, and whether it came true."""
    places = np.minimum(((sure - 0.5) * 2 * BINS).astype(int), BINS - 1)
    sums = [np.bincount(places, of, BINS) for of in (np.ones(len(sure)), sure, right.astype(np.float64))]
    return [[round(float(one), 3) for one in row] for row in np.stack(sums, axis=1)]


def calibration_error(bins: Sequence[Bins]) -> float:
    """Expected calibration error over everybody's answers: over ten bins of what was claimed, how far claimed and right
    are apart."""
    count, claimed, right = np.sum(np.array(bins), axis=0).T
    return float(np.abs(claimed - right).sum() / count.sum())


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None

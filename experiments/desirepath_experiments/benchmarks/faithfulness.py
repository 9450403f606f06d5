"""Is an explanation true? Deletion and insertion: take the thing it names first out of the room, and see what changes.

Per moment at which at least `LEAST_SEEN` things are seen, in the order of their scores and in random orders. Which
explanations may be shown to people is decided by what is measured here (`benchmark explanations`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.analysis.estimates import mean_estimates
from desirepath.explain.attribution import Actor, Explanation
from desirepath.explain.methods import COMMANDS, Command
from desirepath.explain.sight import Sight

Doubles = NDArray[np.float64]
LEAST_SEEN = 3  # ours: with fewer there is hardly an order
RANDOM_ORDERS = 20  # per moment, for the comparison


@dataclass(frozen=True)
class Faithfulness:
    """Of one trajectory, over its moments. All in units of the command in [-1, 1], averaged over the moments.

    first, first_random: how far the command moves when the first thing, or a random one, is taken out. deletion,
    deletion_random: mean change while things are taken out one after the other, the most important first; more is
    better. insertion, insertion_random: mean distance that is left while they are put back into the empty room; less is
    better.
    """

    moments: int
    first: float
    first_random: float
    deletion: float
    deletion_random: float
    insertion: float
    insertion_random: float


def faithfulness(actor: Actor, sight: Sight, explained: Explanation, *, seed: int = 0) -> Faithfulness | None:
    """Deletion and insertion of what was seen, against random orders. None: no moment shows enough things."""
    random = np.random.default_rng(seed)
    moments = np.flatnonzero(sight.seen.sum(axis=1) >= LEAST_SEEN)
    if not len(moments):
        return None
    scores = explained.weights[:, : len(sight.things)]  # the goal is no thing that could be taken out
    ours = [_curves(actor, sight, explained.command, moments, -scores)]
    lots = [
        _curves(actor, sight, explained.command, moments, random.random(scores.shape)) for _ in range(RANDOM_ORDERS)
    ]
    found, by_chance = np.array(ours).mean(axis=0), np.array(lots).mean(axis=0)
    return Faithfulness(
        moments=len(moments),
        first=float(found[0]),
        first_random=float(by_chance[0]),
        deletion=float(found[1]),
        deletion_random=float(by_chance[1]),
        insertion=float(found[2]),
        insertion_random=float(by_chance[2]),
    )


def _curves(
    actor: Actor, sight: Sight, command: Command, moments: NDArray[np.intp], order: Doubles
) -> tuple[float, float, float]:
    """(first, deletion, insertion) when what is seen is taken out by ascending `order` (T, things)."""
    hidden = np.where(sight.seen, order, np.inf)
    place = hidden.argsort(axis=1, kind="stable").argsort(axis=1)  # who goes first has place 0
    number = sight.seen.sum(axis=1)
    full = _commands(actor, sight.observations, command)
    first: list[float] = []
    deleted: list[Doubles] = []
    inserted: list[Doubles] = []
    for taken in range(1, int(number[moments].max()) + 1):
        gone = sight.seen & (place < taken)
        there = sight.seen & (place >= taken)
        change = np.abs(_commands(actor, sight.without(gone), command) - full)
        left = np.abs(_commands(actor, sight.without(there), command) - full)
        if taken == 1:
            first = [float(change[moments].mean())]
        live = (number >= taken)[moments]
        deleted.append(np.where(live, change[moments], np.nan))
        inserted.append(np.where(live, left[moments], np.nan))
    return first[0], float(np.nanmean(deleted, axis=0).mean()), float(np.nanmean(inserted, axis=0).mean())


def _commands(actor: Actor, observations: NDArray[np.float32], command: Command) -> Doubles:
    with torch.no_grad():
        actions = actor(torch.from_numpy(observations))
    return actions[:, COMMANDS.index(command)].numpy().astype(np.float64)


def gain_over_chance(measured: Sequence[Faithfulness], *, seed: int = 0) -> dict[str, dict[str, Any]]:
    """How much better than random orders over trajectories, one per scene: mean and 95 % interval (percentile
    bootstrap over scenes). Positive: the explanation is better than chance. Raises ValueError for fewer than two.
    """
    if len(measured) < 2:
        raise ValueError(f"measured: {len(measured)} trajectories; an interval needs two at least")
    gains = {
        "first": [one.first - one.first_random for one in measured],
        "deletion": [one.deletion - one.deletion_random for one in measured],
        "insertion": [one.insertion_random - one.insertion for one in measured],
    }
    estimates = mean_estimates({name: np.array(values) for name, values in gains.items()}, seed=seed)
    return {
        name: {"mean": round(gain.value, 4), "interval_95": [round(gain.low, 4), round(gain.high, 4)]}
        for name, gain in estimates.items()
    }

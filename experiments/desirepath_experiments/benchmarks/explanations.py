"""`desirepath benchmark explanations`: is an explanation true enough to be shown? Deletion and insertion.

The things that an explanation names are taken out of the room, and put back into the empty room, in the order of their
scores and in random orders, at every moment at which at least `LEAST_SEEN` things are seen.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pydantic
import torch
from numpy.typing import NDArray
from pydantic import Field

from desirepath.analysis.estimates import mean_estimates
from desirepath.cli.science import find_policy
from desirepath.explain.attribution import Actor, Explanation, explain
from desirepath.explain.methods import COMMANDS, METHODS, Command
from desirepath.explain.sight import Sight, sight_of
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import network_of
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.results import Progress

Doubles = NDArray[np.float64]
STEPS = 100  # what the milliseconds are scaled to
LEAST_SEEN = 3  # ours: with fewer there is hardly an order
RANDOM_ORDERS = 20  # per moment, for the comparison


@pydantic.dataclasses.dataclass(frozen=True)
class ExplanationsConfig:
    """Whose explanations are tried in how many scenes."""

    policy: Annotated[str, Field(description="A shipped name such as study_room/base, an id or a path.")] = (
        "study_room/base"
    )
    scenes: Annotated[int, Field(ge=2, description="One trajectory in each.")] = 40
    seed: int = 0


def benchmark_explanations(config: ExplanationsConfig, progress: Progress | None = None) -> dict[str, Any]:
    """One trajectory per scene, each method and command.

    Gains over random orders in units of the command in [-1, 1], mean with 95 % interval over scenes. `may_be_shown`:
    both curves' intervals lie above 0. Milliseconds: processor time for 100 steps, what is seen included.
    """
    use_one_thread()
    policy, scenes, seed = network_of(find_policy(config.policy)), config.scenes, config.seed
    setup, actor = get_setup(policy.setup), actor_of(policy)
    drawn = scene_set(policy.setup, scenes, purpose=Purpose.REPORT, seed=seed)
    trajectories = rollout(setup, policy.rollout_policy, drawn)
    explain(actor, sight_of(trajectories[0]))  # compiled, imported
    rows = []
    for command in COMMANDS:
        for method in METHODS:
            measured, seconds = [], []
            for trajectory in trajectories:
                began = time.process_time()
                sight = sight_of(trajectory)
                explained = explain(actor, sight, method=method, command=command, seed=seed)
                seconds.append((time.process_time() - began) / len(trajectory.actions))
                measured.append(faithfulness(actor, sight, explained, seed=seed))
            judged = [faithful for faithful in measured if faithful is not None]
            gains = gain_over_chance(judged, seed=seed)
            rows.append(
                {
                    "command": command,
                    "method": method,
                    **{f"{curve}_gain": gains[curve]["mean"] for curve in gains},
                    **{f"{curve}_interval_95": gains[curve]["interval_95"] for curve in gains},
                    "may_be_shown": all(gains[curve]["interval_95"][0] > 0 for curve in ("deletion", "insertion")),
                    "ms_per_100_steps": round(float(np.median(seconds)) * STEPS * 1000, 1),
                    "trajectories": len(judged),
                    "moments": sum(faithful.moments for faithful in judged),
                }
            )
    return {
        "policy": config.policy,
        "setup": policy.setup,
        "scenes": describe(Purpose.REPORT, scenes, seed),
        "explanations": rows,
    }


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
    curves = _curves(actor, sight, explained.command, moments, -scores)
    random_orders = [random.random(scores.shape) for _ in range(RANDOM_ORDERS)]
    by_chance = np.mean([_curves(actor, sight, explained.command, moments, order) for order in random_orders], axis=0)
    both = [float(value) for pair in zip(curves, by_chance, strict=True) for value in pair]
    return Faithfulness(len(moments), *both)


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
    for count in range(1, int(number[moments].max()) + 1):
        gone = sight.seen & (place < count)
        left_in = sight.seen & (place >= count)
        change = np.abs(_commands(actor, sight.without(gone), command) - full)
        left = np.abs(_commands(actor, sight.without(left_in), command) - full)
        if count == 1:
            first = [float(change[moments].mean())]
        live = (number >= count)[moments]
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
        "first": [trajectory.first - trajectory.first_random for trajectory in measured],
        "deletion": [trajectory.deletion - trajectory.deletion_random for trajectory in measured],
        "insertion": [trajectory.insertion_random - trajectory.insertion for trajectory in measured],
    }
    estimates = mean_estimates({name: np.array(values) for name, values in gains.items()}, seed=seed)
    return {
        name: {"mean": round(gain.value, 4), "interval_95": [round(gain.low, 4), round(gain.high, 4)]}
        for name, gain in estimates.items()
    }

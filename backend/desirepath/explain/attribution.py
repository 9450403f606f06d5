"""What made a policy do what it did: attributions of its inputs, and scores of the things its lidar saw (chapter 8).

The methods are captum's: Saliency, Integrated Gradients, SmoothGrad; signs are kept until things are scored. Which
thing provides which ray is `sight.py`'s; whether an explanation is true is tested by deletion and insertion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from captum.attr import IntegratedGradients, NoiseTunnel, Saliency
from numpy.typing import NDArray
from torch import Tensor

from desirepath.explain.methods import COMMANDS, Command, Method, check_method
from desirepath.explain.sight import AHEAD, FAR, GOAL, PERSON, Sight
from desirepath.simulation.fast import Floats
from desirepath.simulation.setups import Setup

Doubles = NDArray[np.float64]
Actor = Callable[[Tensor], Tensor]
"""(n, obs) -> (n, 2) actions in [-1, 1], differentiable; `learning/policies/torch_actor.py` makes them."""

IG_STEPS = 128  # points on the way from the baseline; ours: sums are right to 0.05 of a command in [-1, 1]
NOISE, SAMPLES = 0.05, 25  # SmoothGrad: standard deviation in scaled inputs, draws per moment; ours
GOAL_INPUTS = (0, 1)  # distance and bearing, as every lidar setup lays them out


@dataclass(frozen=True)
class Explanation:
    """T moments explained. inputs: (T, obs) float64, the attribution of each scaled input, sign kept.

    things: the sight's and the goal. scores: (T, things) in [0, 1], the greatest attribution of the pooled rays that
    end at the thing, absolute and scaled to 0-1 at each moment over all pooled rays (equation 8.2); 0: not seen.
    For person and goal also what the robot is told of their position, on the rays' scale, at most 1 (ours).
    weights: (T, things), the same before scaling, which orders them also where two score 1.
    """

    method: Method
    command: Command
    inputs: Doubles
    things: tuple[str, ...]
    scores: Doubles
    weights: Doubles


def attribute(
    actor: Actor, observations: Floats, *, setup: Setup, method: Method, command: Command, seed: int = 0
) -> Doubles:
    """observations (T, obs) -> (T, obs) attributions of one command to each input, signed; gradients per unit of the
    scaled input. setup: whose observations these are.

    Integrated Gradients add up to the command's difference from the baseline (`baseline`). `seed`: SmoothGrad's noise.
    Raises AttributionError for an unknown method or command.
    """
    check_method(method, command)
    index = COMMANDS.index(command)
    inputs = torch.from_numpy(np.ascontiguousarray(observations)).requires_grad_(True)
    scores: Tensor
    if method == "saliency":
        scores = Saliency(actor).attribute(inputs, target=index, abs=False)
    elif method == "integrated_gradients":
        start = torch.from_numpy(baseline(observations, setup))
        scores = IntegratedGradients(actor).attribute(
            inputs, baselines=start, target=index, n_steps=IG_STEPS, method="gausslegendre"
        )
    else:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            scores = NoiseTunnel(Saliency(actor)).attribute(
                inputs, nt_type="smoothgrad", nt_samples=SAMPLES, stdevs=NOISE, target=index, abs=False
            )
    return scores.detach().numpy().astype(np.float64)


def baseline(observations: Floats, setup: Setup) -> Floats:
    """(T, obs) an empty room: every ray at the lidar's range, goal and person far off and straight ahead; the robot's
    own velocity stays.
    """
    empty = observations.copy()
    empty[:, setup.polar_size :] = 1.0
    for distance, bearing in filter(None, (GOAL_INPUTS, setup.person_inputs)):
        empty[:, distance], empty[:, bearing] = FAR, AHEAD
    return empty


def explain(
    actor: Actor, sight: Sight, *, method: Method = "saliency", command: Command = "speed", seed: int = 0
) -> Explanation:
    """Score what was seen at each moment by how much it moved the command. Raises AttributionError.

    In double precision: where a command is at its limit, tanh's slope is lost in single, and with it every gradient.
    """
    double = cast("Floats", sight.observations.astype(np.float64))
    inputs = attribute(actor, double, setup=sight.setup, method=method, command=command, seed=seed)
    rays = np.abs(inputs[:, sight.first_ray :])
    weights = np.zeros((len(inputs), len(sight.things) + 1))
    scores = np.zeros_like(weights)
    low, high = rays.min(axis=1, keepdims=True), rays.max(axis=1, keepdims=True)
    spread = np.where(high > low, high - low, 1.0)
    scaled = (rays - low) / spread
    for number in range(len(sight.things)):
        own = sight.provider == number
        weights[:, number] = np.where(own, rays, 0.0).max(axis=1)
        scores[:, number] = np.where(own, scaled, 0.0).max(axis=1)
    for at, pair in ((len(sight.things), GOAL_INPUTS), (_person(sight), sight.setup.person_inputs)):
        if at is not None and pair is not None:
            seen = np.abs(inputs[:, list(pair)]).max(axis=1)
            weights[:, at] = np.maximum(weights[:, at], seen)
            scores[:, at] = np.maximum(scores[:, at], np.clip((seen - low[:, 0]) / spread[:, 0], 0.0, 1.0))
    return Explanation(method, command, inputs, (*sight.things, GOAL), scores, weights)


def _person(sight: Sight) -> int | None:
    return sight.things.index(PERSON) if PERSON in sight.things else None

"""What made a policy do what it did: attributions of its inputs, and scores of the things its lidar saw (chapter 8).

The methods are captum's: Saliency, Integrated Gradients, SmoothGrad; signs are kept until things are scored. Which
thing provides which ray is `sight.py`'s; whether an explanation is true is measured in `faithfulness.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from captum.attr import IntegratedGradients, NoiseTunnel, Saliency
from numpy.typing import NDArray
from torch import Tensor

from backend.explain.methods import COMMANDS, Command, Method, checked
from backend.explain.sight import AHEAD, FAR, GOAL, PERSON, Sight
from backend.simulation.fast import Floats
from backend.simulation.setups import Setup

Doubles = NDArray[np.float64]
Actor = Callable[[Tensor], Tensor]
"""(n, obs) -> (n, 2) actions in [-1, 1], differentiable; `learning/policies/torch_actor.py` makes them."""

IG_STEPS = 128  # points on the way from the baseline; ours: sums are right to 0.05 of a command in [-1, 1]
NOISE, SAMPLES = 0.05, 25  # SmoothGrad: standard deviation in scaled inputs, draws per moment; ours
GOAL_INPUTS = (0, 1)  # distance and bearing, as every lidar setup lays them out


@dataclass(frozen=True)
class Explanation:
    """T moments explained. inputs: (T, obs) float64, the attribution of each scaled input, sign kept.

    things: the sight's and the goal. scores: (T, things) in [0, 1], the greatest attribution of what tells of the
    thing, absolute and scaled to 0-1 at each moment over all rays and positions: the pooled rays that end at it; for
    person and goal also what the robot sees of their position. 0: nothing seen of it.
    """

    method: Method
    command: Command
    inputs: Doubles
    things: tuple[str, ...]
    scores: Doubles


def attribute(
    actor: Actor, observations: Floats, *, setup: Setup, method: Method, command: Command, seed: int = 0
) -> Doubles:
    """observations (T, obs) -> (T, obs) attributions of one command to each input, signed; gradients per unit of the
    scaled input. setup: whose observations these are.

    Integrated Gradients add up to the command's difference from the baseline (`baseline`). `seed`: SmoothGrad's noise.
    Raises AttributionError for an unknown method or command.
    """
    checked(method, command)
    index = COMMANDS.index(command)
    inputs = torch.from_numpy(np.ascontiguousarray(observations)).requires_grad_(True)
    found: Tensor
    if method == "saliency":
        found = Saliency(actor).attribute(inputs, target=index, abs=False)
    elif method == "integrated_gradients":
        start = torch.from_numpy(baseline(observations, setup))
        found = IntegratedGradients(actor).attribute(
            inputs, baselines=start, target=index, n_steps=IG_STEPS, method="gausslegendre"
        )
    else:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            found = NoiseTunnel(Saliency(actor)).attribute(
                inputs, nt_type="smoothgrad", nt_samples=SAMPLES, stdevs=NOISE, target=index, abs=False
            )
    return found.detach().numpy().astype(np.float64)


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
    """Score what was seen at each moment by how much it moved the command. Raises AttributionError."""
    inputs = attribute(actor, sight.observations, setup=sight.setup, method=method, command=command, seed=seed)
    rays = np.abs(inputs[:, sight.first_ray :])
    seen = [np.abs(inputs[:, list(pair)]).max(axis=1) for pair in (GOAL_INPUTS, sight.setup.person_inputs) if pair]
    every = np.column_stack([rays, *seen])
    low, high = every.min(axis=1, keepdims=True), every.max(axis=1, keepdims=True)
    scaled = (every - low) / np.where(high > low, high - low, 1.0)
    sectors = rays.shape[1]
    scores = np.zeros((len(inputs), len(sight.things) + 1))
    for number in range(len(sight.things)):
        scores[:, number] = np.where(sight.provider == number, scaled[:, :sectors], 0.0).max(axis=1)
    scores[:, -1] = scaled[:, sectors]
    if sight.setup.person_inputs is not None:
        at = sight.things.index(PERSON)
        scores[:, at] = np.maximum(scores[:, at], scaled[:, sectors + 1])
    return Explanation(method, command, inputs, (*sight.things, GOAL), scores)

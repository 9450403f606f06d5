"""The thesis's neural reward model (6.4.4): the critic's architecture, Bradley-Terry loss, best epoch kept.

The linear model, our default, is `linear.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from desirepath.learning.policies.networks import Parameters, critic_forward, use_one_thread
from desirepath.learning.policies.shape import FAST_HEADS, NetworkShape
from desirepath.learning.preferences.preferences import Preference, usable_steps
from desirepath.learning.rewards.reward_model import FitSettings, Fitting, Reduction, RewardModel
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class MlpConfig:
    """Thesis 6.4.4 unless marked ours."""

    seed: int = 0
    epochs: int = 10
    learning_rate: float = 1e-4
    reduction: Reduction = "sum"  # equation 6.4; the mean is an option, ours
    heads: tuple[int, int] = FAST_HEADS  # ours; the thesis's critic has 400, 300
    pairs_per_step: int = 1
    held_out_share: float = 0.2  # ours: the epoch is chosen on this share of the answers, once there are 10
    fewest_answers: int = 2  # ours; learning curves begin at 1


@dataclass(frozen=True)
class MlpRewardModel(RewardModel):
    """layers: weight, bias, ... of a one-headed critic. shift, scale: normalise its output to mean 0, deviation 1."""

    kind: ClassVar[str] = "mlp"

    setup: str
    shape: NetworkShape
    layers: tuple[Floats, ...]
    shift: float
    scale: float
    reduction: Reduction = "sum"

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        del next_observations  # the thesis's R(s, a) does not see where the step led
        parts = torch.as_tensor(observations), torch.as_tensor(actions)
        layers = [
            (torch.as_tensor(w), torch.as_tensor(b)) for w, b in zip(self.layers[0::2], self.layers[1::2], strict=True)
        ]
        with torch.no_grad():
            values: Floats = critic_forward(*parts, layers, n_heads=1)[0].numpy()
        normalised: Floats = ((values - self.shift) / self.scale).astype(np.float32)
        return normalised

    def raw_reward(self, trajectory: Trajectory) -> float:
        """Sum or mean of the network's own outputs over a trajectory: what was trained, before normalisation."""
        steps = (
            self.rewards(trajectory.observations, trajectory.actions, trajectory.next_observations) * self.scale
            + self.shift
        )
        return float(steps.sum() if self.reduction == "sum" else steps.mean())

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        meta: dict[str, object] = {
            "kind": self.kind,
            "setup": self.setup,
            "reduction": self.reduction,
            "shape": self.shape.as_dict(),
            "shift": self.shift,
            "scale": self.scale,
        }
        return meta, {f"layer_{k:02d}": array for k, array in enumerate(self.layers)}

    @classmethod
    def from_arrays(cls, meta: dict[str, Any], arrays: dict[str, Floats]) -> MlpRewardModel:
        layers = tuple(arrays[name] for name in sorted(arrays))
        reduction: Reduction = "mean" if meta["reduction"] == "mean" else "sum"
        shape = NetworkShape.from_dict(meta["shape"])
        return cls(meta["setup"], shape, layers, float(meta["shift"]), float(meta["scale"]), reduction)


def bradley_terry_losses(pairs: Sequence[Preference], parameters: Parameters, reduction: Reduction) -> Tensor:
    """Equation 6.4: -log P[chosen > rejected] of each pair, (pairs,)."""
    trajectories = [trajectory for pair in pairs for trajectory in (pair.chosen, pair.rejected)]
    observations = torch.as_tensor(np.concatenate([trajectory.observations for trajectory in trajectories]))
    actions = torch.as_tensor(np.concatenate([trajectory.actions for trajectory in trajectories]))
    lengths = torch.tensor([len(trajectory.actions) for trajectory in trajectories])
    steps = critic_forward(observations, actions, parameters.layers, n_heads=1)[0]
    of_trajectory = torch.repeat_interleave(torch.arange(len(trajectories)), lengths)
    reduced = torch.zeros(len(trajectories)).index_add(0, of_trajectory, steps)
    if reduction == "mean":
        reduced = reduced / lengths
    return torch.nn.functional.softplus(reduced[1::2] - reduced[0::2])


def fit_mlp(preferences: Sequence[Preference], config: MlpConfig | None = None) -> MlpRewardModel:
    """Train for `epochs`, `pairs_per_step` at a time, and keep the epoch with the least loss.

    The loss that chooses is that of held-out answers from ten answers on, of the training answers below.
    Raises LearningError for fewer than `fewest_answers` usable ones, SetupError for mixed setups.
    """
    config = config or MlpConfig()
    use_one_thread()
    setup, kept = usable_steps(preferences, fewest=config.fewest_answers)
    random = np.random.default_rng([config.seed, 4])
    order = random.permutation(len(kept))
    held_out = [kept[k] for k in order[: int(len(kept) * config.held_out_share)]] if len(kept) >= 10 else []
    train = [kept[k] for k in order[len(held_out) :]]
    shape = NetworkShape.of(setup, config.heads)
    parameters = Parameters(shape.critic_layers(n_heads=1), trainable=True)
    parameters.initialise(torch.Generator().manual_seed(config.seed))
    optimiser = torch.optim.Adam([parameters.flat], lr=config.learning_rate, fused=True)
    best_loss, best = float("inf"), parameters.to_arrays()
    for _ in range(config.epochs):
        order = random.permutation(len(train))
        for first in range(0, len(order), config.pairs_per_step):
            parameters.zero_grad()
            together = [train[k] for k in order[first : first + config.pairs_per_step]]
            bradley_terry_losses(together, parameters, config.reduction).mean().backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        with torch.no_grad():
            loss = float(bradley_terry_losses(held_out or train, parameters, config.reduction).mean())
        if loss < best_loss:
            best_loss, best = loss, parameters.to_arrays()
    raw = MlpRewardModel(setup.name, shape, tuple(best), shift=0.0, scale=1.0, reduction=config.reduction)
    trajectories = [trajectory for pair in kept for trajectory in (pair.chosen, pair.rejected)]
    values = np.concatenate([raw.rewards(d.observations, d.actions, d.next_observations) for d in trajectories])
    return MlpRewardModel(
        setup.name, shape, tuple(best), float(values.mean()), float(values.std()) + 1e-6, config.reduction
    )


def _fit(preferences: Sequence[Preference], asked: FitSettings) -> MlpRewardModel:
    return fit_mlp(preferences, MlpConfig(seed=asked.seed, reduction=asked.reduction))


MODEL = MlpRewardModel
FITTING = Fitting(_fit)

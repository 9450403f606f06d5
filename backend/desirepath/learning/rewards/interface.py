"""Chapter 7's reward model: one network for all people's answers in one view (details from the public code).

Chapter 6's neural model for one person's few answers is `mlp.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.preferences.preferences import Preference, usable_steps
from desirepath.learning.rewards.reward_model import FitSettings, Fitting, Reduction, RewardModel
from desirepath.simulation.trajectory import Trajectory

Floats = NDArray[np.float32]
LEAK = 0.01  # torch's default, as in the public code


@dataclass(frozen=True)
class InterfaceConfig:
    """Spec 07 unless marked ours. patience: epochs without a better held-out loss after which it ends."""

    seed: int = 0
    epochs: int = 200
    learning_rate: float = 3e-4
    hidden: tuple[int, ...] = (256, 256, 256)
    dropout: tuple[float, ...] = (0.2, 0.5, 0.5)
    pairs_per_step: int = 64  # ours
    steps_per_trajectory: int = (
        3  # ours: the mean over a trajectory is estimated from so many of its steps, drawn anew each time
    )
    held_out_share: float = 0.1  # ours: the epoch is chosen on this share of the answers
    patience: int = 20  # ours
    fewest_answers: int = 2  # ours


@dataclass(frozen=True)
class InterfaceRewardModel(RewardModel):
    """r(s, a) in (-1, 1). layers: weight (out, in), bias (out,), ... in order."""

    kind: ClassVar[str] = "interface"

    setup: str
    layers: tuple[Floats, ...]
    reduction: Reduction = "mean"

    def rewards(self, observations: Floats, actions: Floats, next_observations: Floats) -> Floats:
        del next_observations  # r(s, a) does not see where the step led
        values = torch.as_tensor(np.concatenate([observations, actions], axis=1))
        weights = [torch.as_tensor(array) for array in self.layers]
        with torch.no_grad():
            for weight, bias in zip(weights[0:-2:2], weights[1:-2:2], strict=True):
                values = nn.functional.leaky_relu(nn.functional.linear(values, weight, bias), LEAK)
            found: Floats = torch.tanh(nn.functional.linear(values, weights[-2], weights[-1]))[:, 0].numpy()
        return found

    def to_arrays(self) -> tuple[dict[str, object], dict[str, Floats]]:
        meta: dict[str, object] = {"kind": self.kind, "setup": self.setup, "reduction": self.reduction}
        return meta, {f"layer_{k:02d}": array for k, array in enumerate(self.layers)}

    @classmethod
    def from_arrays(cls, meta: dict[str, Any], arrays: dict[str, Floats]) -> InterfaceRewardModel:
        return cls(meta["setup"], tuple(arrays[name] for name in sorted(arrays)))


def fit_interface(preferences: Sequence[Preference], config: InterfaceConfig | None = None) -> InterfaceRewardModel:
    """Bradley-Terry on the mean reward of each trajectory; the epoch with the least held-out loss is kept.

    Of 775 simulated answers to shipped queries (three preferences, 5 % lapses) it repeats 86 to 92 % and predicts 82 to
    87 % of 200 right answers about other scenes; the linear model predicts 85 to 96 %. Without dropout it predicts 0.5
    to 2.5 points more and repeats up to 95 %; eight steps of each trajectory for 60 epochs predict no more (81 to 84
    %).

    Raises LearningError for fewer than `fewest_answers` usable answers, SetupError for mixed setups.
    """
    config = config or InterfaceConfig()
    use_one_thread()
    setup, kept = usable_steps(preferences, fewest=config.fewest_answers)
    random = np.random.default_rng([config.seed, 7])
    torch.manual_seed(config.seed)
    steps, spans = _steps(kept)
    order = random.permutation(len(kept))
    held_out = order[: int(len(kept) * config.held_out_share)]
    train = order[len(held_out) :]
    network = _network(steps.shape[1], config, random)
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate, fused=True)
    judged = held_out if len(held_out) else train
    best_loss, best, since = float("inf"), _layers(network), 0
    for _ in range(config.epochs):
        network.train()
        for pairs in np.array_split(random.permutation(train), max(1, len(train) // config.pairs_per_step)):
            rows = _drawn(spans[pairs], config.steps_per_trajectory, random)
            optimiser.zero_grad()
            bradley_terry_mean_loss(network(steps[rows].flatten(0, 2)).view(rows.shape).mean(2)).backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        network.eval()
        with torch.no_grad():
            loss = float(bradley_terry_mean_loss(_whole(network, steps, spans[judged])))
        if loss < best_loss:
            best_loss, best, since = loss, _layers(network), 0
        elif (since := since + 1) >= config.patience:
            break
    return InterfaceRewardModel(setup.name, best)


def _steps(pairs: Sequence[Preference]) -> tuple[Tensor, NDArray[np.int64]]:
    """All trajectories' steps, (steps, inputs), each trajectory once; and per pair the first row and the number of
    rows of the chosen and the rejected trajectory, (pairs, 2, 2)."""
    first: dict[int, tuple[int, int]] = {}
    rows: list[Floats] = []
    count = 0

    def span(trajectory: Trajectory) -> tuple[int, int]:
        nonlocal count
        if id(trajectory) not in first:
            first[id(trajectory)] = (count, len(trajectory.actions))
            rows.append(np.concatenate([trajectory.observations, trajectory.actions], axis=1).astype(np.float32))
            count += len(trajectory.actions)
        return first[id(trajectory)]

    spans = np.array([[span(pair.chosen), span(pair.rejected)] for pair in pairs], dtype=np.int64)
    return torch.as_tensor(np.concatenate(rows)), spans


def _drawn(spans: NDArray[np.int64], count: int, random: np.random.Generator) -> NDArray[np.int64]:
    """Rows of `count` steps of each trajectory, drawn with replacement: (pairs, 2, count)."""
    shares = random.random((*spans.shape[:2], count))
    drawn: NDArray[np.int64] = spans[..., :1] + (shares * spans[..., 1:]).astype(np.int64)
    return drawn


def _whole(network: nn.Module, steps: Tensor, spans: NDArray[np.int64]) -> Tensor:
    """Mean reward over all steps of each trajectory: (pairs, 2)."""
    flat = spans.reshape(-1, 2)
    rows = np.concatenate([np.arange(start, start + length) for start, length in flat])
    of_trajectory = torch.repeat_interleave(torch.arange(len(flat)), torch.as_tensor(flat[:, 1]))
    summed = torch.zeros(len(flat)).index_add(0, of_trajectory, network(steps[rows])[:, 0])
    return (summed / torch.as_tensor(flat[:, 1])).view(-1, 2)


def bradley_terry_mean_loss(means: Tensor) -> Tensor:
    """-log P[chosen > rejected] of mean rewards (pairs, 2), averaged."""
    return nn.functional.softplus(means[:, 1] - means[:, 0]).mean()


class _Dropout(nn.Module):
    """torch's dropout costs as much as the products here; masks of random bytes a tenth (shares to 1/256)."""

    def __init__(self, share: float, random: np.random.Generator) -> None:
        super().__init__()
        self.dropped, self.random = round(share * 256), random

    def forward(self, values: Tensor) -> Tensor:
        if not self.training:
            return values
        kept = torch.from_numpy(self.random.integers(0, 256, tuple(values.shape), np.uint8)) >= self.dropped
        return values * kept * (256 / (256 - self.dropped))


def _network(inputs: int, config: InterfaceConfig, random: np.random.Generator) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width, dropout in zip(config.hidden, config.dropout, strict=True):
        layers += [nn.Linear(inputs, width), nn.LeakyReLU(LEAK), _Dropout(dropout, random)]
        inputs = width
    return nn.Sequential(*layers, nn.Linear(inputs, 1), nn.Tanh())


def _layers(network: nn.Sequential) -> tuple[Floats, ...]:
    return tuple(parameter.detach().numpy().copy() for parameter in network.parameters())


def _fit(preferences: Sequence[Preference], asked: FitSettings) -> InterfaceRewardModel:
    return fit_interface(preferences, InterfaceConfig(seed=asked.seed))


MODEL = InterfaceRewardModel
FITTING = Fitting(_fit)

"""The predictor of section 3.3.2.2: the next latent and where the person is next, from the last five steps.

Two LSTM layers of 64 read (person distance, person bearing, action, latent); two linear heads give the next latent's
mean and log variance, a two-layer head the person's next place. Distances enter and leave as shares of the camera's
range, bearings over pi; a person who is not in view is at (-1 m, 0), as in the state (section 3.3.3).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from desirepath.npz import Arrays
from desirepath.perception.beta_vae import LATENTS, half_precision, single_precision
from desirepath.simulation.stored import StoredArrays

STEPS = 5
UNITS = 64
INPUTS = 2 + 2 + LATENTS

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class PredictorConfig:
    """How it is trained; ours. person_weight: of the person's squared error beside the latents' log-likelihood."""

    seed: int = 0
    batches: int = 3_000
    batch_size: int = 128
    learning_rate: float = 1e-3
    person_weight: float = 300.0

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


class Predictor(nn.Module):
    """Sequences (n, 5, 36) -> next latent's mean and log variance (n, 32), next person (n, 2)."""

    def __init__(self) -> None:
        super().__init__()
        self.memory = nn.LSTM(INPUTS + 2, UNITS, num_layers=2, batch_first=True)
        self.mean = nn.Linear(UNITS, LATENTS)
        self.log_variance = nn.Linear(UNITS, LATENTS)
        self.person = nn.Sequential(nn.Linear(UNITS, UNITS), nn.ReLU(), nn.Linear(UNITS, 2))

    def forward(self, sequences: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        # A step changes little: what has changed is told ten times as large, and changes are learned, not places.
        moved = 10 * (sequences[:, :, :2] - sequences[:, -1:, :2])
        last = self.memory(torch.cat([sequences, moved], dim=2))[0][:, -1]
        person = sequences[:, -1, :2] + self.person(last) / 10
        mean = sequences[:, -1, 4:] + self.mean(last)
        return mean, self.log_variance(last).clamp(-8.0, 3.0), person


def fit_predictor(
    sequences: Floats, next_latents: Floats, next_people: Floats, seen: NDArray[np.bool_], config: PredictorConfig
) -> Predictor:
    """Sequences (n, 5, 36), what followed them (n, 32) and (n, 2); seen (n,): whether the person is in view then."""
    torch.manual_seed(config.seed)
    predictor = Predictor()
    optimiser = torch.optim.Adam(predictor.parameters(), config.learning_rate)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.batches)
    random = np.random.default_rng(config.seed)
    inputs, latents, people = (torch.from_numpy(part) for part in (sequences, next_latents, next_people))
    counted = torch.from_numpy(seen.astype(np.float32))
    for _ in range(config.batches):
        rows = torch.from_numpy(random.integers(len(inputs), size=config.batch_size))
        mean, log_variance, person = predictor(inputs[rows])
        likelihood = (log_variance + (latents[rows] - mean).square() / log_variance.exp()).mean() / 2
        error = ((people[rows] - person).square().sum(dim=1) * counted[rows]).mean()
        optimiser.zero_grad()
        (likelihood + config.person_weight * error).backward()
        optimiser.step()
        falling.step()
    return predictor


class PersonPredictor(StoredArrays):
    """A trained predictor for who only asks."""

    noun, file_format = "depth predictor", "desirepath-depth-predictor-1"

    def __init__(self, predictor: Predictor, about: dict[str, Any] | None = None) -> None:
        self._predictor, self.about = predictor.eval(), about or {}

    def next(self, sequences: Floats) -> tuple[Floats, Floats]:
        """(n, 5, 36) -> the next latents' means (n, 32), the next person (n, 2), scaled as the inputs."""
        with torch.no_grad():
            mean, _, person = self._predictor(torch.from_numpy(sequences))
        return mean.numpy(), person.numpy()

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        return {"about": self.about}, half_precision(self._predictor)

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> PersonPredictor:
        predictor = Predictor()
        predictor.load_state_dict(single_precision(arrays))
        return cls(predictor, header["about"])

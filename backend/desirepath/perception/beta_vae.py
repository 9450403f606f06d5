"""The beta-VAE of section 3.3.2.1: a depth frame becomes 32 latents, and a clean frame again.

With x the clean frame (range 1), x~ the frame as the camera gives it, D = 128 x 80 pixels:

    L = D * mean w (x - decoder(z))^2 / (2 s^2) + beta * KL( N(mu(x~), sigma(x~)^2) || N(0, 1) ),  z ~ N(mu, sigma^2)

so what is lost and how noisy the pictures are never enters the target. beta = 3 as in table 3.1. Ours are s, the
standard deviation that the decoder grants a pixel (the thesis does not say how its two terms are scaled), and how much
a pixel counts, w (mean 1): what is near, the person and thin things cover few pixels, and are what robots hit.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from desirepath.npz import Arrays
from desirepath.simulation.stored import StoredArrays

LATENTS = 32
ROWS, COLUMNS = 80, 128
CHANNELS = (8, 16, 32, 32, 64, 64)  # ours; the thesis says six convolutions with ReLU
STRIDES = (2, 2, 2, 1, 2, 1)
NARROW = 64 * 5 * 8  # numbers between the convolutions and the latents

Frames = NDArray[np.float32]


@dataclass(frozen=True)
class VaeConfig:
    """How it is trained. beta: table 3.1; the rest is ours."""

    seed: int = 0
    beta: float = 3.0
    pixel_std: float = 0.05  # s, of the range: 30 cm
    near: float = 0.15  # w falls as 1 / (x + near)^2
    person_weight: float = 4.0  # times so much on the person
    thin_weight: float = 4.0  # and on thin things
    batches: int = 1_000
    batch_size: int = 32
    learning_rate: float = 1e-3

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


class BetaVae(nn.Module):
    """Six convolutions down, six up. Frames (n, 80, 128) as shares of the range; 0 where the camera saw nothing."""

    def __init__(self) -> None:
        super().__init__()
        down: list[nn.Module] = []
        before = 1
        for channels, stride in zip(CHANNELS, STRIDES, strict=True):
            down += [nn.Conv2d(before, channels, 3, stride, 1), nn.ReLU()]
            before = channels
        self.down = nn.Sequential(*down)
        self.to_latents = nn.Linear(NARROW, 2 * LATENTS)
        self.from_latents = nn.Linear(LATENTS, NARROW)
        up: list[nn.Module] = []
        for channels, stride in zip((*CHANNELS[-2::-1], 1), reversed(STRIDES), strict=True):
            up += [nn.ConvTranspose2d(before, channels, 3, stride, 1, output_padding=stride - 1), nn.ReLU()]
            before = channels
        self.up = nn.Sequential(*up[:-1])
        for layer in self.modules():  # torch's own beginning lets twelve layers fade away
            if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
                nn.init.constant_(cast(Tensor, layer.bias), 0.0)
        last = cast(nn.ConvTranspose2d, self.up[-1])
        with torch.no_grad():
            self.to_latents.weight.mul_(0.1)
            last.weight.mul_(0.1)
            cast(Tensor, last.bias).fill_(0.5)

    def encode(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """(n, 80, 128) -> mean (n, 32), logarithm of the variance (n, 32)."""
        mean, log_variance = self.to_latents(self.down(frames[:, None]).flatten(1)).chunk(2, dim=1)
        return mean, log_variance.clamp(-10.0, 4.0)

    def decode(self, latents: Tensor) -> Tensor:
        """(n, 32) -> (n, 80, 128)."""
        narrow = torch.relu(self.from_latents(latents)).reshape(-1, CHANNELS[-1], 5, 8)
        frames: Tensor = self.up(narrow)[:, 0]
        return frames


def loss_of(
    vae: BetaVae, seen: Tensor, clean: Tensor, weights: Tensor, noise: Tensor, config: VaeConfig
) -> tuple[Tensor, Tensor]:
    """(L as above, mean squared error alone) of frames (n, 80, 128); weights: w, as they; noise (n, 32): normal."""
    mean, log_variance = vae.encode(seen)
    decoded = vae.decode(mean + noise * torch.exp(log_variance / 2))
    apart = (decoded - clean).square()
    squared = (weights * apart).flatten(1).mean(dim=1)
    divergence = (mean.square() + log_variance.exp() - log_variance - 1).sum(dim=1) / 2
    scale = ROWS * COLUMNS / (2 * config.pixel_std**2)
    # Both terms over D: the gradients then have the size that Adam's step expects.
    loss = (scale * squared + config.beta * divergence).mean() / (ROWS * COLUMNS)
    return loss, apart.detach().mean()


class DepthEncoder(StoredArrays):
    """A trained beta-VAE for who only looks: arrays in, arrays out. range_m: what share 1 of a frame means."""

    noun, file_format = "depth encoder", "desirepath-depth-vae-1"

    def __init__(self, vae: BetaVae, range_m: float, about: dict[str, Any] | None = None) -> None:
        self._vae, self.range_m, self.about = vae.eval(), range_m, about or {}

    def latents(self, frames: Frames) -> NDArray[np.float32]:
        """(n, 80, 128) metres -> (n, 32), the means."""
        with torch.no_grad():
            means, _ = self._vae.encode(torch.from_numpy(frames / np.float32(self.range_m)))
        return np.asarray(means.numpy())

    def frames(self, latents: NDArray[np.float32]) -> Frames:
        """(n, 32) -> (n, 80, 128) metres."""
        with torch.no_grad():
            rendered = self._vae.decode(torch.from_numpy(latents)).clamp(0.0, 1.0)
        return np.asarray(rendered.numpy() * np.float32(self.range_m))

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        """Weights in half precision, which changes a latent by about 1e-3."""
        return {"range_m": self.range_m, "about": self.about}, half_precision(self._vae)

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> DepthEncoder:
        vae = BetaVae()
        vae.load_state_dict(single_precision(arrays))
        return cls(vae, float(header["range_m"]), header["about"])


def half_precision(network: nn.Module) -> Arrays:
    """Its weights by name, for storage."""
    return {name: value.numpy().astype(np.float16) for name, value in network.state_dict().items()}


def single_precision(arrays: Arrays) -> dict[str, Tensor]:
    """Back from `half_precision`."""
    return {name: torch.from_numpy(value.astype(np.float32)) for name, value in arrays.items()}

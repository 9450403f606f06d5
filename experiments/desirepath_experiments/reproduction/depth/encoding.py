"""How the beta-VAE learns from a recording: batches of noisy pictures, in parts that can be stored in between.

The loss is `perception/beta_vae.py`'s; what was recorded, `recording.py`'s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.perception.beta_vae import LATENTS, BetaVae, DepthEncoder, VaeConfig, loss_of
from desirepath.simulation.depth_camera import CameraNoise, DepthCamera, Frames
from desirepath_experiments.reproduction.depth.recording import Recording

THIN_M = 0.3  # a jump of this many metres within THIN_PX pixels both ways is something thin
THIN_PX = 4
RISING = 0.02  # share of the batches, ours: in which the learning rate rises


def thin_parts(frames: Frames) -> NDArray[np.bool_]:
    """Pixels (n, rows, columns) of something narrower than THIN_PX with more than THIN_M behind it on both sides."""
    thin = np.zeros(frames.shape, dtype=np.bool_)
    middle = frames[:, :, THIN_PX:-THIN_PX]
    left, right = frames[:, :, : -2 * THIN_PX], frames[:, :, 2 * THIN_PX :]
    thin[:, :, THIN_PX:-THIN_PX] = (left - middle > THIN_M) & (right - middle > THIN_M)
    return thin


def pixel_weights(clean: Frames, alone: Frames, range_m: float, config: VaeConfig) -> Frames:
    """w of the loss (n, rows, columns), mean 1. alone: the same pictures without the person."""
    weights: Frames = (clean / np.float32(range_m) + np.float32(config.near)) ** -2
    weights[clean != alone] *= config.person_weight
    weights[thin_parts(clean)] *= config.thin_weight
    weights /= weights.mean()
    return weights


class EncoderTraining:
    """A training of `config.batches` batches that can be left after any of them and gone on with from its `state`.

    Every batch draws its pictures by its own number, so that it is the same training however often it was left.
    """

    def __init__(
        self,
        recording: Recording,
        cameras: tuple[DepthCamera, ...],
        noise: CameraNoise,
        config: VaeConfig,
        state: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        torch.manual_seed(config.seed)
        self._recording, self._cameras, self._noise, self._config = recording, cameras, noise, config
        self._vae = BetaVae()
        names = [name for name, _ in self._vae.named_parameters()]
        self.curve: list[float] = []
        if state is not None:
            self._vae.load_state_dict({name: torch.from_numpy(state[f"weight_{name}"].copy()) for name in names})
            self.curve = [float(value) for value in state["curve"]]
        # Twice as fast on this layout, to the bit the same numbers.
        self._vae = self._vae.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._optimiser = torch.optim.Adam(self._vae.parameters(), config.learning_rate)
        if state is not None:
            moments = {
                i: {
                    "step": torch.tensor(float(len(self.curve))),
                    "exp_avg": torch.from_numpy(state[f"mean_{name}"].copy()),
                    "exp_avg_sq": torch.from_numpy(state[f"square_{name}"].copy()),
                }
                for i, name in enumerate(names)
            }
            self._optimiser.load_state_dict({**self._optimiser.state_dict(), "state": moments})

    def run(self, until: int) -> None:
        """Go on until so many batches are done. The curve holds their errors, metres."""
        while len(self.curve) < min(until, self._config.batches):
            self._step(len(self.curve))

    def _step(self, batch: int) -> None:
        config, camera = self._config, self._cameras[batch % len(self._cameras)]
        random = np.random.default_rng([config.seed, 0xAE, batch])
        which = random.integers(self._recording.size, size=config.batch_size)
        clean = self._recording.frames(camera, which)
        weights = pixel_weights(clean, self._recording.frames(camera, which, alone=True), camera.range_m, config)
        seen = self._noise.applied(clean, camera, random)
        range_m = np.float32(camera.range_m)
        loss, squared = loss_of(
            self._vae,
            torch.from_numpy(seen / range_m),
            torch.from_numpy(clean / range_m),
            torch.from_numpy(weights),
            torch.from_numpy(random.standard_normal((config.batch_size, LATENTS), dtype=np.float32)),
            config,
        )
        falls = (1 + math.cos(math.pi * batch / config.batches)) / 2
        for group in self._optimiser.param_groups:
            group["lr"] = config.learning_rate * falls * min(1.0, (batch + 1) / (RISING * config.batches))
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()
        self.curve.append(float(squared) ** 0.5 * float(range_m))

    def state(self) -> dict[str, NDArray[Any]]:
        """All that the next part needs."""
        moments = self._optimiser.state_dict()["state"]
        arrays: dict[str, NDArray[Any]] = {"curve": np.array(self.curve, dtype=np.float32)}
        for i, (name, value) in enumerate(self._vae.named_parameters()):
            arrays[f"weight_{name}"] = value.detach().contiguous().numpy()
            arrays[f"mean_{name}"] = moments[i]["exp_avg"].contiguous().numpy()
            arrays[f"square_{name}"] = moments[i]["exp_avg_sq"].contiguous().numpy()
        return arrays

    def encoder(self) -> DepthEncoder:
        """As it is now."""
        return DepthEncoder(self._vae, self._cameras[0].range_m, {"config": self._config.as_dict()})

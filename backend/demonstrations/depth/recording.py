"""What the encoder and the predictor learn from: an obstacle avoider's rollouts in homes (section 3.3.2.3).

Poses are kept, not pictures: a picture is drawn again in less time than it is read from a disk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from backend.demonstrations.depth.episodes import EpisodePool, Episodes, people_of
from backend.learning.policies.policy import Policy
from backend.perception.beta_vae import BetaVae, DepthEncoder, VaeConfig, loss_of
from backend.simulation.depth_camera import CameraNoise, DepthCamera, Frames, Sights
from backend.simulation.fast import FastEngine
from backend.simulation.setups import HOME

Doubles = NDArray[np.float64]
NOISE_M = 0.15  # standard deviation of what is added to the avoider's actions, so that not only its own ways are seen


@dataclass(frozen=True)
class Recording:
    """Time by robots: poses (t, n, 3), people (t, n, 4), actions (t, n, 2) taken there, episodes (t, n), begins (t, n).

    begins: whether the step is an episode's first.
    """

    sights: Sights
    poses: Doubles
    people: Doubles
    actions: NDArray[np.float32]
    episodes: NDArray[np.int64]
    begins: NDArray[np.bool_]

    def frames(self, camera: DepthCamera, which: NDArray[np.int64]) -> Frames:
        """Clean pictures of these steps, numbered through all times and robots."""
        poses, people = (part.reshape(-1, part.shape[-1])[which] for part in (self.poses, self.people))
        return self.sights.pictures(camera, poses, people, self.episodes.reshape(-1)[which])

    @property
    def size(self) -> int:
        return int(self.episodes.size)


def record(policy: Policy, episodes: Episodes, *, steps: int, robots: int, seed: int = 0) -> Recording:
    """Roll the avoider out, with noise on its actions, episode after episode."""
    engine = FastEngine(HOME, robots, seed=seed, pool=EpisodePool(episodes, seed))
    random = np.random.default_rng([seed, 0x5EC])
    poses, people, actions, numbers, begins = [], [], [], [], []
    first = np.ones(robots, dtype=bool)
    for _ in range(steps):
        action = np.clip(policy.act(engine.observations) + random.normal(0.0, NOISE_M, (robots, 2)), -1, 1)
        poses.append(engine.poses.copy())
        people.append(people_of(engine.rows))
        actions.append(action.astype(np.float32))
        numbers.append(engine.seeds.copy())
        begins.append(first)
        engine.step(actions[-1])
        first = engine.dones.copy()
    stacked = (np.stack(part) for part in (poses, people, actions, numbers, begins))
    return Recording(episodes.sights(), *stacked)


def train_encoder(
    recording: Recording, cameras: tuple[DepthCamera, ...], noise: CameraNoise, config: VaeConfig
) -> tuple[DepthEncoder, list[float]]:
    """Fit the beta-VAE to noisy pictures of all recorded steps and all cameras; the curve of its errors in metres."""
    torch.manual_seed(config.seed)
    random = np.random.default_rng([config.seed, 0xAE])
    vae = BetaVae()
    optimiser = torch.optim.Adam(vae.parameters(), config.learning_rate)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.batches)
    curve = []
    for batch in range(config.batches):
        camera = cameras[batch % len(cameras)]
        clean = recording.frames(camera, random.integers(recording.size, size=config.batch_size))
        seen = noise.applied(clean, camera, random)
        range_m = np.float32(camera.range_m)
        loss, squared = loss_of(
            vae,
            torch.from_numpy(seen / range_m),
            torch.from_numpy(clean / range_m),
            torch.from_numpy(random.standard_normal((config.batch_size, 32), dtype=np.float32)),
            config,
        )
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        falling.step()
        curve.append(float(squared) ** 0.5 * float(range_m))
    return DepthEncoder(vae, cameras[0].range_m, {"config": config.as_dict()}), curve

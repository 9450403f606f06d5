"""What a depth vision-based controller acts on: the six configurations of section 3.5.1 and their states.

State: [goal distance, goal bearing, k, person distance, person bearing, (predicted person), latent]. Distances are
shares of the camera's range, bearings of pi; a person out of view is at (-1 m, 0).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.policies.shape import FAST_HEADS, NetworkShape
from desirepath.perception.beta_vae import LATENTS, DepthEncoder
from desirepath.perception.predictor import INPUTS, STEPS, PersonPredictor
from desirepath.simulation import kernels as k
from desirepath.simulation.depth_camera import DEPTH_CAMERA, WIDE_CAMERA, CameraNoise, DepthCamera, Sights

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
UNSEEN_M = -1.0


@dataclass(frozen=True)
class DepthConfiguration:
    """What a controller is told and how it learns. detects_in_evaluation: whether the person is, once it is judged."""

    name: str
    camera: DepthCamera = DEPTH_CAMERA
    goal_distance: bool = True
    predicts: bool = False
    demonstrations: bool = True
    detects_in_evaluation: bool = True
    trained_as: str = ""

    @property
    def task_inputs(self) -> int:
        """Length of the state before the latent."""
        return 4 + self.goal_distance + 2 * self.predicts

    def shape(self, heads: tuple[int, ...] = FAST_HEADS) -> NetworkShape:
        return NetworkShape(self.task_inputs, LATENTS, heads=heads)


CONFIGURATIONS = {
    senses.name: senses
    for senses in (
        DepthConfiguration("VAE-HA"),
        DepthConfiguration("VAE-HU", detects_in_evaluation=False, trained_as="VAE-HA"),
        DepthConfiguration("VAE-ND", demonstrations=False),
        DepthConfiguration("LSTM-HP", predicts=True),
        DepthConfiguration("VAE-FOV-120", camera=WIDE_CAMERA),
        DepthConfiguration("VAE-NG", goal_distance=False),
    )
}


def bearings(poses: Doubles, places: Doubles) -> tuple[Doubles, Doubles]:
    """Distance (m) and bearing (rad) of places (n, 2) from robots at poses (n, 3)."""
    dx, dy = places[:, 0] - poses[:, 0], places[:, 1] - poses[:, 1]
    turned = np.arctan2(dy, dx) - poses[:, 2]
    return np.hypot(dx, dy), (turned + math.pi) % (2 * math.pi) - math.pi


def detect_person(camera: DepthCamera, poses: Doubles, people: Doubles) -> Floats:
    """(n, 3): k, the person's distance as a share of the range, bearing over pi, as the state has them."""
    seen = camera.sees(poses, np.nan_to_num(people, nan=1e6))
    away, turned = bearings(poses, np.nan_to_num(people, nan=1e6))
    distance, bearing = np.where(seen, away, UNSEEN_M) / camera.range_m, np.where(seen, turned, 0.0) / math.pi
    return np.stack([seen, distance, bearing], axis=1).astype(np.float32)


class Senses:
    """Camera, encoder and, where the configuration has it, the predictor of n robots, step by step.

    noise None: clean pictures. evaluating: a configuration whose detection is then switched off sees nobody.
    """

    def __init__(
        self,
        configuration: DepthConfiguration,
        encoder: DepthEncoder,
        predictor: PersonPredictor | None,
        sights: Sights,
        *,
        seed: int = 0,
        noise: CameraNoise | None = None,
        evaluating: bool = False,
    ) -> None:
        if configuration.predicts and predictor is None:
            raise ValueError(f"configuration {configuration.name} needs a predictor")
        self.configuration, self._encoder, self._predictor = configuration, encoder, predictor
        self._sights, self._noise = sights, noise
        self._random = np.random.default_rng([seed, 0x5E5])
        self._blind = evaluating and not configuration.detects_in_evaluation
        self._history = np.zeros((0, STEPS, INPUTS), dtype=np.float32)

    def states(
        self, poses: Doubles, goals: Doubles, people: Doubles, places: NDArray[np.int64], begins: NDArray[np.bool_]
    ) -> Floats:
        """(n, size) of robots at poses (n, 3) with goals (n, 2), people (n, 4), scenes (n,); begins (n,): at first."""
        camera = self.configuration.camera
        frames = self._sights.pictures(camera, poses, people, places)
        if self._noise is not None:
            frames = self._noise.applied(frames, camera, self._random)
        latents = self._encoder.latents(frames)
        person = detect_person(camera, poses, people)
        if self._blind:
            person[:] = 0.0, UNSEEN_M / camera.range_m, 0.0
        away, turned = bearings(poses, goals)
        goal = np.stack([away / camera.range_m, turned / math.pi], axis=1).astype(np.float32)
        parts = [goal if self.configuration.goal_distance else goal[:, 1:], person]
        if self._predictor is not None and self.configuration.predicts:
            parts.append(self._predict(person, latents, begins))
        return np.concatenate([*parts, latents], axis=1)

    def _predict(self, person: Floats, latents: Floats, begins: NDArray[np.bool_]) -> Floats:
        now = np.concatenate([person[:, 1:], np.zeros((len(person), 2), np.float32), latents], axis=1)
        if len(self._history) != len(now):
            self._history, begins = np.zeros((len(now), STEPS, INPUTS), np.float32), np.ones(len(now), bool)
        self._history = np.concatenate([self._history[:, 1:], now[:, None]], axis=1)
        self._history[begins] = now[begins, None]
        assert self._predictor is not None  # noqa: S101 - the caller looked
        _, people = self._predictor.next(self._history)
        return np.where(person[:, :1] > 0, people, person[:, 1:]).astype(np.float32)

    def acted(self, actions: Floats) -> None:
        """Note what the robots do next (n, 2); the predictor reads it with the last state."""
        if len(self._history):
            self._history[:, -1, 2:4] = actions


def goals_of(rows: k.Rows) -> Doubles:
    """(n, 2) of engine rows."""
    return rows[:, k.GOAL_X : k.GOAL_X + 2]

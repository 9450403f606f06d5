"""Episodes in homes: where the robot goes and what the person does meanwhile (section 3.4.3, person modes 1 to 5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.planned_walks import walking_scene
from desirepath.simulation import kernels as k
from desirepath.simulation.depth_camera import Sights
from desirepath.simulation.scene import Scene, SceneError
from desirepath.simulation.scenes import scenes_to_rows
from desirepath.simulation.setups import CONTROL_DT_S, get_setup

HOME = get_setup("home")

MODES = ("opposite", "random", "static", "absent", "replayed")
"""1 to 5 of section 3.4.3: on the way from the robot's goal to its start, between random places, standing, nobody,
walking as they did while they demonstrated."""
YAW_STD = 0.3  # ours: of where robots look at first in demonstrated scenes, around where it was demonstrated
NOWHERE_M = 1e3  # nobody is in the way out there
Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class Episodes:
    """Scenes with people's modes. Where nobody is (mode `absent`), the scene's person is ignored."""

    scenes: tuple[Scene, ...]
    modes: tuple[str, ...]

    def __post_init__(self) -> None:
        if len(self.scenes) != len(self.modes) or not set(self.modes) <= set(MODES):
            raise ValueError(f"{len(self.scenes)} scenes with modes {sorted(set(self.modes))}: known are {MODES}")

    def __len__(self) -> int:
        return len(self.scenes)

    def sights(self) -> Sights:
        """Walls and furniture of the scenes, in order."""
        return Sights(self.scenes)

    def rows(self) -> k.Rows:
        rows = scenes_to_rows(self.scenes)
        absent = np.array([mode == "absent" for mode in self.modes], dtype=bool)
        rows[absent, k.PERSON_X] = NOWHERE_M
        return rows

    def walks(self) -> Doubles:
        """(episodes, max_steps + 1, 3) where people are after every step, NaN for those who stand."""
        times = np.arange(HOME.max_steps + 1) * CONTROL_DT_S
        walks = np.full((len(self), len(times), 3), np.nan)
        for walk, scene in zip(walks, self.scenes, strict=True):
            if scene.walk is not None:
                walk[:] = scene.person_poses(times)
        return walks


def with_mode(scene: Scene, mode: str, seed: int) -> Scene:
    """The scene with a person of that mode (not `replayed`). Raises SceneError where no way was found."""
    return walking_scene(scene, mode, seed) if mode in ("opposite", "random") else replace(scene, walk=None)


def home_episodes(scenes: Sequence[Scene], modes: Sequence[str], seed: int = 0) -> Episodes:
    """These scenes with these modes in turn; one whose person finds no way has them standing."""
    chosen, kinds = [], []
    for i, scene in enumerate(scenes):
        mode = modes[i % len(modes)]
        try:
            chosen.append(with_mode(scene, mode, seed + i))
        except SceneError:
            chosen.append(scene)
            mode = "static"
        kinds.append(mode)
    return Episodes(tuple(chosen), tuple(kinds))


class EpisodePool:
    """A start pool (`FastEngine`'s `pool`) of episodes, drawn at random. Seeds are the episodes' numbers.

    varied (ours): the robot begins looking anywhere, in demonstrated scenes about where it was demonstrated to look;
    where nobody walks, start and goal change places half of the time.
    """

    def __init__(self, episodes: Episodes, seed: int, weights: Doubles | None = None, *, varied: bool = False) -> None:
        self._rows, self._walks = episodes.rows(), episodes.walks()
        self._random = np.random.default_rng([seed, 0xE9])
        even = np.ones(len(episodes)) if weights is None else weights
        self._shares = even / even.sum()
        self._varied = varied
        self._shown = np.array([mode == "replayed" for mode in episodes.modes], dtype=bool)
        self._turns = np.isnan(self._walks[:, 0, 0]) & ~self._shown

    def take(self, count: int) -> tuple[k.Rows, NDArray[np.int64]]:
        rows, which, _ = self.take_walking(count)
        return rows, which

    def take_walking(self, count: int) -> tuple[k.Rows, NDArray[np.int64], Doubles]:
        """Starts that are at the middle of a walk would need its clock: everybody begins at the walk's beginning."""
        which = self._random.choice(len(self._rows), count, p=self._shares)
        rows = self._rows[which]
        return self._vary(rows, which) if self._varied else rows, which, self._walks[which]

    def _vary(self, rows: k.Rows, which: NDArray[np.int64]) -> k.Rows:
        start, goal = slice(k.START_X, k.START_X + 2), slice(k.GOAL_X, k.GOAL_X + 2)
        turned = self._turns[which] & (self._random.random(len(rows)) < 0.5)
        rows[turned, start], rows[turned, goal] = rows[turned, goal], rows[turned, start]
        about = rows[:, k.START_YAW] + self._random.normal(0.0, YAW_STD, len(rows))
        anywhere = self._random.uniform(-math.pi, math.pi, len(rows))
        yaw = np.where(self._shown[which], about, anywhere)
        rows[:, k.START_YAW] = (yaw + math.pi) % (2 * math.pi) - math.pi
        return rows


class InOrder(EpisodePool):
    """Every episode once, in order; for judging."""

    def __init__(self, episodes: Episodes) -> None:
        super().__init__(episodes, 0)
        self._next = 0

    def take_walking(self, count: int) -> tuple[k.Rows, NDArray[np.int64], Doubles]:
        which = np.arange(self._next, self._next + count) % len(self._rows)
        self._next += count
        return self._rows[which], which, self._walks[which]


def people_of(rows: k.Rows) -> Doubles:
    """(n, 4) x, y, yaw, height of the people in engine rows as the camera wants them; NaN where nobody is."""
    people = np.full((len(rows), 4), 1.7)
    people[:, :3] = rows[:, k.PERSON_X : k.PERSON_YAW + 1]
    people[rows[:, k.PERSON_X] >= NOWHERE_M] = math.nan
    return people

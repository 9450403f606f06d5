"""What the encoder and the predictor learn from: an obstacle avoider's rollouts in homes (section 3.3.2.3).

How the encoder learns from it is `encoding.py`'s.

Poses are kept, not pictures: a picture is drawn again in less time than it is read from a disk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.depth.episodes import EpisodePool, Episodes, people_of
from desirepath.learning.policies.policy import Policy
from desirepath.simulation.depth_camera import DepthCamera, Frames, Sights
from desirepath.simulation.fast import make_engine
from desirepath.simulation.setups import get_setup

HOME = get_setup("home")

Doubles = NDArray[np.float64]
FAR_M = 6.0  # ours: where somebody is who is not there
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

    def frames(self, camera: DepthCamera, which: NDArray[np.int64], *, alone: bool = False) -> Frames:
        """Clean pictures of these steps, numbered through all times and robots. alone: as if nobody were there."""
        poses, people = (part.reshape(-1, part.shape[-1])[which] for part in (self.poses, self.people))
        shown = np.full_like(people, np.nan) if alone else people
        return self.sights.pictures(camera, poses, shown, self.episodes.reshape(-1)[which])

    @property
    def size(self) -> int:
        return int(self.episodes.size)


def record(policy: Policy, episodes: Episodes, *, steps: int, robots: int, seed: int = 0) -> Recording:
    """Roll the avoider out, with noise on its actions, episode after episode.

    Where nobody is, it is told that somebody is far away: it has never met an empty home, and stands still in one.
    """
    engine = make_engine(HOME, robots, seed=seed, pool=EpisodePool(episodes, seed))
    random = np.random.default_rng([seed, 0x5EC])
    poses, people, actions, numbers, begins = [], [], [], [], []
    first = np.ones(robots, dtype=bool)
    person = HOME.person_inputs
    for _ in range(steps):
        observed = engine.observations.copy()
        if person is not None:
            observed[:, person[0]] = np.minimum(observed[:, person[0]], FAR_M / HOME.distance_scale_m)
        action = np.clip(policy.act(observed) + random.normal(0.0, NOISE_M, (robots, 2)), -1, 1)
        poses.append(engine.poses.copy())
        people.append(people_of(engine.rows))
        actions.append(action.astype(np.float32))
        numbers.append(engine.seeds.copy())
        begins.append(first)
        engine.step(actions[-1])
        first = engine.dones.copy()
    stacked = (np.stack(part) for part in (poses, people, actions, numbers, begins))
    return Recording(episodes.sights(), *stacked)

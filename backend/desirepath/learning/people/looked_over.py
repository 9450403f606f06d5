"""What a reward of others says of three trajectories that differ plainly, and what it was given there: a wrong unit,
scale or order is seen before anybody learns from it. How it is shown is the page's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.metrics import measure
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.steps import SeenSteps
from desirepath.learning.people.reward_file import RewardFileMember
from desirepath.learning.policies.manners import Manner, MannerPolicy
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory

NAMES = ("close", "far", "slow")
SCENES = 40  # of those for figures; the one in which the three differ most is shown
HALF_SPEED = Manner(speed=0.5)


@dataclass(frozen=True)
class GivenInput:
    """name, unit: of a quantity that the network was given, a scan's sectors together; low, high: the least and the
    greatest number that it was given of it in the three trajectories."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class LookedOver:
    """trajectories: as NAMES. rewards: of each trajectory's steps. sums, means: over its steps; order: 1 for the one
    that the model prefers, by the reduction that its manifest states."""

    trajectories: tuple[Trajectory, ...]
    rewards: tuple[NDArray[np.float64], ...]
    inputs: tuple[GivenInput, ...]
    reduction: str

    @property
    def sums(self) -> list[float]:
        return [float(one.sum()) for one in self.rewards]

    @property
    def means(self) -> list[float]:
        return [float(one.mean()) for one in self.rewards]

    @property
    def order(self) -> list[int]:
        scores = self.sums if self.reduction == "sum" else self.means
        return [1 + sum(other > one for other in scores) for one in scores]

    @property
    def never_changes(self) -> bool:
        """Whether it says the same of every step, which no reward of driving does."""
        together = np.concatenate(self.rewards)
        return bool(np.ptp(together) <= 1e-6 * max(1.0, float(np.abs(together).max())))


@lru_cache(maxsize=4)
def plain_examples(setup: str) -> tuple[Trajectory, ...]:
    """One trajectory close to the person, one far, one at half speed, in one scene. Raises LearningError where no
    scene has all three."""
    conditioned, room = load_conditioned(f"{setup}/conditioned"), get_setup(setup)
    scenes = scene_set(setup, SCENES, purpose=Purpose.FIGURE, seed=0)
    slow = MannerPolicy(room, conditioned.driving().act, HALF_SPEED)
    acts = (conditioned.driving("closer=1").rollout_policy, conditioned.driving("farther=1").rollout_policy, slow)
    trios = list(zip(*(rollout(room, act, scenes) for act in acts), strict=True))
    arrived = [trio for trio in trios if all(one.outcome == Outcome.SUCCESS for one in trio)]
    if not arrived:
        raise LearningError(f"setup {setup}: in none of {SCENES} scenes do all three examples arrive")
    apart = [np.ptp(measure(trio[:2]).min_human_distance) for trio in arrived]
    return arrived[int(np.argmax(apart))]


def look_over(member: RewardFileMember) -> LookedOver:
    """Ask it about the three. Raises LearningError where it cannot be asked, or says what is not a number."""
    trajectories = plain_examples(member.manifest.setup)
    steps = SeenSteps.of_trajectories(trajectories)
    rewards = member.rewards(steps)
    given = member.given(steps)
    columns = zip(member.manifest.conversion.names, given.T, strict=True)
    inputs = []
    for (name, unit), group in groupby(columns, key=lambda column: (_together(column[0][0]), column[0][1])):
        values = np.stack([column for _, column in group])
        inputs.append(GivenInput(name, unit, float(values.min()), float(values.max())))
    each = tuple(rewards[steps.of == k] for k in range(len(trajectories)))
    return LookedOver(trajectories, each, tuple(inputs), member.manifest.reduction)


def _together(name: str) -> str:
    """A scan's sectors by one name."""
    before, _, number = name.rpartition("_")
    return f"{before}_…" if number.isdigit() and before.endswith("lidar") else name

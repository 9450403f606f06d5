"""What people in general find comfortable, before anybody of a study is asked: weights that six raters of still moments
gave to what stands near a robot (SocNav1), as a prior over named measures.

Who comes near whom is all that both know. The weights come with the product (`experiments/shipping` fits them); what
answers make of the prior is `free_posterior.py`'s, which weighs it by how well it predicts them. All ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from desirepath.installed import DATASETS
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.embedding import SIZE
from desirepath.learning.measures.pairs import reference_differences
from desirepath.learning.measures.steps import reference
from desirepath.learning.preferences.features import obstacle_clearance_m
from desirepath.learning.preferences.measures import beside_person
from desirepath.learning.preferences.population_prior import IN_GENERAL, WeightPrior
from desirepath.npz import from_npz, to_npz
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
FILE = DATASETS / "people" / "in_general.npz"
FORMAT = "desirepath-people-in-general-1"
NEAR_M = (0.5, 0.8, 1.2, 1.6, 2.0, 3.0, 4.0)  # within these a person counts, squared towards the robot
SIDES_M = (0.8, 1.2, 2.0, 3.0)  # in front of them, behind, beside
THINGS_M = (0.5, 1.0, 2.0)
COLUMNS = len(NEAR_M) + 3 * len(SIDES_M) + len(THINGS_M)
RIDGE = 0.1  # of the named measures' mean square: over 200 pairs that it was not fitted to, 0.97 of every rater but one


def moment_columns(apart: Doubles, ahead: Doubles, thing: Doubles) -> Doubles:
    """(n, COLUMNS) of n moments. apart: of the person, m; ahead: cosine of where the robot is for them, 1 straight
    ahead; thing: of the nearest wall or thing from the robot's middle, m. All grow with what may disturb."""
    near = {radius: np.square(np.clip(1 - apart / radius, 0, None)) for radius in (*NEAR_M, *SIDES_M)}
    columns = [near[radius] for radius in NEAR_M]
    for radius in SIDES_M:
        sides = (np.clip(ahead, 0, None), np.clip(-ahead, 0, None), 1 - np.abs(ahead))
        columns += [near[radius] * side for side in sides]
    columns += [np.square(np.clip(1 - thing / reach, 0, None)) for reach in THINGS_M]
    return np.stack(columns, axis=1)


def comfort(weights: Doubles, trajectories: Sequence[Trajectory]) -> Doubles:
    """(raters, n): the mean over each trajectory's moments. weights: (raters, COLUMNS)."""
    found: Doubles = weights @ np.stack([_columns(trajectory).mean(0) for trajectory in trajectories]).T
    return found


def _columns(trajectory: Trajectory) -> Doubles:
    setup = get_setup(trajectory.scene.setup)
    apart, ahead = beside_person(trajectory)
    thing = obstacle_clearance_m(trajectory.next_observations, setup).astype(np.float64) + setup.robot.radius_m
    return moment_columns(apart[1:], ahead[1:], thing)


def to_bytes(raters: Sequence[str], weights: Doubles) -> bytes:
    return to_npz({"format": FORMAT, "raters": list(raters)}, {"weights": weights.astype(np.float32)})


@lru_cache(maxsize=1)
def rater_weights() -> dict[str, Doubles]:
    """Rater -> (COLUMNS,), as shipped."""
    header, arrays = from_npz(FILE.read_bytes())
    if header.get("format") != FORMAT:
        raise ValueError(f"{FILE.name}: format {header.get('format')!r}; this version reads {FORMAT!r}")
    return dict(zip(header["raters"], arrays["weights"].astype(np.float64), strict=True))


@lru_cache(maxsize=16)
def people_in_general(setup: str, without: str = "") -> WeightPrior:
    """Over a setup's named measures: what comes nearest to every rater's weights over the reference pairs, the mean and
    what raters differ by. without: a rater who is left out. Raises LearningError among pedestrians, whom no rater saw,
    and for a setup in which nobody is asked for preferences."""
    if get_setup(setup).pedestrians:
        raise LearningError(f"setup = {setup!r}: people in general were asked about one who stands, not about crowds")
    weights = np.stack([of for name, of in rater_weights().items() if name != without])
    scores = comfort(weights, reference(setup).trajectories)
    columns = reference_differences(setup).named
    held_back = RIDGE * float(np.square(columns).sum()) / columns.shape[1] * np.eye(columns.shape[1])
    of_raters = np.linalg.solve(columns.T @ columns + held_back, columns.T @ (scores[:, 0::2] - scores[:, 1::2]).T)
    of_raters /= np.sqrt(np.square(columns @ of_raters).mean(0))
    mean: Doubles = of_raters.mean(1)
    apart = (of_raters - mean[:, None]) / np.sqrt(len(weights))
    return WeightPrior(IN_GENERAL, np.pad(mean, (0, SIZE)), np.pad(apart, ((0, SIZE), (0, 0))))

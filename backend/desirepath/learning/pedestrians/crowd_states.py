"""What each network of chapter 4 is given: one flat vector per state, put together from what the engine senses.

Networks live in `crowd_networks.py`. Lengths are divided by the lidar's range.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.crowds.crowd_engine import COARSE_RANGES, GROUPS, CrowdEngine

Floats = NDArray[np.float32]
Given = Literal["points_and_groups", "points", "two_scans", "three_scans", "coarse", "ranges"]
SECTORS, PATH_POINTS = 180, 5
SIZES: dict[str, int] = {
    "points_and_groups": 2 * SECTORS + 4 * GROUPS + 2 * PATH_POINTS,
    "points": 2 * SECTORS + 2 * PATH_POINTS,
    "two_scans": 4 * SECTORS + 2 * PATH_POINTS,
    "three_scans": 3 * SECTORS + 2 * PATH_POINTS,
    "coarse": COARSE_RANGES + 2 + 2 * PATH_POINTS,
    "ranges": SECTORS + 2 * PATH_POINTS,
}


def states(engine: CrowdEngine, given: Given) -> Floats:
    """(n, SIZES[given]) float32, in this order; the path's points come last.

    points_and_groups: 180 points, 30 descriptors (older, newer). points: without these. two_scans: points of this scan
    and the one before, each in its own robot frame. three_scans: ranges of three scans. coarse: 128 ranges, the goal, a
    path of 1 m spacing. ranges: 180.
    """
    n = engine.n_envs
    path = engine.path_points
    if given == "points_and_groups":
        parts = [engine.points, engine.descriptors()]
    elif given == "points":
        parts = [engine.points]
    elif given == "two_scans":
        parts = [engine.points, engine.older_points]
    elif given == "three_scans":
        parts = [engine.ranges, engine.older_ranges, engine.oldest_ranges]
    elif given == "coarse":
        parts, path = [engine.coarse_ranges(), engine.goals()], engine.coarse_path()
    else:
        parts = [engine.ranges]
    flat = np.concatenate([part.reshape(n, -1) for part in (*parts, path)], axis=1)
    return np.asarray(flat / engine.setup.robot.lidar.range_m, dtype=np.float32)

"""Answers of people who know what they want."""

from __future__ import annotations

import numpy as np

from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.preferences import Preference


def prefers_distance(count: int) -> list[Preference]:
    """Somebody who chooses whatever stays farther from the person."""
    found = []
    for query in load_queries("study_room/queries_varied_200").queries[:count]:
        a, b = query.trajectory_a, query.trajectory_b
        person = np.array([query.scene.person.pose.x, query.scene.person.pose.y])
        nearest = [np.linalg.norm(one.poses[:, :2] - person, axis=1).min() for one in (a, b)]
        better, worse = (a, b) if nearest[0] > nearest[1] else (b, a)
        found.append(Preference(better, worse, "test", "P1"))
    return found

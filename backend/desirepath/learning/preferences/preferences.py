"""A preference as learning sees it: the trajectory that was chosen, the one that was not, and where the answer came
from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.learning.errors import LearningError, TooFewAnswers
from desirepath.learning.preferences.evidence.graded_pair import Degree, Possible
from desirepath.learning.queries.queries import Query
from desirepath.simulation.setups import Setup, get_setup, require_same
from desirepath.simulation.trajectory import Trajectory, require_steps


@dataclass(frozen=True)
class Preference:
    """chosen > rejected, both trajectories of one query; source: `participant`, `oracle:<name>`, ...; person: whose
    answer it is, where that is known, since answers of one person depend on each other. degree, possible: how clear it
    was, among how many answers (`evidence/graded_pair.py`); with no difference neither was chosen, whatever the name.
    """

    chosen: Trajectory
    rejected: Trajectory
    source: str = "participant"
    person: str | None = None
    degree: Degree | None = None
    possible: Possible = 2

    @property
    def is_tie(self) -> bool:
        return self.degree == "no_difference"

    @classmethod
    def of(cls, query: Query, choice: int, *, source: str = "participant") -> Preference:
        """choice: 0 if A was chosen, 1 if B. Raises LearningError for anything else."""
        if choice not in (0, 1):
            raise LearningError(f"choice = {choice!r}: must be 0 (A) or 1 (B)")
        pair = (query.trajectory_a, query.trajectory_b)
        return cls(pair[choice], pair[1 - choice], source)

    @property
    def setup(self) -> str:
        return require_same(chosen=self.chosen.scene.setup, rejected=self.rejected.scene.setup)


def usable(preferences: Sequence[Preference], *, fewest: int = 2, ties: bool = False) -> tuple[Setup, list[Preference]]:
    """The preferences that say something (two trajectories that differ), and their one setup. ties: who learns from
    them too.

    Raises TooFewAnswers if fewer than `fewest` are left, SetupError if setups are mixed.
    """
    used = [
        p
        for p in preferences
        if (ties or not p.is_tie)
        and len(p.chosen.actions)
        and len(p.rejected.actions)
        and not np.array_equal(p.chosen.poses, p.rejected.poses)
    ]
    if len(used) < fewest:
        raise TooFewAnswers(
            f"preferences: {len(used)} usable of {len(preferences)} given; learning needs at least {fewest} answers "
            "about two different trajectories"
        )
    return get_setup(require_same(**{f"answer {k}": p.setup for k, p in enumerate(used)})), used


def usable_steps(preferences: Sequence[Preference], *, fewest: int = 2) -> tuple[Setup, list[Preference]]:
    """`usable` for what is learned from single steps. Raises NotRecordedError where these were not recorded, too."""
    setup, used = usable(preferences, fewest=fewest)
    require_steps(trajectory for preference in used for trajectory in (preference.chosen, preference.rejected))
    return setup, used

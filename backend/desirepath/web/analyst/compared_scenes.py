"""The scenes of a comparison: which ones a number or a bar stands for, and what both policies did in each.

A comparison keeps the trajectories of its first scenes; of all others they are rolled out again, which a policy and a
scene's seed are enough for. Renders nothing; pages are `compare_pages.py`'s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.models import Artefact
from desirepath.web.core.svg_figures import DifferenceBins

OUTCOMES = {"success": Outcome.SUCCESS, "collision": Outcome.COLLISION, "timeout": Outcome.TIMEOUT}
SIDES = ("a", "b")
KEPT_ROLLOUTS = 64  # in memory; a page and its figures ask for the same two


@dataclass(frozen=True)
class ComparedScene:
    """One scene. number: its place in the comparison; outcomes: of A and B; values: of the measure, A and B."""

    number: int
    seed: int
    outcomes: tuple[Outcome, Outcome]
    values: tuple[float, float]

    @property
    def both_succeed(self) -> bool:
        return self.outcomes == (Outcome.SUCCESS, Outcome.SUCCESS)


def pair_rollouts(
    content: Mapping[str, Any], measure: str
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Numbers and seeds of the scenes in which both succeed, and the measure of A and of B there."""
    a, b = content["scenes"]["policies"]
    both = (np.asarray(a["outcome"]) == Outcome.SUCCESS) & (np.asarray(b["outcome"]) == Outcome.SUCCESS)
    seeds = np.asarray(content["scenes"]["scene_seed"])
    return np.flatnonzero(both), seeds[both], np.asarray(a[measure])[both], np.asarray(b[measure])[both]


def bins_of(content: Mapping[str, Any], measure: str) -> tuple[DifferenceBins, tuple[float, float, float]]:
    """The bars of the paired differences B - A, and their mean with its interval."""
    _, _, a, b = pair_rollouts(content, measure)
    mean = (0.0, 0.0, 0.0)
    if len(a):
        estimate = content["compared"]["paired"][measure]["difference"]
        mean = (estimate["value"], estimate["low"], estimate["high"])
    return DifferenceBins.of(b - a, mean), mean


def choose_scenes(content: Mapping[str, Any], only: str, measure: str) -> NDArray[np.intp] | None:
    """Numbers of the scenes behind a number or a bar; None for a filter that does not exist.

    only: empty for all; `a-collision` and so on for an outcome of one policy; `apart` where the outcomes differ;
    `bar-3` for a bar of the measure's histogram.
    """
    per_side = [np.asarray(policy["outcome"]) for policy in content["scenes"]["policies"]]
    if not only:
        return np.arange(len(per_side[0]))
    if only == "apart":
        return np.flatnonzero(per_side[0] != per_side[1])
    side, _, named = only.partition("-")
    if side in SIDES and named in OUTCOMES:
        return np.flatnonzero(per_side[SIDES.index(side)] == OUTCOMES[named])
    if side == "bar" and named.isdecimal():
        numbers: NDArray[np.intp] = pair_rollouts(content, measure)[0]
        behind: NDArray[np.intp] = numbers[bins_of(content, measure)[0].which == int(named)]
        return behind
    return None


def compare_scene(content: Mapping[str, Any], number: int, measure: str) -> ComparedScene:
    a, b = content["scenes"]["policies"]
    return ComparedScene(
        number,
        content["scenes"]["scene_seed"][number],
        (Outcome(a["outcome"][number]), Outcome(b["outcome"][number])),
        (a[measure][number], b[measure][number]),
    )


def rollouts_in(
    s: DatabaseSession, files: ArtefactStore, content: Mapping[str, Any], number: int
) -> tuple[Trajectory, Trajectory] | None:
    """What A and B did in a scene: as it was kept, or rolled out again. None where a policy is not there any more."""
    if number < len(content["replays"]):
        a, b = (load_trajectory(files, trajectory) for trajectory in content["replays"][number]["trajectories"])
        return a, b
    seed = content["scenes"]["scene_seed"][number]
    policies = [s.get(Artefact, policy["id"]) for policy in content["policies"]]
    if any(policy is None or policy.quarantined_at is not None for policy in policies):
        return None
    a, b = (
        roll_out(files, policy["id"], policy.get("weights") or "", content["setup"], seed)
        for policy in content["policies"]
    )
    return a, b


@lru_cache(maxsize=KEPT_ROLLOUTS)
def roll_out(files: ArtefactStore, policy: str, weights: str, setup: str, seed: int) -> Trajectory:
    """The policy of that id at these weights in a scene of that setup. Raises LearningError."""
    from desirepath.learning.policies.shipped import policy_conditioned_on

    played = policy_conditioned_on(files.get(policy), f"{policy}@{weights}" if weights else policy).rollout_policy
    from desirepath.simulation.fast import rollout  # the simulator: not while a server starts
    from desirepath.simulation.scenes import draw_scene
    from desirepath.simulation.setups import get_setup

    return rollout(get_setup(setup), played, [draw_scene(setup, seed)])[0]

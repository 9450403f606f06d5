"""The workspace opens with a scene in which there is something to see on every tab, found by a rule."""

from __future__ import annotations

from itertools import count

import numpy as np

from desirepath.explain.explanation_files import LEAST_CHANGE, command_of, reach
from desirepath.learning.policies.shipped import load_shipped
from desirepath.learning.scene_sets import Purpose, first_seed
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
from desirepath.simulation.fast import rollout
from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.web.analyst import attention_pages
from desirepath.web.analyst.chosen_policies import TELLING
from desirepath.web.analyst.workspace import ATTENTION, EXPLAIN, TABS

PASSES_M = 1.2  # between centres


def drives(seed: int) -> dict[str, Trajectory]:
    """What every tab shows of its own default in that scene, by the default."""
    found = {}
    for name in {tab.default for tab in TABS} - {ATTENTION.default}:
        policy = load_shipped(name).driving("")
        found[name] = rollout(get_setup(policy.setup), policy.rollout_policy, [draw_scene(policy.setup, seed)])[0]
    attended = load_shipped(ATTENTION.default).to_bytes()
    return found | {ATTENTION.default: attention_pages.roll_out(attended, TRAINED_SETUPS[0], seed)[0]}


def arrives_past_somebody(driven: Trajectory) -> bool:
    """With the way to the goal still to go when they are nearest."""
    people = driven.scene.people_at(np.arange(len(driven.poses)) * driven.dt)
    away = np.linalg.norm(people - driven.poses[None, :, :2], axis=2).min(axis=0)
    return driven.outcome == Outcome.SUCCESS and away.min() < PASSES_M and 0 < away.argmin() < len(away) - 3


def slows_down(driven: Trajectory) -> bool:
    low, high = reach(driven.scene.setup, "speed")
    return bool(np.diff(command_of(driven, "speed")).min() <= -LEAST_CHANGE * (high - low))


def is_telling(seed: int) -> bool:
    found = drives(seed)
    return slows_down(found[EXPLAIN.default]) and all(map(arrives_past_somebody, found.values()))


def test_the_workspace_opens_with_the_first_scene_that_shows_something_on_every_tab():
    first = first_seed(Purpose.FIGURE, 0)
    assert next(k for k in count() if is_telling(first + k)) == TELLING

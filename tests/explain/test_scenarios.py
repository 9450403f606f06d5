"""The 48 scenarios of chapter 8: five objects each, seen, always the same, and none that a policy was trained on."""

from __future__ import annotations

import numpy as np
import pytest

from backend.explain.scenarios import OBJECTS, PRACTICE, SCENARIOS, object_names, practice_scenarios, scenarios
from backend.explain.sight import sight_of
from backend.learning.policies.mirroring import mirror_of
from backend.learning.preferences.features import obstacle_clearance_m
from backend.learning.scene_sets import Purpose, first_seed
from backend.simulation.fast import rollout
from backend.simulation.scenes import check_scene
from backend.simulation.setups import EXPLAINED_ROOM, SetupError
from tests.simulation.simple_policies import towards_goal


def test_there_are_48_scenarios_of_five_named_objects_and_two_to_practise_in() -> None:
    every = [*scenarios(), *practice_scenarios()]
    assert len(scenarios()) == SCENARIOS == 48
    assert len({scene.seed for scene in every}) == SCENARIOS + PRACTICE
    for scene in every:
        check_scene(scene)
        assert object_names(scene) == ("couch", "table", "cupboard", "box", "pillar")
    assert len(object_names(every[0])) == OBJECTS


def test_scenarios_are_queries_so_nothing_was_trained_or_chosen_on_them() -> None:
    assert min(scene.seed for scene in scenarios()) >= first_seed(Purpose.QUERIES, 0)
    assert max(scene.seed for scene in scenarios()) < first_seed(Purpose.QUERIES, 1)
    assert min(scene.seed for scene in practice_scenarios()) >= first_seed(Purpose.QUERIES, 1)
    assert [scene.seed - first_seed(Purpose.QUERIES, 0) for scene in scenarios()[:4]] == [2, 4, 7, 10]


def test_the_robot_is_told_of_its_goal_and_15_rays_and_of_the_person_by_these_alone() -> None:
    assert [one["name"] for one in EXPLAINED_ROOM.observation_layout()] == [
        "goal_distance",
        "goal_bearing",
        *(f"lidar_{sector}" for sector in range(15)),
    ]
    trajectory = rollout(EXPLAINED_ROOM, towards_goal(EXPLAINED_ROOM), scenarios()[:1])[0]
    sight = sight_of(trajectory)
    nothing = np.zeros((len(sight.observations), len(sight.things)), dtype=bool)
    np.testing.assert_allclose(sight.without(nothing), sight.observations, atol=2e-6)
    mirror = mirror_of(EXPLAINED_ROOM)
    assert mirror.signs.tolist() == [1, -1, *[1] * 15]
    with pytest.raises(SetupError, match="does not observe where the person is"):
        obstacle_clearance_m(trajectory.observations, EXPLAINED_ROOM)

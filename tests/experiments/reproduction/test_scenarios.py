"""The 48 scenarios of chapter 8: five objects each, seen, always the same, and none that a policy was trained on."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch

from desirepath.explain.attribution import attribute, baseline, explain
from desirepath.explain.in_sight import LEAST_IN_SIGHT, share_in_sight
from desirepath.explain.methods import METHODS
from desirepath.explain.ranking_sets import DRIVE_S, RankingSet, explain_rollout
from desirepath.explain.sight import sight_of
from desirepath.learning.cards import file_sha256
from desirepath.learning.policies.mirroring import mirror_of
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.preferences.features import obstacle_clearance_m
from desirepath.learning.scene_sets import Purpose, first_seed, scene_set
from desirepath.learning.shipped_files import load_card, resolve
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Obstacle, Person, Pose
from desirepath.simulation.scenes import check_scene
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.reproduction.explanations.scenarios import (
    OBJECTS,
    PRACTICE,
    SCENARIOS,
    practice_rooms,
    rooms,
)
from desirepath_experiments.reproduction.explanations.slowing import slowing
from tests.simulation.simple_policies import towards_goal

EXPLAINED_ROOM = get_setup("explained_room")


@pytest.fixture(scope="module")
def stored() -> RankingSet:
    return RankingSet.load(resolve("explained_room/scenarios_48"))


def test_there_are_48_scenarios_of_five_named_objects_and_two_to_practise_in(stored: RankingSet) -> None:
    every = [one.trajectory.scene for one in stored.rollouts]
    assert [one.practice for one in stored.rollouts] == [False] * SCENARIOS + [True] * PRACTICE
    assert len({scene.seed for scene in every}) == SCENARIOS + PRACTICE
    for one in stored.rollouts:
        check_scene(one.trajectory.scene)
        assert one.things == ("couch", "table", "cupboard", "box", "pillar")
        assert len(one.things) == OBJECTS


def test_scenarios_are_queries_so_nothing_was_trained_or_chosen_on_them(stored: RankingSet) -> None:
    seeds = [one.trajectory.scene.seed for one in stored.rollouts]
    assert min(seeds) >= first_seed(Purpose.QUERIES, 0)
    assert max(seeds[:SCENARIOS]) < first_seed(Purpose.QUERIES, 1) <= min(seeds[SCENARIOS:])
    assert [scene.seed - first_seed(Purpose.QUERIES, 0) for scene in islice(rooms(), 4)] == [2, 4, 7, 10]


@pytest.mark.parametrize("name", ["explained_room/scenarios_48", "crowd_corridor/scenarios_24"])
def test_who_ranks_sees_the_robot_where_it_halts_in_every_shipped_scenario(name: str) -> None:
    for one in RankingSet.load(resolve(name)).rollouts:
        scene, (x, y) = one.trajectory.scene, one.trajectory.poses[-1, :2]
        assert share_in_sight(scene, float(x), float(y), DRIVE_S) >= LEAST_IN_SIGHT, f"{name}, scene {scene.seed}"


def test_a_cupboard_between_eyes_and_robot_hides_it_and_a_low_table_does_not() -> None:
    scene = next(rooms())
    person = Person(Pose(0.0, 0.0))
    for height, seen in ((1.8, 0.0), (0.4, 1.0)):
        between = (Obstacle("box", Pose(1.0, 0.0), 0.4, 1.2, height),)
        here = replace(scene, person=person, obstacles=between)
        assert share_in_sight(here, 3.0, 0.0, 0.0) == pytest.approx(seen, abs=0.05)
        assert share_in_sight(here, -3.0, 0.0, 0.0) == 1.0
    half = replace(scene, person=person, obstacles=(Obstacle("box", Pose(1.0, 0.5), 0.4, 1.0, 1.8),))
    assert 0.3 < share_in_sight(half, 3.0, 0.0, 0.0) < 0.7


def test_the_robot_is_told_of_its_goal_and_15_rays_and_of_the_person_by_these_alone() -> None:
    assert [one["name"] for one in EXPLAINED_ROOM.observation_layout()] == [
        "goal_distance",
        "goal_bearing",
        *(f"lidar_{sector}" for sector in range(15)),
    ]
    trajectory = rollout(EXPLAINED_ROOM, towards_goal(EXPLAINED_ROOM), [next(rooms())])[0]
    sight = sight_of(trajectory)
    nothing = np.zeros((len(sight.observations), len(sight.things)), dtype=bool)
    np.testing.assert_allclose(sight.without(nothing), sight.observations, atol=2e-6)
    mirror = mirror_of(EXPLAINED_ROOM)
    assert mirror.signs.tolist() == [1, -1, *[1] * 15]
    with pytest.raises(SetupError, match="does not observe where the person is"):
        obstacle_clearance_m(trajectory.observations, EXPLAINED_ROOM)


@pytest.fixture(scope="module")
def policy() -> Policy:
    return load_policy("explained_room/base")


def test_the_shipped_policy_is_that_of_chapter_8_arrives_and_slows_down(policy: Policy) -> None:
    assert [array.shape for array in policy.actor[::2]] == [(17, 256), (256, 128), (128, 64), (64, 2)]
    results = load_card("explained_room/base").results
    assert min(results["success_rate_per_seed"]) > 0.97
    assert results["slowing"]["share_of_trajectories_that_slow_down"] > 0.5
    drawn = scene_set("explained_room", 60, purpose=Purpose.REPORT, seed=0)
    trajectories = rollout(EXPLAINED_ROOM, policy.act, drawn)
    assert np.mean([one.outcome == Outcome.SUCCESS for one in trajectories]) > 0.9
    told = slowing(actor_of(policy), trajectories)
    assert told["share_of_trajectories_that_slow_down"] == pytest.approx(
        results["slowing"]["share_of_trajectories_that_slow_down"], abs=0.2
    )


def test_the_shipped_ranking_set_is_the_shipped_policy_in_these_rooms(policy: Policy, stored: RankingSet) -> None:
    drawn = {scene.seed for scene in [*islice(rooms(), 2 * SCENARIOS), *islice(practice_rooms(), 2 * PRACTICE)]}
    assert drawn >= {one.trajectory.scene.seed for one in stored.rollouts}
    assert (stored.policy, stored.method, stored.command) == ("explained_room/base", "saliency", "speed")
    assert load_card("explained_room/scenarios_48").sha256 == file_sha256(resolve("explained_room/scenarios_48"))
    first = explain_rollout(actor_of(policy), policy.act, stored.rollouts[0].trajectory.scene)
    np.testing.assert_allclose(first.scores, stored.rollouts[0].scores, atol=1e-4)


def test_the_new_policy_is_explained_by_gradients_that_add_up(policy: Policy) -> None:
    sight = sight_of(rollout(EXPLAINED_ROOM, policy.act, [next(rooms())])[0])
    actor, seen = actor_of(policy), sight.observations
    found = attribute(actor, seen, setup=EXPLAINED_ROOM, method="integrated_gradients", command="speed")
    with torch.no_grad():
        apart = (actor(torch.from_numpy(seen)) - actor(torch.from_numpy(baseline(seen, EXPLAINED_ROOM))))[:, 0].numpy()
    np.testing.assert_allclose(found.sum(axis=1), apart, atol=0.05)
    hidden = ~sight.seen[:, :OBJECTS]
    for method in METHODS:
        assert not explain(actor, sight, method=method).scores[:, :OBJECTS][hidden].any()

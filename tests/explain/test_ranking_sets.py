"""What rankings are asked about: rollouts that halt, objects with scores at every step, files that come back alike."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from desirepath.explain.attribution import explain
from desirepath.explain.in_sight import halts_in_sight
from desirepath.explain.methods import AttributionError
from desirepath.explain.ranking_sets import RankingSet, explain_rollout, is_ranking_set, ranking_set
from desirepath.explain.sight import sight_of
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Obstacle, Person, Pose
from desirepath.simulation.setups import get_setup
from tests.explain.ranking_rooms import five_things, small_ranking_set


def test_the_robot_drives_three_seconds_and_every_moment_has_a_score_per_object() -> None:
    for one in small_ranking_set().rollouts:
        assert one.trajectory.duration_s == pytest.approx(3.0)
        assert one.scores.shape == (16, 5)
        assert one.things == ("box 1", "box 2", "box 3", "pillar 1", "pillar 2")
        assert 0 <= one.scores.min() <= one.scores.max() <= 1
        assert list(one.at_halt) == list(one.things)


def test_the_scores_at_the_halt_explain_what_the_policy_would_have_done_next() -> None:
    policy, one = load_policy("study_room/base"), small_ranking_set().rollouts[0]
    whole = rollout(get_setup("study_room"), policy.rollout_policy, [one.trajectory.scene])[0]
    explained = explain(actor_of(policy), sight_of(whole), method="saliency")
    np.testing.assert_allclose(explained.scores[15, :5], one.scores[-1], atol=1e-4)


def test_a_robot_at_full_speed_is_explained_too() -> None:
    """In single precision tanh ends at 1 there, and every object scored nothing."""
    policy = load_policy("study_room/base")
    fast = replace(policy, actor=(*policy.actor[:-1], policy.actor[-1] + np.float32([7, 0])))
    explained = 0
    for scene in islice(five_things(), 12):
        with suppress(AttributionError):
            one = explain_rollout(actor_of(fast), fast.rollout_policy, scene, drive_s=1.0)
            assert one.scores.any()
            explained += 1
    assert explained > 3


def test_a_set_is_read_back_as_it_was_and_tells_itself_from_queries() -> None:
    made = small_ranking_set()
    content = made.to_bytes()
    again = RankingSet.from_bytes(content)
    assert again.to_bytes() == content
    assert is_ranking_set(content)
    assert [one.practice for one in again.rollouts] == [False] * 8 + [True] * 2
    for kept, read in zip(made.rollouts, again.rollouts, strict=True):
        assert read.trajectory.digest() == kept.trajectory.digest()
        np.testing.assert_array_equal(read.scores, kept.scores)
    assert not is_ranking_set(b"PK")
    with pytest.raises(AttributionError, match="not a desirepath ranking set"):
        RankingSet.from_bytes(made.rollouts[0].trajectory.to_bytes())


def test_a_rollout_that_is_over_before_the_halt_is_refused_by_its_scene() -> None:
    policy, scene = load_policy("study_room/base"), next(five_things())
    with pytest.raises(AttributionError, match=f"scene {scene.seed}: the rollout is over"):
        explain_rollout(actor_of(policy), policy.rollout_policy, scene, drive_s=60.0)
    with pytest.raises(AttributionError, match="in 0 of them; a ranking set of 1 needs more"):
        ranking_set(actor_of(policy), policy.rollout_policy, [], [], count=1, practised=0, policy="study_room/base")


def test_a_set_takes_the_first_scenes_in_which_the_person_sees_the_robot_halt() -> None:
    policy, scenes = load_policy("study_room/base"), list(islice(five_things(), 12))
    made = ranking_set(
        actor_of(policy), policy.rollout_policy, scenes, scenes[9:], count=3, practised=1, policy="study_room/base"
    )
    assert [one.practice for one in made.rollouts] == [False] * 3 + [True]
    assert all(halts_in_sight(one.trajectory) for one in made.rollouts)
    walled = [replace(scene, obstacles=cupboards_around(scene.person)) for scene in scenes[:3]]
    with pytest.raises(AttributionError, match="in 0 of them"):
        ranking_set(actor_of(policy), policy.rollout_policy, walled, [], count=1, practised=0, policy="study_room/base")


def cupboards_around(person: Person) -> tuple[Obstacle, ...]:
    """Four, taller than the person, so that nothing but them is seen."""
    x, y = person.pose.x, person.pose.y
    around = ((0.6, 0.0, 0.1, 1.1), (-0.6, 0.0, 0.1, 1.1), (0.0, 0.6, 1.3, 0.1), (0.0, -0.6, 1.3, 0.1))
    return tuple(Obstacle("box", Pose(x + dx, y + dy), length, width, 2.0) for dx, dy, length, width in around)

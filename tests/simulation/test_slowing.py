"""Slow beside the person by a rule: the same way, later; and nothing else moves."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest

from desirepath.deploy.steering import Slowing, SteeringError
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.export import policy_to_onnx
from desirepath.learning.policies.policy import Policy, PolicyError
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.policies.steerability import Course
from desirepath.learning.preferences.measures import MEASURES
from desirepath.learning.preferences.objectives import preference_weights
from desirepath.learning.queries.queries import QueryConfig
from desirepath.learning.queries.varied_queries import VariedConfig, generate_varied_queries
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.shipped_files import load_card
from desirepath.npz import from_npz, to_npz
from desirepath.simulation.fast import evaluate, make_engine, rollout
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.slowing import slowed
from desirepath.study.personalising.live_rollouts import condition_on

FIELD = get_setup("open_field")
RULE = Slowing(near_m=2.0, free_m=3.0, most=0.3)
SLOWER = preference_weights({"slower_near_person": 1.0})


@pytest.fixture(scope="module")
def trained() -> ConditionedPolicy:
    return load_conditioned("open_field/conditioned").as_trained()


def test_speed_and_turning_are_scaled_alike_and_only_near_the_person() -> None:
    observed = np.zeros((4, FIELD.observation_size), dtype=np.float32)
    observed[:, 2] = np.array([1.0, 2.5, 3.5, 1.0], dtype=np.float32) / FIELD.distance_scale_m
    commanded = np.array([[1.0, 0.8], [1.0, -0.8], [1.0, 0.8], [-0.8, 1.0]], dtype=np.float32)
    limited = slowed(RULE, commanded, observed, FIELD)
    forward = (limited[:, 0] + 1) / 2
    np.testing.assert_allclose(forward, [0.3, 0.65, 1.0, 0.1], atol=1e-5)
    np.testing.assert_allclose(limited[:, 1], [0.3 * 0.8, -0.65 * 0.8, 0.8, 1.0], atol=1e-5)
    assert limited.dtype == np.float32
    np.testing.assert_array_equal(commanded[0], np.array([1.0, 0.8], dtype=np.float32), "what was given stays as it is")


def test_the_heavier_slowness_weighs_the_slower_and_at_zero_there_is_no_rule() -> None:
    assert RULE.weighted(0.0) is None
    assert RULE.weighted(1.0) == RULE
    half = RULE.weighted(0.5)
    assert half is not None
    assert half.most == pytest.approx(0.65)


def test_a_rule_that_cannot_be_is_refused() -> None:
    with pytest.raises(SteeringError, match="near_m = 3"):
        Slowing(near_m=3, free_m=2)
    with pytest.raises(SteeringError, match="most = 0"):
        Slowing(most=0)
    with pytest.raises(SetupError, match="explained_room: the person's distance"):
        replace(load_policy("explained_room/base"), slowing=RULE)


def test_robots_slow_down_beside_the_person_in_every_engine_and_still_arrive(trained: ConditionedPolicy) -> None:
    slowed = replace(trained, slowing=RULE)
    scenes = scene_set("open_field", 60, purpose=Purpose.ALIGN_SELECT, seed=46)
    course = Course(scenes)
    usual, slow = course.rollout(trained.at(SLOWER)), course.rollout(slowed.at(SLOWER))
    both = usual.success & slow.success
    speed = MEASURES.index("speed_near_person_m_s")
    assert both.mean() > 0.9
    assert slow.measured[both, speed].mean() < 0.6 * usual.measured[both, speed].mean()
    way = MEASURES.index("path_length_m")
    assert slow.measured[both, way].mean() == pytest.approx(usual.measured[both, way].mean(), rel=0.03)
    policy = slowed.at(SLOWER)
    singly = rollout(FIELD, policy.rollout_policy, scenes[:5])
    assert [int(one.outcome) for one in singly] == slow.outcome[:5].tolist()
    batched = evaluate(policy.act, FIELD, scenes[:5])
    assert [len(one.poses) - 1 for one in singly] == batched.steps.tolist()


def test_who_gives_slowness_no_weight_rolls_out_bit_for_bit_as_before(trained: ConditionedPolicy) -> None:
    slowed = replace(trained, slowing=RULE)
    for weights in ({}, {"farther": 1.0}, {"clearance": 0.8, "faster": 0.5}):
        before, after = (one.at(preference_weights(weights)) for one in (trained, slowed))
        assert after.digest() == before.digest()
    seen = make_engine(FIELD, 32, seed=6).observations
    np.testing.assert_array_equal(
        slowed.at(preference_weights({"shorter": 1.0})).act(seen),
        trained.at(preference_weights({"shorter": 1.0})).act(seen),
    )


def test_a_robot_that_is_freed_keeps_the_rule() -> None:
    room = load_conditioned("study_room/conditioned")
    slowed = replace(room, slowing=RULE).at(SLOWER)
    assert len(slowed.recovery_policies) == 2
    freed = replace(slowed, actor=tuple(np.zeros_like(layer) for layer in slowed.actor))  # stands and is stuck
    scenes = draw_scenes("study_room", range(3))

    def fastest(policy: Policy) -> list[float]:
        return [
            float(np.hypot(*np.diff(one.poses[:, :2], axis=0).T).max() / one.dt)
            for one in rollout(get_setup("study_room"), policy.rollout_policy, scenes)
        ]

    without = fastest(replace(freed, slowing=None))
    assert max(without) > 0.7, "somebody is freed, and drives"
    assert max(fastest(freed)) < 0.7 * max(without)


def test_files_keep_the_rule_and_the_strengths_and_as_trained_gives_the_old_bytes(
    trained: ConditionedPolicy, tmp_path: Path
) -> None:
    added = replace(trained, slowing=RULE, strengths={"clearance": 1.5})
    added.save(tmp_path / "added.npz")
    again = ConditionedPolicy.load(tmp_path / "added.npz")
    assert (again.slowing, again.strengths, again.digest()) == (RULE, {"clearance": 1.5}, added.digest())
    assert again.as_trained().digest() == trained.digest() != added.digest()
    own = again.at(SLOWER)
    read = Policy.from_bytes(own.to_bytes())
    assert (read.slowing, read.digest()) == (RULE, own.digest())
    assert "slowing" not in trained.at(SLOWER).to_bytes()[:400].decode("latin-1")
    seen = make_engine(FIELD, 16, seed=7).observations
    for asked, entering in (
        ({"clearance": 0.5}, {"clearance": 0.75}),
        ({"clearance": 0.8, "faster": 0.4}, {"clearance": 1.0, "faster": 0.4}),
        ({"clearance": 0.6, "faster": 0.6}, {"clearance": 0.6, "faster": 0.6}),
    ):
        own, same = added.at(preference_weights(asked)), trained.at(preference_weights(entering))
        np.testing.assert_allclose(own.act(seen), same.act(seen), atol=1e-5)
    own = again.at(SLOWER)
    with pytest.raises(PolicyError, match="'strengths' names"):
        replace(trained, strengths={"politeness": 2.0})
    header, arrays = from_npz(own.to_bytes())
    broken = to_npz(header | {"slowing": {"most": 7}}, arrays)
    with pytest.raises(PolicyError, match="'slowing'"):
        Policy.from_bytes(broken)


def test_an_exported_policy_says_that_the_rule_is_not_in_it(trained: ConditionedPolicy) -> None:
    slow = replace(trained, slowing=RULE).at(SLOWER).without_critic()
    assert slow.slowing == RULE
    said = json.loads(onnx.load_from_string(policy_to_onnx(slow)).metadata_props[0].value)
    assert said["slowing"]["most"] == RULE.most
    assert "network alone" in said["slowing"]["exported"]
    assert trained.at(SLOWER).manifest()["slowing"] is None


def test_the_field_s_shipped_policy_is_the_trained_one_with_a_rule_and_its_card_says_so() -> None:
    shipped, card = load_conditioned("open_field/conditioned"), load_card("open_field/conditioned")
    assert shipped.slowing is not None
    assert card.results["as_trained_sha256"] == shipped.as_trained().digest()
    assert card.results["added"]["kept"] == {"strengths": shipped.strengths, "slowing": shipped.slowing.as_dict()}
    assert any("slowed down there by a rule" in said for said in card.departures)
    assert load_conditioned("study_room/conditioned").slowing is None
    for policy in (
        load_policy("open_field/conditioned@slower_near_person=1"),  # commands and comparisons
        condition_on("open_field", {"slower_near_person": 1.0}),  # the step at which weights are set by hand
    ):
        assert policy.slowing == shipped.slowing


def test_queries_are_still_made_of_what_was_trained(trained: ConditionedPolicy) -> None:
    few = VariedConfig(QueryConfig(count=3, scenes_per_round=16, max_scenes=64), settings=9)
    added = replace(trained, slowing=RULE, strengths={"clearance": 2.0})
    assert generate_varied_queries(added, few).to_bytes() == generate_varied_queries(trained, few).to_bytes()

"""Attention among pedestrians: sizes as published, what attention sees, training that goes on, evaluation."""

import numpy as np
import pytest
import torch

from desirepath.analysis.metrics import measure
from desirepath.learning.pedestrians.attended import as_trajectory
from desirepath.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds, roll_out_crowd
from desirepath.learning.pedestrians.crowd_networks import (
    VARIANTS,
    Actor,
    Attention,
    Critic,
    actor_from_arrays,
    actor_to_arrays,
    attention_weights,
)
from desirepath.learning.pedestrians.crowd_states import SIZES, states
from desirepath.learning.scene_sets import Purpose
from desirepath.simulation.crowds.crowd_engine import CrowdEngine
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED, UNSEEN_HOMES, draw_crowd_scene
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath_experiments.training.pedestrians.crowd_planners import PLANNERS
from desirepath_experiments.training.pedestrians.crowd_training import CrowdTrainingConfig, ended_for_good, train_crowd

TINY = {"random_transitions": 64, "n_envs": 8, "batch_size": 16, "evaluation_episodes": 2, "evaluate_every": 8}


@pytest.fixture(scope="module")
def scenes():
    return crowd_scene_set(6, PUBLISHED, purpose=Purpose.FIGURE, seed=3)


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_network_reads_its_state_and_acts(variant, scenes):
    engine = CrowdEngine(n_envs=6)
    engine.reset(scenes)
    given = states(engine, VARIANTS[variant].given)
    assert given.shape == (6, SIZES[VARIANTS[variant].given])
    assert np.abs(given).max() <= 3.0
    batch = torch.as_tensor(given)
    actions = Actor(variant)(batch)
    assert actions.shape == (6, 2)
    assert Critic(variant)(batch, actions).shape == (6,)


def test_attention_has_the_published_layers_and_weighs_what_it_embeds():
    attention = Attention(22)
    sizes = [[layer.out_features for layer in part if hasattr(layer, "out_features")] for part in (
        attention.embedding, attention.score, attention.feature)]  # fmt: skip
    assert sizes == [[256, 128, 64], [60, 50, 1], [80, 50, 30]]
    given = torch.randn(4, 30, 22)
    weights = attention.weights(given)
    assert torch.allclose(weights.sum(dim=1), torch.ones(4))
    by_hand = sum(weights[:, i, None] * attention.feature(attention.embedding(given[:, i])) for i in range(30))
    assert torch.allclose(attention(given), by_hand, atol=1e-6)


def test_the_temporal_stream_is_given_the_newer_centroid_and_the_gap_in_its_own_unit(scenes):
    engine = CrowdEngine(n_envs=6)
    engine.reset(scenes)
    engine.step(np.zeros((6, 2), np.float32))
    groups = engine.descriptors() / engine.setup.robot.lidar.range_m
    older, newer = groups[:, :, :2], groups[:, :, 2:]
    assert np.abs(newer - older).max() > 0.01, "somebody walks"
    _, (_, given) = Actor("ours").read.streams(torch.as_tensor(states(engine, "points_and_groups")))
    assert np.allclose(given[:, :, :2], newer, atol=1e-6)
    assert np.allclose(given[:, :, 2:4], 20 * (newer - older), atol=1e-4)


def test_which_streams_a_policy_attends_with(scenes):
    engine = CrowdEngine(n_envs=6)
    engine.reset(scenes)
    seen = {
        variant: set(attention_weights(Actor(variant), torch.as_tensor(states(engine, VARIANTS[variant].given))))
        for variant in ("ours", "no_spatial", "no_temporal", "no_tagd")
    }
    assert seen == {
        "ours": {"spatial", "temporal"}, "no_spatial": {"temporal"}, "no_temporal": {"spatial"},
        "no_tagd": {"spatial", "temporal"},
    }  # fmt: skip
    with pytest.raises(ValueError, match="no attention"):
        attention_weights(Actor("b1"), torch.zeros(1, SIZES["three_scans"]))


@pytest.mark.parametrize("learner", ["td3", "ddpg"])
def test_a_training_in_two_parts_goes_on_where_it_was(learner):
    config = CrowdTrainingConfig(variant="b3", learner=learner, updates=16, **TINY)
    half = train_crowd(config, until=8)
    whole = train_crowd(config, state=half.state)
    assert [row["updates"] for row in whole.history] == [8, 16]
    assert whole.transitions > half.transitions
    before, after = actor_to_arrays(half.actor), actor_to_arrays(whole.actor)
    again = actor_to_arrays(actor_from_arrays("b3", after))
    assert all(np.array_equal(after[name], again[name]) for name in after)
    assert before.keys() == after.keys()


def test_running_out_of_steps_ends_no_value():
    assert ended_for_good(np.array([0, 1, 2, 3], np.int8)).tolist() == [False, True, True, False]


def test_everybody_is_judged_in_the_same_scenes_and_a_planner_needs_no_training(scenes):
    table = evaluate_crowds(None, "ranges", scenes, plan=PLANNERS["follow"])
    again = evaluate_crowds(None, "ranges", scenes, plan=PLANNERS["follow"])
    assert np.array_equal(table.outcome, again.outcome)
    rates = table.rates()
    assert rates["success"] + rates["collision"] + rates["timeout"] == pytest.approx(100)
    for name in ("dwa", "orca", "social_force"):
        assert len(evaluate_crowds(None, "ranges", scenes[:2], plan=PLANNERS[name]).outcome) == 2


def test_the_social_metrics_of_a_table_are_those_of_what_was_driven(scenes):
    """Each episode driven alone, where people went kept with its scene, and measured as an exported trajectory is."""
    torch.manual_seed(0)
    actor = Actor("b3")
    avoiding = [draw_crowd_scene("crowd_corridor", 5, CrowdConditions(behaviour="orca"))]
    scenes = [*scenes, *avoiding, draw_crowd_scene("crowd_home", 1, UNSEEN_HOMES)]
    act = lambda seen: actor(torch.as_tensor(seen)).detach().numpy()  # noqa: E731
    table = evaluate_crowds(act, VARIANTS["b3"].given, scenes)
    for k, scene in enumerate(scenes):
        alone = measure([as_trajectory(roll_out_crowd(act, VARIANTS["b3"].given, scene))])
        assert table.min_human_distance_m[k] == pytest.approx(alone.min_human_distance[0], abs=1e-3)
        for name, values in table.social.columns().items():
            assert values[k] == pytest.approx(alone.social.columns()[name][0], abs=0.1), name


def test_a_rollout_keeps_where_everybody_was(scenes):
    actor = Actor("ours")
    made = roll_out_crowd(lambda seen: actor(torch.as_tensor(seen)).detach().numpy(), "points_and_groups", scenes[0])
    assert len(made.poses) == len(made.actions) + 1
    assert all(one.walk is not None for one in made.scene.crowd.pedestrians)

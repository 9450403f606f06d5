"""Whatever drives can be evaluated, compared, drawn, explained and exported, or is told what works instead."""

from __future__ import annotations

import numpy as np
import pytest

from desirepath.demonstrations.depth.judging import depth_trajectories
from desirepath.demonstrations.depth.states import CONFIGURATIONS
from desirepath.demonstrations.depth.training import senses_of
from desirepath.explain.flow_files import flow_files, starts_files
from desirepath.learning.alignment.each_scene import answers_of, choose_each_scene
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.evaluate import compare_policies, evaluate_policy
from desirepath.learning.policies.export import policy_to_onnx, policy_to_sb3_zip
from desirepath.learning.policies.policy import DrivingPolicy, network_of, read_policy
from desirepath.learning.policies.shipped import load_driving
from desirepath.learning.shipped_files import load_card, resolve, shipped_names
from desirepath.perception import SHIPPED_ENCODER
from desirepath.perception.beta_vae import DepthEncoder
from desirepath.simulation.fast import rollout
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath.web.core.explained_policy import explain_policy
from tests.answers import prefers_distance
from tests.experiments.shipping.test_depth_queries import towards_the_goal

SHIPPED = [name for name in shipped_names() if load_card(name).kind.endswith("policy") and "/ensemble/" not in name]
DEPTH = ["VAE-HA", "LSTM-HP"]  # one with a predictor: their files come from jobs, none is shipped
CHOOSING = "choosing"  # somebody's own, among several
EVERY = [*SHIPPED, *DEPTH, CHOOSING]
NO_NETWORK = ("crowd_corridor/attention", *DEPTH, CHOOSING)


def find(name: str) -> DrivingPolicy:
    if name == CHOOSING:
        return read_policy(choose_each_scene(answers_of(prefers_distance(9)), kept=2).to_bytes()).driving()
    if name not in DEPTH:
        return load_driving(name)
    return read_policy(towards_the_goal(name, 0.4).to_bytes()).driving()


def test_policies_of_every_kind_are_there() -> None:
    assert {"adaptable/policy", "crowd_corridor/attention", "crowd_hall/conditioned", "explained_room/base"} <= set(
        SHIPPED
    )


@pytest.mark.parametrize("name", EVERY)
def test_it_is_evaluated_compared_and_drawn(name: str) -> None:
    policy = find(name)
    assert evaluate_policy(policy, n=3)["n"] == 3
    assert compare_policies(policy, policy, n=2)
    setup, scene = get_setup(policy.setup), draw_scenes(policy.setup, [3_500_000_000])[0]
    assert flow_files([(name, policy.in_scene(scene).rollout_policy)], setup, scene, cell_m=2.5).files
    assert starts_files({name: policy.rollout_policy}, setup, scene, starts=2).files


@pytest.mark.parametrize("name", EVERY)
def test_it_is_explained_or_says_what_works_instead(name: str) -> None:
    policy = find(name)
    asked = {"name": name, "method": "saliency", "command": "speed", "at_s": None}
    scene = draw_scenes(policy.setup, [3_500_000_000])[0]
    if name in DEPTH:
        with pytest.raises(LearningError, match=r"depth camera's pictures: no thing .* compare, flow-field"):
            explain_policy(policy, scene, **asked)
        return
    explained = explain_policy(policy, scene, **asked)
    assert set(explained.files) == {"explanation.png", "explanation.svg", "explanation.csv"}
    assert explained.numbers["method"] == ("attention" if name == "crowd_corridor/attention" else "saliency")
    assert explained.numbers["most_important"]


@pytest.mark.parametrize("name", EVERY)
def test_it_is_exported_or_says_what_works_instead(name: str) -> None:
    policy = find(name)
    assert policy.manifest()["setup"] == policy.setup
    assert read_policy(policy.to_bytes()).driving().digest() == policy.digest()
    if name in NO_NETWORK:
        with pytest.raises(LearningError, match=r"reads its setup's observation alone\. .* file and manifest"):
            network_of(policy)
        return
    assert policy_to_onnx(network_of(policy))
    assert policy_to_sb3_zip(network_of(policy))


@pytest.mark.parametrize("name", DEPTH[:1])
def test_a_depth_controller_drives_as_it_is_judged(name: str) -> None:
    scenes = draw_scenes("home", range(3_500_000_000, 3_500_000_004))
    encoder = DepthEncoder.from_bytes(resolve(SHIPPED_ENCODER).read_bytes())
    judged = depth_trajectories(towards_the_goal(name, 0.4), senses_of(CONFIGURATIONS[name], encoder, None), scenes)
    driven = rollout(get_setup("home"), find(name).rollout_policy, scenes)
    for one, other in zip(judged, driven, strict=True):
        assert one.outcome == other.outcome
        np.testing.assert_allclose(one.poses, other.poses, atol=1e-4)

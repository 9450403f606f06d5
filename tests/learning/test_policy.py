"""A policy is bound to its setup, survives storage, and acts the same in every format it is exported to."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray
from stable_baselines3 import TD3

from desirepath.learning.policies.export import policy_to_onnx, policy_to_sb3_zip
from desirepath.learning.policies.policy import Policy, PolicyError
from desirepath.learning.policies.shape import EXPLAINED_HEADS, THESIS_HEADS, NetworkShape
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.td3.base import BaseResult
from desirepath.learning.td3.ensemble import agent_of
from desirepath.learning.td3.td3 import Td3Config
from desirepath.simulation.fast import evaluate, make_engine
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import SetupError, get_setup
from desirepath_experiments.benchmarks.training_arms import policy_of_sb3

EXPLAINED_ROOM = get_setup("explained_room")
OPEN_FIELD = get_setup("open_field")
STUDY_ROOM = get_setup("study_room")


@pytest.fixture(params=["open_field", "study_room"])
def policy(request: pytest.FixtureRequest) -> Policy:
    return load_policy(f"{request.param}/base")


def seen_by(policy: Policy, n: int = 64) -> NDArray[np.float32]:
    return make_engine(get_setup(policy.setup), n, seed=9).observations.copy()


def test_numpy_and_torch_act_alike(tiny_base: BaseResult) -> None:
    policy = tiny_base.policy
    agent = agent_of(policy, Td3Config(), seed=0, updates=1)
    np.testing.assert_allclose(policy.act(seen_by(policy)), agent.act(seen_by(policy)), atol=1e-6)


def test_actions_and_commands_stay_in_the_setup_limits(policy: Policy) -> None:
    actions = policy.act(seen_by(policy))
    assert actions.dtype == np.float32
    assert (np.abs(actions) <= 1).all()
    limits = get_setup(policy.setup).robot.limits
    commands = policy.commands(actions)
    assert (commands[:, 0] >= limits.v_min).all()
    assert (commands[:, 0] <= limits.v_max).all()
    assert (np.abs(commands[:, 1]) <= limits.w_max + 1e-6).all()
    corners = policy.commands(np.array([[-1, -1], [1, 1], [0, 0]], dtype=np.float32))
    np.testing.assert_allclose(
        corners,
        [[limits.v_min, -limits.w_max], [limits.v_max, limits.w_max], [(limits.v_min + limits.v_max) / 2, 0]],
        rtol=1e-6,
    )


def test_storage_gives_the_same_policy_and_the_same_bytes(policy: Policy, tmp_path: Path) -> None:
    policy.save(tmp_path / "p.npz")
    again = Policy.load(tmp_path / "p.npz")
    assert again.digest() == policy.digest()
    np.testing.assert_array_equal(again.act(seen_by(policy)), policy.act(seen_by(policy)))


def test_escapes_are_stored_and_drive_only_while_the_robot_is_stuck(tmp_path: Path) -> None:
    base = load_policy("study_room/base")
    still = (*base.actor[:-1], np.array([-9, 0], dtype=np.float32))
    stuck = Policy(base.setup, base.shape, (*(np.zeros_like(array) for array in still[:-1]), still[-1]))
    freed = replace(stuck, recovery_policies=(base.actor,))
    freed.save(tmp_path / "freed.npz")
    again = Policy.load(tmp_path / "freed.npz")
    assert again.digest() == freed.digest() != stuck.digest()
    scenes = draw_scenes(get_setup(base.setup), range(40, 60))
    assert evaluate(stuck.rollout_policy, get_setup(base.setup), scenes).success.sum() == 0
    assert evaluate(again.rollout_policy, get_setup(base.setup), scenes).success.sum() > 0
    np.testing.assert_array_equal(freed.act(seen_by(freed)), stuck.act(seen_by(stuck)))
    assert freed.manifest()["recovery"]
    assert stuck.manifest()["recovery"] is None
    with pytest.raises(PolicyError, match="'actor'"):
        replace(stuck, recovery_policies=(base.actor[:-1],))


def test_whose_a_policy_is_tells_files_apart_that_drive_alike(policy: Policy) -> None:
    own, other = (replace(policy, made_for=whose) for whose in ("answers of one", "answers of another"))
    assert len({policy.digest(), own.digest(), other.digest()}) == 3
    again = Policy.from_bytes(own.to_bytes())
    assert (again.made_for, policy.made_for) == ("answers of one", "")
    np.testing.assert_array_equal(again.act(seen_by(policy)), policy.act(seen_by(policy)))


def test_a_held_policy_says_so_until_it_loses_its_critic(policy: Policy) -> None:
    held = replace(policy, held=4.0)
    assert Policy.from_bytes(held.to_bytes()).held == 4.0
    assert held.digest() != policy.digest()
    assert held.without_critic().digest() == policy.without_critic().digest()
    for weight in (-1.0, float("nan"), float("inf"), "much"):
        with pytest.raises(PolicyError, match="'held'"):
            replace(policy, held=weight)


def test_the_other_setup_is_refused(policy: Policy) -> None:
    other = STUDY_ROOM if policy.setup == "open_field" else OPEN_FIELD
    with pytest.raises(SetupError, match=policy.setup):
        policy.act(make_engine(other, 2, seed=0).observations)
    with pytest.raises(SetupError, match="inputs"):
        Policy(other.name, policy.shape, policy.actor)


def test_broken_weights_and_foreign_files_are_refused(policy: Policy, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="'actor'"):
        Policy(policy.setup, policy.shape, policy.actor[:-1])
    with pytest.raises(PolicyError, match="NaN"):
        Policy(policy.setup, policy.shape, (policy.actor[0] * np.float32("nan"), *policy.actor[1:]))
    (tmp_path / "text.npz").write_text("weights")
    np.savez(tmp_path / "other.npz", meta=np.frombuffer(b'{"format": "else"}', dtype=np.uint8))
    for name in ("text.npz", "other.npz", "missing.npz"):
        with pytest.raises(PolicyError):
            Policy.load(tmp_path / name)


def test_a_pickle_inside_a_policy_file_is_never_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "evil.npz", meta=np.array([{"format": "desirepath-policy-1"}], dtype=object))
    with pytest.raises(PolicyError):
        Policy.load(tmp_path / "evil.npz")


def test_onnx_acts_alike_and_carries_its_manifest(policy: Policy) -> None:
    data = policy_to_onnx(policy)
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    observations = seen_by(policy)
    (actions,) = session.run(["action"], {"observation": observations})
    np.testing.assert_allclose(actions, policy.act(observations), atol=1e-5)
    properties = {entry.key: entry.value for entry in onnx.load(io.BytesIO(data)).metadata_props}
    manifest = json.loads(properties["manifest"])
    assert manifest == json.loads(json.dumps(policy.manifest()))
    assert len(manifest["observation"]["layout"]) == observations.shape[1]
    assert manifest["setup"] == policy.setup


def test_sb3_zip_acts_alike_and_trains_on(policy: Policy) -> None:
    model = TD3.load(io.BytesIO(policy_to_sb3_zip(policy)), device="cpu")
    assert type(model.actor.features_extractor).__module__ == "desirepath.learning.policies.sb3_extractor"
    observations = seen_by(policy)
    np.testing.assert_allclose(model.predict(observations, deterministic=True)[0], policy.act(observations), atol=1e-5)
    again = policy_of_sb3(model, get_setup(policy.setup), policy.shape.heads)
    assert again.digest() == policy.digest()


def test_sb3_zips_can_be_made_at_the_same_time(policy: Policy) -> None:
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: policy_to_sb3_zip(policy), range(16)))
    assert all(zip_.startswith(b"PK") for zip_ in made)


def test_sb3_zip_opens_where_our_package_is_missing(policy: Policy, tmp_path: Path) -> None:
    (tmp_path / "policy.zip").write_bytes(policy_to_sb3_zip(policy))
    observations = seen_by(policy, 5)
    np.save(tmp_path / "observations.npy", observations)
    program = (
        "import sys; sys.modules['desirepath'] = None\n"
        "import numpy as np\n"
        "from stable_baselines3 import TD3\n"
        "model = TD3.load('policy.zip', device='cpu')\n"
        "np.save('actions.npy', model.predict(np.load('observations.npy'), deterministic=True)[0])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose(np.load(tmp_path / "actions.npy"), policy.act(observations), atol=1e-5)


def test_the_thesis_heads_fit_everywhere() -> None:
    shape = NetworkShape.of(OPEN_FIELD, THESIS_HEADS)
    acts_alike_in_onnx("open_field", shape)


def test_one_network_without_extractors_acts_alike_in_every_format() -> None:
    """Chapter 8: goal and 15 rays go straight into 256, 128 and 64 units."""
    policy = acts_alike_in_onnx("explained_room", NetworkShape.of(EXPLAINED_ROOM, EXPLAINED_HEADS))
    assert [array.shape for array in policy.actor[::2]] == [(17, 256), (256, 128), (128, 64), (64, 2)]
    observations = seen_by(policy)
    model = TD3.load(io.BytesIO(policy_to_sb3_zip(policy)), device="cpu")
    np.testing.assert_allclose(model.predict(observations, deterministic=True)[0], policy.act(observations), atol=1e-5)
    assert Policy.from_bytes(policy.to_bytes()).digest() == policy.digest()


def acts_alike_in_onnx(setup: str, shape: NetworkShape) -> Policy:
    assert NetworkShape.from_dict(shape.as_dict()) == shape
    random = np.random.default_rng(0)
    actor = tuple(
        random.standard_normal(size).astype(np.float32) * 0.1
        for i, o in shape.actor_layers()
        for size in ((i, o), (o,))
    )
    policy = Policy(setup, shape, actor)
    observations = seen_by(policy)
    session = onnxruntime.InferenceSession(policy_to_onnx(policy), providers=["CPUExecutionProvider"])
    np.testing.assert_allclose(session.run(None, {"observation": observations})[0], policy.act(observations), atol=1e-5)
    return policy

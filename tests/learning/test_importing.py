"""Policies come back: what was exported here, what others trained in Stable-Baselines3, ONNX of theirs; what could harm
or does not fit is refused and says what would work."""

from __future__ import annotations

import base64
import io
import json
import pickle
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from numpy.typing import NDArray
from onnx import helper, numpy_helper
from stable_baselines3 import A2C, PPO, SAC, TD3
from torch import nn

from desirepath.learning.errors import LearningError
from desirepath.learning.foreign.limited import LimitedNetwork
from desirepath.learning.foreign.onnx_bounds import ROWS
from desirepath.learning.policies.evaluate import compare_policies, evaluate_policy
from desirepath.learning.policies.export import policy_to_onnx, policy_to_sb3_zip
from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.foreign_files import open_policy_file
from desirepath.learning.policies.importing import import_policy
from desirepath.learning.policies.manifest import setup_manifest
from desirepath.learning.policies.policy import DrivingPolicy, Policy, network_of, read_policy
from desirepath.learning.policies.shipped import load_driving, load_policy
from desirepath.learning.policies.torch_actor import actor_of
from desirepath.learning.queries.queries import QueryConfig, generate_queries
from desirepath.notebook import make_env
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath.web.core.explained_policy import explain_policy
from tests.learning.people.test_reward_file import Evil
from tests.test_every_policy import NO_NETWORK, SHIPPED

SETUP = get_setup("study_room")
WIDTH = SETUP.observation_size
MANIFEST = {"setup": "study_room", **setup_manifest(SETUP)}
NETWORKS = [name for name in SHIPPED if name not in NO_NETWORK]
WEIGHTED = ["study_room/conditioned@slower_near_person=1", "adaptable/policy@distance=1"]


def bring(content: bytes, named: str, setup: str = "", manifest: str | None = None) -> dict[str, Any]:
    """What the process that reads others' files says of one, said here: a process for each file takes seconds."""
    asked = {"file": named, "setup": setup, "manifest": manifest, "manifest_named": "manifest"}
    told: dict[str, Any] = json.loads(open_policy_file(json.dumps(asked).encode(), content).told)
    return told | {"policy": read_policy(base64.b64decode(told["policy"]))}


def seen_in(setup: str, n: int = 200) -> NDArray[np.float32]:
    """(n, obs) what a robot observes in n scenes."""
    return make_engine(get_setup(setup), n, seed=9).observations.copy()


def same(one: DrivingPolicy, other: DrivingPolicy) -> None:
    assert one.setup == other.setup
    observations = seen_in(one.setup)
    np.testing.assert_allclose(one.act(observations), other.act(observations), atol=1e-5)  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", [*NETWORKS, *WEIGHTED])
@pytest.mark.parametrize("write", [policy_to_onnx, policy_to_sb3_zip], ids=["onnx", "zip"])
def test_what_is_exported_here_comes_back_and_acts_alike(
    name: str, write: Callable[[DrivingPolicy], bytes], tmp_path: Path
) -> None:
    policy = network_of(load_driving(name))
    ending = {policy_to_onnx: "onnx", policy_to_sb3_zip: "zip"}[write]
    again = bring(write(policy), f"mine.{ending}")
    assert isinstance(again["policy"], Policy)
    same(again["policy"], policy)
    assert again["policy"].slowing == policy.slowing
    assert again["made_from"] == policy.digest()
    assert any("recovery policies" in note for note in again["notes"]) == bool(policy.recovery_policies)
    if ending == "zip" and not policy.recovery_policies:
        assert again["policy"].digest() == policy.digest()  # value functions included


@pytest.mark.parametrize("name", SHIPPED)
def test_our_own_file_comes_back_whole_whatever_its_kind(name: str) -> None:
    stored = load_driving(name)
    again = import_policy(stored.to_bytes(), "policy.npz")
    assert again.policy.digest() == stored.digest()


# ---- of others, trained in Stable-Baselines3 -------------------------------------------------------------------------

KINDS: dict[str, tuple[Any, dict[str, Any], type]] = {
    "td3": (TD3, {}, Policy),
    "td3, small": (TD3, {"policy_kwargs": {"net_arch": [32, 16]}}, Policy),
    "sac": (SAC, {"policy_kwargs": {"net_arch": [32, 32]}}, Policy),
    "ppo": (PPO, {}, ForeignPolicy),
    "ppo, relu": (PPO, {"policy_kwargs": {"activation_fn": nn.ReLU, "net_arch": [4]}}, ForeignPolicy),
    "a2c": (A2C, {"policy_kwargs": {"activation_fn": nn.ELU}}, ForeignPolicy),
    "td3, tanh": (TD3, {"policy_kwargs": {"activation_fn": nn.Tanh, "net_arch": [16]}}, ForeignPolicy),
}  # fmt: skip


def saved(model: Any) -> bytes:
    out = io.BytesIO()
    model.save(out)
    return out.getvalue()


def sb3(kind: str = "td3, small", setup: str = "study_room") -> Any:
    algorithm, options, _ = KINDS[kind]
    more = {"buffer_size": 10} if algorithm in (TD3, SAC) else {}
    return algorithm("MlpPolicy", make_env(setup), seed=3, device="cpu", **options, **more)


@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_trained_in_stable_baselines3_acts_as_it_does_there(kind: str) -> None:
    model = sb3(kind)
    with torch.no_grad():  # untrained actors of PPO do next to nothing
        for parameter in model.policy.parameters():
            parameter.mul_(3.0)
    policy = bring(saved(model), "model.zip", setup="study_room")["policy"]
    assert type(policy) is KINDS[kind][2]
    observations = seen_in("study_room")
    expected = model.predict(observations, deterministic=True)[0]
    np.testing.assert_allclose(policy.act(observations), expected, atol=1e-5)
    again = read_policy(policy.to_bytes()).driving()
    assert again.digest() == policy.digest()
    assert evaluate_policy(again, n=3)["n"] == 3
    back = bring(policy_to_onnx(again), "again.onnx")["policy"]
    np.testing.assert_allclose(back.act(observations), expected, atol=1e-5)


def test_what_moved_a_network_of_others_is_what_its_slopes_say() -> None:
    """By differences where it can only be asked, against the slopes that torch has."""
    model = sb3("td3, tanh")
    policy = import_policy(saved(model), "model.zip", setup="study_room").policy
    given = torch.from_numpy(seen_in("study_room", 5)).double().requires_grad_(True)
    actor_of(policy)(given)[:, 0].sum().backward()
    exact = torch.from_numpy(seen_in("study_room", 5)).requires_grad_(True)
    model.actor(exact)[:, 0].sum().backward()
    assert given.grad is not None
    assert exact.grad is not None
    assert float(exact.grad.abs().max()) > 0.01
    np.testing.assert_allclose(given.grad.numpy(), exact.grad.numpy(), atol=2e-3)


def test_networks_of_others_start_no_training_and_say_so() -> None:
    policy = import_policy(saved(sb3("ppo")), "model.zip", setup="study_room")
    with pytest.raises(LearningError, match="network of another kind; needed is one network of linear layers"):
        network_of(policy.policy.driving())
    assert any("no training starts from it" in note for note in policy.notes)


def test_a_network_of_others_drives_is_compared_explained_and_asked_about() -> None:
    """As the network within, which is one of ours that was trained."""
    base, member = load_policy("study_room/base"), load_policy("study_room/ensemble/0")
    foreign = ForeignPolicy("study_room", policy_to_onnx(base))
    scene = draw_scenes("study_room", [3_500_000_000])[0]
    asked = {"name": "other", "method": "saliency", "command": "speed", "at_s": None}
    told, exact = (explain_policy(policy, scene, **asked).numbers for policy in (foreign, base))  # type: ignore[arg-type]
    score = {row["thing"]: row["score"] for row in exact["most_important"]}
    assert {row["thing"]: row["score"] for row in told["most_important"]} == pytest.approx(score, abs=0.01)
    compared = compare_policies(base, foreign, n=40)
    assert abs(compared["success_difference"]["value"]) < 0.1
    made = generate_queries([foreign, member], QueryConfig(count=3, seed=4))
    assert len(made) == 3


# ---- ONNX of others --------------------------------------------------------------------------------------------------


def graph(nodes: list[Any], weights: dict[str, np.ndarray], manifest: object = MANIFEST, outputs: int = 2) -> bytes:
    """A network of one input `x` (n, WIDTH) and one output `y`, as another program would write it."""
    given = helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, ["batch", WIDTH])
    found = helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, ["batch", outputs])
    stored = [numpy_helper.from_array(array, name) for name, array in weights.items()]
    model = helper.make_model(
        helper.make_graph(nodes, "policy", [given], [found], stored),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=9,
    )
    if manifest is not None:
        helper.set_model_props(model, {"manifest": json.dumps(manifest)})
    return bytes(model.SerializeToString())


RANDOM = np.random.default_rng(1)
W1, B1 = RANDOM.normal(size=(16, WIDTH)).astype(np.float32), RANDOM.normal(size=16).astype(np.float32)
W2 = RANDOM.normal(size=(16, 2)).astype(np.float32)
LAYERS = [
    helper.make_node("Gemm", ["x", "w1", "b1"], ["h"], transB=1),
    helper.make_node("Relu", ["h"], ["a"]),
    helper.make_node("MatMul", ["a", "w2"], ["m"]),
    helper.make_node("Add", ["m", "b2"], ["o"]),
    helper.make_node("Tanh", ["o"], ["y"]),
]
PARAMETERS = {"w1": W1, "b1": B1, "w2": W2, "b2": np.array([0.1, -0.2], np.float32)}


def test_layers_in_any_writing_become_a_network_of_ours() -> None:
    """So nothing but NumPy runs in engine and training."""
    policy = bring(graph(LAYERS, PARAMETERS), "other.onnx")["policy"]
    assert isinstance(policy, Policy)
    observations = seen_in("study_room")
    expected = np.tanh(np.maximum(observations @ W1.T + B1, 0) @ W2 + PARAMETERS["b2"])
    np.testing.assert_allclose(policy.act(observations), expected, atol=1e-5)


def test_what_is_no_chain_of_layers_is_run_as_it_came() -> None:
    """A residual connection, an activation of its own, actions beyond what a robot does."""
    nodes = [
        *LAYERS[:2],
        helper.make_node("Add", ["a", "a"], ["twice"]),
        helper.make_node("MatMul", ["twice", "w2"], ["y"]),
    ]
    found = bring(graph(nodes, PARAMETERS), "other.onnx")
    assert isinstance(found["policy"], ForeignPolicy)
    assert any("clipped" in note for note in found["notes"])
    observations = seen_in("study_room", 30)
    expected = np.clip(2 * np.maximum(observations @ W1.T + B1, 0) @ W2, -1, 1)
    np.testing.assert_allclose(found["policy"].act(observations), expected, atol=1e-4)


def test_the_manifest_may_lie_beside_the_network() -> None:
    bare = graph(LAYERS, PARAMETERS, manifest=None)
    with pytest.raises(LearningError, match="no manifest: needed is JSON under the key 'manifest'"):
        import_policy(bare, "other.onnx")
    assert import_policy(bare, "other.onnx", manifest=json.dumps(MANIFEST).encode()).policy.setup == "study_room"


def changed(path: str, value: Any) -> dict[str, Any]:
    """The manifest with another value at `lidar.beams`; None: without it."""
    manifest = json.loads(json.dumps(MANIFEST))
    *before, last = path.split(".")
    holder = manifest
    for name in before:
        holder = holder[int(name)] if isinstance(holder, list) else holder[name]
    if value is None:
        del holder[last]
    else:
        holder[int(last) if isinstance(holder, list) else last] = value
    return manifest


@pytest.mark.parametrize(
    ("manifest", "said"),
    [
        (changed("lidar.beams", 180), f"'lidar.beams' = 180; the setup's is {SETUP.robot.lidar.beams}"),
        (changed("lidar.order", "clockwise"), "'lidar.order' = 'clockwise'; the setup's is 'from straight ahead"),
        (changed("lidar.pooling", "mean"), "'lidar.pooling' = 'mean'; the setup's is 'minimum per sector'"),
        (changed("lidar.range_m", 3.5), f"'lidar.range_m' = 3.5; the setup's is {SETUP.robot.lidar.range_m}"),
        (changed("lidar", None), "'lidar' is missing"),
        (changed("control_rate_hz", 10), "'control_rate_hz' = 10; the setup's is 5"),
        (changed("control_rate_hz", True), "'control_rate_hz' = True"),
        (changed("action.layout.0.range", [0, 0.26]), "'action.layout[0].range[1]' = 0.26; the setup's is"),
        (changed("action.scaling", None), "'action.scaling' is missing"),
        (changed("observation.layout.0.unit", "cm"), "'observation.layout[0].unit' = 'cm'; the setup's is 'm'"),
        (
            changed("observation.layout.1.divided_by", 1.0),
            "'observation.layout[1].divided_by' = 1.0; the setup's is 3.1",
        ),
        (changed("observation.layout", MANIFEST["observation"]["layout"][:5]), "has 5 entries; the setup's has"),
        (changed("angles", float("nan")), "'angles' = nan"),
        (MANIFEST | {"normalise": [1]}, "'normalise' is unknown here; known are observation, lidar"),
        (MANIFEST | {"setup": "the moon"}, "'setup' = 'the moon': unknown setup"),
        (MANIFEST | {"slowing": {"near_m": -1}}, "near_m = -1"),
        (MANIFEST | {"slowing": [1]}, "'slowing'"),
        ({"setup": "study_room"}, "'observation' is missing"),
        ([1], "its manifest is list, must be an object"),
    ],
)
def test_what_a_manifest_says_wrong_or_not_at_all_is_named(manifest: Any, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        bring(graph(LAYERS, PARAMETERS, manifest), "other.onnx")


def test_a_setup_that_would_do_is_named() -> None:
    other = {"setup": "open_field", **setup_manifest(SETUP)}
    with pytest.raises(LearningError, match="it fits study_room: name it with --setup"):
        bring(graph(LAYERS, PARAMETERS, other), "other.onnx")
    found = bring(graph(LAYERS, PARAMETERS, other), "other.onnx", setup="study_room")
    assert found["policy"].setup == "study_room"
    assert any("open_field" in note for note in found["notes"])


# ---- what could harm -------------------------------------------------------------------------------------------------


def with_parts(content: bytes, **parts: bytes | None) -> bytes:
    """The zip with other members; None: without it."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as given, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as made:
        for one in given.infolist():
            if one.filename not in parts:
                made.writestr(one.filename, given.read(one))
        for name, part in parts.items():
            if part is not None:
                made.writestr(name, part)
    return out.getvalue()


def state(change: Callable[[dict[str, torch.Tensor]], Any]) -> bytes:
    """The actor's tensors, changed."""
    tensors = {name: tensor.clone() for name, tensor in sb3().policy.state_dict().items()}
    changed_to = change(tensors)
    out = io.BytesIO()
    torch.save(tensors if changed_to is None else changed_to, out)
    return out.getvalue()


def data(**fields: Any) -> bytes:
    with zipfile.ZipFile(io.BytesIO(saved(sb3()))) as archive:
        known = json.loads(archive.read("data"))
    return json.dumps({name: value for name, value in (known | fields).items() if value is not None}).encode()


def nan(tensors: dict[str, torch.Tensor]) -> None:
    tensors["actor.mu.0.weight"][0, 0] = float("nan")


def huge(tensors: dict[str, torch.Tensor]) -> None:
    tensors["actor.mu.0.weight"] = torch.zeros(1, 1).expand(3_000_000, 2)


def without_bias(tensors: dict[str, torch.Tensor]) -> None:
    del tensors["actor.mu.2.bias"]


ZIPS: dict[str, tuple[Callable[[], bytes], str]] = {
    "no zip": (lambda: b"PK\x03\x04 and no more", "no zip that can be read"),
    "cut": (lambda: saved(sb3())[:-30], "holds no 'data'"),
    "no weights": (lambda: with_parts(saved(sb3()), **{"policy.pth": None}), "holds no 'policy.pth'"),
    "a bomb": (lambda: with_parts(saved(sb3()), **{"policy.pth": bytes(80 * 2**20)}), "more than 67,108,864 bytes"),
    "a bomb of text": (lambda: with_parts(saved(sb3()), data=b" " * (17 * 2**20)), "more than 16,777,216 bytes"),
    "a pickle": (
        lambda: with_parts(saved(sb3()), **{"policy.pth": pickle.dumps({"actor.mu.0.weight": Evil()})}),
        "not a state dict of tensors",
    ),
    "a pickle among tensors": (
        lambda: with_parts(saved(sb3()), **{"policy.pth": state(lambda _: {"actor.mu.0.weight": Evil()})}),
        "not a state dict of tensors",
    ),
    "no numbers": (lambda: with_parts(saved(sb3()), **{"policy.pth": state(nan)}), "NaN or infinite"),
    "rows that are one": (lambda: with_parts(saved(sb3()), **{"policy.pth": state(huge)}), "6,0"),
    "half a layer": (lambda: with_parts(saved(sb3()), **{"policy.pth": state(without_bias)}), "needed is a linear"),
    "a list": (lambda: with_parts(saved(sb3()), **{"policy.pth": state(lambda t: list(t.values()))}), "a state dict"),
    "data that are none": (lambda: with_parts(saved(sb3()), data=b"[" * 100_000), "no JSON"),
    "data of a list": (lambda: with_parts(saved(sb3()), data=b"[]"), "must be an object"),
    "no space": (lambda: with_parts(saved(sb3()), data=data(observation_space=None)), "'observation_space' is missing"),
    "another activation": (
        lambda: with_parts(saved(sb3()), data=data(policy_kwargs={"activation_fn": "<function f>"})),
        "read are ReLU, Tanh",
    ),
    "noise of states": (lambda: with_parts(saved(sb3()), data=data(use_sde=True)), "'use_sde' = true"),
    "another robot": (lambda: saved(sb3(setup="open_field")), "Box of 66"),
}  # fmt: skip


@pytest.mark.parametrize("name", ZIPS)
def test_a_zip_that_could_harm_or_does_not_fit_is_refused(name: str) -> None:
    make, said = ZIPS[name]
    with pytest.raises(LearningError, match=re.escape(said)):
        bring(make(), "model.zip", setup="study_room")
    assert not Path("/tmp/desirepath-was-here").exists()


def test_what_is_pickled_in_a_zip_is_never_opened() -> None:
    """What Stable-Baselines3 would unpickle stays text."""
    evil = {
        ":type:": "<class 'dict'>",
        ":serialized:": "gASVLAAAAAAAAACMBXBvc2l4lIwGc3lzdGVtlJOUjBF0b3VjaCAvdG1wL2hlcmWUhZRSlC4=",
    }
    policy = bring(with_parts(saved(sb3()), data=data(lr_schedule=evil)), "model.zip", setup="study_room")["policy"]
    assert isinstance(policy, Policy)
    assert not Path("/tmp/here").exists()


def test_a_zip_without_a_manifest_needs_to_be_told_its_setup() -> None:
    with pytest.raises(LearningError, match="needs --setup SETUP"):
        bring(saved(sb3()), "model.zip")


def test_a_space_of_another_scale_is_named() -> None:
    known = json.loads(data())["observation_space"]
    low, high = ("[" + " ".join(["0.0"] * WIDTH) + "]"), ("[" + " ".join(["9.0"] * WIDTH) + "]")
    other = data(observation_space=known | {"low": low, "high": high})
    with pytest.raises(LearningError, match=r"high of goal_distance = 9|low of goal_bearing = 0; .*setup in which"):
        bring(with_parts(saved(sb3()), data=other), "model.zip", setup="study_room")


ONNX: dict[str, tuple[Callable[[], bytes], str]] = {
    "nothing": (lambda: b"no network", "no ONNX file"),
    "NaN weights": (lambda: graph(LAYERS, PARAMETERS | {"b1": np.full(16, np.nan, np.float32)}), "not numbers"),
    "three outputs": (
        lambda: graph([helper.make_node("MatMul", ["x", "w"], "y")], {"w": np.ones((WIDTH, 3), np.float32)}, outputs=3),
        "needed is an output (n, 2)",
    ),
    "an operator": (
        lambda: graph([helper.make_node("NonZero", ["x"], ["z"]), *LAYERS], PARAMETERS),
        "NonZero is not run",
    ),
    "other types": (
        lambda: graph(LAYERS, PARAMETERS | {"w1": W1.astype(np.float64)}),
        "no ONNX network",
    ),
    "rows that depend on each other": (
        lambda: graph(
            [*LAYERS[:4], helper.make_node("Softmax", ["o"], ["y"], axis=0)], PARAMETERS
        ),
        "changes with the steps that are asked beside it",
    ),
    "wide": (
        lambda: graph(
            [helper.make_node("Concat", ["x"] * 300, ["z"], axis=1), helper.make_node("MatMul", ["z", "w"], ["y"])],
            {"w": np.ones((WIDTH * 300, 2), np.float32)},
        ),
        "numbers per step; at most",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ONNX)
def test_an_onnx_file_that_could_harm_or_does_not_fit_is_refused(name: str) -> None:
    make, said = ONNX[name]
    with pytest.raises(LearningError, match=re.escape(said)):
        bring(make(), "other.onnx")


def test_weights_in_another_file_are_not_looked_for() -> None:
    model = onnx.load_model_from_string(graph(LAYERS, PARAMETERS))
    stored = model.graph.initializer[0]
    stored.ClearField("raw_data")
    stored.data_location = onnx.TensorProto.EXTERNAL
    entry = stored.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"
    with pytest.raises(LearningError, match="another file; export them inside"):
        bring(model.SerializeToString(), "other.onnx")


def test_a_file_of_ours_with_other_numbers_is_refused() -> None:
    policy = load_policy("study_room/base")
    broken = io.BytesIO(policy.to_bytes())
    arrays = dict(np.load(broken))
    arrays["actor_00"] = arrays["actor_00"] * np.float32("nan")
    out = io.BytesIO()
    np.savez(out, **arrays)
    with pytest.raises(LearningError, match="actor_00 holds NaN"):
        import_policy(out.getvalue(), "policy.npz")
    with pytest.raises(LearningError, match="a policy of setup study_room, not of open_field"):
        import_policy(policy.to_bytes(), "policy.npz", setup="open_field")
    bomb = io.BytesIO()
    np.savez_compressed(bomb, meta=np.zeros(200 * 2**20, np.uint8))
    with pytest.raises(LearningError, match="when unpacked"):
        import_policy(bomb.getvalue(), "policy.npz")
    with pytest.raises(LearningError, match=r"must end with one of \.npz, \.onnx, \.zip"):
        import_policy(b"x", "policy.pt")


def test_a_policy_that_gives_no_numbers_while_it_drives_says_so() -> None:
    nodes = [*LAYERS[:4], helper.make_node("Log", ["o"], ["y"])]
    policy = ForeignPolicy("study_room", graph(nodes, PARAMETERS | {"b2": np.array([-99, -99], np.float32)}))
    with pytest.raises(ValueError, match="an action is not a number"):
        policy.act(seen_in("study_room", 3))


def test_more_rows_than_are_asked_at_once() -> None:
    nodes = [helper.make_node("MatMul", ["x", "w"], ["y"])]
    weights = {"w": np.ones((WIDTH, 2), np.float32)}
    with LimitedNetwork("policy", b'{"setup": "study_room"}', graph(nodes, weights), "other.onnx") as network:
        rows = np.arange((ROWS + 5) * WIDTH, dtype=np.float32).reshape(-1, WIDTH) / 1e5
        np.testing.assert_allclose(network(rows), rows @ weights["w"], rtol=1e-3)


def test_a_network_that_came_as_our_own_file_is_opened_as_others_are():
    content = ForeignPolicy("study_room", b"garbage, no ONNX at all").to_bytes()
    with pytest.raises(LearningError, match="policy of study_room"):
        import_policy(content, "mine.npz")

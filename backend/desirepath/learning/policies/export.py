"""A policy in other people's formats: a Stable-Baselines3 TD3 zip, and ONNX with a manifest. Nothing is read here."""

from __future__ import annotations

import io
import json
import threading

import cloudpickle
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from desirepath.learning.policies import sb3_extractor
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.sb3 import sb3_model_of

ONNX_OPSET = 17
_BY_VALUE = threading.Lock()  # what cloudpickle takes along by value is one list of the whole process


def policy_to_onnx(policy: Policy) -> bytes:
    """An ONNX graph `observation (n, obs) -> action (n, 2)`, the policy's manifest in its metadata."""
    split = policy.shape.task_inputs
    nodes: list[onnx.NodeProto] = []
    weights = [numpy_helper.from_array(np.ascontiguousarray(array), f"p{k}") for k, array in enumerate(policy.actor)]

    def dense(x: str, layer: int, activation: str, out: str) -> str:
        nodes.append(helper.make_node("Gemm", [x, f"p{2 * layer}", f"p{2 * layer + 1}"], [f"{out}_linear"]))
        nodes.append(helper.make_node(activation, [f"{out}_linear"], [out]))
        return out

    last, layer = "observation", 0
    if policy.shape.extractor:
        sizes = np.array([split, policy.shape.lidar_inputs], dtype=np.int64)
        weights.insert(0, numpy_helper.from_array(sizes, "split_sizes"))
        nodes.append(helper.make_node("Split", ["observation", "split_sizes"], ["task", "lidar"], axis=1))
        task = dense(dense("task", 0, "Relu", "task_1"), 1, "Relu", "task_2")
        lidar = dense(dense("lidar", 2, "Relu", "lidar_1"), 3, "Relu", "lidar_2")
        nodes.append(helper.make_node("Concat", [task, lidar], ["features"], axis=1))
        last, layer = "features", 4
    for number in range(1, len(policy.shape.heads) + 1):
        last, layer = dense(last, layer, "Relu", f"head_{number}"), layer + 1
    dense(last, layer, "Tanh", "action")
    graph = helper.make_graph(
        nodes,
        "desirepath_policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["n", policy.shape.observation_size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", 2])],
        weights,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", ONNX_OPSET)], producer_name="desirepath")
    model.ir_version = 10  # what onnxruntime >= 1.18 reads
    helper.set_model_props(model, {"manifest": json.dumps(policy.manifest(), sort_keys=True)})
    onnx.checker.check_model(model)
    serialised: bytes = model.SerializeToString()
    return serialised


def policy_to_sb3_zip(policy: Policy) -> bytes:
    """A zip that `stable_baselines3.TD3.load` opens without our package and that acts like the policy.

    The two-branch feature extractor travels inside the zip by value. Carries the critic where the policy has one.
    """
    model = sb3_model_of(policy)
    out = io.BytesIO()
    with _BY_VALUE:
        cloudpickle.register_pickle_by_value(sb3_extractor)
        try:
            model.save(out)
        finally:
            cloudpickle.unregister_pickle_by_value(sb3_extractor)
    return out.getvalue()

"""A policy in other people's formats: a Stable-Baselines3 TD3 zip, and ONNX with a manifest. Back they come
by `foreign_files.py`."""

from __future__ import annotations

import io
import json
import threading
import zipfile

import cloudpickle
import numpy as np
import onnx
from onnx import helper

from desirepath.learning.policies import sb3_extractor
from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.foreign_files import ZIP_MANIFEST
from desirepath.learning.policies.onnx_layers import Layer, TwoBranches, onnx_of_layers
from desirepath.learning.policies.policy import DrivingPolicy, Policy, network_of
from desirepath.learning.policies.sb3 import sb3_model_of

_BY_VALUE = threading.Lock()  # what cloudpickle takes along by value is one list of the whole process


def policy_to_onnx(policy: DrivingPolicy) -> bytes:
    """An ONNX graph `observation (n, obs) -> action (n, 2)`, the policy's manifest in its metadata.

    Raises LearningError for a policy that reads more than its setup's observation."""
    if isinstance(policy, ForeignPolicy):
        model = onnx.load_model_from_string(policy.network)
    else:
        model = onnx_of_layers(_layers(network_of(policy)))
    del model.metadata_props[:]
    helper.set_model_props(model, {"manifest": json.dumps(policy.manifest(), sort_keys=True)})
    serialised: bytes = model.SerializeToString()
    return serialised


def _layers(policy: Policy) -> list[Layer] | TwoBranches:
    arrays = [np.ascontiguousarray(array) for array in policy.actor]
    every = [Layer(weight, bias, "Relu") for weight, bias in zip(arrays[0::2], arrays[1::2], strict=True)]
    every[-1] = every[-1]._replace(activation="Tanh")
    if not policy.shape.extractor:
        return every
    return TwoBranches(policy.shape.task_inputs, every[:2], every[2:4], every[4:])


def policy_to_sb3_zip(policy: DrivingPolicy) -> bytes:
    """A zip that `stable_baselines3.TD3.load` opens without our package and that acts like the policy.

    The two-branch feature extractor travels inside the zip by value. Carries the critic where the policy has one, and
    the manifest, which Stable-Baselines3 does not look at. Raises LearningError as `policy_to_onnx`, and for ONNX of
    others.
    """
    model = sb3_model_of(network_of(policy))
    out = io.BytesIO()
    with _BY_VALUE:
        cloudpickle.register_pickle_by_value(sb3_extractor)
        try:
            model.save(out)
        finally:
            cloudpickle.unregister_pickle_by_value(sb3_extractor)
    with zipfile.ZipFile(out, "a") as archive:
        archive.writestr(zipfile.ZipInfo(ZIP_MANIFEST), json.dumps(policy.manifest(), sort_keys=True))
    return out.getvalue()

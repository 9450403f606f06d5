"""A policy as a bundle: all that `desirepath.deploy` needs to drive a robot by it, and what other programs are checked
by."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

import desirepath.deploy
from desirepath.deploy.bundle import MANIFEST, POLICY
from desirepath.deploy.conditioning import PREFERENCES, SHARES
from desirepath.deploy.controller import Controller
from desirepath.deploy.inputs import Odometry, Person, Scan
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.adaptable import AdaptablePolicy
from desirepath.learning.policies.choosing import ChoosingPolicy
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.export import policy_to_onnx
from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.policy import Policy, StoredPolicy
from desirepath.learning.preferences.objectives import OPPOSITES
from desirepath.simulation.fast import raw_ranges, rollout
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import Setup, get_setup, require_lidar

BY_SCAN = (Policy, ConditionedPolicy, AdaptablePolicy, ForeignPolicy, ChoosingPolicy)
"""Kinds of policy that go by what a robot's scan tells."""
VECTORS = "test_vectors.json"
VECTOR_SCENES = range(7_000, 7_010)
"""Seeds of the scenes that test vectors are taken from, one each."""
PROGRAM = ("zip_files.py", "npz.py", "deploy/**/*.py", "deploy/**/*.yaml")
"""Of the package: what drives a robot that has no more of it than this. Without `__init__.py` above it, so that a whole
`desirepath` is taken where one is installed."""


def bundle_files(stored: StoredPolicy, weights: str = "") -> dict[str, bytes]:
    """Names and contents. weights: of a conditioned policy, as behind `@`; it then takes none while it drives.

    Raises LearningError, SetupError or BundleError for a policy that no robot can be driven by.
    """
    policy = stored.driving(weights) if weights else stored
    files = driving_files(policy)
    controller = Controller.load(zipped(files))
    driving = policy.driving()
    files[VECTORS] = _json({"vectors": test_vectors(controller, policy)})
    if not isinstance(driving, ChoosingPolicy):  # which is many networks: all are in policy.npz
        files["policy.onnx"] = policy_to_onnx(driving)
    if isinstance(driving, Policy):
        for number, actor in enumerate(driving.recovery_policies, start=1):
            alone = Policy(driving.setup, driving.shape, actor, slowing=driving.slowing)
            files[f"recovery_{number}.onnx"] = policy_to_onnx(alone)
    package = Path(desirepath.deploy.__file__).parents[1]
    for pattern in PROGRAM:
        for file in sorted(package.glob(pattern)):
            files[f"desirepath/{file.relative_to(package).as_posix()}"] = file.read_bytes()
    return files


def driving_files(policy: StoredPolicy) -> dict[str, bytes]:
    """Of these, what `desirepath.deploy` drives by. Raises as `bundle_files`."""
    if not isinstance(policy, BY_SCAN):
        raise LearningError(f"{type(policy).__name__} of {policy.setup} reads what a robot's scan does not tell")
    require_lidar(get_setup(policy.setup))
    return {MANIFEST: _json(bundle_manifest(policy)), POLICY: policy.to_bytes()}


def zipped(files: Mapping[str, bytes]) -> bytes:
    """One file of them, the same bytes each time."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return out.getvalue()


def bundle_manifest(policy: StoredPolicy) -> dict[str, Any]:
    """That of what drives without weights, with what weights it takes."""
    if isinstance(policy, ChoosingPolicy):
        recovers = max(policy.policies, key=lambda one: len(one.recovery_policies)).manifest()["recovery"]
        return policy.policies[0].manifest() | policy.manifest() | {"conditioning": None, "recovery": recovers}
    manifest = policy.driving().manifest() | {"policy_sha256": policy.digest(), "conditioning": None}
    if isinstance(policy, ConditionedPolicy):
        opposites = [[policy.objectives[a], policy.objectives[b]] for a, b in OPPOSITES]
        taken = {"kind": PREFERENCES, "objectives": list(policy.objectives), "opposites": opposites, "weights": {}}
        return manifest | {
            "conditioning": taken | {"strengths": dict(policy.strengths), "exported": "onnx: without any preference"},
            "slowing": policy.slowing and policy.slowing.as_dict() | {"of": "slower_near_person at weight 1"},
        }
    if isinstance(policy, AdaptablePolicy):
        taken = {"kind": SHARES, "objectives": list(policy.objectives), "weights": {}}
        return manifest | {"conditioning": taken | {"exported": "onnx: a third of each"}}
    return manifest


def scan_in(setup: Setup, scene: Scene, pose: Pose, stamp_s: float = 0.0) -> Scan:
    """What the setup's lidar sees there, every beam, without its errors: as a robot's lidar says it."""
    lidar = setup.robot.lidar
    ranges, bearings = raw_ranges(setup, scene, pose), np.array(lidar.bearings())
    if not lidar.all_round:
        right = len(ranges) - (len(ranges) + 1) // 2
        ranges, bearings = np.roll(ranges, right), np.roll(bearings, right)
        bearings[:right] -= 2 * np.pi
    return Scan(stamp_s, float(bearings[0]), float(bearings[1] - bearings[0]), 0.0, lidar.range_m, ranges)


def test_vectors(controller: Controller, policy: StoredPolicy) -> list[dict[str, Any]]:
    """Ten times: scan, odometry, goal, people -> observation -> action -> command; each as if a robot began to be
    driven there, at the speeds that its odometry says. Taken from rollouts in scenes of its setup."""
    setup = get_setup(policy.setup)
    scenes = draw_scenes(setup, VECTOR_SCENES)
    found = []
    for k, driven in enumerate(rollout(setup, policy.driving().rollout_policy, scenes)):
        step = min(4 * k, len(driven.actions) - 1)
        scene, pose = driven.scene, Pose(*(float(one) for one in driven.poses[step]))
        now, next_s = step * driven.dt, (step + 1) * driven.dt
        moving = scene.people_at(np.array([now, next_s]))
        people = [Person(*map(float, (*at, *(then - at) / driven.dt))) for at, then in moving]
        person = replace(scene.person, pose=Pose(*map(float, scene.person_poses(np.array([now]))[0])))
        seen = replace(scene, person=person, walk=None, crowd=None)
        scan = scan_in(setup, seen, pose, now)
        scan = replace(scan, ranges=np.round(scan.ranges, 4))
        limits = setup.robot.limits
        v, w = 0.0, 0.0
        if step:
            forward, turning = driven.actions[step - 1].tolist()
            v, w = limits.v_min + (forward + 1) / 2 * (limits.v_max - limits.v_min), turning * limits.w_max
        odometry = Odometry(scan.stamp_s, pose.x, pose.y, pose.yaw, v, w)
        goal = (scene.goal.x, scene.goal.y)
        controller.reset()
        controller.command = replace(controller.command, v=v, w=w)
        command = controller.step(scan, odometry, goal, people)
        found.append(
            {
                "scan": asdict(scan) | {"ranges": scan.ranges.tolist()},
                "odometry": asdict(odometry),
                "goal": list(goal),
                "people": [asdict(one) for one in people],
                "observation": controller.observation.tolist(),
                "action": controller.action.tolist(),
                "command": asdict(command),
            }
        )
    return found


def _json(value: object) -> bytes:
    return json.dumps(value, indent=1, sort_keys=True, allow_nan=False).encode()

"""A policy that comes in as a file: our own (.npz), ONNX with a manifest, a zip of Stable-Baselines3.

What may be read is decided where little can be lost (`foreign_files.py`, in a process of its own); how it is kept is
`store/imported_policies.py`'s.
"""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from desirepath.learning.errors import LearningError
from desirepath.learning.foreign.limited import LimitedNetwork
from desirepath.learning.foreign.onnx_bounds import ROWS
from desirepath.learning.policies.choosing import ChoosingPolicy
from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.policy import StoredPolicy, read_policy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.npz import MIB, Bounds, NpzError, from_npz
from desirepath.simulation.observation_bounds import observation_bounds
from desirepath.simulation.setups import get_setup

FILE_BYTES = 64 * MIB
ENDINGS = (".npz", ".onnx", ".zip")
BOUNDS = Bounds(header_bytes=MIB, all_bytes=2 * FILE_BYTES)


@dataclass(frozen=True)
class ImportedPolicy:
    """policy: what came in. file, sha256: the file it came as. notes: what is to be known of it, in sentences.
    made_from: id of the policy that it says it was exported of, or nothing."""

    policy: StoredPolicy
    file: str
    sha256: str
    notes: tuple[str, ...] = ()
    made_from: str = ""


def import_policy(
    content: bytes, named: str, *, setup: str = "", manifest: bytes | None = None, manifest_named: str = "manifest"
) -> ImportedPolicy:
    """Read a policy's file. setup: whose robot it drives, where the file does not say or another is meant; manifest:
    of an ONNX file or a zip without one. Raises ValueError that names the field, the value and what would work."""
    file = PurePath(named).name
    ending = PurePath(file).suffix.lower()
    if ending not in ENDINGS:
        raise LearningError(f"{file}: must end with one of {', '.join(ENDINGS)}: our own file, ONNX, Stable-Baselines3")
    if not 0 < len(content) <= FILE_BYTES:
        raise LearningError(f"{file}: {len(content):,} bytes; between 1 and {FILE_BYTES:,} are read")
    sha256 = hashlib.sha256(content).hexdigest()
    if ending == ".npz":
        own = _own(content, file, setup)
        if isinstance(own, ForeignPolicy):  # its network is opened and run as those of other files are
            low, high = observation_bounds(get_setup(own.setup))
            own.act(np.random.default_rng(0).uniform(low, high, (ROWS, len(low))).astype(np.float32))
        if isinstance(own, ChoosingPolicy):
            _choose_once(own, file)
        return ImportedPolicy(own, file, sha256)
    try:
        beside = manifest.decode() if manifest is not None else None
    except UnicodeDecodeError:
        raise LearningError(f"{manifest_named}: must be UTF-8") from None
    asked = {"file": file, "setup": setup, "manifest": beside, "manifest_named": PurePath(manifest_named).name}
    with LimitedNetwork("policy_file", json.dumps(asked).encode(), content, file) as reading:
        told = json.loads(reading.told)
    policy = read_policy(base64.b64decode(told["policy"]))
    return ImportedPolicy(policy, file, sha256, tuple(told["notes"]), told["made_from"])


def _choose_once(policy: ChoosingPolicy, file: str) -> None:
    try:
        policy.places(scene_set(policy.setup, 1, purpose=Purpose.FIGURE, seed=0))
    except (ArithmeticError, IndexError, TypeError, ValueError) as problem:
        raise LearningError(f"{file}: it cannot choose in a scene of {policy.setup}: {problem}") from None


def _own(content: bytes, file: str, setup: str) -> StoredPolicy:
    try:
        arrays = from_npz(content, BOUNDS)[1]
    except NpzError as problem:
        raise LearningError(f"{file}: not a policy's file (.npz): {problem}") from None
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise LearningError(f"{file}: {name} holds NaN or infinite weights; train again or take an earlier file")
    policy = read_policy(content)
    if setup and policy.setup != setup:
        raise LearningError(f"{file}: it is a policy of setup {policy.setup}, not of {setup}; leave --setup away")
    return policy

"""What the manifest of a reward file says, and the one file that it and its network are kept as. No network is opened
here, so that a server may take one in without torch: reading it is `reward_file.py`'s."""

from __future__ import annotations

import json
from functools import cached_property
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from desirepath.learning.errors import LearningError
from desirepath.learning.people.reward_inputs import Conversion, InputPart, conversion
from desirepath.npz import NpzError, from_npz, to_npz
from desirepath.simulation.setups import get_setup, preference_setups

FORMAT = "desirepath-reward-2"
KEPT_FORMAT = "desirepath-reward-file-1"
MANIFEST_BYTES = 64 * 1024
FILE_BYTES = 64 * 1024 * 1024
MOST_INPUTS = 2048


class RewardManifest(BaseModel):
    """What a reward file's manifest says.

    file: the network beside it, `.pt` or `.pth` (a state dict of linear layers in their order) or `.onnx` (one input
    (n, inputs) float32, one output). inputs: what is put side by side, of each step, with every unit, scale and order
    stated (`reward_inputs.py`): nothing is taken for granted. hidden, output: of a state dict; reduction: how a
    trajectory's steps are put together.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal["desirepath-reward-2"]
    setup: str
    file: str = Field(pattern=r"^[A-Za-z0-9._-]+\.(pt|pth|onnx)$")
    inputs: tuple[InputPart, ...] = Field(min_length=1, max_length=6)
    hidden: Literal["relu", "leaky_relu", "tanh"] = "leaky_relu"
    output: Literal["none", "tanh"] = "none"
    reduction: Literal["mean", "sum"] = "mean"

    @cached_property
    def conversion(self) -> Conversion:
        """Steps of ours to what the network is given. Raises ValueError."""
        return conversion(get_setup(self.setup), self.inputs)

    @property
    def width(self) -> int:
        """Inputs of the network, of each step."""
        return len(self.conversion.of)


def read_manifest(content: bytes, named: str) -> RewardManifest:
    """Raises LearningError that names the field, the value and what would work. named: for messages."""
    if len(content) > MANIFEST_BYTES:
        raise LearningError(f"{named}: {len(content):,} bytes; at most {MANIFEST_BYTES:,} are read")
    try:
        manifest = RewardManifest.model_validate(json.loads(content))
    except ValidationError as problem:
        wrong = "; ".join(
            f"{'.'.join(map(str, error['loc'])) or 'manifest'}: {error['msg']}" for error in problem.errors()
        )
        raise LearningError(f"{named}: not a reward manifest of format {FORMAT!r}: {wrong}") from None
    except (ValueError, RecursionError) as problem:
        raise LearningError(f"{named}: not a reward manifest of format {FORMAT!r}: {problem}") from None
    if manifest.setup not in preference_setups():
        raise LearningError(f"{named}: setup = {manifest.setup!r}: must be one of {', '.join(preference_setups())}")
    try:
        if (width := manifest.width) > MOST_INPUTS:
            raise ValueError(f"{width} inputs; at most {MOST_INPUTS} are read")
    except ValueError as problem:
        raise LearningError(f"{named}: inputs: {problem}") from None
    return manifest


def pack(manifest: RewardManifest, network: bytes) -> bytes:
    """Both as one file; the same content, the same bytes. Raises LearningError for a network that is too large."""
    if not 0 < len(network) <= FILE_BYTES:
        raise LearningError(f"{manifest.file}: {len(network):,} bytes; between 1 and {FILE_BYTES:,} are read")
    header: dict[str, Any] = {"format": KEPT_FORMAT, "manifest": manifest.model_dump(mode="json")}
    return to_npz(header, {"network": np.frombuffer(network, dtype=np.uint8)})


def unpack(content: bytes) -> tuple[RewardManifest, bytes] | None:
    """What `pack` made one; None for another file. Raises LearningError for a damaged one."""
    try:
        header, arrays = from_npz(content)
    except NpzError as problem:
        raise LearningError(f"not a reward of the store: {problem}") from None
    if header.get("format") != KEPT_FORMAT:
        return None
    try:
        return RewardManifest.model_validate(header.get("manifest")), arrays["network"].tobytes()
    except (ValidationError, KeyError) as problem:
        raise LearningError(f"not a reward file of format {KEPT_FORMAT!r}: {problem}") from None

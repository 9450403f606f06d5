"""Reads policies of others: ONNX with a manifest, zips of Stable-Baselines3 (weights alone, nothing unpickled). Runs in
a process of its own (`learning/foreign/limited.py`); `importing.py` asks it."""

from __future__ import annotations

import base64
import io
import json
import re
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.foreign.limited import Opened
from desirepath.learning.foreign.onnx_bounds import ROWS, check_network
from desirepath.learning.foreign.reading import open_onnx, read_tensors
from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.manifest import agreed_setup, json_object, read_manifest
from desirepath.learning.policies.onnx_layers import Layer, TwoBranches, layers_of, onnx_of_layers
from desirepath.learning.policies.policy import Policy, PolicyError, read_slowing
from desirepath.learning.policies.shape import ACTION_SIZE, NetworkShape
from desirepath.simulation.observation_bounds import observation_bounds
from desirepath.simulation.setups import Setup, get_setup
from desirepath.zip_files import BROKEN, open_zip

Floats = NDArray[np.float32]
ZIP_MANIFEST = "manifest.json"  # beside what Stable-Baselines3 reads of a zip
MOST_MEMBERS = 100
DATA_BYTES = 16 * 2**20
WEIGHT_BYTES = 64 * 2**20
ACTIVATIONS = {"ReLU": "Relu", "Tanh": "Tanh", "ELU": "Elu", "LeakyReLU": "LeakyRelu", "Sigmoid": "Sigmoid"}
"""Of torch -> of ONNX."""
LEAST_ALIKE = 1e-4  # of actions, between a network that was recognised and the one that came


def open_policy(description: bytes, content: bytes) -> Opened:
    """A `ForeignPolicy`'s network, to be run."""
    setup = get_setup(json.loads(description)["setup"])
    run = open_onnx(content, setup.observation_size, f"policy of {setup.name}", ACTION_SIZE)
    return Opened(width=setup.observation_size, run=run)


def open_policy_file(description: bytes, content: bytes) -> Opened:
    """What a file holds: JSON with `policy` (as it is stored, base64), `notes` and `made_from` (sha256 of the policy
    that it was exported of, or none). Raises ValueError that names the field, the value and what would work."""
    asked = json.loads(description)
    named, beside = asked["file"], asked["manifest"]
    given = read_manifest(beside.encode(), asked["manifest_named"]) if beside else None
    read = _from_zip if named.lower().endswith(".zip") else _from_onnx
    policy, manifest, notes = read(content, named, asked["setup"], given)
    made_from = str(manifest.get("policy_sha256") or "")
    if manifest.get("setup") not in (None, policy.setup):
        notes.append(f"Its manifest was written for setup {str(manifest['setup'])[:60]!r}.")
    if manifest.get("recovery"):
        notes.append(
            "Its recovery policies are not in this file: it drives by its usual actor alone. The .npz has all."
        )
    told = {"policy": base64.b64encode(policy.to_bytes()).decode(), "notes": notes, "made_from": made_from}
    return Opened(json.dumps(told).encode())


Found = tuple[Policy | ForeignPolicy, dict[str, Any], list[str]]
"""The policy, its manifest, what is to be said of it."""


def _from_onnx(content: bytes, named: str, wanted: str, given: dict[str, Any] | None) -> Found:
    try:
        model = onnx.load_model_from_string(content)  # never follows external data
        within = {entry.key: entry.value for entry in model.metadata_props}.get("manifest")
    except Exception as problem:  # protobuf raises what it likes for files of others
        raise LearningError(
            f"{named}: no ONNX file: {(str(problem) or 'cannot be parsed').splitlines()[0][:200]}"
        ) from None
    if given is None and within is None:
        raise LearningError(
            f"{named}: no manifest: needed is JSON under the key 'manifest' in the file's metadata, or a file "
            "beside it (--manifest FILE). `desirepath setups show SETUP --json` prints one to compare with"
        )
    manifest = given if given is not None else read_manifest(str(within).encode(), named)
    setup = agreed_setup(manifest, wanted, named)
    width, slowing = setup.observation_size, _slowing(manifest)
    run = open_onnx(content, width, named, ACTION_SIZE)
    tried = _observations(setup)
    actions = run(tried)
    if not np.isfinite(actions).all():
        raise LearningError(
            f"{named}: its actions are not numbers for observations of {setup.name}: NaN in its weights?"
        )
    network = _network_of(setup, layers_of(model, width))
    if network is not None and np.abs(network.act(tried) - actions).max() < LEAST_ALIKE:
        return replace(network, slowing=slowing), manifest, []
    notes = ["Its network is none of ours: it is run as the ONNX file that it came as, and no training starts from it."]
    if (beyond := float((np.abs(actions) > 1 + LEAST_ALIKE).any(1).mean())) > 0:
        notes.append(f"Its actions are clipped to [-1, 1]: {beyond:.0%} of drawn observations give more.")
    return ForeignPolicy(setup.name, content, slowing), manifest, notes


def _observations(setup: Setup) -> Floats:
    """(ROWS, obs) drawn within the setup's bounds."""
    low, high = observation_bounds(setup)
    return np.random.default_rng(0).uniform(low, high, (ROWS, len(low))).astype(np.float32)


def _slowing(manifest: dict[str, Any]) -> Any:
    rule = manifest.get("slowing")
    if not rule:
        return None
    if not isinstance(rule, dict) or not all(isinstance(value, int | float | str) for value in rule.values()):
        raise LearningError(f"manifest field 'slowing' = {str(rule)[:80]}: must be near_m, free_m and most, or null")
    return read_slowing({"slowing": {name: value for name, value in rule.items() if name != "exported"}})


def _network_of(setup: Setup, found: Sequence[Layer] | TwoBranches | None) -> Policy | None:
    """A network of ours with these layers, None where ours are of another kind."""
    branches: tuple[Sequence[Layer], ...] = ()
    if isinstance(found, TwoBranches):
        if found.split != setup.polar_size:
            return None
        branches, layers = (found.task, found.lidar), found.head
    elif found is None:
        return None
    else:
        layers = found
    hidden = [one.activation for one in (*(one for branch in branches for one in branch), *layers[:-1])]
    if not layers or layers[-1].activation != "Tanh" or any(one != "Relu" for one in hidden):
        return None
    width = branches[0][0].bias.shape[0] if branches and branches[0] else 0
    heads = tuple(one.bias.shape[0] for one in layers[:-1])
    shape = NetworkShape(setup.polar_size, setup.surroundings_size, width, heads)
    arrays = [array for part in (*branches, layers) for one in part for array in (one.weight, one.bias)]
    try:
        return Policy(setup.name, shape, tuple(np.ascontiguousarray(array, dtype=np.float32) for array in arrays))
    except PolicyError:  # branches that are not of two equal layers
        return None


# ---- Stable-Baselines3 ----------------------------------------------------------------------------------------------


def _from_zip(content: bytes, named: str, wanted: str, given: dict[str, Any] | None) -> Found:
    parts = _members(content, named)
    within = parts.get(ZIP_MANIFEST)
    manifest = given if given is not None else read_manifest(within, named) if within is not None else {}
    if not manifest and not wanted:
        raise LearningError(f"{named}: no setup: a zip without a manifest needs --setup SETUP, in which it was trained")
    setup = agreed_setup(manifest, wanted, named) if manifest else get_setup(wanted)
    data = json_object(parts["data"], f"{named}: its data are")
    low, high = observation_bounds(setup)
    names = [str(one["name"]) for one in setup.observation_layout()]
    _check_space(data, "observation_space", low, high, names, named, setup)
    ones = np.ones(ACTION_SIZE, dtype=np.float32)
    _check_space(data, "action_space", -ones, ones, ["linear_velocity", "angular_velocity"], named, setup)
    if data.get("use_sde"):
        raise LearningError(
            f"{named}: data field 'use_sde' = true: state-dependent noise is not read; train without it"
        )
    tensors = read_tensors(parts["policy.pth"], f"{named}, policy.pth")
    if unfit := next((name for name, array in tensors.items() if not np.isfinite(array).all()), None):
        raise LearningError(f"{named}: {unfit} holds NaN or infinite weights; train again or take an earlier file")
    notes = ["Read of the zip were its weights alone. What a VecNormalize did to observations is not in such a file."]
    found = _actor_of(tensors, _activation(data, tensors, named), named)
    network = _network_of(setup, found)
    if network is not None:
        policy = replace(network, slowing=_slowing(manifest))
        # A policy without value functions is exported with such that nobody trained.
        return _with_critic(policy, tensors) if manifest.get("value_functions", True) else policy, manifest, notes
    if isinstance(found, TwoBranches):
        raise LearningError(f"{named}: its feature extractor is not one for setup {setup.name}")
    sizes = [found[0].weight.shape[0] if found else 0, found[-1].bias.shape[0] if found else 0]
    if sizes != [setup.observation_size, ACTION_SIZE]:
        raise LearningError(
            f"{named}: its actor has {sizes[0]} inputs and {sizes[1]} outputs; setup {setup.name} has "
            f"{setup.observation_size} and {ACTION_SIZE}"
        )
    as_onnx = onnx_of_layers(found).SerializeToString()
    check_network(as_onnx, setup.observation_size, named, ACTION_SIZE)
    notes.append(
        "Its network is none of ours (ReLU, tanh at its end): it is run as ONNX, and no training starts from it."
    )
    return ForeignPolicy(setup.name, as_onnx, _slowing(manifest)), manifest, notes


def _members(content: bytes, named: str) -> dict[str, bytes]:
    """What is read of a zip, each part no larger than it may be. Raises LearningError."""
    limits = {"data": DATA_BYTES, "policy.pth": WEIGHT_BYTES, ZIP_MANIFEST: DATA_BYTES}
    found: dict[str, bytes] = {}
    try:
        with open_zip(io.BytesIO(content)) as archive:
            members = archive.infolist()
            if len(members) > MOST_MEMBERS or len({one.filename for one in members}) < len(members):
                raise LearningError(
                    f"{named}: {len(members)} members, or two of one name; at most {MOST_MEMBERS} are read"
                )
            for one in members:
                most = limits.get(one.filename)
                if most is None:
                    continue
                if one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise LearningError(
                        f"{named}: {one.filename} is compressed otherwise than Stable-Baselines3 does it"
                    )
                with archive.open(one) as opened:
                    found[one.filename] = opened.read(most + 1)
                if len(found[one.filename]) > most:
                    raise LearningError(f"{named}: {one.filename} has more than {most:,} bytes when unpacked")
    except (*BROKEN, OSError) as problem:
        raise LearningError(f"{named}: no zip that can be read: {problem}") from None
    for needed in ("data", "policy.pth"):
        if needed not in found:
            raise LearningError(
                f"{named}: holds no {needed!r}; needed is what `model.save` of Stable-Baselines3 writes"
            )
    return found


def _check_space(
    data: dict[str, Any], which: str, low: Floats, high: Floats, names: list[str], named: str, setup: Setup
) -> None:
    """Raise LearningError unless the zip's space is the setup's box."""
    space = data.get(which)
    where = f"{named}: data field {which!r}"
    if not isinstance(space, dict):
        raise LearningError(f"{where} is missing; setup {setup.name}'s is a Box of {len(low)} numbers")
    kind, shape = str(space.get(":type:", ""))[:80], space.get("_shape")
    if "box.Box" not in kind or str(shape).strip("([, ])") != str(len(low)):
        raise LearningError(
            f"{where} is {kind} of shape {str(shape)[:40]}; setup {setup.name}'s is a Box of {len(low)}"
        )
    for side, expected in (("low", low), ("high", high)):
        found = _numbers(str(space.get(side, "")))
        if len(found) != len(expected):
            continue  # long ones are written shortened
        wrong = np.flatnonzero(~np.isclose(found, expected, rtol=1e-3, atol=1e-3))
        if len(wrong):
            k = int(wrong[0])
            raise LearningError(
                f"{where}: {side} of {names[k]} = {found[k]:g}; setup {setup.name}'s is {expected[k]:g}: name the "
                "setup in which it was trained"
            )


def _numbers(text: str) -> NDArray[np.float64]:
    return np.array([float(one) for one in re.findall(r"-?(?:inf|nan|\d[\d.]*(?:e[-+]?\d+)?)", text[:2_000_000])])


def _activation(data: dict[str, Any], tensors: dict[str, Floats], named: str) -> str:
    """ONNX's name of what stands between the layers: as said, or as the algorithm has it where nothing is said."""
    options = data.get("policy_kwargs")
    said = options.get("activation_fn") if isinstance(options, dict) else None
    if said is None:
        return "Tanh" if "action_net.weight" in tensors else "Relu"  # of ActorCriticPolicy, of TD3 and SAC
    found = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", str(said))
    if found is None or found[1] not in ACTIVATIONS:
        raise LearningError(
            f"{named}: data field 'policy_kwargs.activation_fn' = {str(said)[:80]}: read are {', '.join(ACTIVATIONS)}; "
            "export another network as ONNX with a manifest"
        )
    return ACTIVATIONS[found[1]]


def _actor_of(tensors: dict[str, Floats], activation: str, named: str) -> list[Layer] | TwoBranches:
    """The deterministic actor of TD3, DDPG, SAC (and what is built like them), PPO or A2C."""
    extracted = [name for name in tensors if "features_extractor." in name]
    if "action_net.weight" in tensors:
        if extracted or tensors.get("log_std", np.zeros((1, 1))).ndim != 1:
            raise LearningError(
                f"{named}: {(extracted or ['log_std'])[0]}: read are PPO and A2C of MlpPolicy, continuous"
            )
        layers = _stack(tensors, "mlp_extractor.policy_net", activation, named)
        return [*layers, _layer(tensors, "action_net", "", named)]
    if "actor.mu.weight" in tensors and not extracted:  # SAC
        return [*_stack(tensors, "actor.latent_pi", activation, named), _layer(tensors, "actor.mu", "Tanh", named)]
    if "actor.mu.0.weight" in tensors and "actor.latent_pi.0.weight" not in tensors:  # TD3, DDPG
        head = _stack(tensors, "actor.mu", activation, named)
        head[-1] = Layer(head[-1].weight, head[-1].bias, "Tanh")
        own = [name for name in extracted if name.startswith("actor.features_extractor.")]
        if not own:
            return head
        task, lidar = (_stack(tensors, f"actor.features_extractor.{part}", "Relu", named) for part in ("task", "lidar"))
        if task and lidar and len(own) == 2 * (len(task) + len(lidar)):
            return TwoBranches(task[0].weight.shape[0], task, lidar, head)
    raise LearningError(
        f"{named}: {next(iter(extracted or tensors), 'no tensors')[:80]}: read are MlpPolicy of TD3, DDPG, SAC, PPO "
        "and A2C, and what is exported here; export another network as ONNX with a manifest"
    )


def _stack(tensors: dict[str, Floats], prefix: str, activation: str, named: str) -> list[Layer]:
    """Linear layers `PREFIX.NUMBER` in their order, each with the activation."""
    parts = (name[len(prefix) + 1 :] for name in tensors if name.startswith(f"{prefix}."))
    numbers = sorted({int(part[1]) for name in parts if (part := re.fullmatch(r"(\d{1,3})\.\w+", name))})
    return [_layer(tensors, f"{prefix}.{number}", activation, named) for number in numbers]


def _layer(tensors: dict[str, Floats], name: str, activation: str, named: str) -> Layer:
    weight, bias = tensors.get(f"{name}.weight"), tensors.get(f"{name}.bias")
    if weight is None or bias is None or weight.ndim != 2 or bias.shape != weight.shape[:1]:
        raise LearningError(f"{named}: {name}: needed is a linear layer, weight (outputs, inputs) and bias (outputs,)")
    return Layer(weight.T, bias, activation)


def _with_critic(policy: Policy, tensors: dict[str, Floats]) -> Policy:
    """With TD3's value functions, where they are of the actor's sizes: alignment starts from them."""
    prefixes = [f"critic.features_extractor.{part}" for part in ("task", "lidar")] if policy.shape.extractor else []
    try:
        parts = [_stack(tensors, prefix, "", "critic") for prefix in (*prefixes, "critic.qf0", "critic.qf1")]
        critic = tuple(
            np.ascontiguousarray(array) for part in parts for one in part for array in (one.weight, one.bias)
        )
        return replace(policy, critic=critic)
    except (LearningError, PolicyError):
        return policy

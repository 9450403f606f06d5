"""A policy with everything that driving a robot by it needs: a folder or zip of `manifest.json` and `policy.npz`.

Whatever else lies there is for people and other programs, and is not read.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.conditioning import PREFERENCES, SHARES, SLOWER, Conditioning, WeightsError
from desirepath.deploy.manifest import MANIFEST_BYTES, BundleError, Manifest, read_manifest
from desirepath.deploy.network import MOST_LAYERS, Act, Layers, NetworkError, folded, onnx_network
from desirepath.deploy.steering import Slowing, SteeringError
from desirepath.npz import Arrays, Bounds, NpzError, from_npz
from desirepath.zip_files import BROKEN, open_zip

Floats = NDArray[np.float32]
MANIFEST, POLICY = "manifest.json", "policy.npz"
MOST_ZIPPED = 64 * 2**20
MOST_RECOVERIES = 4
MOST_CHOICES = 100  # policies of which one drives at a time
MOST_NUMBERS = 30_000_000
"""Weights of all their networks together, those that share layers counted apart: side by side they are in memory so.
The 25 policies of the study room have 2.8 million."""
MOST_OBJECTIVES = 40
BOUNDS = Bounds(arrays=1_500, header_bytes=2**20, all_bytes=128 * 2**20)
SIZES = {MANIFEST: MANIFEST_BYTES, POLICY: MOST_ZIPPED}


@dataclass(frozen=True)
class Driving:
    """What drives: the usual network, then those that free a robot that is stuck; how they are slowed beside people."""

    networks: tuple[Act, ...]
    slowing: Slowing | None


@dataclass(frozen=True)
class Bundle:
    """A policy to drive by. conditioning: what weights it takes while it drives, or None; weights: those it begins
    with. at: what drives under weights that were checked. choices: of a policy that is several, each of them, the usual
    one first; content: its file, for whoever decides which drives (`deciding.py`)."""

    manifest: Manifest
    conditioning: Conditioning | None
    weights: Mapping[str, float]
    at: Callable[[Mapping[str, float]], Driving]
    choices: tuple[Driving, ...] = ()
    content: bytes = b""

    @classmethod
    def read(cls, source: Path | str | bytes) -> Bundle:
        """From a folder, a zip, or a zip's bytes. Raises BundleError for what is none."""
        files = _files(source)
        manifest = read_manifest(files[MANIFEST])
        found = hashlib.sha256(files[POLICY]).hexdigest()
        if found != manifest.policy_sha256:
            raise BundleError(
                f"{POLICY} has sha256 {found}, its manifest says {manifest.policy_sha256[:64]}: they do not belong "
                "together; export again"
            )
        try:
            return _bundle(manifest, files[POLICY])
        except (NpzError, NetworkError, SteeringError, WeightsError) as problem:
            raise BundleError(f"{POLICY}: {problem}") from None


def _files(source: Path | str | bytes) -> dict[str, bytes]:
    try:
        if isinstance(source, bytes):
            return _unzipped(source)
        path = Path(source)
        if path.is_dir():
            return {name: _read(path / name, most) for name, most in SIZES.items()}
        return _unzipped(_read(path, MOST_ZIPPED))
    except OSError as problem:
        named = "" if isinstance(source, bytes) else f" {source}"
        raise BundleError(f"cannot read the bundle{named}: {problem.strerror or problem}") from None


def _read(path: Path, most: int) -> bytes:
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise BundleError(f"{path.name}: more than {most:,} bytes are not read")
    return content


def _unzipped(content: bytes) -> dict[str, bytes]:
    if len(content) > MOST_ZIPPED:
        raise BundleError(f"a zip of {len(content):,} bytes; at most {MOST_ZIPPED:,} are read")
    try:
        with open_zip(io.BytesIO(content)) as archive:
            found = {}
            for name, most in SIZES.items():
                if (size := archive.getinfo(name).file_size) > most:
                    raise BundleError(f"{name}: {size:,} bytes when unpacked; at most {most:,} are read")
                found[name] = archive.read(name)
            return found
    except KeyError:
        raise BundleError(f"the zip lacks {MANIFEST} or {POLICY}: it is no exported bundle") from None
    except BROKEN as problem:
        raise BundleError(f"the bundle is no zip that can be read: {problem}") from None


def _bundle(manifest: Manifest, content: bytes) -> Bundle:
    header, arrays = from_npz(content, BOUNDS)
    kind = str(header.get("format"))
    if kind not in _KINDS:
        raise BundleError(f"{POLICY} has format {kind[:60]!r}; what can be driven by: {', '.join(_KINDS)}")
    slowing = _slowing(manifest, header)
    conditioning, weights = _conditioning(manifest, header)
    drives = _KINDS[kind](_Parts(manifest, header, arrays, slowing, conditioning))
    policies = drives(weights)
    if (max(len(one.networks) for one in policies) > 1) != (manifest.recovery is not None):
        raise BundleError(f"{MANIFEST}: field 'recovery' must be there if {POLICY} has recovery policies, else null")
    several = len(policies) > 1
    return Bundle(
        manifest,
        conditioning,
        weights,
        at=lambda under: drives(under)[0],
        choices=policies if several else (),
        content=content if several else b"",
    )


Drives = Callable[[Mapping[str, float]], tuple[Driving, ...]]
"""Under weights that were checked, the policies of which one drives at a time; the usual one first."""


@dataclass(frozen=True)
class _Parts:
    manifest: Manifest
    header: Mapping[str, Any]
    arrays: Arrays
    slowing: Slowing | None
    conditioning: Conditioning | None

    def layers(self, name: str, weights: int = 0) -> Layers | None:
        """The network of that name, if it is there. weights: inputs of the task part beside what is observed."""
        task = len(self.manifest.inputs) - self.manifest.lidar.sectors + weights
        arrays = tuple(self.arrays[key] for key in sorted(self.arrays) if key.rpartition("_")[0] == name)
        if not arrays:
            return None
        shape = self.header.get("shape")
        found = Layers(arrays, task, extractors=bool(isinstance(shape, dict) and shape.get("extractor")))
        found.check(len(self.manifest.inputs) + weights, f"network {name!r}")
        return found

    def needed(self, name: str, weights: int = 0) -> Layers:
        found = self.layers(name, weights)
        if found is None:
            raise NetworkError(f"network {name!r} is missing")
        return found

    def objectives(self) -> Conditioning:
        if self.conditioning is None:
            raise BundleError(f"{MANIFEST}: field 'conditioning' must say what weights {POLICY} takes")
        return self.conditioning


def _plain(parts: _Parts) -> Drives:
    names = [f"escape{k}" for k in range(MOST_RECOVERIES)]
    networks = (parts.needed("actor"), *filter(None, map(parts.layers, names)))
    driving = Driving(networks, parts.slowing)
    return lambda _: (driving,)


def _conditioned(parts: _Parts) -> Drives:
    """As `learning/policies/conditioned.py`: while it is stuck the base policy drives, then it with all weights 0."""
    known = parts.objectives()
    actor, base = parts.needed("actor", len(known.objectives)), parts.layers("escape0")
    split = actor.task_inputs - len(known.objectives)

    def at(weights: Mapping[str, float]) -> tuple[Driving, ...]:
        def conditioned(on: Floats) -> Layers:
            return Layers(folded(actor.arrays, split, on), split, actor.extractors)

        usual = conditioned(known.entering(weights))
        slowing = parts.slowing.weighted(weights.get(SLOWER, 0.0)) if parts.slowing else None
        unmoved = conditioned(np.zeros(len(known.objectives), dtype=np.float32))
        return (Driving((usual, base, unmoved) if base else (usual,), slowing),)

    return at


def _adaptable(parts: _Parts) -> Drives:
    """As `learning/policies/adaptable.py`."""
    known = parts.objectives()
    actor = parts.needed("actor", len(known.objectives))
    split = actor.task_inputs - len(known.objectives)

    def at(weights: Mapping[str, float]) -> tuple[Driving, ...]:
        usual = Layers(folded(actor.arrays, split, known.entering(weights)), split, actor.extractors)
        return (Driving((usual,), None),)

    return at


def _foreign(parts: _Parts) -> Drives:
    network = parts.arrays.get("network")
    if network is None or network.dtype != np.uint8:
        raise NetworkError("array 'network' of bytes is missing")
    driving = Driving((onnx_network(network.tobytes(), len(parts.manifest.inputs)),), parts.slowing)
    return lambda _: (driving,)


def _choosing(parts: _Parts) -> Drives:
    """As `learning/policies/choosing.py`: each by its own networks, which share layers."""
    manifest, told = parts.manifest, parts.header.get("policies")
    if not isinstance(told, list) or not 2 <= len(told) <= MOST_CHOICES:
        raise NetworkError(f"policies: must be a list of 2 to {MOST_CHOICES}")
    wide = {name: part.astype(np.float32) for name, part in parts.arrays.items() if name.startswith("layer_")}
    inputs, left = len(manifest.inputs), [MOST_NUMBERS]

    def network(numbers: Any, extractors: bool) -> Layers:
        names = [f"layer_{k:04d}" for k in numbers] if _are_counts(numbers) else ["?"]
        if missing := [name for name in names if name not in wide]:
            raise NetworkError(f"policies: {missing[0]} is no layer of this file")
        left[0] -= sum(wide[name].size for name in names)
        if left[0] < 0:
            raise NetworkError(f"policies: more than {MOST_NUMBERS:,} weights together")
        found = Layers(tuple(wide[name] for name in names), inputs - manifest.lidar.sectors, extractors)
        found.check(inputs, "a network of policies")
        return found

    choices = []
    for one in told:
        if not isinstance(one, dict) or not isinstance(one.get("recovery"), list):
            raise NetworkError("policies: each must be an object with shape, actor and recovery")
        extractors = bool(isinstance(one.get("shape"), dict) and one["shape"].get("extractor"))
        every = [one.get("actor"), *one["recovery"][:MOST_RECOVERIES]]
        networks = tuple(network(numbers, extractors) for numbers in every)
        choices.append(Driving(networks, _slowing(manifest, one)))
    return lambda _: tuple(choices)


_KINDS: Mapping[str, Callable[[_Parts], Drives]] = {
    "desirepath-policy-1": _plain,
    "desirepath-conditioned-1": _conditioned,
    "desirepath-adaptable-1": _adaptable,
    "desirepath-foreign-1": _foreign,
    "desirepath-choosing-1": _choosing,
}


def _are_counts(given: Any) -> bool:
    return isinstance(given, list) and len(given) <= 2 * MOST_LAYERS and all(type(k) is int and k >= 0 for k in given)


def _slowing(manifest: Manifest, header: Mapping[str, Any]) -> Slowing | None:
    given = header.get("slowing")
    if given is None:
        return None
    if not isinstance(given, dict) or not all(isinstance(value, int | float) for value in given.values()):
        raise SteeringError("slowing: must be an object of numbers")
    if manifest.place("person_distance") is None or manifest.limits.v_min != 0:
        raise SteeringError("slowing: needs a policy that observes person_distance, and a robot that can stand")
    try:
        return Slowing(**given)
    except TypeError as problem:
        raise SteeringError(f"slowing: {str(problem)[:200]}") from None


def _conditioning(manifest: Manifest, header: Mapping[str, Any]) -> tuple[Conditioning | None, Mapping[str, float]]:
    given = manifest.conditioning
    if given is None:
        return None, {}
    objectives: Any = given.get("objectives")
    opposites: Any = given.get("opposites", [])
    strengths, weights = header.get("strengths", {}), given.get("weights", {})
    if given.get("kind") not in (PREFERENCES, SHARES):
        raise WeightsError(f"conditioning.kind = {str(given.get('kind'))[:60]!r}: must be {PREFERENCES} or {SHARES}")
    if not _are_texts(objectives) or not 1 <= len(objectives) <= MOST_OBJECTIVES:
        raise WeightsError(f"conditioning.objectives: must be 1 to {MOST_OBJECTIVES} names")
    if list(objectives) != header.get("objectives"):
        raise WeightsError("conditioning.objectives: are others than the policy's own")
    if not isinstance(opposites, list) or not all(_are_texts(pair) and len(pair) == 2 for pair in opposites):
        raise WeightsError("conditioning.opposites: must be pairs of names")
    if not {name for pair in opposites for name in pair} <= set(objectives):
        raise WeightsError("conditioning.opposites: must be objectives")
    for named, numbers in (("strengths", strengths), ("weights", weights)):
        if not isinstance(numbers, dict) or not all(isinstance(one, int | float) for one in numbers.values()):
            raise WeightsError(f"conditioning.{named}: must be numbers by objective")
    if not all(np.isfinite(value) and abs(value) <= 100 for value in strengths.values()):
        raise WeightsError("conditioning.strengths: must be numbers up to 100")
    found = Conditioning(given["kind"], tuple(objectives), tuple((a, b) for a, b in opposites), dict(strengths))
    return found, found.checked(weights)


def _are_texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(one, str) for one in value)

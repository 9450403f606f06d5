"""What was trained in a setup and comes back among its files, as the page hands it out: each artefact with its card,
bounded and checked as shipped ones are. Read are weights and numbers; nothing is unpickled.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from desirepath.learning.cards import Card, card_path
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.shipping.own_setup import DEFINITION, description_sha256, is_made
from desirepath.npz import MIB, Bounds, from_npz
from desirepath.simulation.scenes import check_scene

ARTEFACT, CARD = ".npz", ".card.json"
BOUNDS = Bounds(all_bytes=128 * MIB)
LARGEST_CARD = MIB
KINDS: Mapping[str, type[Policy | ConditionedPolicy | QuerySet]] = {
    "policy": Policy,
    "conditioned_policy": ConditionedPolicy,
    "query_set": QuerySet,
}
_MADE = (
    (re.compile(r"base|ensemble/[0-9]"), "policy"),
    (re.compile(r"conditioned"), "conditioned_policy"),
    (re.compile(r"queries(_varied)?_[0-9]{1,4}"), "query_set"),
)
_CARD = TypeAdapter(Card)


def split(files: Mapping[str, bytes]) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Files of trained artefacts, and all others."""
    trained = {path: content for path, content in files.items() if path.endswith((ARTEFACT, CARD))}
    return trained, {path: content for path, content in files.items() if path not in trained}


def bring_back(folder: Path, files: Mapping[str, bytes]) -> tuple[list[str], list[str]]:
    """Put trained artefacts into the folder of the setup that they were trained in, by which the setup is found
    already. Returns their names, and why others are left out, in sentences."""
    kept: list[str] = []
    left_out: list[str] = []
    described = description_sha256(folder)
    stems = {path.removesuffix(ARTEFACT) for path in files if path.endswith(ARTEFACT)}
    for stem in sorted(stems, key=lambda stem: ("queries" in stem, stem)):  # what others are made of comes first
        try:
            _put(folder, stem, files, described)
            kept.append(f"{folder.name}/{stem}")
        except (ValueError, ArithmeticError, LookupError, TypeError) as problem:
            left_out.append(f"{stem}{ARTEFACT}: {problem}")
    left_out += sorted(
        f"{path}: {path.removesuffix(CARD)}{ARTEFACT} is not among the files"
        for path in files
        if path.endswith(CARD) and path.removesuffix(CARD) not in stems
    )
    return kept, left_out


def _put(folder: Path, stem: str, files: Mapping[str, bytes], described: str) -> None:
    """Write one artefact and its card. Raises LearningError, or what its reader raises, and then nothing lies there."""
    kind = next((kind for pattern, kind in _MADE if pattern.fullmatch(stem)), None)
    if kind is None:
        raise LearningError("is nothing that training a setup makes")
    content, card = files[stem + ARTEFACT], _card(files.get(stem + CARD))
    if (card.kind, card.name, card.setup) != (kind, f"{folder.name}/{stem}", folder.name):
        raise LearningError(f"its card says {card.kind} {card.name}; bring it back under its setup's name")
    if card.sha256 != hashlib.sha256(content).hexdigest():
        raise LearningError("file and card disagree (sha256)")
    if card.parents.get(DEFINITION) != described:
        raise LearningError("was trained in another description of the setup; train again")
    _check(kind, content, folder.name)
    path = folder / f"{stem}{ARTEFACT}"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    card.save(card_path(path))
    if not is_made(folder, stem, described, card.command):
        path.unlink()
        card_path(path).unlink()
        raise LearningError("was made of other policies than came with it; train again")


def _card(content: bytes | None) -> Card:
    if content is None or len(content) > LARGEST_CARD:
        raise LearningError(f"has no card ({CARD}) of at most {LARGEST_CARD // MIB} MB beside it")
    try:
        card = _CARD.validate_json(content)
        json.dumps(card.__dict__, allow_nan=False)
    except (ValidationError, RecursionError, ValueError) as problem:
        raise LearningError(f"its card is incomplete or no card: {str(problem).splitlines()[0]}") from None
    if b"\\u0000" in content:
        raise LearningError("its card holds NUL characters")
    return card


def _check(kind: str, content: bytes, setup: str) -> None:
    """Whether it is of that kind and setup and holds finite numbers alone. Raises ValueError."""
    for name, array in from_npz(content, BOUNDS)[1].items():
        if not np.isfinite(array).all():
            raise LearningError(f"{name} holds NaN or infinite numbers")
    read = KINDS[kind].from_bytes(content)
    if read.setup != setup:
        raise LearningError(f"is of setup {read.setup[:60]}")
    for query in read.queries if isinstance(read, QuerySet) else ():
        check_scene(query.scene)
        for one in (query.trajectory_a, query.trajectory_b):
            steps = len(one.actions)
            if not steps or (len(one.poses), len(one.rewards), len(one.observations)) != (steps + 1, steps, steps):
                raise LearningError("a trajectory's poses, actions and observations are not as many as its steps")

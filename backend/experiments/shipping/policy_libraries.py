"""Makes a shipped policy library with its card. Can be stopped and started again: every trained policy is a file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from backend.learning.alignment.gate import GateRule
from backend.learning.alignment.library_measures import measured_against
from backend.learning.alignment.own_reward import OwnRewardConfig, tune_to_reward
from backend.learning.alignment.policy_library import PolicyLibrary
from backend.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from backend.learning.errors import LearningError
from backend.learning.measures.step_basis import Floats, StepBasis
from backend.learning.policies.policy import Policy
from backend.learning.policies.shipped import load_conditioned, load_policy, load_step_basis
from backend.learning.preferences.objectives import NAMES, preference_weights
from backend.learning.queries.varied_queries import drawn_weights
from backend.learning.rewards.step_weights import StepWeightsRewardModel
from backend.learning.scene_sets import Purpose, describe, scene_set
from backend.learning.td3.base import OnProgress

SCENES_SEED = 7_100  # of no other card and no benchmark
DIRECTIONS_SEED = 77


@dataclass(frozen=True)
class PolicyLibraryConfig:
    """trained: policies, two of each direction; updates: of each. drawn: settings of the conditioned policy beside
    each objective's at a half and at full strength. scenes: that all are measured in."""

    trained: int
    updates: int = 4_000
    drawn: int = 51
    scenes: int = 80


TRAINED = {"study_room": 48, "open_field": 32}


def ship_policy_library(setup: str, seed: int, folder: Path, work: Path | None, on_progress: OnProgress) -> Card:
    """Train what is not in `work` yet, measure all, store `SETUP/policy_library.npz` with what is
    allowed to be anybody's."""
    config, basis = PolicyLibraryConfig(TRAINED[setup]), load_step_basis(setup)
    if basis is None:
        raise LearningError(f"setup = {setup!r}: no step basis is shipped for it")
    base, conditioned = load_policy(f"{setup}/base"), load_conditioned(f"{setup}/conditioned").as_trained()
    weights = directions(basis.size, config.trained)
    trained = []
    for place, one in enumerate(weights):
        trained.append(_trained(base, basis, one, place, config.updates, work))
        on_progress(0.9 * (place + 1) / len(weights), {"trained": place + 1})
    actors = tuple(tuple(layer.astype(np.float16) for layer in policy.actor) for policy in trained)
    settings = library_settings(config.drawn)

    def policies() -> Iterator[Policy]:
        for setting in settings:
            yield conditioned.at(setting)
        for actor in actors:
            yield Policy(setup, base.shape, tuple(layer.astype(np.float32) for layer in actor), (), (base.actor,))

    scenes = scene_set(setup, config.scenes, purpose=Purpose.ALIGN_SELECT, seed=SCENES_SEED)
    measures = measured_against(base, policies(), basis, scenes)
    whole = PolicyLibrary(setup, settings, weights, actors, measures)
    library = whole.without_what_is_not_allowed()
    path = folder / setup / "policy_library.npz"
    path.write_bytes(library.to_bytes())
    card = Card(
        kind="policy_library",
        name=f"{setup}/policy_library",
        setup=setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"python -m backend.experiments.ship policy-library {setup} --seed {seed}",
        seed=seed,
        commit=source_commit(),
        config=asdict(config),
        scenes={"measured": describe(Purpose.ALIGN_SELECT, config.scenes, SCENES_SEED)},
        results={
            "policies": len(library),
            "trained": len(library.actors),
            "left_out": len(whole) - len(library),
            "allowed": int(library.allowed.sum()),
            "longest_s": round(library.longest_s, 1),
            "mean_success": round(float(library.measures.success[library.allowed].mean()), 3),
        },
        parents={f"{setup}/{name}": file_sha256(folder / setup / f"{name}.npz") for name in ("base", "step_basis")}
        | {f"{setup}/conditioned": conditioned.digest()},  # as trained: what was added since has no part in it
        departures=[DEPARTURES["policy_library"]],
        notes=["Nobody's answers have a part in it; the step basis is of the tuning families of simulated people."],
    )
    card.save(card_path(path))
    return card


def directions(size: int, count: int) -> Floats:
    """(count, size) weights of a step basis, each followed by its opposite; `2 size` in turn are orthogonal."""
    random, found = np.random.default_rng(DIRECTIONS_SEED), list[Floats]()
    while len(found) < count:
        rotated, _ = np.linalg.qr(random.normal(size=(size, size)))
        for row in (rotated * np.sqrt(size)).astype(np.float32):
            found += [row, -row]
    return np.stack(found[:count])


def library_settings(drawn: int) -> Floats:
    """(n, 9) each objective at a half and at full strength, then two or three together."""
    alone = [preference_weights({name: strength}) for name in NAMES for strength in (0.5, 1.0)]
    return np.stack(alone + drawn_weights(drawn + len(NAMES), 1)[len(NAMES) :])


def _trained(base: Policy, basis: StepBasis, weights: Floats, place: int, updates: int, work: Path | None) -> Policy:
    stored = work / base.setup / f"{place}.npz" if work is not None else None
    if stored is not None and stored.is_file():
        return Policy.load(stored)
    config = OwnRewardConfig(updates=updates, checkpoints=updates // 1_000, seed=place, gate=GateRule(scenes=50))
    found = tune_to_reward(base, StepWeightsRewardModel(base.setup, basis, weights), config)
    if stored is not None:
        found.policy.save(stored)
        stored.with_suffix(".json").write_text(json.dumps({"gained": found.gained, "history": found.history}))
    return found.policy

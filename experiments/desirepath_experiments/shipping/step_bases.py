"""Makes a shipped step basis with its card: how much of how people's scores differ it can say, by family."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from desirepath.learning.people.card import members, people_card
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.td3.base import OnProgress
from desirepath_experiments.shipping.step_basis_fitting import (
    FIRST_SEED,
    StepBasisConfig,
    explained,
    fit_step_basis,
    varied_rollouts,
)

FIRST_MEMBER = 200  # of those that the basis is measured on: of no benchmark
MEASURED = 6


def ship_step_basis(setup: str, seed: int, folder: Path, on_progress: OnProgress) -> Card:
    """Fit and store `SETUP/step_basis.npz`; families that are held out have no part, not even on the card."""
    config = StepBasisConfig()
    basis = fit_step_basis(setup, config)
    on_progress(0.7, {"size": basis.size})
    rollouts = varied_rollouts(setup, config, seed=FIRST_SEED + 1)
    said = {
        family: [
            explained(basis, rollouts, one.scores(rollouts), config.scenes)
            for one in members(family, MEASURED, setup, FIRST_MEMBER).values()
        ]
        for family in people_card().tuning
    }
    path = folder / setup / "step_basis.npz"
    basis.save(path)
    card = Card(
        kind="step_basis",
        name=f"{setup}/step_basis",
        setup=setup,
        file=path.name,
        sha256=file_sha256(path),
        command=f"desirepath ship step-basis {setup} --seed {seed}",
        seed=seed,
        commit=source_commit(),
        config=asdict(config),
        scenes={
            "fitted": describe(Purpose.ALIGN_SELECT, config.scenes, FIRST_SEED),
            "measured": describe(Purpose.ALIGN_SELECT, config.scenes, FIRST_SEED + 1),
        },
        results={
            "explained_within_scenes": {name: round(float(np.mean(of)), 3) for name, of in said.items()},
            "least": {name: round(float(np.min(of)), 3) for name, of in said.items()},
            "people_of_each": MEASURED,
        },
        parents={
            f"{setup}/base": file_sha256(folder / setup / "base.npz"),
            f"{setup}/conditioned": load_conditioned(f"{setup}/conditioned").as_trained().digest(),
        },
        departures=[DEPARTURES["step_basis"]],
        notes=["Its random layer depends on the shipped varied queries, whose steps scale the inputs."],
    )
    card.save(card_path(path))
    return card

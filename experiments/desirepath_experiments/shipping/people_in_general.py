"""What people in general find comfortable (`learning/preferences/people_in_general.py`): fitted to raters' moments."""

from __future__ import annotations

import numpy as np
import typer

from desirepath.learning.cards import Card, file_sha256
from desirepath.learning.preferences.people_in_general import FILE, moment_columns, to_bytes
from desirepath.learning.preferences.population_prior import IN_GENERAL
from desirepath.learning.shipping.storing import Request, store
from desirepath_experiments.benchmarks.raters import (
    COLUMNS,
    Doubles,
    RatedScene,
    RatersConfig,
    RatersFit,
    look_around,
    measure,
    read_raters,
)

SOURCE = (
    "Weights fitted to SocNav1, six of its twelve raters (L. J. Manso, P. Bachiller, P. Núñez, L. V. Calderita, "
    "D. R. Faria), CC BY 4.0; its scenes and scores are not among these files."
)
APART = np.array([group in ("between", "crowd") for group, _ in COLUMNS])
"""What only scenes of several people have: fitted beside, so that nothing else stands for it, and not kept."""


def ship_people_in_general(request: Request) -> Card:
    """Fit and store them; `--work` is the raters' folder. Seconds."""
    if request.work is None:
        raise typer.BadParameter("--work: needs the folder with a JSON file per rater (SocNav1's raw_data)")
    config = RatersConfig(folder=request.work, seed=request.seed)
    rated = read_raters(request.work)
    scores = {name: np.array([scene.score for _, scene in scenes]) for name, scenes in rated.items()}
    tables = {name: np.array([_measure(scene) for _, scene in scenes]) for name, scenes in rated.items()}
    fit = RatersFit(config, tables, scores)
    everything = np.ones(fit.scale.size, dtype=np.bool_)
    weights = np.array([fit.weights(everything, [name]) / fit.scale for name in rated])[:, : -APART.sum()]
    kept = np.arange(everything.size) < weights.shape[1]
    return store(
        IN_GENERAL,
        f"{FILE.parent.name}/{FILE.stem}",
        to_bytes(list(rated), weights),
        request.folder,
        command=f"desirepath ship people-in-general --work socnav1 --seed {request.seed}",
        seed=request.seed,
        config={"pairs": config.pairs, "shrinkage": config.shrinkage},
        results={
            "scenes": {name: len(of) for name, of in rated.items()},
            "left_out": fit.left_out(everything),
            "left_out_without_what_several_people_make": fit.left_out(kept),
        },
        parents={f"{name}.json": file_sha256(request.work / f"{name}.json") for name in rated},
        notes=[
            SOURCE,
            "left_out: share of a rater's pairs of scenes, 10 points of 100 apart, that weights fitted to the others "
            "order as the rater does.",
        ],
    )


def _measure(scene: RatedScene) -> Doubles:
    """What the product's moments have, people summed, the nearest thing; then what only several people make."""
    apart, ahead, thing = look_around(scene)
    columns = np.zeros(moment_columns(np.ones(1), np.ones(1), np.ones(1)).shape[1])
    if len(apart):
        columns = moment_columns(apart, ahead, np.full(len(apart), np.inf)).sum(0)
    things = moment_columns(np.array([np.inf]), np.zeros(1), np.array([thing]))[0]
    return np.concatenate([columns + things, np.array(measure(scene))[APART]])

"""Snapshots of programmed demonstrators' demonstrations: simulated, for science runs without participants."""

from __future__ import annotations

import json

from sqlalchemy.orm import Session

from backend.demonstrations.demonstrators import demonstrate
from backend.simulation.demonstration_scenes import demonstration_scenes
from backend.store.artefacts import ArtefactStore, save_artefact
from backend.store.demonstration_snapshots import FORMAT, KeptDemonstration
from backend.store.models import Artefact


def take_simulated_demonstrations(
    s: Session, files: ArtefactStore, *, style: str, environment: str, per_pair: int, seed: int
) -> Artefact:
    """Let a programmed demonstrator draw in all pairs and freeze that, as `take_demonstrations` does for people's.

    Raises ValueError for an unknown style, SceneError for an unknown environment.
    """
    kept = []
    for pair, scene in enumerate(demonstration_scenes(environment)):
        for drawn in range(per_pair):
            content = demonstrate(style, scene, seed * per_pair + drawn).to_bytes()
            name = f"{style}-{seed}-{pair}-{drawn}"
            kept.append(KeptDemonstration(name, name, style, pair, files.put(content), "simulated"))
    snapshot = {
        "format": FORMAT,
        "setup": environment,
        "study": None,
        "session": None,
        "demonstrations": [vars(one) for one in kept],
    }
    return save_artefact(
        s,
        files,
        kind="demonstrations",
        name=f"{len(kept)} demonstrations in the {environment} by the programmed {style}",
        setup=environment,
        content=json.dumps(snapshot, sort_keys=True).encode(),
        card={"environment": environment, "style": style, "seed": seed, "demonstrations": len(kept), "human": 0},
        simulated=True,
    )

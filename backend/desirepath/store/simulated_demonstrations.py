"""Snapshots of programmed demonstrators' demonstrations: simulated, for science runs without participants."""

from __future__ import annotations

import json
from contextlib import suppress

from sqlalchemy.orm import Session

from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.demonstrations.planned_walks import walking_scene
from desirepath.demonstrations.stroke import StrokeProblem
from desirepath.simulation.demonstration_scenes import demonstration_scenes
from desirepath.simulation.scene import Scene, SceneError
from desirepath.store.artefacts import ArtefactStore, save_artefact
from desirepath.store.demonstration_snapshots import FORMAT, KeptDemonstration
from desirepath.store.models import Artefact

WALKS_TRIED = 20


def take_simulated_demonstrations(
    s: Session, files: ArtefactStore, *, style: str, environment: str, per_pair: int, seed: int, person: str = "still"
) -> Artefact:
    """Let a programmed demonstrator draw in all pairs and freeze that, as `take_demonstrations` does for people's.

    person: `still`, or how they walk meanwhile (`opposite`, `random`).
    Raises ValueError for an unknown style, SceneError for an unknown environment, or if nobody found a way to walk.
    """
    demonstrations = []
    for pair, scene in enumerate(demonstration_scenes(environment)):
        for drawn in range(per_pair):
            content = _drawn(style, scene, seed * per_pair + drawn, person).to_bytes()
            name = f"{style}-{seed}-{pair}-{drawn}"
            demonstrations.append(KeptDemonstration(name, name, style, pair, files.put(content), "simulated"))
    who = "" if person == "still" else f", a person walking ({person})"
    snapshot = {
        "format": FORMAT,
        "setup": environment,
        "study": None,
        "session": None,
        "demonstrations": [vars(item) for item in demonstrations],
    }
    return save_artefact(
        s,
        files,
        kind="demonstrations",
        name=f"{len(demonstrations)} demonstrations in the {environment} by the programmed {style}{who}",
        setup=environment,
        content=json.dumps(snapshot, sort_keys=True).encode(),
        card={
            "environment": environment,
            "style": style,
            "seed": seed,
            "demonstrations": len(demonstrations),
            "human": 0,
        }
        | ({} if person == "still" else {"person": person}),
        simulated=True,
    )


def _drawn(style: str, scene: Scene, seed: int, person: str) -> Demonstration:
    """One demonstration. A walk that nobody can draw past is not taken, but another one."""
    if person == "still":
        return demonstrate(style, scene, seed)
    for other in range(WALKS_TRIED):
        with suppress(StrokeProblem):
            return demonstrate(style, walking_scene(scene, person, seed * WALKS_TRIED + other), seed)
    raise SceneError("person", person, f"no walk of {WALKS_TRIED} that one can draw past; use another seed")

"""Snapshots of programmed demonstrators' demonstrations: simulated, for science runs without participants."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from sqlalchemy.orm import Session

from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.demonstrations.planned_walks import walking_scene
from desirepath.demonstrations.stroke import StrokeProblem
from desirepath.simulation.demonstration_scenes import demonstration_scenes
from desirepath.simulation.scene import Scene, SceneError
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.demonstration_snapshots import KeptDemonstration, save_demonstrations
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
            content = _draw(style, scene, seed * per_pair + drawn, person).to_bytes()
            name = f"{style}-{seed}-{pair}-{drawn}"
            demonstrations.append(KeptDemonstration(name, name, style, pair, files.put(content), "simulated"))
    by = f"the programmed {style}"
    about: dict[str, Any] = {"style": style, "seed": seed}
    if person != "still":
        by += f", a person walking ({person})"
        about["person"] = person
    return save_demonstrations(s, files, demonstrations, environment=environment, by=by, about=about)


def _draw(style: str, scene: Scene, seed: int, person: str) -> Demonstration:
    """One demonstration. A walk that nobody can draw past is not taken, but another one."""
    if person == "still":
        return demonstrate(style, scene, seed)
    for other in range(WALKS_TRIED):
        with suppress(StrokeProblem):
            return demonstrate(style, walking_scene(scene, person, seed * WALKS_TRIED + other), seed)
    raise SceneError("person", person, f"no walk of {WALKS_TRIED} that one can draw past; use another seed")

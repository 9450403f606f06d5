"""A ranking set as a shipped file with its card, whatever its scores come from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from desirepath.explain.ranking_sets import RankingSet
from desirepath.learning.cards import Card, card_path, file_sha256, source_commit


def store_ranking_set(
    made: RankingSet,
    name: str,
    folder: Path,
    *,
    config: dict[str, Any],
    most_key: str,
    without_key: str,
    parent: tuple[str, Path],
    results: dict[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> Card:
    """Store it as `folder`/`name`. most_key, without_key: under which the card says what most often has the highest
    score, and how many have none; parent: the policy's name and file; results: more of them."""
    out = folder / f"{name}.npz"
    made.save(out)
    regular = [one for one in made.rollouts if not one.practice]
    card = Card(
        kind="ranking_set",
        name=name,
        setup=made.setup,
        file=out.name,
        sha256=file_sha256(out),
        command=f"desirepath ship ranking-set {made.setup}",
        seed=0,
        commit=source_commit(),
        config=config,
        scenes={
            "regular": [one.trajectory.scene.seed for one in regular],
            "practice": [one.trajectory.scene.seed for one in made.rollouts if one.practice],
        },
        results={
            "scenarios": len(regular),
            "with_tied_scores": sum(len(set(one.at_halt.values())) < len(one.things) for one in regular),
            without_key: sum(score == 0 for one in regular for score in one.at_halt.values()),
            most_key: {
                thing: sum(max(one.at_halt, key=lambda name: one.at_halt[name]) == thing for one in regular)
                for thing in regular[0].things
            },
            **(results or {}),
        },
        notes=list(notes),
        parents={parent[0]: file_sha256(parent[1])},
    )
    card.save(card_path(out))
    return card

"""Ranking sets in the store (chapter 8): brought in once, their scores looked up by artefact and query.

A study draws from one as from a query set (`query_sets.py`), each rollout being both sides of its query. How one is
made lives in `explain/ranking_sets.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

from sqlalchemy.orm import Session, defer

from desirepath.explain.shown_explanation import ShownAttention
from desirepath.store.artefacts import ArtefactError, ArtefactStore, query_entry, save_artefact, save_trajectories
from desirepath.store.models import Artefact

if TYPE_CHECKING:  # torch comes with it
    from desirepath.explain.ranking_sets import RankingSet

Scores = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class StoredScores:
    """What is ranked in one query: the objects, and each one's score at every pose of the trajectory. attention: what
    the policy looked at meanwhile, if it has any."""

    things: tuple[str, ...]
    scores: Scores
    attention: ShownAttention | None = None

    @property
    def at_halt(self) -> dict[str, float]:
        """Thing -> its score where the robot stands."""
        return dict(zip(self.things, self.scores[-1], strict=True))


def save_ranking_set(
    s: Session,
    files: ArtefactStore,
    ranked: RankingSet,
    *,
    name: str,
    card: dict[str, Any],
    parents: list[tuple[str, str]] | None = None,
    content: bytes | None = None,
) -> Artefact:
    """Store a ranking set and each of its trajectories once; idempotent. content: as in `save_query_set`."""
    rows = save_trajectories(s, files, [rollout.trajectory for rollout in ranked.rollouts])
    stored = [
        {
            **query_entry(row, row),
            "practice": explained.practice,
            "things": list(explained.things),
            "scores": [[round(float(score), 4) for score in moment] for moment in explained.scores],
            **(
                {} if explained.attention is None else {"attention": [_per_mille(part) for part in explained.attention]}
            ),
        }
        for row, explained in zip(rows, ranked.rollouts, strict=True)
    ]
    return save_artefact(
        s,
        files,
        kind="ranking_set",
        name=name,
        setup=ranked.setup,
        content=ranked.to_bytes() if content is None else content,
        card={**card, "stored_queries": stored},
        parents=parents or (),
    )


def scores_of(s: Session, artefact_id: str, query_id: str) -> StoredScores:
    """What is ranked in that query of a stored set. Raises ArtefactError if it is not of one."""
    artefact = s.get(Artefact, artefact_id, options=[defer(Artefact.card)])
    if artefact is None or artefact.kind != "ranking_set":
        raise ArtefactError(f"{artefact_id!r} is not a ranking set in this store")
    row = (artefact.id, artefact.created_at)
    if row not in _read:
        _read[row] = {
            entry["id"]: StoredScores(
                tuple(entry["things"]),
                tuple(tuple(moment) for moment in entry["scores"]),
                ShownAttention(*(_weights(part) for part in entry["attention"])) if "attention" in entry else None,
            )
            for entry in artefact.card["stored_queries"]
        }
    if query_id not in _read[row]:
        raise ArtefactError(f"query {query_id!r} is not in ranking set {artefact_id}")
    return _read[row][query_id]


_read: dict[tuple[str, datetime], dict[str, StoredScores]] = {}  # by the artefact's row, which never changes


def _per_mille(weights: Any) -> list[list[int]]:
    """Weights of attention as a card has them: short."""
    return [[round(1000 * float(weight)) for weight in moment] for moment in weights]


def _weights(per_mille: list[list[int]]) -> Scores:
    return tuple(tuple(weight / 1000 for weight in moment) for moment in per_mille)

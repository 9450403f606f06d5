"""Answers that people gave elsewhere, as a snapshot: marked as imported, with its query set as parent.

What learns from snapshots learns from these as from any other. There are no rows of answers and nobody takes part: who
is to be forgotten is left out of the file, and the snapshot is rebuilt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from desirepath.store.artefacts import ArtefactStore, save_artefact
from desirepath.store.models import Artefact
from desirepath.store.query_sets import queries_of
from desirepath.store.sides import Side
from desirepath.store.snapshots import LONGEST_NAME, MIN_ANSWERS, Answer, Snapshot, TooFewAnswers

IMPORTED = "imported"
"""Whose answers such a snapshot holds, where others name a group."""


@dataclass(frozen=True)
class ImportedAnswer:
    """line: of the file; query: which of the set's queries; choice: its trajectory A or B; person: a pseudonym."""

    line: int
    query: int
    choice: Side
    person: str


def save_imported_answers(
    s: Session,
    files: ArtefactStore,
    query_set: Artefact,
    answers: Sequence[ImportedAnswer],
    *,
    name: str,
    source: dict[str, Any],
    study_id: str | None = None,
) -> Artefact:
    """source: file and sha256 of what was imported; study_id: the study it belongs to, None: none. Raises TooFewAnswers
    for fewer than two."""
    if len(answers) < MIN_ANSWERS:
        raise TooFewAnswers("people", len(answers), {}, 0)
    queries = queries_of(s, files, query_set.id)
    given = [
        Answer(
            response=f"{source['sha256'][:12]}-{one.line}",
            trial=f"line {one.line}",
            participant=one.person,
            view="top_down",
            query=queries[one.query].id,
            trajectory_a=queries[one.query].trajectory_a,
            trajectory_b=queries[one.query].trajectory_b,
            choice=one.choice,
            source="human",
            probe=False,
        )
        for one in answers
    ]
    snapshot = Snapshot(query_set.setup, "", "", IMPORTED, None, tuple(given), {})
    people = len({one.participant for one in given})
    ending = f", {len(given)} imported answers of {people} people"
    return save_artefact(
        s,
        files,
        kind="snapshot",
        name=name[: LONGEST_NAME - len(ending)] + ending,
        setup=query_set.setup,
        content=snapshot.to_bytes(),
        card={
            "whose": IMPORTED,
            "imported": source,
            "answers": len(given),
            "probes": 0,
            "participants": people,
            "human": len(given),
        },
        parents=[(query_set.id, "query_set")],
        study_id=study_id,
    )

"""Takes snapshots of demonstrations: the kept paths that a job learns from, frozen. A data set's rows of them are
`dataset/stroke_rows.py`'s.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.store.artefacts import ArtefactError, ArtefactStore, save_artefact
from desirepath.store.models import Artefact, Participant, Response, StrokeRow
from desirepath.store.models import Session as SessionRow
from desirepath.store.snapshots import WHOSE_WORDS
from desirepath.store.who_counts import Whose, learned_from, lets_us_learn

FORMAT = "desirepath-demonstrations-1"
KEPT = "kept"


class StrokeError(ValueError):
    """Strokes that cannot be used as asked."""


@dataclass(frozen=True)
class KeptDemonstration:
    """One demonstration of a snapshot. demonstration: sha256 of its file. source: human or simulated."""

    response: str
    stroke: str
    participant: str
    pair: int
    demonstration: str
    source: str


def demonstrations_of(
    s: Session,
    *,
    study_id: str,
    environment: str | None = None,
    session_id: str | None = None,
    participant_id: str | None = None,
    whose: Whose = "people",
) -> list[tuple[StrokeRow, Participant, Response]]:
    """What was kept and may be learned from, in order: not left out, and of whom `who_counts` lets learn. whose: of a
    study's participants only people (default), only simulated ones, or all; a session or a participant is asked for by
    name.
    """
    rows = (
        select(StrokeRow, Participant, Response)
        .join(SessionRow, SessionRow.id == StrokeRow.session_id)
        .join(Participant, Participant.id == SessionRow.participant_id)
        .join(Response, (Response.session_id == StrokeRow.session_id) & (Response.step_key == StrokeRow.step_key))
        .where(
            SessionRow.study_id == study_id,
            StrokeRow.state == KEPT,
            StrokeRow.left_out_at.is_(None),
            learned_from("session" if session_id else "all" if participant_id else whose),
        )
        .order_by(Participant.code, StrokeRow.created_at, StrokeRow.id)
    )
    if environment is not None:
        rows = rows.where(StrokeRow.environment == environment)
    if session_id is not None:
        rows = rows.where(StrokeRow.session_id == session_id)
    if participant_id is not None:
        rows = rows.where(Participant.id == participant_id)
    return [(stroke, person, response) for stroke, person, response in s.execute(rows) if lets_us_learn(person)]


def take_demonstrations(
    s: Session,
    files: ArtefactStore,
    *,
    study_id: str,
    environment: str,
    session_id: str | None = None,
    participant_id: str | None = None,
    whose: Whose = "people",
) -> Artefact:
    """Freeze the demonstrations of one environment as an artefact of kind `demonstrations`: of a session, of a
    participant, or of everybody in the study who is of that kind. Raises StrokeError if there are none.
    """
    demonstrations = demonstrations_of(
        s, study_id=study_id, environment=environment, session_id=session_id, participant_id=participant_id, whose=whose
    )
    if not demonstrations:
        of = "" if session_id or participant_id else f" by {WHOSE_WORDS[whose]}"
        raise StrokeError(f"environment = {environment!r}: no demonstration was kept{of} that may be learned from")
    chosen = [
        KeptDemonstration(
            response=response.id,
            stroke=stroke.id,
            participant=person.code,
            pair=stroke.pair,
            demonstration=stroke.demonstration or "",
            source="simulated" if person.simulated else "human",
        )
        for stroke, person, response in demonstrations
    ]
    people = sorted({item.participant for item in chosen})
    whom = people[0] if len(people) == 1 else f"{len(people)} participants"
    about: dict[str, Any] = {"pairs": sorted({item.pair for item in chosen}), "participants": len(people)}
    about |= {"study": study_id, "session": session_id}
    answers = [item.response for item in chosen]
    return save_demonstrations(s, files, chosen, environment=environment, by=whom, about=about, answers=answers)


def save_demonstrations(
    s: Session,
    files: ArtefactStore,
    demonstrations: Sequence[KeptDemonstration],
    *,
    environment: str,
    by: str,
    about: Mapping[str, Any],
    answers: Sequence[str] = (),
) -> Artefact:
    """Store a snapshot of demonstrations. by: who drew them, in words; about: what else its card says, with the ids
    `study` and `session` where it is of one."""
    content = {
        "format": FORMAT,
        "setup": environment,
        "study": about.get("study"),
        "session": about.get("session"),
        "demonstrations": [vars(item) for item in demonstrations],
    }
    return save_artefact(
        s,
        files,
        kind="demonstrations",
        name=f"{len(demonstrations)} demonstrations in the {environment} by {by}",
        setup=environment,
        content=json.dumps(content, sort_keys=True).encode(),
        card={
            **about,
            "environment": environment,
            "demonstrations": len(demonstrations),
            "human": sum(item.source == "human" for item in demonstrations),
        },
        answers=answers,
        study_id=about.get("study"),
        simulated=any(item.source == "simulated" for item in demonstrations),
    )


def read_demonstrations(content: bytes) -> tuple[str, Sequence[KeptDemonstration]]:
    """Environment and demonstrations of a snapshot's file. Raises StrokeError for anything else."""
    try:
        data = json.loads(content)
        if data["format"] != FORMAT:
            raise ValueError(f"format {data['format']!r}, what is read here is {FORMAT!r}")
        return data["setup"], [KeptDemonstration(**item) for item in data["demonstrations"]]
    except (ValueError, KeyError, TypeError) as problem:
        raise StrokeError(f"no snapshot of demonstrations: {problem}") from None


def programmed_files(s: Session, files: ArtefactStore) -> set[str]:
    """Files that snapshots of programmed demonstrators alone name: no row of a person's path does."""
    named: set[str] = set()
    for snapshot in s.scalars(
        select(Artefact.id).where(Artefact.kind == "demonstrations", Artefact.quarantined_at.is_(None))
    ):
        with suppress(ArtefactError):  # that file is gone, so nothing needs the others
            data = json.loads(files.get(snapshot))
            if data.get("study") is None:
                named |= {item["demonstration"] for item in data.get("demonstrations", [])}
    return named

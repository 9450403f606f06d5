"""Strokes on their way out of and back into the database: rows and files of a data set, and snapshots to learn from.

What a stroke is stands in `models`, what its columns mean in `dataset.py`.

A walk (`StrokeRow.walk`) is {"source": "walked", "times_s": [...], "poses": [[x m, y m, yaw rad], ...] as recorded,
"spline": {...} as `Walk`, "beside": the drive that the participant walked beside (trajectory id), "simulated"} or
{"source": "planned", "mode", "seed", "spline"}, one that was planned by a program and chosen by the participant.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from backend.store.artefacts import ArtefactStore, save_artefact
from backend.store.dataset import DEMONSTRATION_FOLDER
from backend.store.models import Artefact, Participant, Response, StrokeRow
from backend.store.models import Session as SessionRow
from backend.store.snapshots import WHOSE_WORDS, Whose

Row = dict[str, Any]
FIELDS = (
    *("attempt", "environment", "pair", "view", "pointer", "drawn", "walk", "state", "problem"),
    *("demonstration", "trajectory", "watched_at", "client_time", "created_at"),
    *("left_out_at", "left_out_by", "left_out_reason"),
)
JSON_FIELDS = ("drawn", "walk", "problem")
FORMAT = "desirepath-demonstrations-1"
KEPT = "kept"


class StrokeError(ValueError):
    """Strokes that cannot be used as asked."""


# ---- data sets -------------------------------------------------------------------------------------------------------


def strokes_of(s: Session, sessions: Mapping[str, Any]) -> list[StrokeRow]:
    """The strokes of these sessions (by id), in the sessions' order."""
    order = {session_id: k for k, session_id in enumerate(sessions)}
    found = s.scalars(select(StrokeRow).where(StrokeRow.session_id.in_(order)))
    return sorted(found, key=lambda row: (order[row.session_id], row.created_at, row.step_key, row.attempt))


def stroke_rows(strokes: Iterable[StrokeRow], of_session: Callable[[str], Row]) -> Iterator[Row]:
    """Rows of the table `strokes`; of_session: the columns that say whose it is."""
    for stroke in strokes:
        row = {name: getattr(stroke, name) for name in FIELDS}
        for name in JSON_FIELDS:
            row[name] = None if row[name] is None else json.dumps(row[name], sort_keys=True)
        yield {"stroke": stroke.id, **of_session(stroke.session_id), "step": stroke.step_key, **row}


def drives_of(walk: Mapping[str, Any] | None, trajectory: str | None) -> set[str]:
    """Ids of the trajectories that hang on a stroke: its drive, and the one that the participant walked beside."""
    return {one for one in (trajectory, (walk or {}).get("beside")) if one}


def write_demonstrations(files: ArtefactStore, strokes: Iterable[StrokeRow], out: Path) -> None:
    """Every demonstration's file, named by its sha256, into the data set's folder `out`; no folder where none is."""
    for sha in sorted({stroke.demonstration for stroke in strokes if stroke.demonstration}):
        folder = out / DEMONSTRATION_FOLDER
        folder.mkdir(exist_ok=True)
        (folder / f"{sha}.npz").write_bytes(files.get(sha))


def add_strokes(s: Session, files: ArtefactStore, folder: Path, rows: Iterable[Row]) -> None:
    """Import rows of table `strokes` (JSON read) with their files. Raises StrokeError for a file of another name."""
    for row in rows:
        if row["demonstration"] is not None:
            name = f"{DEMONSTRATION_FOLDER}/{row['demonstration']}.npz"
            try:
                content = (folder / name).read_bytes()
            except OSError as problem:
                raise StrokeError(f"{name}: cannot be read ({problem.strerror})") from None
            if hashlib.sha256(content).hexdigest() != row["demonstration"]:
                raise StrokeError(f"{name}: holds another demonstration than its name says")
            files.put(content)
        s.add(
            StrokeRow(
                id=row["stroke"],
                session_id=row["session"],
                step_key=row["step"],
                request_id=f"imported-{row['stroke']}",
                **{name: row[name] for name in FIELDS},
            )
        )
    s.flush()


# ---- snapshots -------------------------------------------------------------------------------------------------------


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
    """What was kept and may be learned from, in order: not left out, nobody who withdrew, is excluded or did not agree
    to learning; a pilot's participants only in their own session, as in `snapshots.py`. whose: of a study's
    participants only people (default), only simulated ones, or all; a session or a participant is asked for by name.
    """
    asked = (
        select(StrokeRow, Participant, Response)
        .join(SessionRow, SessionRow.id == StrokeRow.session_id)
        .join(Participant, Participant.id == SessionRow.participant_id)
        .join(Response, (Response.session_id == StrokeRow.session_id) & (Response.step_key == StrokeRow.step_key))
        .where(
            SessionRow.study_id == study_id,
            StrokeRow.state == KEPT,
            StrokeRow.left_out_at.is_(None),
            Participant.withdrawn_at.is_(None),
            Participant.excluded_at.is_(None),
        )
        .order_by(Participant.code, StrokeRow.created_at, StrokeRow.id)
    )
    if environment is not None:
        asked = asked.where(StrokeRow.environment == environment)
    if session_id is not None:
        asked = asked.where(StrokeRow.session_id == session_id)
    else:
        asked = asked.where(Participant.pilot.is_(False))
    if participant_id is not None:
        asked = asked.where(Participant.id == participant_id)
    elif session_id is None and whose != "all":
        asked = asked.where(Participant.simulated.is_(whose == "simulated"))
    return [
        (stroke, person, response)
        for stroke, person, response in s.execute(asked)
        if (person.consents or {}).get("training") is not False
    ]


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
    found = demonstrations_of(
        s,
        study_id=study_id,
        environment=environment,
        session_id=session_id,
        participant_id=participant_id,
        whose=whose,
    )
    if not found:
        of = "" if session_id or participant_id else f" by {WHOSE_WORDS[whose]}"
        raise StrokeError(f"environment = {environment!r}: no demonstration was kept{of} that may be learned from")
    kept = [
        KeptDemonstration(
            response=response.id,
            stroke=stroke.id,
            participant=person.code,
            pair=stroke.pair,
            demonstration=stroke.demonstration or "",
            source="simulated" if person.simulated else "human",
        )
        for stroke, person, response in found
    ]
    content = {
        "format": FORMAT,
        "setup": environment,
        "study": study_id,
        "session": session_id,
        "demonstrations": [vars(one) for one in kept],
    }
    people = sorted({one.participant for one in kept})
    whom = people[0] if len(people) == 1 else f"{len(people)} participants"
    return save_artefact(
        s,
        files,
        kind="demonstrations",
        name=f"{len(kept)} demonstrations in the {environment} by {whom}",
        setup=environment,
        content=json.dumps(content, sort_keys=True).encode(),
        card={
            "study": study_id,
            "session": session_id,
            "environment": environment,
            "demonstrations": len(kept),
            "pairs": sorted({one.pair for one in kept}),
            "participants": len(people),
            "human": sum(one.source == "human" for one in kept),
        },
        answers=[one.response for one in kept],
        study_id=study_id,
        simulated=any(one.source == "simulated" for one in kept),
    )


def read_demonstrations(content: bytes) -> tuple[str, Sequence[KeptDemonstration]]:
    """Environment and demonstrations of a snapshot's file. Raises StrokeError for anything else."""
    try:
        data = json.loads(content)
        if data["format"] != FORMAT:
            raise ValueError(f"format {data['format']!r}, what is read here is {FORMAT!r}")
        return data["setup"], [KeptDemonstration(**one) for one in data["demonstrations"]]
    except (ValueError, KeyError, TypeError) as problem:
        raise StrokeError(f"no snapshot of demonstrations: {problem}") from None

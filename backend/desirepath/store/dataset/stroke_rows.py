"""Drawn paths on their way into a data set and back: rows and files. Snapshots are `demonstration_snapshots.py`'s.

What a stroke is stands in `models`, what its columns mean in `tables.yaml`.

A walk (`StrokeRow.walk`) is {"source": "walked", "times_s": [...], "poses": [[x m, y m, yaw rad], ...] as recorded,
"spline": {...} as `Walk`, "beside": the trajectory that the participant walked beside (id), "simulated"} or
{"source": "planned", "mode", "seed", "spline"}, one that was planned by a program and chosen by the participant.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.dataset.columns import DEMONSTRATION_FOLDER
from desirepath.store.dataset.rows import stored_columns
from desirepath.store.dataset.tables import STROKES
from desirepath.store.demonstration_snapshots import StrokeError
from desirepath.store.models import StrokeRow, TrajectoryRow

Row = dict[str, Any]


def strokes_of(s: Session, sessions: Mapping[str, Any]) -> list[StrokeRow]:
    """The strokes of these sessions (by id), in the sessions' order."""
    order = {session_id: k for k, session_id in enumerate(sessions)}
    rows = s.scalars(select(StrokeRow).where(StrokeRow.session_id.in_(order)))
    return sorted(rows, key=lambda row: (order[row.session_id], row.created_at, row.step_key, row.attempt))


def stroke_rows(strokes: Iterable[StrokeRow], of_session: Callable[[str], Row]) -> Iterator[Row]:
    """Rows of the table `strokes`; of_session: the columns that say whose it is."""
    for stroke in strokes:
        row = stored_columns(STROKES, stroke)
        yield {**row, **of_session(stroke.session_id), "stroke": stroke.id, "step": stroke.step_key}


def trajectories_of(walk: Mapping[str, Any] | None, trajectory: str | None) -> set[str]:
    """Ids of the trajectories that hang on a stroke: its own, and the one the participant walked beside."""
    return {identity for identity in (trajectory, (walk or {}).get("beside")) if identity}


def write_demonstrations(files: ArtefactStore, strokes: Iterable[StrokeRow], out: Path) -> None:
    """Every demonstration's file, named by its sha256, into the data set's folder `out`; no folder where none is."""
    for sha in sorted({stroke.demonstration for stroke in strokes if stroke.demonstration}):
        folder = out / DEMONSTRATION_FOLDER
        folder.mkdir(exist_ok=True)
        (folder / f"{sha}.npz").write_bytes(files.get(sha))


def add_strokes(s: Session, files: ArtefactStore, folder: Path, rows: Iterable[Row]) -> None:
    """Import rows of table `strokes` (JSON read) with their files. Raises StrokeError for a file of another name."""
    for row in rows:
        beside = (row["walk"] or {}).get("beside")
        if beside is not None and (not isinstance(beside, str) or s.get(TrajectoryRow, beside) is None):
            raise StrokeError(f"strokes.parquet: walk: beside = {str(beside)[:80]!r} is not in the data set")
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
                **{name: row[name] for name in STROKES.kept_in(StrokeRow)},
            )
        )
    s.flush()

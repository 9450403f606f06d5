"""Writes a study as a data set: CSV, Parquet, trajectories, protocol, dictionary, checksums.

What the tables are lives in `tables.yaml`, reading one back in `reading.py`. Who took part under which recruiting id,
from where and with which link never leaves the database, nor do completion codes; of who withdrew only that and when.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import uuid
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from datetime import datetime
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.csv_text import csv_text
from desirepath.simulation.setups import get_setup
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.coding_rows import code_rows, coding_rows
from desirepath.store.dataset.columns import CHECKSUMS_FILE, DICTIONARY_FILE, FORMAT, PROTOCOL_FOLDER, STUDY_FILE, Table
from desirepath.store.dataset.descriptions import (
    NOT_STATED,
    About,
    data_dictionary,
    instruments_asked,
    write_descriptions,
)
from desirepath.store.dataset.preference_pairs import write_pairs
from desirepath.store.dataset.rows import Content
from desirepath.store.dataset.stroke_rows import stroke_rows, strokes_of, trajectories_of, write_demonstrations
from desirepath.store.dataset.tables import (
    CODEBOOK,
    CODINGS,
    EVENTS,
    HEAD_POSES,
    ITEMS,
    METRICS,
    PAIRS,
    PARTICIPANTS,
    PLANNED_STEPS,
    RANKINGS,
    RESPONSES,
    SESSIONS,
    STEPS,
    STROKES,
    TABLES,
    TRAJECTORIES,
    TRIALS,
    TUNING_CHANGES,
)
from desirepath.store.dataset.trajectory_files import write_trajectories
from desirepath.store.head_poses import head_pose_rows
from desirepath.store.models import ProtocolVersion, Study, Tombstone, TrajectoryRow, protocol_digest
from desirepath.store.payment_codes import changes_without, data_without, yaml_without
from desirepath.store.robot_recordings import write_recordings

Row = dict[str, Any]


class ExportError(ValueError):
    """The data set cannot be written as asked."""


def export_study(
    db: Database, files: ArtefactStore, study_id: str, out_dir: Path, *, pilots: bool = False, open_data: bool = False
) -> dict[str, Any]:
    """Write the study's data set into `out_dir` (made if missing, must be empty); the same data give the same bytes.

    pilots: with the pilot participants, marked; without them nothing tells of them. open_data: for publication, without
    whatever participants left who did not agree to that. Returns {"study": id, "files": [{"path", "rows" (None where a
    file has none), "sha256"}]}, paths relative. Raises LookupError for an unknown study, ExportError if the folder is
    not empty, ArtefactError if a trajectory is gone.
    """
    if out_dir.exists() and (not out_dir.is_dir() or any(out_dir.iterdir())):
        raise ExportError(f"out = {str(out_dir)!r}: is not an empty folder; choose another one")
    # Built beside and renamed at the end: a folder of that name is always a whole data set.
    partial = out_dir.with_name(f".{out_dir.name}-{uuid.uuid4().hex}")
    try:
        with db.session() as s:
            study = s.get(Study, study_id)
            if study is None:
                raise LookupError(f"no study with id {study_id!r}; `desirepath studies list` shows them")
            partial.mkdir(parents=True)
            rows = _write_all(s, files, study, partial, Content(s, study, pilots=pilots, open_data=open_data))
        listed = _checksums(partial, rows)
        if out_dir.exists():
            out_dir.rmdir()
        partial.rename(out_dir)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {"study": study_id, "files": listed}


def answers_of(s: Session, study: Study) -> dict[str, list[Row]]:
    """The tables of participants, sessions, trials and responses by name, as they would be exported without pilots,
    JSON unpacked."""
    content = Content(s, study, pilots=False)
    tables: dict[Table, Iterable[Row]] = {
        PARTICIPANTS: content.participants(),
        SESSIONS: content.sessions(),
        TRIALS: content.trials(),
        RESPONSES: content.responses(),
    }
    unpacked = {table.name: [table.unpack(row) for row in rows] for table, rows in tables.items()}
    for row in unpacked[SESSIONS.name]:
        row["plan"] = content.by_id[row["session"]].plan
    return unpacked


def _write_all(s: Session, files: ArtefactStore, study: Study, out: Path, content: Content) -> dict[str, int]:
    """Write every file but the checksums. Returns file name -> rows, for those that have rows."""
    trials = list(content.trials())
    strokes = strokes_of(s, content.by_id)
    rolled_out = {trajectory for stroke in strokes for trajectory in trajectories_of(stroke.walk, stroke.trajectory)}
    shown = sorted(rolled_out.union(*(trial.shown for trial in content.trial_rows)))
    stored = {row.id: row for row in s.scalars(select(TrajectoryRow).where(TrajectoryRow.id.in_(shown)))}
    tables: dict[Table, list[Row]] = {
        PARTICIPANTS: list(content.participants()),
        SESSIONS: list(content.sessions()),
        PLANNED_STEPS: list(content.planned_steps()),
        TRIALS: trials,
        RESPONSES: list(content.responses()),
        ITEMS: list(content.items()),
        TUNING_CHANGES: list(content.tuning_changes()),
        RANKINGS: list(content.rankings()),
        CODEBOOK: list(code_rows(s, study)),
        CODINGS: list(coding_rows(s, study, content.answers, content.of_session)),
        EVENTS: list(content.events()),
        PAIRS: list(content.pairs(stored)),
        STROKES: list(stroke_rows(strokes, content.of_session)),
        HEAD_POSES: list(head_pose_rows(s, content.by_id, content.of_session)),
    }
    write_demonstrations(files, strokes, out)
    write_recordings(s, files, list(content.by_id), out, voices=not content.open_data)
    written = write_trajectories(files, [stored[name] for name in shown], out)
    tables[TRAJECTORIES], tables[METRICS] = written.rows, written.metrics
    may = content.learned_from()
    pairs = [row for row in tables[PAIRS] if row["participant"] in may]
    write_pairs(out, pairs, written.prompts, written.texts)
    counted = {f"{STEPS.name}.parquet": written.steps}
    for table, rows in tables.items():
        pq.write_table(pa.Table.from_pylist(rows, schema=table.schema()), out / f"{table.name}.parquet")
        counted[f"{table.name}.parquet"] = len(rows)
        if table.csv:
            (out / f"{table.name}.csv").write_text(csv_text(_plain_rows(table, rows)), encoding="utf-8", newline="")
            counted[f"{table.name}.csv"] = len(rows)
    _write_study(s, study, out, {table.name: len(rows) for table, rows in tables.items()}, stored.values())
    return counted


def _plain_rows(table: Table, rows: Iterable[Row]) -> Iterator[list[object]]:
    """The columns' names, then their values as a reader of CSV expects them."""
    names = [column.name for column in table.columns]
    yield list(names)
    for row in rows:
        yield [_plain(row[name]) for name in names]


def _plain(value: object) -> object:
    if isinstance(value, bool):
        return "true" if value else "false"
    return value.isoformat(timespec="microseconds") if isinstance(value, datetime) else value


def _write_study(s: Session, study: Study, out: Path, counts: dict[str, int], stored: Iterable[TrajectoryRow]) -> None:
    """Write study.json, the protocol's copy and the data dictionary."""
    folder = out / PROTOCOL_FOLDER
    folder.mkdir()
    written = yaml_without(study.protocol_yaml)
    (folder / "protocol.yaml").write_text(written, encoding="utf-8", newline="")
    _write_json(folder / "frozen.json", {"protocol": data_without(study.protocol), "files": study.files})
    for name, content in study.files.items():
        path = PurePosixPath(name)
        if isinstance(content, str) and not path.is_absolute() and ".." not in path.parts:
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(content, encoding="utf-8", newline="")
    later = s.scalars(
        select(ProtocolVersion).where(ProtocolVersion.study_id == study.id).order_by(ProtocolVersion.number)
    ).all()
    later_written = {revision.number: yaml_without(revision.protocol_yaml) for revision in later}
    for revision in later:
        frozen = {
            "yaml": later_written[revision.number],
            "protocol": data_without(revision.protocol),
            "files": revision.files,
        }
        _write_json(folder / f"{revision.number}.json", frozen)
    erased = s.scalars(select(Tombstone).where(Tombstone.study_id == study.id).order_by(Tombstone.erased_at))
    setups = {}
    for name in sorted({row.setup for row in stored}):
        setup = get_setup(name)
        setups[name] = {
            "limits": asdict(setup.robot.limits),
            "core_reward": asdict(setup.reward),
            "goal_radius_m": setup.goal_radius_m,
            "robot_radius_m": setup.robot.radius_m,
            "observation_layout": setup.observation_layout(),
        }
    _write_json(
        out / STUDY_FILE,
        {
            "format": FORMAT,
            "written_by": f"desirepath {version('desirepath')}",
            "study": study.id,
            "name": study.name,
            "created_at": study.created_at.isoformat(),
            "seed": study.seed,
            "protocol": {
                "name": study.protocol_name,
                "version": study.protocol_version,
                "sha256": study.protocol_hash,
                "written_sha256": protocol_digest(written, study.files),
            },
            "protocol_versions": [
                {
                    "number": revision.number,
                    "version": revision.protocol_version,
                    "sha256": revision.protocol_hash,
                    "written_sha256": protocol_digest(later_written[revision.number], revision.files),
                    "changes": changes_without(revision.changes),
                    "created_at": revision.created_at.isoformat(),
                }
                for revision in later
            ],
            "licence": study.protocol.get("licence") or NOT_STATED,
            "citation": _citation(study),
            "rows": counts,
            "setups": setups,
            "erased_participants": [
                {"tombstone": tombstone.id, "erased_at": tombstone.erased_at.isoformat()} for tombstone in erased
            ],
        },
    )
    (out / DICTIONARY_FILE).write_text(data_dictionary() + instruments_asked(study.files), encoding="utf-8")
    about = About(
        study=study.id,
        name=study.name,
        protocol=f"{study.protocol_name} version {study.protocol_version}",
        created_at=study.created_at.isoformat(),
        licence=study.protocol.get("licence"),
        citation=_citation(study),
    )
    write_descriptions(out, about, TABLES)


def _citation(study: Study) -> str:
    stated: str | None = study.protocol.get("citation")
    return stated or (
        f"{study.name} (study {study.id}, protocol {study.protocol_name} version {study.protocol_version}, "
        f"sha256 {study.protocol_hash}), collected with Desire Path"
    )


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=2, sort_keys=True, ensure_ascii=False) + "\n", encoding="utf-8", newline="")


def _checksums(folder: Path, rows: dict[str, int]) -> list[dict[str, Any]]:
    """Write the checksums file; returns what lies in the data set, that file included."""
    found = write_checksums(folder)
    found[CHECKSUMS_FILE] = hashlib.sha256((folder / CHECKSUMS_FILE).read_bytes()).hexdigest()
    return [{"path": name, "rows": rows.get(name), "sha256": sha} for name, sha in found.items()]


def write_checksums(folder: Path) -> dict[str, str]:
    """Write the checksums of everything there, as `sha256sum` reads them; returns them by name."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    found = {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
    text = "".join(f"{sha}  {name}\n" for name, sha in found.items())
    (folder / CHECKSUMS_FILE).write_text(text, encoding="utf-8", newline="")
    return found

"""Writes a study as a data set: CSV, Parquet, trajectories, protocol, dictionary, checksums.

What the tables are lives in `dataset.py`, reading one back in `importing.py`. Who took part under which recruiting id,
from where and with which link never leaves the database; of who withdrew only that and when.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import shutil
import uuid
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from datetime import datetime
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from sqlalchemy import select
from sqlalchemy.orm import Session

from backend.simulation.setups import get_setup
from backend.simulation.trajectory import Outcome, Trajectory
from backend.store.artefacts import ArtefactStore
from backend.store.database import Database
from backend.store.dataset import (
    CHECKSUMS_FILE,
    DICTIONARY_FILE,
    EVENTS,
    FORMAT,
    ITEMS,
    PAIRS,
    PARTICIPANTS,
    PROTOCOL_FOLDER,
    RESPONSES,
    SESSIONS,
    STEPS,
    STROKES,
    STUDY_FILE,
    TRAJECTORIES,
    TRAJECTORY_FOLDER,
    TRIALS,
    Table,
    data_dictionary,
)
from backend.store.events import FORBIDDEN_KEYS, mentions
from backend.store.models import (
    Event,
    Participant,
    RecruitingId,
    Response,
    Study,
    Tombstone,
    TrajectoryRow,
    Trial,
)
from backend.store.models import Session as SessionRow
from backend.store.strokes import stroke_rows, strokes_of, write_demonstrations

Row = dict[str, Any]
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n")
REMOVED = "[removed]"
MIN_SCRUBBED_LENGTH = 6  # a recruiting id shorter than this would blot out ordinary words
STEPS_ROWS_AT_ONCE = 4096
# Entries of an event's data that hold words and ids of ours; everything else may have been typed or told by a page.
OWN_WORDS = frozenset(
    {
        *("step", "phase", "goes_on_with", "drive", "response", "outcome", "code", "language"),
        *("job", "snapshot", "protocol", "hash", "tombstone"),
    }
)


class ExportError(ValueError):
    """The data set cannot be written as asked."""


def export_study(
    db: Database, files: ArtefactStore, study_id: str, out_dir: Path, *, pilots: bool = False
) -> dict[str, Any]:
    """Write the study's data set into `out_dir` (made if missing, must be empty); the same data give the same bytes.

    pilots: with the pilot participants, marked; without them nothing tells of them. Returns {"study": id, "files":
    [{"path", "rows" (None where a file has none), "sha256"}]}, paths relative. Raises LookupError for an unknown study,
    ExportError if the folder is not empty, ArtefactError if a drive is gone.
    """
    if out_dir.exists() and (not out_dir.is_dir() or any(out_dir.iterdir())):
        raise ExportError(f"out = {str(out_dir)!r}: is not an empty folder; choose another one")
    # Built beside and renamed at the end: a folder of that name is always a whole data set.
    partial = out_dir.with_name(f".{out_dir.name}-{uuid.uuid4().hex}")
    try:
        with db.session() as s:
            study = s.get(Study, study_id)
            if study is None:
                raise LookupError(f"no study with id {study_id!r}; `desirepath study list` shows them")
            partial.mkdir(parents=True)
            rows = _write_all(s, files, study, partial, pilots)
        listed = _checksums(partial, rows)
        if out_dir.exists():
            out_dir.rmdir()
        partial.rename(out_dir)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {"study": study_id, "files": listed}


def answers_of(s: Session, study: Study, *, pilots: bool = False) -> dict[str, list[Row]]:
    """The tables of participants, sessions, trials and responses by name, as they would be exported, JSON unpacked.

    pilots: with the pilot participants.
    """
    content = _Content(s, study, pilots=pilots)
    tables = {
        PARTICIPANTS: content.participants(),
        SESSIONS: content.sessions(),
        TRIALS: content.trials(),
        RESPONSES: content.responses(),
    }
    return {table.name: [table.unpacked(row) for row in rows] for table, rows in tables.items()}


def _write_all(s: Session, files: ArtefactStore, study: Study, out: Path, pilots: bool) -> dict[str, int]:
    """Write every file but the checksums. Returns file name -> rows, for those that have rows."""
    content = _Content(s, study, pilots=pilots)
    trials = list(content.trials())
    strokes = strokes_of(s, content.by_id)
    driven = {stroke.trajectory for stroke in strokes if stroke.trajectory}
    shown = sorted(driven | {t for row in trials for t in (row["trajectory_a"], row["trajectory_b"])})
    stored = {row.id: row for row in s.scalars(select(TrajectoryRow).where(TrajectoryRow.id.in_(shown)))}
    (out / TRAJECTORY_FOLDER).mkdir()
    tables: dict[Table, list[Row]] = {
        PARTICIPANTS: list(content.participants()),
        SESSIONS: list(content.sessions()),
        TRIALS: trials,
        RESPONSES: list(content.responses()),
        ITEMS: list(content.items()),
        EVENTS: list(content.events()),
        PAIRS: list(content.pairs(stored)),
        STROKES: list(stroke_rows(strokes, content.of_session)),
    }
    write_demonstrations(files, strokes, out)
    tables[TRAJECTORIES], step_count = _write_trajectories(files, [stored[name] for name in shown], out)
    counted = {f"{STEPS.name}.parquet": step_count}
    for table, rows in tables.items():
        pq.write_table(pa.Table.from_pylist(rows, schema=table.schema()), out / f"{table.name}.parquet")
        (out / f"{table.name}.csv").write_text(_csv(table, rows), encoding="utf-8", newline="")
        counted |= {f"{table.name}.{ending}": len(rows) for ending in ("parquet", "csv")}
    _write_study(s, study, out, {table.name: len(rows) for table, rows in tables.items()}, stored.values())
    return counted


class _Content:
    """The rows of every table, in a fixed order, marked, scrubbed."""

    def __init__(self, s: Session, study: Study, *, pilots: bool) -> None:
        self.s, self.study = s, study
        everyone = list(
            s.scalars(select(Participant).where(Participant.study_id == study.id).order_by(Participant.code))
        )
        self.people = {person.id: person for person in everyone if pilots or not person.pilot}
        sessions = s.scalars(
            select(SessionRow).where(SessionRow.study_id == study.id).order_by(SessionRow.created_at, SessionRow.id)
        ).all()
        gone = {one.id: one.code for one in everyone if one.withdrawn_at is not None or one.id not in self.people}
        kept = [row for row in sessions if row.participant_id not in gone]
        self.by_id = {row.id: row for row in sorted(kept, key=lambda row: self.people[row.participant_id].code)}
        # what an event may call somebody who withdrew or is left out
        self.gone = {*gone, *gone.values()} | {row.id for row in sessions} - self.by_id.keys()
        order = {session_id: k for k, session_id in enumerate(self.by_id)}
        in_study = SessionRow.study_id == study.id
        trials = s.scalars(select(Trial).join(SessionRow, SessionRow.id == Trial.session_id).where(in_study))
        self.trial_rows = sorted(
            (trial for trial in trials if trial.session_id in order), key=lambda t: (order[t.session_id], t.index, t.id)
        )
        self.trial_by_id = {trial.id: trial for trial in self.trial_rows}
        answers = s.scalars(select(Response).join(SessionRow, SessionRow.id == Response.session_id).where(in_study))
        self.answers = sorted(
            (answer for answer in answers if answer.session_id in order),
            key=lambda r: (order[r.session_id], r.created_at, r.id),
        )
        self.secrets = _recruiting_words(s, study.id)
        self.chosen_items = _items_without_free_text(study)

    def participants(self) -> Iterator[Row]:
        for person in self.people.values():
            withdrawn = person.withdrawn_at is not None
            yield {
                **self._of_participant(person),
                "pilot": person.pilot,
                "withdrawn": withdrawn,
                "oracle": None if withdrawn else _json(person.oracle),
                "created_at": person.created_at,
                "withdrawn_at": person.withdrawn_at,
                "excluded_at": person.excluded_at,
                "excluded_reason": None if withdrawn else self._scrub(person.excluded_reason),
            }

    def sessions(self) -> Iterator[Row]:
        for row in self.by_id.values():
            yield {
                **self.of_session(row.id),
                "state": row.state,
                "language": row.language,
                "seed": row.seed,
                "plan": _json(row.plan),
                "position": row.position,
                "device": _json(row.device),
                "personalisation": row.personalisation,
                "created_at": row.created_at,
                "started_at": row.started_at,
                "finished_at": row.finished_at,
                "last_seen_at": row.last_seen_at,
                "expires_at": row.expires_at,
            }

    def trials(self) -> Iterator[Row]:
        for trial in self.trial_rows:
            yield {
                "trial": trial.id,
                **self.of_session(trial.session_id),
                "learning": trial.role == "learning",
                "step": trial.step_key,
                "index": trial.index,
                "block": trial.block,
                "kind": trial.kind,
                "role": trial.role,
                "view": trial.view,
                "query": trial.query_id,
                "trajectory_a": trial.trajectory_a,
                "trajectory_b": trial.trajectory_b,
                "arms": _json(trial.arms),
                "look_alike": (trial.arms or {}).get("look_alike"),
                "phase": trial.phase,
                "phase_since": trial.phase_since,
                "a_seen_at": trial.a_seen_at,
                "b_seen_at": trial.b_seen_at,
                "restarts": trial.restarts,
            }

    def responses(self) -> Iterator[Row]:
        for answer in self.answers:
            trial = self.trial_by_id.get(answer.trial_id or "")
            choice = answer.value.get("choice")
            yield {
                "response": answer.id,
                "trial": answer.trial_id,
                **self.of_session(answer.session_id),
                "learning": trial is not None and trial.role == "learning",
                "step": answer.step_key,
                "kind": answer.kind,
                "view": trial.view if trial else None,
                "role": trial.role if trial else None,
                "query": trial.query_id if trial else None,
                "choice": choice if isinstance(choice, str) else None,
                "value": _json(self._value(answer)),
                "decision_s": answer.decision_s,
                "client_time": answer.client_time,
                "created_at": answer.created_at,
            }

    def items(self) -> Iterator[Row]:
        for answer in self.answers:
            if answer.kind != "questionnaire":
                continue
            for item, given in sorted(self._value(answer).items()):
                is_number = isinstance(given, int | float) and not isinstance(given, bool)
                yield {
                    "response": answer.id,
                    **self.of_session(answer.session_id),
                    "step": answer.step_key,
                    "item": item,
                    "answer": given if isinstance(given, str) else _json(given),
                    "answer_number": float(given) if is_number else None,
                }

    def events(self) -> Iterator[Row]:
        found = self.s.scalars(select(Event).where(Event.study_id == self.study.id).order_by(Event.id))
        nobody = {"session": None, "participant": None, "simulated": None, "excluded": None}
        kept = (e for e in found if e.session_id not in self.gone and not mentions(e.data, self.gone))
        for number, event in enumerate(kept, start=1):
            known = event.session_id in self.by_id
            yield {
                "number": number,
                "at": event.at,
                **(self.of_session(event.session_id) if known and event.session_id else nobody),
                "trial": event.trial_id,
                "kind": event.kind,
                "client_time": event.client_time,
                "data": _json({key: v if key in OWN_WORDS else self._scrub_all(v) for key, v in event.data.items()}),
            }

    def pairs(self, stored: dict[str, TrajectoryRow]) -> Iterator[Row]:
        for answer in self.answers:
            trial = self.trial_by_id.get(answer.trial_id or "")
            choice = answer.value.get("choice")
            if trial is None or choice not in ("a", "b"):
                continue
            person = self.people[self.by_id[answer.session_id].participant_id]
            drives = (trial.trajectory_a, trial.trajectory_b)
            chosen, rejected = drives if choice == "a" else drives[::-1]
            yield {
                "response": answer.id,
                **self._of_participant(person),
                "learning": trial.role == "learning",
                "source": "simulated" if person.simulated else "human",
                "kind": trial.kind,
                "role": trial.role,
                "view": trial.view,
                "query": trial.query_id,
                "setup": stored[chosen].setup,
                "scene_hash": stored[chosen].scene_hash,
                "chosen": chosen,
                "rejected": rejected,
                "chosen_shown": "first" if choice == "a" else "second",
            }

    def of_session(self, session_id: str) -> Row:
        return {"session": session_id, **self._of_participant(self.people[self.by_id[session_id].participant_id])}

    def _of_participant(self, person: Participant) -> Row:
        return {
            "participant": person.code,
            "simulated": person.simulated,
            "excluded": person.excluded_at is not None,
        }

    def _value(self, answer: Response) -> Row:
        """The answer's value, with what was typed freely scrubbed; every other kind of answer holds our own words."""
        if answer.kind != "questionnaire":
            return answer.value
        return {
            item: given if item in self.chosen_items else self._scrub_all(given) for item, given in answer.value.items()
        }

    def _scrub_all(self, value: Any) -> Any:
        """Plain data with every text in it scrubbed."""
        if isinstance(value, dict):
            return {key: self._scrub_all(inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [self._scrub_all(inner) for inner in value]
        return self._scrub(value) if isinstance(value, str) else value

    def _scrub(self, text: str | None) -> str | None:
        """The text without any recruiting id of this study, wherever it came in (an address bar, a free-text field)."""
        for word in self.secrets if text else ():
            text = text.replace(word, REMOVED) if text else text
        return text


def _json(value: Any) -> str | None:
    """JSON without the entries that must not leave the database."""
    return None if value is None else json.dumps(_allowed(value), sort_keys=True, ensure_ascii=False)


def _allowed(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _allowed(inner) for key, inner in value.items() if key.lower() not in FORBIDDEN_KEYS}
    return [_allowed(inner) for inner in value] if isinstance(value, list) else value


def _items_without_free_text(study: Study) -> set[str]:
    """Keys of the items whose answers were chosen or counted, in every questionnaire that has them."""
    chosen: set[str] = set()
    typed: set[str] = set()
    for name, content in study.files.items():
        if not name.startswith("questionnaires/"):
            continue
        for block in yaml.safe_load(content)["blocks"]:
            for item in block["items"]:
                (typed if item["type"] == "text" else chosen).add(item["key"])
    return chosen - typed


def _recruiting_words(s: Session, study_id: str) -> list[str]:
    words: set[str] = set()
    for row in s.scalars(select(RecruitingId).where(RecruitingId.study_id == study_id)):
        words |= {row.external_id, *(value for value in row.details.values() if isinstance(value, str))}
    return sorted((word for word in words if len(word) >= MIN_SCRUBBED_LENGTH), key=len, reverse=True)


def _csv(table: Table, rows: Iterable[Row]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [column.name for column in table.columns]
    writer.writerow(names)
    for row in rows:
        writer.writerow([_cell(row[name]) for name in names])
    return out.getvalue()


def _cell(value: Any) -> str:
    """One CSV cell; text that a spreadsheet would run as a formula is made plain text."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, datetime):
        return value.isoformat(timespec="microseconds")
    if isinstance(value, str) and value.startswith(FORMULA_STARTS):
        return f"'{value}"
    return str(value)


def _write_trajectories(files: ArtefactStore, stored: list[TrajectoryRow], out: Path) -> tuple[list[Row], int]:
    """Write the NPZ files and the table of steps. Returns the rows of the trajectories' table and the steps' count."""
    rows, count = [], 0
    waiting: list[Row] = []
    with pq.ParquetWriter(out / f"{STEPS.name}.parquet", STEPS.schema()) as writer:
        for row in stored:
            content = files.get(row.id)
            (out / TRAJECTORY_FOLDER / f"{row.id}.npz").write_bytes(content)
            trajectory = Trajectory.from_bytes(content)
            rows.append(
                {
                    "trajectory": row.id,
                    "setup": row.setup,
                    "scene_hash": row.scene_hash,
                    "scene": json.dumps(trajectory.scene.as_dict(), sort_keys=True),
                    "outcome": Outcome(row.outcome).name.lower(),
                    "steps": row.steps,
                    "dt_s": trajectory.dt,
                    "duration_s": row.duration_s,
                    "self_intersections": trajectory.self_intersections,
                    "made_by": row.made_by,
                    "created_at": row.created_at,
                }
            )
            waiting += _steps(row.id, trajectory)
            count += row.steps
            if len(waiting) >= STEPS_ROWS_AT_ONCE:
                writer.write_table(pa.Table.from_pylist(waiting, schema=STEPS.schema()))
                waiting = []
        writer.write_table(pa.Table.from_pylist(waiting, schema=STEPS.schema()))
    return rows, count


def _steps(trajectory_id: str, trajectory: Trajectory) -> Iterator[Row]:
    poses, actions = trajectory.poses.astype(np.float64), trajectory.actions.astype(np.float64)
    for k in range(len(actions)):
        yield {
            "trajectory": trajectory_id,
            "step": k,
            "time_s": k * trajectory.dt,
            **dict(zip(("x_m", "y_m", "yaw_rad"), poses[k].tolist(), strict=True)),
            **dict(zip(("next_x_m", "next_y_m", "next_yaw_rad"), poses[k + 1].tolist(), strict=True)),
            "action_linear": actions[k, 0].item(),
            "action_angular": actions[k, 1].item(),
            "reward": float(trajectory.rewards[k]),
            "done": bool(trajectory.dones[k]),
            "observation": trajectory.observations[k].tolist(),
            "next_observation": trajectory.next_observations[k].tolist(),
        }


def _write_study(s: Session, study: Study, out: Path, counts: dict[str, int], stored: Iterable[TrajectoryRow]) -> None:
    """Write study.json, the protocol's copy and the data dictionary."""
    folder = out / PROTOCOL_FOLDER
    folder.mkdir()
    (folder / "protocol.yaml").write_text(study.protocol_yaml, encoding="utf-8", newline="")
    _write_json(folder / "frozen.json", {"protocol": study.protocol, "files": study.files})
    for name, content in study.files.items():
        path = PurePosixPath(name)
        if isinstance(content, str) and not path.is_absolute() and ".." not in path.parts:
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(content, encoding="utf-8", newline="")
    erased = s.scalars(select(Tombstone).where(Tombstone.study_id == study.id).order_by(Tombstone.erased_at))
    setups = {}
    for name in sorted({row.setup for row in stored}):
        setup = get_setup(name)
        setups[name] = {
            "limits": asdict(setup.limits),
            "core_reward": asdict(setup.reward),
            "goal_radius_m": setup.goal_radius_m,
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
            },
            "licence": study.protocol.get("licence")
            or "not stated in the protocol: ask the study's experimenter before you use or share these data",
            "citation": study.protocol.get("citation")
            or f"{study.name} (study {study.id}, protocol {study.protocol_name} version {study.protocol_version}, "
            f"sha256 {study.protocol_hash}), collected with Desire Path",
            "rows": counts,
            "setups": setups,
            "erased_participants": [
                {"tombstone": tombstone.id, "erased_at": tombstone.erased_at.isoformat()} for tombstone in erased
            ],
        },
    )
    (out / DICTIONARY_FILE).write_text(data_dictionary(), encoding="utf-8")


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=2, sort_keys=True, ensure_ascii=False) + "\n", encoding="utf-8", newline="")


def _checksums(folder: Path, rows: dict[str, int]) -> list[dict[str, Any]]:
    """Write the checksums file; returns what lies in the data set, that file included."""
    listed = []
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        listed.append({"path": name, "rows": rows.get(name), "sha256": hashlib.sha256(path.read_bytes()).hexdigest()})
    text = "".join(f"{file['sha256']}  {file['path']}\n" for file in listed)
    (folder / CHECKSUMS_FILE).write_text(text, encoding="utf-8", newline="")
    listed.append({"path": CHECKSUMS_FILE, "rows": None, "sha256": hashlib.sha256(text.encode()).hexdigest()})
    return listed

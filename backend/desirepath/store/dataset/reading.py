"""Reads a data set that lies in a folder: checked, bounded, older formats by today's names. `writing.py` writes them.

What came from elsewhere may be made to harm: nothing is unpacked before its hash was checked, and rows, sizes, depth
and ids have bounds.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from desirepath.grammar.questionnaires import frozen_questionnaire
from desirepath.grammar.source import ProtocolError, Source
from desirepath.grammar.text_files import NotUtf8Error, read_text
from desirepath.os_errors import in_words
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.dataset.columns import (
    CHECKSUMS_FILE,
    FORMAT,
    PROTOCOL_FOLDER,
    SHA,
    STUDY_FILE,
    TEXT,
    TRAJECTORY_FOLDER,
    Table,
)
from desirepath.store.dataset.tables import PARTICIPANTS, PLANNED_STEPS, RESPONSES, SESSIONS, TRIALS
from desirepath.store.plain_data import MOST_LEVELS, levels_of
from desirepath.zip_files import is_of_the_system

Row = dict[str, Any]
# Ours. 31 people in three views leave 60,000 events and 40 MB of tables.
MOST_ROWS = 1_000_000  # of a table
MOST_TABLE_BYTES = 2**30  # of a table when it is unpacked
MOST_FILE_BYTES = 2**30
ROWS_AT_ONCE = 1_024


class DatasetError(ValueError):
    """A folder that is no whole, unchanged data set of this format; nothing was imported."""


class _Stored(BaseModel):
    """Part of study.json; what else stands there is for people."""

    model_config = ConfigDict(extra="ignore", frozen=True)


Sha = Annotated[str, Field(pattern=f"^{SHA}$")]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class AboutProtocol(_Stored):
    """A protocol that answers were collected with. written_sha256: of its copy here, which has no completion codes."""

    name: Annotated[str, Field(pattern="^[A-Za-z0-9_-]{0,80}$")] = ""  # of files that are downloaded
    version: Annotated[int, Field(ge=0, lt=2**31)]
    sha256: Sha
    written_sha256: Sha


class AboutVersion(AboutProtocol):
    """A later protocol of the study."""

    number: Annotated[int, Field(ge=2, lt=10_000)]
    changes: list[dict[str, Any]]
    created_at: AwareDatetime


class AboutErased(_Stored):
    """Somebody who was erased."""

    tombstone: Annotated[str, Field(pattern="^[0-9a-f]{32}$")]
    erased_at: AwareDatetime


class About(_Stored):
    """What study.json says of the study. The id is one of ours, so it names no path."""

    format: str
    study: Annotated[str, Field(pattern="^[0-9a-f]{32}$")]
    name: Name
    seed: Annotated[int, Field(ge=-(2**31), lt=2**31)]
    created_at: AwareDatetime
    protocol: AboutProtocol
    protocol_versions: list[AboutVersion]
    erased_participants: list[AboutErased]


@dataclass(frozen=True)
class ReadDataset:
    """A data set as it lies in a folder. about: study.json; protocol, files: the study's frozen copy; tables: by name,
    JSON columns as plain data; later: {"protocol", "files"} of its later versions, in order."""

    folder: Path
    about: About
    protocol: Row
    files: dict[str, str]
    tables: dict[str, list[Row]]
    later: list[Row]

    def trajectory(self, trajectory_id: str) -> Trajectory:
        return Trajectory.from_bytes((self.folder / TRAJECTORY_FOLDER / f"{trajectory_id}.npz").read_bytes())


def read_dataset(folder: Path) -> ReadDataset:
    """Participants, sessions, trials and responses of the data set in `folder`; nothing is imported.

    Raises DatasetError as `import_dataset` does.
    """
    check_files(folder)
    about = read_about(folder)
    _, frozen = frozen_in(folder)
    tables = read_tables(folder, (PARTICIPANTS, SESSIONS, TRIALS, RESPONSES))
    later = [version_in(folder, version.number) for version in about.protocol_versions]
    return ReadDataset(folder, about, frozen["protocol"], frozen["files"], tables, later)


def check_files(folder: Path) -> None:
    """Every file must be listed with its sha256, every listed one be there, none be too large; what systems leave in
    folders is passed over. Raises DatasetError."""
    try:
        lines = read_text(folder / CHECKSUMS_FILE).splitlines()
    except (OSError, NotUtf8Error) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else problem
        raise DatasetError(f"{folder} is no exported data set: cannot read {CHECKSUMS_FILE} ({reason})") from None
    listed = {name: sha for sha, _, name in (line.partition("  ") for line in lines)}
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    present = {path.as_posix() for path in paths if not any(map(is_of_the_system, path.parts))} - {CHECKSUMS_FILE}
    for name in sorted(set(listed) ^ present):
        raise DatasetError(f"{name}: " + ("is missing" if name in listed else f"is not listed in {CHECKSUMS_FILE}"))
    for name, sha in listed.items():
        with (folder / name).open("rb") as file:
            if (folder / name).stat().st_size > MOST_FILE_BYTES:
                raise DatasetError(f"{name}: is larger than {MOST_FILE_BYTES // 2**20} MB, which no file of a study is")
            if hashlib.file_digest(file, "sha256").hexdigest() != sha:
                raise DatasetError(f"{name}: was changed after the export (its sha256 differs); use an untouched copy")


def read_about(folder: Path) -> About:
    """study.json. Raises DatasetError for another format, or naming the field that is not as an export writes it."""
    stored = _read_json(folder / STUDY_FILE)
    if not isinstance(stored, dict) or stored.get("format") != FORMAT:
        format_name = stored.get("format") if isinstance(stored, dict) else stored
        raise DatasetError(f"{STUDY_FILE}: format {format_name!r} is unknown; this version reads {FORMAT}")
    try:
        return About.model_validate(stored)
    except ValidationError as problem:
        first = problem.errors()[0]
        field = ".".join(map(str, first["loc"]))
        value = repr(first["input"])[:80]
        raise DatasetError(f"{STUDY_FILE}: {field} = {value}: {first['msg']}") from None


def frozen_in(folder: Path) -> tuple[str, Row]:
    """The study's first protocol: its YAML, and {"protocol", "files"}. Raises DatasetError."""
    frozen = _frozen(folder / PROTOCOL_FOLDER / "frozen.json")
    try:
        written = (folder / PROTOCOL_FOLDER / "protocol.yaml").read_bytes().decode()  # as it was, for its hash
        Source("protocol.yaml", written)  # bounded: it will be read again
        return written, frozen
    except (OSError, ValueError) as problem:
        raise DatasetError(f"{PROTOCOL_FOLDER}/protocol.yaml: cannot be read ({in_words(problem)})") from None


def version_in(folder: Path, number: int) -> Row:
    """A later protocol: {"yaml", "protocol", "files"}. Raises DatasetError."""
    return _frozen(folder / PROTOCOL_FOLDER / f"{number}.json", "yaml")


def _frozen(path: Path, *texts: str) -> Row:
    frozen: Row = _read_json(path)
    files = frozen.get("files") if isinstance(frozen, dict) else None
    if (
        not isinstance(files, dict)
        or not isinstance(frozen.get("protocol"), dict)
        or not all(isinstance(text, str) for text in (*files.values(), *(frozen.get(name) for name in texts)))
    ):
        raise DatasetError(f"{path.name}: holds no protocol with its files")
    try:
        for name, content in files.items():
            if name.startswith("questionnaires/"):
                frozen_questionnaire(name, content)
    except ProtocolError as problem:
        raise DatasetError(f"{path.name}: {problem}") from None
    return frozen


def _read_json(path: Path) -> Any:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as problem:
        raise DatasetError(f"{path.name}: cannot be read ({in_words(problem)})") from None
    _check_depth(content, path.name)
    return content


def _check_depth(data: Any, where: str) -> None:
    if levels_of(data) > MOST_LEVELS:
        raise DatasetError(f"{where}: nests deeper than {MOST_LEVELS} levels, which nothing of ours does")


# ---- tables ----------------------------------------------------------------------------------------------------------


def read_tables(folder: Path, tables: Iterable[Table]) -> dict[str, list[Row]]:
    """The rows of those tables by name, JSON as plain data. A session's `plan` is put
    together from its steps. Raises DatasetError naming file and column."""
    tables_read = {table.name: list(_rows(folder, table)) for table in tables}
    sessions = tables_read.get(SESSIONS.name, [])
    for row in tables_read.get(RESPONSES.name, []):
        if row["value"] is None:
            raise DatasetError(f"{RESPONSES.name}.parquet: value is missing")
    if sessions:
        plans: dict[str, list[Row]] = {row["session"]: [] for row in sessions}
        for step in _rows(folder, PLANNED_STEPS):
            if step["session"] in plans:
                plans[step["session"]].append(step)
        for row in sessions:
            row["plan"] = [step["planned"] for step in sorted(plans[row["session"]], key=lambda step: step["index"])]
    for row in sessions:
        if not isinstance(row["plan"], list) or not all(
            isinstance((step or {}).get("key"), str) for step in row["plan"]
        ):
            raise DatasetError(f"{SESSIONS.name}: session {row['session']} has a plan that is none of ours")
    return tables_read


def _rows(folder: Path, table: Table) -> Iterator[Row]:
    name = f"{table.name}.parquet"
    for row in _unbounded_rows(folder, table):
        for column in table.columns:
            value = row[column.name]
            if column.form is not None and value is not None and not column.form.fullmatch(value):
                raise DatasetError(f"{name}: {column.name} = {value[:80]!r}: no {column.name} of ours is written so")
            if column.json and value is not None:
                _check_depth(value, f"{name}: {column.name}")
                if not isinstance(value, dict):
                    raise DatasetError(f"{name}: {column.name} = {str(value)[:80]!r}: must be a JSON object")
        yield row


def _unbounded_rows(folder: Path, table: Table) -> Iterator[Row]:
    """Rows as they lie there, a part of the file at a time."""
    name = f"{table.name}.parquet"
    try:
        # texts as a dictionary: a small file may hold one long text a million times
        texts = [column.name for column in pq.read_schema(folder / name) if column.type == TEXT]
        with pq.ParquetFile(folder / name, read_dictionary=texts) as file:
            if file.metadata.num_rows > MOST_ROWS:
                raise DatasetError(f"{name}: has {file.metadata.num_rows} rows, at most {MOST_ROWS} are read")
            size = 0
            for batch in file.iter_batches(batch_size=ROWS_AT_ONCE):
                part = _columns(pa.Table.from_batches([batch]), table, name)
                size += _unpacked_bytes(part)
                if size > MOST_TABLE_BYTES:
                    raise DatasetError(f"{name}: is larger than {MOST_TABLE_BYTES // 2**20} MB when it is unpacked")
                for row in part.to_pylist():
                    yield table.unpack(row)
    except (OSError, pa.ArrowException) as problem:
        raise DatasetError(f"{name}: cannot be read ({in_words(problem)})") from None
    except DatasetError:
        raise
    except ValueError as problem:
        raise DatasetError(f"{name}: {problem}") from None


def _columns(rows: pa.Table, table: Table, name: str) -> pa.Table:
    """The table's own columns. Raises DatasetError for one that is missing or of another type."""
    for column in table.columns:
        if column.name not in rows.column_names or not _is(rows.schema.field(column.name).type, column.type):
            raise DatasetError(f"{name}: column {column.name!r} ({column.type_name()}) is missing or of another type")
    return rows.select([column.name for column in table.columns])


def _is(actual: pa.DataType, wanted: pa.DataType) -> bool:
    return bool((actual.value_type if pa.types.is_dictionary(actual) else actual) == wanted)


def _unpacked_bytes(rows: pa.Table) -> int:
    """How large the rows are once every text stands in its row."""
    size = 0
    for column in rows.columns:
        if pa.types.is_dictionary(column.type):
            for chunk in column.chunks:
                size += pc.sum(pc.binary_length(chunk.dictionary).take(chunk.indices)).as_py() or 0
        else:
            size += column.nbytes
    return size

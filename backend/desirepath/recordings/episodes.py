"""Data sets of episodes in Parquet: Minari's (also Arrow) and LeRobotDataset v3. Only poses are taken of them.

Which numbers are a place the mapping says (`robot: {field: observation.state, x: 0, y: 1, yaw: 2}`), unless the data
set itself names them x, y, yaw. Neither package is needed. Types and sizes are looked at before a file is read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping as AnyMapping
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.ipc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from desirepath.recordings.mapping import Keys, Mapping
from desirepath.recordings.recording import (
    BOUNDS,
    Bounds,
    Recording,
    RecordingError,
    Source,
    Track,
    read_bounded,
    sha256_of,
    track,
)
from desirepath.recordings.socnav3 import parse_json

Doubles = NDArray[np.float64]
MINARI, LEROBOT = "minari", "lerobot"
LEROBOT_VERSION = "v3.0"
INFO = Path("meta/info.json")
MOST_NUMBERS = 50_000_000  # of all columns and files together
YAWS = ("yaw", "theta", "heading", "angle")
STATE = "observation.state"
OURS = "desirepath/"  # Minari data sets that `desirepath studies export` wrote
LEFT_OUT = "observations and actions are in the data set and were not imported: only poses were"


def kind_of(folder: Path) -> str | None:
    """Whether a folder is such a data set."""
    if (folder / INFO).is_file():
        return LEROBOT
    return MINARI if _minari_data(folder) is not None else None


def read_minari(path: Path, mapping: Mapping, bounds: Bounds = BOUNDS) -> list[Recording]:
    """Every episode of a Minari data set. Raises RecordingError by file, field and row."""
    data = _minari_data(path)
    if data is None:
        raise RecordingError(path.name, "data/metadata.json", None, "is missing; name the folder that has data/ in it")
    about = _json(data / "metadata.json", bounds)
    form = about.get("data_format", "hdf5")
    if form not in ("arrow", "parquet"):
        problem = "arrow and parquet are read; write the data set anew with data_format='arrow'"
        raise RecordingError(path.name, "metadata.json, data_format", form, problem)
    dt_s = mapping.dt_s or (0.2 if str(about.get("dataset_id", "")).startswith(OURS) else None)
    if dt_s is None:
        raise RecordingError(
            path.name, "dt_s", None, "episodes have no times; `dt_s` in the mapping says seconds per step"
        )
    keys = mapping.robot or Keys(field="infos.pose", x=0, y=1, yaw=2)
    found, read = [], _Read()
    episodes = sorted(
        (one for one in data.iterdir() if one.is_dir() and one.name.isdigit()), key=lambda one: int(one.name)
    )
    for episode in episodes[: bounds.runs + 1]:
        parts = sorted(one for one in episode.iterdir() if one.suffix in (".parquet", ".arrow"))
        if not parts:
            raise RecordingError(
                path.name, f"episode {episode.name}", None, "has no .parquet or .arrow file; was it cut?"
            )
        names = {keys.field, *(one.field for one in mapping.people.values())}
        table = _table(parts, sorted(names), bounds, read)
        times = np.asarray(np.arange(len(table)) * dt_s, dtype=np.float64)
        digest = hashlib.sha256("".join(_digest(one, bounds) for one in parts).encode()).hexdigest()
        source = Source(path.name, MINARI, digest)
        found.append(_recording(source, f"{path.name}/{episode.name}", path, table, times, keys, mapping, bounds))
    if not found:
        raise RecordingError(path.name, "data", None, "has no episode")
    return found


def read_lerobot(path: Path, mapping: Mapping, bounds: Bounds = BOUNDS) -> list[Recording]:
    """Every episode of a LeRobotDataset v3. Raises RecordingError by file, field and row."""
    about = _json(path / INFO, bounds)
    version = about.get("codebase_version")
    if version != LEROBOT_VERSION:
        problem = f"only {LEROBOT_VERSION} is read; lerobot converts older ones"
        raise RecordingError(path.name, "info.json, codebase_version", version, problem)
    features = about.get("features")
    if not isinstance(features, dict):
        raise RecordingError(path.name, "info.json, features", features, "must be an object of features by name")
    keys = mapping.robot or _named_place(path.name, features)
    names = sorted({"episode_index", "timestamp", keys.field, *(one.field for one in mapping.people.values())})
    files = sorted((path / "data").rglob("*.parquet"))
    if not files or len(files) > bounds.files:
        raise RecordingError(path.name, "data", len(files), f"Parquet files; 1 to {bounds.files} are read")
    table = _table(files, names, bounds, _Read())
    episodes = _numbers(path.name, table, "episode_index")[:, 0]
    times = _numbers(path.name, table, "timestamp")[:, 0]
    digest = hashlib.sha256("".join(_digest(one, bounds) for one in files).encode()).hexdigest()
    source, found = Source(path.name, LEROBOT, digest), []
    starts = np.flatnonzero(np.diff(episodes, prepend=np.nan) != 0)
    if len(starts) > bounds.runs:
        raise RecordingError(path.name, "episodes", len(starts), f"at most {bounds.runs} are read")
    for first, end in zip(starts, [*starts[1:], len(episodes)], strict=True):
        part = table.slice(first, end - first)
        name = f"{path.name}/{episodes[first]:g}"
        found.append(_recording(source, name, path, part, times[first:end], keys, mapping, bounds))
    if not found:
        raise RecordingError(path.name, "data", None, "has no episode")
    return found


def look_at_fields(path: Path, bounds: Bounds = BOUNDS) -> list[tuple[str, int, tuple[str, ...]]]:
    """The arrays of numbers of a data set: name, numbers in a row, what they are called where it says. Raises
    RecordingError."""
    if kind_of(path) == LEROBOT:
        features = _json(path / INFO, bounds).get("features")
        found = []
        for field, about in (features if isinstance(features, dict) else {}).items():
            shape, names = (about.get(what) for what in ("shape", "names")) if isinstance(about, dict) else (None, None)
            if isinstance(names, dict) and len(names) == 1:
                names = next(iter(names.values()))
            named = tuple(map(str, names)) if isinstance(names, list) else ()
            if isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int):
                found.append((str(field), shape[0], named))
        return found
    data = _minari_data(path)
    episode = (
        min((one for one in data.iterdir() if one.is_dir() and one.name.isdigit()), default=None) if data else None
    )
    parts = sorted(one for one in episode.iterdir() if one.suffix in (".parquet", ".arrow")) if episode else []
    if not parts:
        raise RecordingError(path.name, "data", None, "has no episode")
    try:
        if parts[0].suffix == ".arrow":
            with pa.memory_map(str(parts[0])) as mapped:
                schema = pa.ipc.open_file(mapped).schema
        else:
            schema = pq.read_schema(parts[0])
    except (pa.ArrowException, OSError, ValueError) as wrong:
        raise RecordingError(parts[0].name, "", None, f"is cut or no {parts[0].suffix[1:]} file: {wrong}") from None
    return [(name, width, ()) for one in schema for name, width in _arrays(one.name, one.type)]


def _arrays(name: str, kind: pa.DataType) -> list[tuple[str, int]]:
    """Names and widths of the lists of numbers in a column, `infos.pose` of a struct; width 0: not known."""
    if pa.types.is_struct(kind):
        return [found for one in kind for found in _arrays(f"{name}.{one.name}", one.type)]
    if pa.types.is_fixed_size_list(kind):
        return [(name, kind.list_size)]
    return [(name, 0)] if pa.types.is_list(kind) or pa.types.is_large_list(kind) else []


def _minari_data(folder: Path) -> Path | None:
    return next((one for one in (folder / "data", folder) if (one / "metadata.json").is_file()), None)


def _json(file: Path, bounds: Bounds) -> dict[str, Any]:
    data = parse_json(file.name, read_bounded(file, bounds.json_bytes))
    if not isinstance(data, dict):
        raise RecordingError(file.name, "", type(data).__name__, "must be an object")
    return data


def _digest(file: Path, bounds: Bounds) -> str:
    return sha256_of(read_bounded(file, bounds.file_bytes))


def _named_place(file: str, features: AnyMapping[str, Any]) -> Keys:
    """The feature of which the data set itself says that it is x, y (and yaw): the state, or the only one."""
    found: dict[str, Keys] = {}
    for field, about in features.items():
        names = about.get("names") if isinstance(about, dict) else None
        if isinstance(names, dict) and len(names) == 1:
            names = next(iter(names.values()))
        if isinstance(names, list) and "x" in names and "y" in names and field != "action":
            yaw = next((names.index(one) for one in YAWS if one in names), None)
            found[field] = Keys(field=field, x=names.index("x"), y=names.index("y"), yaw=yaw)
    if STATE in found or len(found) == 1:
        return found.get(STATE) or next(iter(found.values()))
    what = f"several name x and y ({', '.join(found)})" if found else "none names x and y"
    problem = f"{what}; `robot: {{field: {STATE}, x: 0, y: 1, yaw: 2}}` in the mapping says where they are"
    raise RecordingError(file, "info.json, features", list(features)[:10], problem)


@dataclass
class _Read:
    """How much was read of a data set."""

    rows: int = 0
    numbers: int = 0
    bytes: int = 0

    def add(self, where: str, rows: int, numbers: int, size: int, bounds: Bounds) -> None:
        """Raises RecordingError where it is too much with this; before it is read."""
        self.rows, self.numbers, self.bytes = self.rows + rows, self.numbers + numbers, self.bytes + size
        if self.rows > bounds.rows:
            raise RecordingError(where, "rows", self.rows, f"at most {bounds.rows} are read of all files together")
        if self.numbers > MOST_NUMBERS or self.bytes > bounds.file_bytes:
            problem = f"numbers in {self.bytes} bytes; at most {MOST_NUMBERS} in {bounds.file_bytes} are read"
            raise RecordingError(where, "columns", self.numbers, problem)


def _table(files: Sequence[Path], names: Sequence[str], bounds: Bounds, read: _Read) -> pa.Table:
    """These columns of all files."""
    return pa.concat_tables([_table_of(one, names, bounds, read) for one in files])


def _table_of(file: Path, names: Sequence[str], bounds: Bounds, read: _Read) -> pa.Table:
    where = f"{file.parent.name}/{file.name}"
    size = file.stat().st_size
    if not 0 < size <= bounds.file_bytes:
        raise RecordingError(where, "bytes", size, f"must be 1 to {bounds.file_bytes}")
    try:
        if file.suffix == ".arrow":
            with pa.memory_map(str(file)) as mapped:
                return _arrow(where, mapped, names, bounds, read)
        opened = pq.ParquetFile(file)
        _check_columns(where, opened.schema_arrow, names)
        about = opened.metadata
        numbers, unpacked = 0, 0
        for group in range(about.num_row_groups):
            for column in range(about.num_columns):
                one = about.row_group(group).column(column)
                if any(f"{one.path_in_schema}.".startswith(f"{name}.") for name in names):
                    numbers, unpacked = numbers + one.num_values, unpacked + one.total_uncompressed_size
        read.add(where, about.num_rows, numbers, unpacked, bounds)
        return opened.read(columns=list(names))
    except RecordingError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError) as wrong:
        raise RecordingError(where, "", None, f"is cut or no {file.suffix[1:]} file: {wrong}") from None


def _arrow(where: str, mapped: pa.NativeFile, names: Sequence[str], bounds: Bounds, read: _Read) -> pa.Table:
    """Arrow files are read batch by batch."""
    reader = pa.ipc.open_file(mapped)
    _check_columns(where, reader.schema, names)
    batches = []
    for k in range(reader.num_record_batches):
        batch = reader.get_batch(k)
        read.add(where, batch.num_rows, 0, batch.nbytes, bounds)
        batches.append(batch)
    names = sorted({name if name in reader.schema.names else name.split(".")[0] for name in names})
    table = pa.Table.from_batches(batches, reader.schema).select(names)
    table.validate(full=True)
    return pa.table(
        {name: pa.concat_arrays(table[name].chunks) if table[name].chunks else table[name] for name in names}
    )


def _check_columns(where: str, schema: pa.Schema, names: Sequence[str]) -> None:
    """Each is there and holds numbers, or lists of them; `infos.pose` is field pose of the struct infos."""
    for name in names:
        first, *inside = (name,) if name in schema.names else name.split(".")
        if first not in schema.names:
            problem = (
                f"no such column; `robot: {{field: ...}}` in the mapping names one of {', '.join(schema.names[:20])}"
            )
            raise RecordingError(where, "columns", name, problem)
        kind = schema.field(first).type
        for part in inside:
            if not pa.types.is_struct(kind) or kind.get_field_index(part) < 0:
                there = [one.name for one in kind] if pa.types.is_struct(kind) else str(kind)
                raise RecordingError(where, f"column {name}", there, f"has no field {part!r}")
            kind = kind.field(part).type
        of = kind.value_type if _is_list(kind) else kind
        if not (pa.types.is_floating(of) or pa.types.is_integer(of)):
            raise RecordingError(where, f"column {name}", str(of), "must hold numbers, or lists of them")


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_fixed_size_list(kind) or pa.types.is_list(kind) or pa.types.is_large_list(kind))


def _numbers(file: str, table: pa.Table, field: str) -> Doubles:
    """(n, k) of a column of numbers or of lists of one length, as `_check_columns` found it."""
    if field in table.column_names:
        found: Any = table[field].combine_chunks()
    else:
        name, *inside = field.split(".")
        found = table[name].combine_chunks()
        for part in inside:
            found = found.field(part)
    if isinstance(found, pa.ChunkedArray):  # of a table without rows
        found = pa.concat_arrays(found.chunks) if found.num_chunks else pa.array([], found.type)
    width, kind = 1, found.type
    if found.null_count:
        row = int(np.flatnonzero(np.asarray(found.is_null()))[0])
        raise RecordingError(file, f"column {field}, row {row}", None, "is empty; leave such rows out")
    if _is_list(kind):
        lengths = np.asarray(found.value_lengths()) if len(found) else np.zeros(0)
        if len(set(lengths.tolist())) > 1:
            raise RecordingError(
                file, f"column {field}", sorted(set(lengths.tolist()))[:5], "lists must be of one length"
            )
        width = int(lengths[0]) if len(lengths) else 0
        found = found.flatten()
    values = found.to_numpy(zero_copy_only=False).astype(np.float64)
    return np.asarray(values.reshape(len(values) // width if width else 0, width))


def _track(file: str, who: str, table: pa.Table, times: Doubles, keys: Keys, mapping: Mapping, bounds: Bounds) -> Track:
    values = _numbers(file, table, keys.field)
    for name, place in (("x", keys.x), ("y", keys.y), ("yaw", keys.yaw)):
        if place is not None and place >= values.shape[1]:
            problem = f"there are {values.shape[1]} numbers in {keys.field}; count from 0"
            raise RecordingError(file, f"mapping, {who}, {name}", place, problem)
    yaw = values[:, keys.yaw] if keys.yaw is not None else np.full(len(values), np.nan)
    poses = np.stack([values[:, keys.x] - mapping.origin[0], values[:, keys.y] - mapping.origin[1], yaw], axis=1)
    return track(file, who, times, poses, lambda k: f"row {k}", bounds=bounds)


def _recording(
    source: Source,
    run: str,
    path: Path,
    table: pa.Table,
    times: Doubles,
    keys: Keys,
    mapping: Mapping,
    bounds: Bounds,
) -> Recording:
    return Recording(
        source=source,
        run=run,
        scene=path.name,
        robot=_track(run, "the robot", table, times, keys, mapping, bounds),
        people={
            who: _track(run, f"person {who!r}", table, times, of, mapping, bounds)
            for who, of in mapping.people.items()
            if who not in mapping.leave_out
        },
        how=(LEFT_OUT,),
    )

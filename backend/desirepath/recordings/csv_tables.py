"""Recordings as CSV: a row per time and body (`who`), or a column per body (`robot_x_m`, `anna_x_m`).

Units stand in the heads (`x_m`, `x [cm]`) or in the mapping; a head without either is an error, since a guess would be
off by a hundred.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from desirepath.grammar.text_files import NotUtf8Error, decode_utf8
from desirepath.recordings.mapping import ANGLES, LENGTHS, TIMES, Mapping
from desirepath.recordings.recording import (
    BOUNDS,
    Bounds,
    Goal,
    Recording,
    RecordingError,
    Source,
    Thing,
    Track,
    read_bounded,
    sha256_of,
    track,
)

FORMAT = "csv"
SYNONYMS = {
    "time": ("time", "t", "timestamp", "stamp"),
    "x": ("x", "pos_x", "position_x"),
    "y": ("y", "pos_y", "position_y"),
    "yaw": ("yaw", "theta", "heading", "angle", "orientation"),
    "who": ("who", "agent", "id", "name"),
    "kind": ("kind", "type"),
    "run": ("run", "trajectory", "episode", "trial"),
    "scene": ("scene", "place"),
    "length": ("length",),
    "width": ("width",),
    "height": ("height",),
    "radius": ("radius",),
}
"""Our columns, and what heads may call them where the mapping names none."""
OF_UNIT = {"time": TIMES, "yaw": ANGLES} | dict.fromkeys(("x", "y", "length", "width", "height", "radius"), LENGTHS)
NEEDED = ("time", "x", "y")
ROBOT, PERSON, OBSTACLE, GOAL = "robot", "person", "obstacle", "goal"
KINDS = (ROBOT, PERSON, OBSTACLE, GOAL)
PAIR_COLUMNS = ("a", "b")
DELIMITERS = ",;\t"
MOST_COLUMNS = 500
LONGEST_LINE = 1_000_000
LONGEST_CODE = 40
_BRACKETED = re.compile(r"(?P<name>[^\[(]*)[\[(](?P<unit>[^\])]*)[\])]")


@dataclass(frozen=True)
class _Column:
    """Where a number stands, and what makes SI units of it."""

    place: int
    head: str
    scale: float = 1.0


@dataclass
class _Body:
    """Rows of one body in one run: lines, and numbers in SI units."""

    lines: list[int] = field(default_factory=list)
    rows: list[tuple[float, float, float, float]] = field(default_factory=list)  # time, x, y, yaw


@dataclass
class _Run:
    scene: str
    bodies: dict[tuple[str, str], _Body] = field(default_factory=dict)  # (kind, who)
    things: list[Thing] = field(default_factory=list)
    goal: Goal | None = None


def read_csv(path: Path, mapping: Mapping, bounds: Bounds = BOUNDS) -> list[Recording]:
    """The runs of one file. Raises RecordingError by line and column."""
    content = read_bounded(path, bounds.file_bytes)
    source = Source(path.name, FORMAT, sha256_of(content))
    heads, rows = _table(path.name, content, bounds)
    wide = _wide_bodies(heads, mapping)
    runs = (
        _read_wide(path, heads, rows, wide, mapping, bounds) if wide else _read_long(path, heads, rows, mapping, bounds)
    )
    robots = {name: run for name, run in runs.items() if any(kind == ROBOT for kind, _ in run.bodies)}
    if not robots:
        found = sorted({who for run in runs.values() for _, who in run.bodies})[:10]
        raise RecordingError(
            path.name,
            "",
            found,
            f"no robot in it; name it {ROBOT!r} in column who, or give a column kind with {ROBOT!r}",
        )
    return [_recording(source, name, run, bounds) for name, run in robots.items()]


@dataclass(frozen=True)
class GivenPair:
    """A line of a list of pairs: runs or videos a and b; of videos the runs that are their poses, where there are, and
    their seconds, where files do not say them. Each pair of fields is of a and of b."""

    names: tuple[str, str]
    poses: tuple[str, str] = ("", "")
    seconds: tuple[float | None, float | None] = (None, None)


def read_pairs(path: Path, bounds: Bounds = BOUNDS) -> list[GivenPair]:
    """Pairs of a CSV with the columns a and b; poses_a, poses_b, seconds_a and seconds_b may be there for videos."""
    heads, rows = _table(path.name, read_bounded(path, bounds.json_bytes), bounds)
    names = [head.strip().lower() for head in heads]
    for column in PAIR_COLUMNS:
        if column not in names:
            raise RecordingError(path.name, "line 1", heads[:10], f"column {column!r} is missing; pairs need a and b")
    columns = {name: place for place, name in enumerate(names)}
    found = []
    for line, row in rows:

        def cell(what: str, row: list[str] = row) -> str:
            return row[columns[what]].strip() if what in columns else ""

        def seconds(what: str, line: int = line, row: list[str] = row) -> float | None:
            return _number(path.name, line, row, _Column(columns[what], what)) if cell(what, row) else None

        found.append(
            GivenPair(
                (cell("a"), cell("b")),
                (cell("poses_a"), cell("poses_b")),
                (seconds("seconds_a"), seconds("seconds_b")),
            )
        )
    return found


@dataclass(frozen=True)
class GivenAnswer:
    """A line of a file of answers: runs a and b, which of them was chosen, and by whom (a pseudonym)."""

    line: int
    a: str
    b: str
    choice: Literal["a", "b"]
    person: str


def read_answers(path: Path, bounds: Bounds = BOUNDS) -> tuple[list[GivenAnswer], str]:
    """Answers of a CSV with the columns a, b, choice (a, b or the run's name) and, where several people answered,
    person; and the sha256 of the file."""
    content = read_bounded(path, bounds.json_bytes)
    heads, rows = _table(path.name, content, bounds)
    names = [head.strip().lower() for head in heads]
    for column in (*PAIR_COLUMNS, "choice"):
        if column not in names:
            problem = f"column {column!r} is missing; answers need a, b, choice and may have person"
            raise RecordingError(path.name, "line 1", heads[:10], problem)
    found = []
    for line, row in rows:
        of = dict(zip(names, (cell.strip() for cell in row), strict=True))
        fits = [side for side in ("a", "b") if of["choice"] in (side, side.upper(), of[side])]
        if len(fits) != 1:
            sides = f"must be a, b, {of['a']} or {of['b']}"
            problem = f"{sides}, and may mean either here: rename the runs" if fits else sides
            raise RecordingError(path.name, f"line {line}, column choice", of["choice"], problem)
        (chosen,) = fits
        person = of.get("person", "") or "1"
        if len(person) > LONGEST_CODE:
            raise RecordingError(path.name, f"line {line}, column person", person, f"at most {LONGEST_CODE} characters")
        found.append(GivenAnswer(line, of["a"], of["b"], "a" if chosen == "a" else "b", person))
    if not found:
        raise RecordingError(path.name, "", None, "holds no answer")
    return found, sha256_of(content)


def look_at_heads(path: Path, bounds: Bounds = BOUNDS) -> tuple[list[dict[str, Any]], tuple[str, ...]]:
    """What the heads of a table say, as fields of `looking.Column`, and the bodies that have columns of their own."""
    heads, rows = _table(path.name, read_bounded(path, bounds.file_bytes), bounds)
    _, first = next(rows, (0, [""] * len(heads)))
    by_name = {name: ours for ours, names in SYNONYMS.items() for name in names}
    wide = _wide_bodies(heads, Mapping())
    axes = {place: axis for places in wide.values() for axis, place in places.items()}
    found = []
    for place, (head, example) in enumerate(zip(heads, first, strict=True)):
        name, unit = _split_head(head)
        ours = axes.get(place) or by_name.get(name)
        known = OF_UNIT.get(ours or "", {})
        found.append({
            "head": head.strip(), "ours": None if place in axes else ours, "unit": unit if unit in known else None,
            "measured": bool(known), "example": example.strip()[:LONGEST_CODE],
        })  # fmt: skip
    return found, tuple(wide)


def is_pairs(path: Path) -> bool:
    """Whether it is a list of pairs by its name."""
    return path.stem.lower() == "pairs" and path.suffix.lower() == ".csv"


def _table(file: str, content: bytes, bounds: Bounds) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """The heads, and the rows with their lines."""
    lines = content.count(b"\n") + content.count(b"\r")
    if lines > 2 * bounds.rows:  # before any of it is text
        raise RecordingError(file, "lines", lines, f"at most {bounds.rows} rows are read; split the file or thin it")
    try:
        text = decode_utf8(content)
    except NotUtf8Error as wrong:
        raise RecordingError(file, f"line {wrong.line}", None, str(wrong)) from None
    if not text.strip():
        raise RecordingError(file, "", None, "is empty: it has no line but white space")
    longest = max(map(len, text.split("\n")))
    if longest > LONGEST_LINE:
        raise RecordingError(file, "", longest, f"characters in a line; at most {LONGEST_LINE} are read")
    first = text.lstrip("\n").split("\n", 1)[0]
    delimiter = max(DELIMITERS, key=first.count)
    if first.count(delimiter) >= MOST_COLUMNS:
        raise RecordingError(file, "line 1", first.count(delimiter) + 1, f"columns; at most {MOST_COLUMNS} are read")
    reader = csv.reader(io.StringIO(text), delimiter=delimiter)
    try:
        heads = next((row for row in reader if any(cell.strip() for cell in row)), [])
    except csv.Error as wrong:
        raise RecordingError(file, f"line {reader.line_num}", None, f"is no CSV: {wrong}") from None
    if len(heads) > MOST_COLUMNS:
        raise RecordingError(file, "line 1", len(heads), f"columns; at most {MOST_COLUMNS} are read")
    return heads, _rows(file, reader, len(heads), bounds)


def _rows(file: str, reader: Iterator[list[str]], columns: int, bounds: Bounds) -> Iterator[tuple[int, list[str]]]:
    count = 0
    while True:
        try:
            row = next(reader, None)
        except csv.Error as wrong:
            raise RecordingError(file, f"line {reader.line_num}", None, f"is no CSV: {wrong}") from None  # type: ignore[attr-defined]
        if row is None:
            return
        line: int = reader.line_num  # type: ignore[attr-defined]
        if not any(cell.strip() for cell in row):
            continue
        count += 1
        if count > bounds.rows:
            raise RecordingError(
                file, f"line {line}", count, f"at most {bounds.rows} rows are read; thin the recording"
            )
        if len(row) != columns:
            raise RecordingError(file, f"line {line}", len(row), f"cells, the heads are {columns}")
        yield line, row


def _split_head(head: str) -> tuple[str, str | None]:
    """The name and the unit of a head: `x [cm]`, `x (cm)`, `x_cm`."""
    plain = head.strip().lower()
    bracketed = _BRACKETED.fullmatch(plain)
    if bracketed:
        return bracketed["name"].rstrip(" _"), bracketed["unit"].strip()
    name, _, last = plain.rpartition("_")
    if name and any(last in units for units in (LENGTHS, ANGLES, TIMES)):
        return name, last
    return plain, None


def _column(file: str, ours: str, place: int, head: str, mapping: Mapping) -> _Column:
    """Raises RecordingError for a unit that is unknown or not given."""
    known = OF_UNIT.get(ours)
    if known is None:
        return _Column(place, head)
    what = {id(LENGTHS): "length", id(ANGLES): "angle", id(TIMES): "time"}[id(known)]
    unit = _split_head(head)[1] or getattr(mapping.units, what)
    if unit is None:
        example = {"length": "x_m", "angle": "yaw_rad", "time": "time_s"}[what]
        raise RecordingError(
            file,
            "line 1, head",
            head,
            f"names no unit; write it behind the name, as {example}, or `units: {{{what}: ...}}` in the mapping "
            f"({', '.join(known)})",
        )
    if unit not in known:
        raise RecordingError(file, "line 1, head", head, f"unit {unit!r} is unknown; known: {', '.join(known)}")
    return _Column(place, head, known[unit])


def _find(file: str, heads: Sequence[str], mapping: Mapping) -> dict[str, _Column]:
    """Our columns that the table has, by our names."""
    for ours in mapping.columns:
        if ours not in SYNONYMS:
            raise RecordingError(file, "mapping, columns", ours, f"is none of ours: {', '.join(SYNONYMS)}")
    names = [_split_head(head)[0] for head in heads]
    found: dict[str, _Column] = {}
    for ours, synonyms in SYNONYMS.items():
        if ours in mapping.columns:
            theirs = mapping.columns[ours].strip()
            places = [k for k, head in enumerate(heads) if head.strip() == theirs]
            if not places:
                listed = ", ".join(head.strip() for head in heads[:20])
                raise RecordingError(file, "mapping, columns", theirs, f"there is no such column; there are {listed}")
        else:
            places = [k for k, name in enumerate(names) if name in synonyms]
        if len(places) > 1:
            both = [heads[k] for k in places]
            raise RecordingError(
                file, "line 1, heads", both, f"any may be {ours}; `columns: {{{ours}: ...}}` says which"
            )
        if places:
            found[ours] = _column(file, ours, places[0], heads[places[0]], mapping)
    return found


def _number(file: str, line: int, row: Sequence[str], column: _Column) -> float:
    text = row[column.place].strip()
    try:
        value = float(text)
    except ValueError:
        problem = "must be a number, with a point for the decimals" if text else "is empty; leave such rows out"
        raise RecordingError(file, f"line {line}, column {column.head.strip()}", text, problem) from None
    if not math.isfinite(value):
        problem = "must be a finite number; leave such rows out"
        raise RecordingError(file, f"line {line}, column {column.head.strip()}", text, problem)
    return value * column.scale


def _run_of(runs: dict[str, _Run], name: str, scene: str, file: str, line: int, bounds: Bounds) -> _Run:
    if name not in runs:
        if len(runs) >= bounds.runs:
            raise RecordingError(file, f"line {line}", len(runs) + 1, f"runs; at most {bounds.runs} are read")
        runs[name] = _Run(scene)
    return runs[name]


def _body_of(run: _Run, kind: str, who: str, file: str, line: int, bounds: Bounds) -> _Body:
    key = kind, who
    if key not in run.bodies:
        if len(run.bodies) > bounds.people:
            problem = f"people in a run; at most {bounds.people} are shown, `leave_out` names others"
            raise RecordingError(file, f"line {line}", len(run.bodies), problem)
        run.bodies[key] = _Body()
    return run.bodies[key]


def _read_long(
    path: Path, heads: Sequence[str], rows: Iterator[tuple[int, list[str]]], mapping: Mapping, bounds: Bounds
) -> dict[str, _Run]:
    file, found = path.name, _find(path.name, heads, mapping)
    for ours in NEEDED:
        if ours not in found:
            listed = ", ".join(head.strip() for head in heads[:20])
            problem = f"no column for {ours}; name it {SYNONYMS[ours][0]} or map it with `columns`. There are {listed}"
            raise RecordingError(file, "line 1, heads", None, problem)
    runs: dict[str, _Run] = {}
    everywhere: list[tuple[str, Thing]] = []  # scene or "" -> things of rows that name no run
    goals: list[tuple[str, Goal]] = []  # likewise

    def text(row: Sequence[str], ours: str) -> str:
        return row[found[ours].place].strip() if ours in found else ""

    for line, row in rows:
        who = text(row, "who") or ROBOT
        kind = text(row, "kind").lower()
        if not kind:
            kind = who.lower() if who.lower() in (ROBOT, GOAL, OBSTACLE) else PERSON
        elif kind not in KINDS:
            place = f"line {line}, column {found['kind'].head.strip()}"
            raise RecordingError(file, place, kind, f"unknown; one of {', '.join(KINDS)}")
        if who in mapping.leave_out:
            continue
        name, scene = text(row, "run"), text(row, "scene")
        if kind == OBSTACLE:
            thing = _thing(file, line, row, found, who, mapping)
            if name:
                of = _run_of(runs, name, scene or path.stem, file, line, bounds)
                of.things.append(thing)
            else:
                everywhere.append((scene, thing))
            if len(everywhere) > bounds.things:
                raise RecordingError(file, f"line {line}", len(everywhere), f"obstacles; at most {bounds.things}")
            continue
        x, y = _place(file, line, row, found, mapping)
        yaw = _number(file, line, row, found["yaw"]) if text(row, "yaw") else math.nan
        if kind == GOAL:
            radius = _number(file, line, row, found["radius"]) if text(row, "radius") else None
            if radius is not None and radius <= 0:
                raise RecordingError(file, f"line {line}, column {found['radius'].head}", radius, "must be above 0")
            goals.append((scene, Goal(x, y, 0.0 if math.isnan(yaw) else yaw, radius)))
            if name:
                _run_of(runs, name, scene or path.stem, file, line, bounds).goal = goals.pop()[1]
            continue
        run = _run_of(runs, name or path.stem, scene or path.stem, file, line, bounds)
        body = _body_of(run, kind, ROBOT if kind == ROBOT else who, file, line, bounds)
        body.lines.append(line)
        body.rows.append((_number(file, line, row, found["time"]), x, y, yaw))
    for scene, goal in goals:
        for run in runs.values():
            if scene in ("", run.scene) and run.goal is None:
                run.goal = goal
    for scene, thing in everywhere:
        for run in runs.values():
            if scene in ("", run.scene):
                run.things.append(thing)
    return runs


def _place(
    file: str, line: int, row: Sequence[str], found: dict[str, _Column], mapping: Mapping
) -> tuple[float, float]:
    x, y = (_number(file, line, row, found[axis]) for axis in ("x", "y"))
    return x - mapping.origin[0], y - mapping.origin[1]


def _thing(file: str, line: int, row: Sequence[str], found: dict[str, _Column], who: str, mapping: Mapping) -> Thing:
    x, y = _place(file, line, row, found, mapping)
    sizes: dict[str, float | None] = {}
    for ours in ("length", "width", "height"):
        given = ours in found and row[found[ours].place].strip()
        if not given and ours != "height":
            raise RecordingError(file, f"line {line}", who, f"an obstacle needs its {ours}; a column {ours}_m gives it")
        sizes[ours] = _number(file, line, row, found[ours]) if given else None
        value = sizes[ours]
        if value is not None and not 0 < value <= 1_000:
            raise RecordingError(file, f"line {line}, column {found[ours].head.strip()}", value, "must be 0 to 1,000 m")
    yaw = _number(file, line, row, found["yaw"]) if "yaw" in found and row[found["yaw"].place].strip() else 0.0
    length, width, height = sizes["length"], sizes["width"], sizes["height"]
    assert length is not None and width is not None  # noqa: S101, PT018  seen to above
    return Thing(who, x, y, yaw, length, width, height)


def _wide_bodies(heads: Sequence[str], mapping: Mapping) -> dict[str, dict[str, int]]:
    """who -> axis -> place, of heads such as robot_x_m; empty unless there is a robot_x."""
    bodies: dict[str, dict[str, int]] = defaultdict(dict)
    for place, head in enumerate(heads):
        who, _, axis = _split_head(head)[0].rpartition("_")
        if who and axis in ("x", "y", "yaw") and who not in ("pos", "position"):
            bodies[who][axis] = place
    return dict(bodies) if "x" in bodies.get(ROBOT, {}) and not mapping.columns.get("x") else {}


def _read_wide(
    path: Path,
    heads: Sequence[str],
    rows: Iterator[tuple[int, list[str]]],
    wide: dict[str, dict[str, int]],
    mapping: Mapping,
    bounds: Bounds,
) -> dict[str, _Run]:
    file, found = path.name, _find(path.name, heads, mapping)
    if "time" not in found:
        raise RecordingError(file, "line 1, heads", None, "no column for time; name it time_s or map it with `columns`")
    columns: dict[str, dict[str, _Column]] = {}
    for who, places in wide.items():
        if missing := [axis for axis in ("x", "y") if axis not in places]:
            raise RecordingError(file, "line 1, heads", who, f"has no {who}_{missing[0]}; places need x and y")
        columns[who] = {axis: _column(file, axis, place, heads[place], mapping) for axis, place in places.items()}
    runs: dict[str, _Run] = {}
    for line, row in rows:
        name = (row[found["run"].place].strip() if "run" in found else "") or path.stem
        scene = (row[found["scene"].place].strip() if "scene" in found else "") or path.stem
        run, time_s = _run_of(runs, name, scene, file, line, bounds), _number(file, line, row, found["time"])
        for who, axes in columns.items():
            if who in mapping.leave_out or (who != ROBOT and not row[axes["x"].place].strip()):
                continue  # who is not there has empty cells
            x, y = _place(file, line, row, axes, mapping)
            yaw = (
                _number(file, line, row, axes["yaw"]) if "yaw" in axes and row[axes["yaw"].place].strip() else math.nan
            )
            if who == GOAL:
                run.goal = Goal(x, y, 0.0 if math.isnan(yaw) else yaw)
                continue
            body = _body_of(run, ROBOT if who == ROBOT else PERSON, who, file, line, bounds)
            body.lines.append(line)
            body.rows.append((time_s, x, y, yaw))
    return runs


def _recording(source: Source, name: str, run: _Run, bounds: Bounds) -> Recording:
    tracks: dict[tuple[str, str], Track] = {}
    for (kind, who), body in run.bodies.items():
        values = np.array(body.rows, dtype=np.float64)
        called = ROBOT if kind == ROBOT else f"person {who!r}"
        tracks[kind, who] = track(
            source.file,
            f"{called} in run {name!r}",
            values[:, 0],
            values[:, 1:],
            lambda k, lines=body.lines: f"line {lines[k]}",  # type: ignore[misc]
            bounds=bounds,
            gaps=kind == PERSON,
        )
    return Recording(
        source=source,
        run=name,
        scene=run.scene,
        robot=next(found for (kind, _), found in tracks.items() if kind == ROBOT),
        people={who: found for (kind, who), found in tracks.items() if kind == PERSON},
        things=tuple(run.things),
        goal=run.goal,
    )

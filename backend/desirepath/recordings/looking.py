"""What is in a recording before anybody said which of it is what: columns, topics, fields; what their names suggest.

Nothing becomes a trajectory here; that is `importing.py`'s, by the mapping that somebody makes of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from desirepath.recordings import bags, csv_tables, episodes, socnav3, videos
from desirepath.recordings.importing import find_files
from desirepath.recordings.mapping import Mapping
from desirepath.recordings.recording import BOUNDS, Bounds, RecordingError


@dataclass(frozen=True)
class Column:
    """head: as it stands in the table; ours: what its name says it is; unit: that its name gives; example: of line 2.
    measured: whether it needs a unit."""

    head: str
    ours: str | None
    unit: str | None
    measured: bool
    example: str


@dataclass(frozen=True)
class Topic:
    """fits: which of `Topics` in the mapping it may be, by its type. count: of messages."""

    name: str
    type: str
    count: int
    fits: tuple[str, ...]


@dataclass(frozen=True)
class Field:
    """An array of a data set of episodes. width: numbers in a row, names: of them, where the data set says."""

    name: str
    width: int
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Found:
    """file: the one that was looked into, of `files` of its format; formats: of all. bodies: of a table with a column
    per body. pairs, answers: whether a list of them lies with the recordings."""

    files: int
    file: str
    format: str
    formats: tuple[str, ...]
    columns: tuple[Column, ...] = ()
    bodies: tuple[str, ...] = ()
    topics: tuple[Topic, ...] = ()
    fields: tuple[Field, ...] = ()
    pairs: bool = False

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def look(path: Path, bounds: Bounds = BOUNDS, answers: Path | None = None) -> Found:
    """What is in the first recording at `path`; the others are taken to be alike. Raises RecordingError."""
    files, pair_file = find_files(path, Mapping(), bounds, answers)
    file, kind = next((one for one in files if one[1] != videos.FORMAT), files[0])
    seen: dict[str, Any] = {}
    if kind == csv_tables.FORMAT:
        columns, seen["bodies"] = csv_tables.look_at_heads(file, bounds)
        seen["columns"] = tuple(Column(**one) for one in columns)
    elif kind in (bags.MCAP, bags.ROSBAG2):
        there = bags.look_at_topics(file, bounds)
        seen["topics"] = tuple(Topic(name, type_, count, _fits(type_)) for name, (type_, count) in there.items())
    elif kind in (episodes.MINARI, episodes.LEROBOT):
        seen["fields"] = tuple(Field(*one) for one in episodes.look_at_fields(file, bounds))
    elif kind not in (socnav3.FORMAT, videos.FORMAT):
        raise RecordingError(file.name, "format", kind, "cannot be looked into")
    formats = tuple(sorted({form for _, form in files}))
    return Found(len(files), file.name, kind, formats, pairs=pair_file is not None, **seen)


def _fits(kind: str) -> tuple[str, ...]:
    return tuple(what for what, kinds in bags.FITS.items() if kind in kinds)


def suggest(found: Found) -> Mapping:
    """The mapping that names suggest: the usual topic of a type, else the one with the most messages; a field that the
    data set itself calls x, y."""
    given: dict[str, Any] = {}
    if found.topics:
        usual = Mapping().topics
        given["topics"] = {what: _usual(found.topics, what, getattr(usual, what)) for what in bags.FITS}
        if given["topics"]["pose"] is None:
            del given["topics"]["pose"]
    if found.fields:
        place = next((one for one in found.fields if {"x", "y"} <= set(one.names)), None)
        place = place or next((one for one in found.fields if one.width in (2, 3)), found.fields[0])
        named = {axis: place.names.index(axis) for axis in ("x", "y", "yaw") if axis in place.names}
        yaw = 2 if place.width > 2 and not place.names else None
        given["robot"] = {"field": place.name, "x": 0, "y": min(1, place.width - 1), "yaw": yaw} | named
    return Mapping.model_validate(given)


def _usual(topics: Sequence[Topic], what: str, usual: str | None) -> str | None:
    fitting = [one for one in topics if what in one.fits and one.count]
    if any(one.name == usual for one in fitting):
        return usual
    return max(fitting, key=lambda one: one.count).name if fitting else None

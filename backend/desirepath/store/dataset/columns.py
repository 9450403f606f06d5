"""What the tables of a data set are made of: columns with a type and a meaning, and the names of its files."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from desirepath.simulation.recorded import Video

FORMAT = "desirepath-dataset-6"
STUDY_FILE = "study.json"
CHECKSUMS_FILE = "checksums.sha256"
DICTIONARY_FILE = "data-dictionary.md"
PROTOCOL_FOLDER = "protocol"
TRAJECTORY_FOLDER = "trajectories"
VIDEO_FOLDER = "videos"
VIDEO_ENDINGS = {"video/mp4": "mp4", "video/webm": "webm"}
DEMONSTRATION_FOLDER = "demonstrations"

TEXT, WHOLE, NUMBER, YES_NO = pa.string(), pa.int64(), pa.float64(), pa.bool_()
MOMENT = pa.timestamp("us", tz="UTC")
FLOATS = pa.list_(pa.float32())

SHA = "[0-9a-f]{64}"
IS_SHA = re.compile(SHA)
IS_ID = re.compile(r"[0-9A-Za-z_-]{1,32}")
IS_CODE = re.compile(r"[0-9A-Za-z][0-9A-Za-z-]{0,15}")
IS_KEY = re.compile(r"[^\x00-\x1f]{1,80}")


@dataclass(frozen=True)
class Column:
    """One column. json: the text is a JSON value. form: how its texts are written, where they are ids."""

    name: str
    type: pa.DataType
    meaning: str
    json: bool = False
    form: re.Pattern[str] | None = None

    def type_name(self) -> str:
        """The type in words a reader of CSV understands."""
        words = {TEXT: "text", WHOLE: "whole number", NUMBER: "number", YES_NO: "true/false", MOMENT: "time, UTC ISO"}
        return "text, JSON" if self.json else words.get(self.type, "list of numbers")


@dataclass(frozen=True)
class Table:
    """One table: one row per `row`. key: the columns that tell its rows apart. refers: (column, table, column of that
    table that it names)."""

    name: str
    row: str
    columns: tuple[Column, ...]
    csv: bool = True
    key: tuple[str, ...] = ()
    refers: tuple[tuple[str, str, str], ...] = ()

    def schema(self) -> pa.Schema:
        """The Parquet schema; every column says what it means."""
        return pa.schema(
            [pa.field(c.name, c.type, metadata={"meaning": c.meaning}) for c in self.columns],
            metadata={"format": FORMAT, "row": self.row},
        )

    def kept_in(self, model: Any) -> list[str]:
        """The columns that a class of the database has under the same names."""
        return [column.name for column in self.columns if column.name in model.__table__.columns]

    def unpack(self, row: dict[str, Any]) -> dict[str, Any]:
        """The row with its JSON columns as plain data. Raises ValueError naming the column that is no JSON."""
        unpacked = dict(row)
        for column in self.columns:
            if column.json and unpacked.get(column.name) is not None:
                try:
                    unpacked[column.name] = json.loads(unpacked[column.name])
                except (ValueError, RecursionError):
                    raise ValueError(
                        f"{column.name} = {unpacked[column.name][:80]!r} is no JSON that can be read"
                    ) from None
        return unpacked


def video_name(video: Video) -> str:
    """The file of a video in VIDEO_FOLDER."""
    return f"{video.sha256}.{VIDEO_ENDINGS[video.media]}"

"""What the tables of a data set are made of: columns with a type and a meaning, and the names of its files."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

FORMAT = "desirepath-dataset-6"
# 3 has no strokes.walk; 4 no responses.device, and fixed completion codes in the protocol; 5 other names of columns,
# the plan in `sessions` and neither conditions of questionnaires nor metrics
READABLE = ("desirepath-dataset-3", "desirepath-dataset-4", "desirepath-dataset-5", FORMAT)
STUDY_FILE = "study.json"
CHECKSUMS_FILE = "checksums.sha256"
DICTIONARY_FILE = "data-dictionary.md"
PROTOCOL_FOLDER = "protocol"
TRAJECTORY_FOLDER = "trajectories"
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
    """One column. json: the text is a JSON value. newer: older data sets that can still be read do not have it. former:
    what it was called in those of before format 6. form: how its texts are written, where they are ids."""

    name: str
    type: pa.DataType
    meaning: str
    json: bool = False
    newer: bool = False
    former: str | None = None
    form: re.Pattern[str] | None = None

    def type_name(self) -> str:
        """The type in words a reader of CSV understands."""
        words = {TEXT: "text", WHOLE: "whole number", NUMBER: "number", YES_NO: "true/false", MOMENT: "time, UTC ISO"}
        return "text, JSON" if self.json else words.get(self.type, "list of numbers")

    def formerly(self) -> str:
        """What the dictionary says of the name it had."""
        return f" (`{self.former}` before format 6)" if self.former else ""


@dataclass(frozen=True)
class Table:
    """One table: one row per `row`. key: the columns that tell its rows apart. refers: (column, table, column of that
    table that it names). older_columns: of data sets of before format 6 alone. newer: older data sets that can still be
    read do not have the table."""

    name: str
    row: str
    columns: tuple[Column, ...]
    csv: bool = True
    key: tuple[str, ...] = ()
    refers: tuple[tuple[str, str, str], ...] = ()
    older_columns: tuple[Column, ...] = ()
    newer: bool = False

    def all_columns(self) -> Iterator[Column]:
        yield from self.columns
        yield from self.older_columns

    def schema(self) -> pa.Schema:
        """The Parquet schema; every column says what it means."""
        return pa.schema(
            [pa.field(c.name, c.type, metadata={"meaning": c.meaning}) for c in self.columns],
            metadata={"format": FORMAT, "row": self.row},
        )

    def unpacked(self, row: dict[str, Any]) -> dict[str, Any]:
        """The row with its JSON columns as plain data. Raises ValueError naming the column that is no JSON."""
        found = dict(row)
        for column in self.all_columns():
            if column.json and found.get(column.name) is not None:
                try:
                    found[column.name] = json.loads(found[column.name])
                except (ValueError, RecursionError):
                    raise ValueError(
                        f"{column.name} = {found[column.name][:80]!r} is no JSON that can be read"
                    ) from None
        return found

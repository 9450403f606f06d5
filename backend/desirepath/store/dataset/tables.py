"""The tables of a data set, every column with its meaning, as `tables.yaml` has them. Filling them lives in `rows.py`,
files in `writing.py`.

The one source of the Parquet schemas, the data dictionary, the descriptions that tools read, and the import.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from desirepath.grammar.source import Source, file_text
from desirepath.store.dataset.columns import (
    FLOATS,
    IS_CODE,
    IS_ID,
    IS_KEY,
    IS_SHA,
    MOMENT,
    NUMBER,
    TEXT,
    WHOLE,
    YES_NO,
    Column,
    Table,
)

_FILE = Path(__file__).with_name("tables.yaml")
_TYPES = {"text": TEXT, "whole": WHOLE, "number": NUMBER, "yes_no": YES_NO, "moment": MOMENT, "floats": FLOATS}
_FORMS = {"sha": IS_SHA, "id": IS_ID, "code": IS_CODE, "key": IS_KEY}


def _read_tables(file: Path) -> tuple[Table, ...]:
    data = Source(file.name, file_text(file)).data
    stored: dict[str, dict[str, Any]] = data["tables"]

    def column(name: str, own: list[str] | None) -> Column:
        type_name, meaning = own or data["shared"][name]
        kind = _TYPES.get(type_name, TEXT)
        return Column(name, kind, meaning, json=type_name == "json", form=_FORMS.get(type_name))

    return tuple(
        Table(
            name,
            table["row"],
            tuple(column(*of) for of in table["columns"].items()),
            csv=table.get("csv", True),
            key=tuple(table["key"]),
            refers=tuple((of, other, stored[other]["key"][0]) for of, other in table.get("refers", {}).items()),
        )
        for name, table in stored.items()
    )


TABLES = _read_tables(_FILE)
PARTICIPANTS, SESSIONS, PLANNED_STEPS, TRIALS, RESPONSES, ITEMS, TUNING_CHANGES, RANKINGS = TABLES[:8]
CODEBOOK, CODINGS, EVENTS, PAIRS, STROKES, HEAD_POSES, TRAJECTORIES, METRICS, STEPS = TABLES[8:]

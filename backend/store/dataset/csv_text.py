"""Tables as CSV that a spreadsheet neither runs nor tears apart. What is in them is `rows.py`'s."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any

from backend.store.dataset.columns import Table

_LINE_END = re.compile(r"\r\n?")
_FORMULA = re.compile(r"^(?=[=+\-@\t])", re.MULTILINE)  # what a spreadsheet takes for one, in every line of a cell
_NEEDS_QUOTES = re.compile(r'[",\n]')


def csv_text(table: Table, rows: Iterable[Mapping[str, Any]]) -> str:
    """The table as it lies in a data set: one header line, cells quoted where they must be, lines end with a line feed.

    Carriage returns within a cell become line feeds: alone, and unquoted, they end a row for many readers.
    """
    names = [column.name for column in table.columns]
    lines = [",".join(names), *(",".join(_cell(row[name]) for name in names) for row in rows)]
    return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    """One cell; text that a spreadsheet would run as a formula is made plain text."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, datetime):
        return value.isoformat(timespec="microseconds")
    if not isinstance(value, str):
        return str(value)
    plain = _FORMULA.sub("'", _LINE_END.sub("\n", value))
    if plain.startswith("\n"):
        plain = f"'{plain}"
    if _NEEDS_QUOTES.search(plain):
        return '"' + plain.replace('"', '""') + '"'
    return plain

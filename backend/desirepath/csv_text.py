"""Tables as CSV that a spreadsheet neither runs nor tears apart; whatever leaves as CSV is written here."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable

_LINE_END = re.compile(r"\r\n?")
_FORMULA = re.compile(
    # Where a spreadsheet may see a cell begin: in every line of a text, and behind the semicolon by which a German one
    # parts the columns of any CSV; and what it takes for a formula there, in letters of either width.
    r"(^|[;\v\f\x1c-\x1e\x85\u2028\u2029])(?= *[=+\-@\t\uff1d\uff0b\uff0d\uff20])",
    re.MULTILINE,
)


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """The rows, the heads first, with cells quoted where they must be; lines end with a line feed.

    Carriage returns within a cell become line feeds: alone, and unquoted, they end a row for many readers.
    """
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(map(_cell, row) for row in rows)
    return out.getvalue()


def _cell(value: object) -> object:
    """Text that a spreadsheet would run as a formula is made plain text; a number stays one."""
    if not isinstance(value, str) or _is_number(value):
        return value
    plain = _FORMULA.sub(r"\1'", _LINE_END.sub("\n", value))
    return f"'{plain}" if plain.startswith("\n") else plain


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and text == text.strip()

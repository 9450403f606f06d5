"""What the dissertation prints, as data: a YAML file a chapter, read here, set beside ours by the reports."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from desirepath.grammar.error_words import parse
from desirepath.grammar.parts import Part
from desirepath.grammar.source import Source, file_text

Compared = Literal["at least", "at most"]


class PrintedTable(Part):
    """A printed table, or numbers that a text gives.

    lines: where they stand in the dissertation's text. units: by measure. ours: what is set beside them in
    `compared.csv`, an expression of `condition`, `measure` and the report's values. compared: by condition and measure,
    whether ours should be at least or at most as large; where nothing is said, it is only looked at. rows: by condition
    and measure, as printed.
    """

    source: str
    lines: str
    units: dict[str, str]
    ours: str
    compared: dict[str, dict[str, Compared]] = Field(default_factory=dict)
    rows: dict[str, dict[str, float | str | None]]


class Published(Part):
    """A chapter's tables by name, and single numbers that its report or its plan asks for."""

    tables: dict[str, PrintedTable] = Field(default_factory=dict)
    numbers: dict[str, float] = Field(default_factory=dict)

    def __getitem__(self, table: str) -> dict[str, dict[str, Any]]:
        """The rows of a table."""
        return self.tables[table].rows


@cache
def published(chapter: str) -> Published:
    """Raises ProtocolError for a file that says something else."""
    path = Path(__file__).with_name(f"{chapter}.yaml")
    return parse(Source(path.name, file_text(path)), Published)

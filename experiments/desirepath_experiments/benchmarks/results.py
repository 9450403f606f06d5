"""What a benchmark leaves: a result as a file of `experiments/results`, and what is there already if it is stopped."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

MANY_ROWS = 10


@dataclass(frozen=True)
class Progress:
    """Whom a long benchmark tells how far it is, and the file in which unfinished results survive a stop."""

    tell: Callable[[str], None] = lambda words: None
    out: Path | None = None

    def keep(self, result: dict[str, Any]) -> None:
        """Write what is there so far, whole."""
        if self.out is not None:
            self.out.parent.mkdir(parents=True, exist_ok=True)
            self.out.write_text(json.dumps(result), encoding="utf-8")

    def kept_persons(self, setup: str, config: Any) -> list[dict[str, Any]]:
        """The persons of an unfinished run with the same settings."""
        if self.out is None or not self.out.is_file():
            return []
        stored = json.loads(self.out.read_text(encoding="utf-8"))
        same = stored.get("setup") == setup and stored.get("config") == json.loads(json.dumps(asdict(config)))
        return list(stored["persons"]) if same and isinstance(stored["persons"], list) else []


def write_result(out: Path, result: dict[str, Any]) -> None:
    """A result as a file of `experiments/results`: its command and commit, numbers to five digits. Many rows become a
    CSV file beside it (`people.persons.csv` of `people.json`), which a diff can show, and the JSON names that."""
    from desirepath.learning.cards import short, source_commit

    command = " ".join(["desirepath", *map(_drop_folder, sys.argv[1:])])
    written = {"command": command, "commit": source_commit()} | short(result)
    out.parent.mkdir(parents=True, exist_ok=True)
    for key, rows in written.items():
        if isinstance(rows, list) and len(rows) >= MANY_ROWS and all(isinstance(row, dict) for row in rows):
            table = out.with_name(f"{out.stem}.{key}.csv")
            flat = [_flatten(row) for row in rows]
            columns = list(dict.fromkeys(name for row in flat for name in row))
            with table.open("w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, columns, lineterminator="\n")
                writer.writeheader()
                writer.writerows(flat)
            written[key] = table.name
    out.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


def _flatten(row: dict[str, Any]) -> dict[str, Any]:
    """Nested values as columns `outer.inner`, lists as JSON."""
    cells: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, dict):
            cells |= {f"{name}.{inner}": cell for inner, cell in _flatten(value).items()}
        else:
            cells[name] = value if isinstance(value, str) else json.dumps(value)
    return cells


def _drop_folder(argument: str) -> str:
    """An argument without the folders of this machine: of a path that begins at the root its name alone."""
    option, sign, value = argument.rpartition("=")
    return f"{option}{sign}{Path(value).name}" if value.startswith("/") else argument

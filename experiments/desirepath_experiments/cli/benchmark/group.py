"""The group that every benchmark is a command of, and how their results are written."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from desirepath.cli.output import say

commands = typer.Typer(help="Measure speed; every ratio comes from one run on this machine.", no_args_is_help=True)


def seed_range(seeds: str) -> tuple[int, ...]:
    """(0, 1, 2, 3, 4) of 0-4, (7,) of 7. Raises BadParameter."""
    first, _, last = seeds.partition("-")
    if not first.isdigit() or not (last or first).isdigit():
        raise typer.BadParameter(f"seeds = {seeds}: such as 0-4")
    return tuple(range(int(first), int(last or first) + 1))


MANY_ROWS = 10
OutOption = Annotated[Path | None, typer.Option(help="Also write the result to this file, as JSON.")]


def tell(words: str) -> None:
    """How far it is, for who waits at the terminal; no part of the result."""
    typer.echo(words, err=True)


def say_and_write(result: dict[str, Any], out: Path | None, as_json: bool) -> None:
    """Print a result, and write it where a file is named."""
    if out is not None:
        write_result(out, result)
    say(result, as_json)


def write_result(out: Path, result: dict[str, Any]) -> None:
    """A result as a file of `experiments/results`: its command and commit, numbers to five digits. Many rows become a
    CSV file beside it (`people.persons.csv` of `people.json`), which a diff can show, and the JSON names that."""
    from desirepath.learning.cards import short, source_commit

    command = " ".join(["desirepath", *map(_without_folder, sys.argv[1:])])
    write_with_tables(out, {"command": command, "commit": source_commit()} | short(result))


def write_with_tables(out: Path, result: dict[str, Any]) -> None:
    """Write `result` to `out`, its lists of rows to CSV files. Nested values are columns `outer.inner`, lists JSON."""
    out.parent.mkdir(parents=True, exist_ok=True)
    written = dict(result)
    for key, rows in result.items():
        if isinstance(rows, list) and len(rows) >= MANY_ROWS and all(isinstance(row, dict) for row in rows):
            table = out.with_name(f"{out.stem}.{key}.csv")
            flat = [_columns(row) for row in rows]
            with table.open("w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(
                    file, list(dict.fromkeys(name for row in flat for name in row)), lineterminator="\n"
                )
                writer.writeheader()
                writer.writerows(flat)
            written[key] = table.name
    out.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


def _columns(row: dict[str, Any]) -> dict[str, Any]:
    cells: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, dict):
            cells |= {f"{name}.{inner}": cell for inner, cell in _columns(value).items()}
        else:
            cells[name] = value if isinstance(value, str) else json.dumps(value)
    return cells


def _without_folder(argument: str) -> str:
    """What was given on the command line, a path that begins at the root by its name alone: folders are a machine's."""
    option, sign, given = argument.rpartition("=")
    return f"{option}{sign}{Path(given).name}" if given.startswith("/") else argument

"""The group that every benchmark is a command of, and how their results are written."""

from __future__ import annotations

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
    """A result as a file that datasets/ can hold: its command and commit, numbers to five digits."""
    from desirepath.learning.cards import short, source_commit

    out.parent.mkdir(parents=True, exist_ok=True)
    command = " ".join(["desirepath", *map(_without_folder, sys.argv[1:])])
    written = {"command": command, "commit": source_commit()} | short(result)
    out.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


def _without_folder(argument: str) -> str:
    """What was given on the command line, a path that begins at the root by its name alone: folders are a machine's."""
    option, sign, given = argument.rpartition("=")
    return f"{option}{sign}{Path(given).name}" if given.startswith("/") else argument

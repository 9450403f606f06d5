"""How people may say what they want: in words, by hand, by choices, by drawings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from desirepath.cli.output import JsonFlag, plain_errors
from desirepath_experiments.cli.benchmark.group import commands, say_and_write


@commands.command()
@plain_errors
def words(
    part: Annotated[str, typer.Option(help="test, or development (the only one to look at while tuning).")] = "test",
    out: Annotated[Path | None, typer.Option(help="Also write everything to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """How well wishes in plain English and German become preference weights, case by case."""
    from desirepath_experiments.benchmarks.words import benchmark_words

    if part not in ("test", "development"):
        raise typer.BadParameter(f"part = {part}: test or development")
    chosen: Literal["test", "development"] = "test" if part == "test" else "development"
    result = benchmark_words(chosen)
    say_and_write(result, out, as_json)

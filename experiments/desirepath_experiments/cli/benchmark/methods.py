"""How people may say what they want: in words, by hand, by choices, by drawings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from desirepath.cli.output import JsonFlag, plain_errors, say
from desirepath_experiments.cli.benchmark.group import commands, say_and_write, seed_range, write_result


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


@commands.command()
@plain_errors
def telling(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "study_room",
    seeds: Annotated[str, typer.Option(help="FIRST-LAST; each has scenes, pairs and hands of its own.")] = "0-2",
    candidates: Annotated[int, typer.Option(min=20, help="Weights that drawn paths are compared with.")] = 600,
    out: Annotated[Path | None, typer.Option(help="Also write every row to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated people say what they prefer by 15 choices, four drawn paths, sliders and a sentence: how far off each
    is."""
    from desirepath_experiments.benchmarks.ways_of_telling import TellingConfig, benchmark_telling

    config = TellingConfig(setup=setup, candidates=candidates)
    result = benchmark_telling(seed_range(seeds), config, lambda done, _: typer.echo(f"{done:.0%}", err=True))
    if out is not None:
        write_result(out, result)
    say({name: value for name, value in result.items() if name != "rows"}, as_json)

"""A command of a function of its configuration: options of the fields, one result printed, and written with `--out`."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from desirepath.cli.options import OptionsOf
from desirepath.cli.output import JsonFlag, in_data_folder, say
from desirepath_experiments.benchmarks.results import Progress, write_result

OUT = Annotated[Path | None, typer.Option(help="Also write the result to this file, as JSON.")]


def parse_seeds(seeds: str) -> tuple[int, ...]:
    """(0, 1, 2, 3, 4) of 0-4, (7,) of 7. Raises BadParameter."""
    first, _, last = seeds.partition("-")
    if not first.isdigit() or not (last or first).isdigit():
        raise typer.BadParameter(f"seeds = {seeds}: such as 0-4")
    return tuple(range(int(first), int(last or first) + 1))


def make_command(run: Callable[..., dict[str, Any]], config: OptionsOf) -> Callable[..., None]:
    """A command that calls `run(config, progress)` and tells what it returns."""

    def command(*, out: Path | None = None, as_json: bool = False, **given: Any) -> None:
        result = run(config.read(given), Progress(lambda words: typer.echo(words, err=True), out))
        if out is not None:
            write_result(out, result)
        say(result, as_json)

    options = config.parameters()
    for name, annotation, default in (("out", OUT, None), ("as_json", JsonFlag, False)):
        options.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation))
    command.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    command.__annotations__ = {option.name: option.annotation for option in options}
    return in_data_folder(command)

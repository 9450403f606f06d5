"""`desirepath reproduce ...`: a published chapter computed anew, with its report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from backend.commands.output import JsonFlag, plain_errors, say

commands = typer.Typer(help="Compute a published chapter anew, with its report.", no_args_is_help=True)


@commands.callback()
def chapters() -> None:
    """One command per chapter."""


@commands.command()
@plain_errors
def enquery(
    out: Annotated[Path, typer.Option(help="Folder for report, figures and finished work; again: it goes on there.")],
    budget: Annotated[str, typer.Option(help="small (minutes) or full (hours); an estimate is told first.")] = "small",
    seed: Annotated[int, typer.Option(min=0, max=99)] = 0,
    processes: Annotated[int, typer.Option(min=1, help="One thread each.")] = 2,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 6: ensembles, reward models, aligned policies, flow fields."""
    from backend.reproduction.enquery import BUDGETS
    from backend.reproduction.run import reproduce_enquery

    if budget not in BUDGETS:
        raise LookupError(f"--budget {budget!r}: known are {', '.join(BUDGETS)}")
    # The folder is no part of what has to be typed again, and may be private.
    command = f"desirepath reproduce enquery --out DIR --budget {budget} --seed {seed} --processes {processes}"
    console = Console(stderr=True)
    say(
        reproduce_enquery(
            out,
            BUDGETS[budget],
            seed=seed,
            processes=processes,
            command=command,
            tell=lambda words: console.print(words, highlight=False, soft_wrap=True),
        ),
        as_json,
    )


@commands.command()
@plain_errors
def demonstrations(
    out: Annotated[Path, typer.Option(help="Folder for report, figures and finished work; again: it goes on there.")],
    budget: Annotated[str, typer.Option(help="small (minutes) or full (hours); an estimate is told first.")] = "small",
    processes: Annotated[int, typer.Option(min=1, help="One thread each.")] = 2,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 2: programmed demonstrators, personal controllers, DWA and social cost beside them."""
    from backend.reproduction.demonstrations import BUDGETS
    from backend.reproduction.demonstrations_run import reproduce_demonstrations

    if budget not in BUDGETS:
        raise LookupError(f"--budget {budget!r}: known are {', '.join(BUDGETS)}")
    command = f"desirepath reproduce demonstrations --out DIR --budget {budget} --processes {processes}"
    console = Console(stderr=True)
    say(
        reproduce_demonstrations(
            out,
            BUDGETS[budget],
            processes=processes,
            command=command,
            tell=lambda words: console.print(words, highlight=False, soft_wrap=True),
        ),
        as_json,
    )

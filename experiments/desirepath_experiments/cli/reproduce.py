"""`desirepath reproduce CHAPTER`: a published chapter, reproduced, with its report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from desirepath.cli.output import COMMAND_LINE, JsonFlag, in_data_folder, say
from desirepath_experiments.cli.options import parse_seeds


class Where(StrEnum):
    """Where a chapter's tasks are computed."""

    here = "here"
    workers = "workers"


class Name(StrEnum):
    """The dissertation's chapters that are reproduced."""

    demonstrations = "demonstrations"  # 2
    depth = "depth"  # 3
    pedestrians = "pedestrians"  # 4
    adaptable = "adaptable"  # 5
    enquery = "enquery"  # 6
    interface = "interface"  # 7
    explanations = "explanations"  # 8


@in_data_folder
def commands(
    chapter: Annotated[
        Name,
        typer.Argument(
            help="Chapter 2: demonstrations (personal controllers, DWA and social cost beside them); 3: depth (encoder "
            "and predictor, six configurations in homes); 4: pedestrians (attention, baselines, planners); 5: "
            "adaptable (policies for all weights of three objectives); 6: enquery (ensembles, reward models, aligned "
            "policies); 7: interface (three views); 8: explanations (48 scenarios, simulated rankers)."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for report, figures and finished work; again: it goes on there.")],
    budget: Annotated[
        str,
        typer.Option(
            help="small (minutes), full; chapter 2: long, 3: quick (half of small), 5 and 6: medium (an hour)."
        ),
    ] = "small",
    seed: Annotated[int | None, typer.Option(min=0, max=99, help="Of chapters 6, 7 and 8; default 0.")] = None,
    seeds: Annotated[str | None, typer.Option(help="Of chapter 3: FIRST-LAST; default the budget's own.")] = None,
    processes: Annotated[int | None, typer.Option(min=1, help="One thread each; default 2, of chapter 3 one.")] = None,
    device: Annotated[
        str | None, typer.Option(help="Of chapter 4: what trains, cpu, or cuda where a GPU is there; default cpu.")
    ] = None,
    on: Annotated[
        Where,
        typer.Option(help="workers: as jobs on the queue of this installation, over all its workers and machines."),
    ] = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Reproduce a published chapter, with its report."""
    from desirepath_experiments.reproduction.driver import chapter_named, reproduce

    wanted = chapter_named(chapter)
    if budget not in wanted.budgets:
        raise LookupError(f"--budget {budget!r}: known are {', '.join(wanted.budgets)}")
    typed_options: dict[str, Any] = {"seed": seed, "seeds": seeds, "device": device}
    typed = {name: value for name, value in typed_options.items() if value is not None}
    options = {name: parse_seeds(value) if name == "seeds" else value for name, value in typed.items()}
    processes = processes or wanted.processes
    console = Console(stderr=True)
    more = "".join(f"--{name} {value} " for name, value in typed.items())
    with _compute_on(on, chapter):
        summary = reproduce(
            wanted,
            out,
            wanted.budgets[budget],
            processes=processes,
            # The folder is no part of what has to be typed again, and may be private.
            command=f"desirepath reproduce {chapter} --out DIR --budget {budget} {more}--processes {processes}",
            tell=lambda words: console.print(words, highlight=False, soft_wrap=True),
            **options,
        )
    say(summary, as_json)


@contextmanager
def _compute_on(on: Where, chapter: str) -> Iterator[None]:
    """Compute what the block asks for there."""
    if on is Where.here:
        yield
        return
    from desirepath.cli.study import open_store
    from desirepath_experiments.reproduction.on_workers import Queue
    from desirepath_experiments.reproduction.tasks import ELSEWHERE

    database, files = open_store()
    before = ELSEWHERE.set(Queue(chapter, database, files, created_by=COMMAND_LINE))
    try:
        yield
    finally:
        ELSEWHERE.reset(before)

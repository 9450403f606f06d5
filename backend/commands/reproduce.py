"""`desirepath reproduce ...`: a published chapter computed anew, with its report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console

from backend.commands.output import COMMAND_LINE, JsonFlag, plain_errors, say


class Where(StrEnum):
    """Where a chapter's tasks are computed."""

    here = "here"
    workers = "workers"


commands = typer.Typer(help="Compute a published chapter anew, with its report.", no_args_is_help=True)

Out = Annotated[Path, typer.Option(help="Folder for report, figures and finished work; again: it goes on there.")]
BudgetName = Annotated[str, typer.Option(help="small (minutes), full; chapter 6: medium (an hour), chapter 2: long.")]
Processes = Annotated[int, typer.Option(min=1, help="One thread each.")]
On = Annotated[
    Where, typer.Option(help="workers: as jobs on the queue of this installation, over all its workers and machines.")
]
Budget = TypeVar("Budget")


@commands.callback()
def chapters() -> None:
    """One command per chapter."""


@commands.command()
@plain_errors
def enquery(
    out: Out,
    budget: BudgetName = "small",
    seed: Annotated[int, typer.Option(min=0, max=99)] = 0,
    processes: Processes = 2,
    on: On = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 6: ensembles, reward models, aligned policies, flow fields."""
    from backend.experiments.reproduction.enquery.budgets import BUDGETS
    from backend.experiments.reproduction.enquery.run import reproduce_enquery

    chosen = _chosen(BUDGETS, budget)
    run = _run("enquery", budget, processes, f"--seed {seed} ")
    with _computed_on(on, "enquery"):
        say(reproduce_enquery(out, chosen, seed=seed, **run), as_json)


@commands.command()
@plain_errors
def demonstrations(
    out: Out,
    budget: BudgetName = "small",
    processes: Processes = 2,
    on: On = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 2: programmed demonstrators, personal controllers, DWA and social cost beside them."""
    from backend.experiments.reproduction.demonstrations.plan import BUDGETS
    from backend.experiments.reproduction.demonstrations.run import reproduce_demonstrations

    chosen = _chosen(BUDGETS, budget)
    with _computed_on(on, "demonstrations"):
        say(reproduce_demonstrations(out, chosen, **_run("demonstrations", budget, processes)), as_json)


@commands.command()
@plain_errors
def interface(
    out: Out,
    budget: BudgetName = "small",
    seed: Annotated[int, typer.Option(min=0, max=9)] = 0,
    processes: Processes = 2,
    on: On = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 7: simulated people in three views, a reward model and a policy per view; tables 7.1 to 7.3."""
    from backend.experiments.reproduction.interface.run import BUDGETS, reproduce_interface

    chosen = _chosen(BUDGETS, budget)
    run = _run("interface", budget, processes, f"--seed {seed} ")
    with _computed_on(on, "interface"):
        say(reproduce_interface(out, chosen, seed=seed, **run), as_json)


@commands.command()
@plain_errors
def adaptable(
    out: Out,
    budget: BudgetName = "small",
    processes: Processes = 2,
    on: On = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 5: rewards from demonstrations, policies for all weights of three objectives; table 5.1."""
    from backend.experiments.reproduction.adaptable.plan import BUDGETS
    from backend.experiments.reproduction.adaptable.run import reproduce_adaptable

    chosen = _chosen(BUDGETS, budget)
    with _computed_on(on, "adaptable"):
        say(reproduce_adaptable(out, chosen, **_run("adaptable", budget, processes)), as_json)


@commands.command()
@plain_errors
def depth(
    out: Out,
    budget: BudgetName = "small",
    processes: Processes = 1,
    on: On = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 3: encoder and predictor, six configurations in furnished homes among people who walk."""
    from backend.experiments.reproduction.depth.plan import BUDGETS
    from backend.experiments.reproduction.depth.run import reproduce_depth

    chosen = _chosen(BUDGETS, budget)
    with _computed_on(on, "depth"):
        say(reproduce_depth(out, chosen, **_run("depth", budget, processes)), as_json)


@commands.command()
@plain_errors
def pedestrians(
    out: Out,
    budget: BudgetName = "small",
    processes: Processes = 2,
    device: Annotated[str, typer.Option(help="What trains: cpu, or cuda where a GPU is there.")] = "cpu",
    on: On = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 4: attention networks, ablations, baselines and planners among pedestrians; table 4.1."""
    from backend.experiments.reproduction.pedestrians.plan import BUDGETS
    from backend.experiments.reproduction.pedestrians.run import reproduce_pedestrians

    chosen = _chosen(BUDGETS, budget)
    run = _run("pedestrians", budget, processes, f"--device {device} ")
    with _computed_on(on, "pedestrians"):
        say(reproduce_pedestrians(out, chosen, device=device, **run), as_json)


@commands.command()
@plain_errors
def explanations(
    out: Out,
    budget: BudgetName = "small",
    seed: Annotated[int, typer.Option(min=0, max=99)] = 0,
    processes: Processes = 2,
    on: On = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 8: the policy, its 48 scenarios, simulated rankers with and without outlines; tables 8.1 and 8.2."""
    from backend.experiments.reproduction.explanations.run import BUDGETS, reproduce_explanations

    chosen = _chosen(BUDGETS, budget)
    run = _run("explanations", budget, processes, f"--seed {seed} ")
    with _computed_on(on, "explanations"):
        say(reproduce_explanations(out, chosen, seed=seed, **run), as_json)


def _chosen(budgets: Mapping[str, Budget], name: str) -> Budget:
    if name not in budgets:
        raise LookupError(f"--budget {name!r}: known are {', '.join(budgets)}")
    return budgets[name]


def _run(chapter: str, budget: str, processes: int, more: str = "") -> dict[str, Any]:
    """What every chapter's run is given. The folder is no part of what has to be typed again, and may be private."""
    console = Console(stderr=True)
    return {
        "processes": processes,
        "command": f"desirepath reproduce {chapter} --out DIR --budget {budget} {more}--processes {processes}",
        "tell": lambda words: console.print(words, highlight=False, soft_wrap=True),
    }


@contextmanager
def _computed_on(on: Where, chapter: str) -> Iterator[None]:
    """Compute what the block asks for there."""
    if on is Where.here:
        yield
        return
    from backend.commands.study import open_store
    from backend.experiments.reproduction.on_workers import Queue
    from backend.experiments.reproduction.running import ELSEWHERE

    database, files = open_store()
    before = ELSEWHERE.set(Queue(chapter, database, files, created_by=COMMAND_LINE))
    try:
        yield
    finally:
        ELSEWHERE.reset(before)

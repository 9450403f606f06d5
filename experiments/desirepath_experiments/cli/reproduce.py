"""`desirepath reproduce ...`: a published chapter, reproduced, with its report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console

from desirepath.cli.output import COMMAND_LINE, JsonFlag, plain_errors, say
from desirepath_experiments.cli.benchmark.group import seed_range


class Where(StrEnum):
    """Where a chapter's tasks are computed."""

    here = "here"
    workers = "workers"


commands = typer.Typer(help="Reproduce a published chapter, with its report.", no_args_is_help=True)

Out = Annotated[Path, typer.Option(help="Folder for report, figures and finished work; again: it goes on there.")]
BudgetName = Annotated[
    str,
    typer.Option(help="small (minutes), full; chapter 2: long, 3: quick (half of small), 5 and 6: medium (an hour)."),
]
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
    from desirepath_experiments.reproduction.enquery.budgets import BUDGETS
    from desirepath_experiments.reproduction.enquery.run import reproduce_enquery

    _reproduce("enquery", reproduce_enquery, BUDGETS, budget, out, processes, on, as_json, seed=seed)


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
    from desirepath_experiments.reproduction.demonstrations.plan import BUDGETS
    from desirepath_experiments.reproduction.demonstrations.run import reproduce_demonstrations

    _reproduce("demonstrations", reproduce_demonstrations, BUDGETS, budget, out, processes, on, as_json)


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
    from desirepath_experiments.reproduction.interface.run import BUDGETS, reproduce_interface

    _reproduce("interface", reproduce_interface, BUDGETS, budget, out, processes, on, as_json, seed=seed)


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
    from desirepath_experiments.reproduction.adaptable.plan import BUDGETS
    from desirepath_experiments.reproduction.adaptable.run import reproduce_adaptable

    _reproduce("adaptable", reproduce_adaptable, BUDGETS, budget, out, processes, on, as_json)


@commands.command()
@plain_errors
def depth(
    out: Out,
    budget: BudgetName = "small",
    processes: Processes = 1,
    seeds: Annotated[str | None, typer.Option(help="FIRST-LAST; default the budget's own.")] = None,
    on: On = Where.here,
    as_json: JsonFlag = False,
) -> None:
    """Chapter 3: encoder and predictor, six configurations in furnished homes among people who walk."""
    from desirepath_experiments.reproduction.depth.plan import BUDGETS
    from desirepath_experiments.reproduction.depth.run import reproduce_depth

    budgets = BUDGETS
    if seeds is not None:
        budgets = {name: replace(one, seeds=seed_range(seeds)) for name, one in BUDGETS.items()}
    typed = f"--seeds {seeds} " if seeds is not None else ""
    _reproduce("depth", reproduce_depth, budgets, budget, out, processes, on, as_json, typed=typed)


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
    from desirepath_experiments.reproduction.pedestrians.plan import BUDGETS
    from desirepath_experiments.reproduction.pedestrians.run import reproduce_pedestrians

    _reproduce("pedestrians", reproduce_pedestrians, BUDGETS, budget, out, processes, on, as_json, device=device)


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
    from desirepath_experiments.reproduction.explanations.run import BUDGETS, reproduce_explanations

    _reproduce("explanations", reproduce_explanations, BUDGETS, budget, out, processes, on, as_json, seed=seed)


def _reproduce(
    chapter: str,
    reproduce: Callable[..., dict[str, Any]],
    budgets: Mapping[str, Budget],
    budget: str,
    out: Path,
    processes: int,
    on: Where,
    as_json: bool,
    typed: str = "",
    **options: Any,
) -> None:
    """Compute a chapter and say what came of it. options: those that the chapter has besides everybody's; typed: what
    the budgets were changed by, as it was typed."""
    if budget not in budgets:
        raise LookupError(f"--budget {budget!r}: known are {', '.join(budgets)}")
    console = Console(stderr=True)
    more = typed + "".join(f"--{name} {value} " for name, value in options.items())
    with _computed_on(on, chapter):
        found = reproduce(
            out,
            budgets[budget],
            processes=processes,
            # The folder is no part of what has to be typed again, and may be private.
            command=f"desirepath reproduce {chapter} --out DIR --budget {budget} {more}--processes {processes}",
            tell=lambda words: console.print(words, highlight=False, soft_wrap=True),
            **options,
        )
        say(found, as_json)


@contextmanager
def _computed_on(on: Where, chapter: str) -> Iterator[None]:
    """Compute what the block asks for there."""
    if on is Where.here:
        yield
        return
    from desirepath.cli.study import open_store
    from desirepath_experiments.reproduction.on_workers import Queue
    from desirepath_experiments.reproduction.running import ELSEWHERE

    database, files = open_store()
    before = ELSEWHERE.set(Queue(chapter, database, files, created_by=COMMAND_LINE))
    try:
        yield
    finally:
        ELSEWHERE.reset(before)

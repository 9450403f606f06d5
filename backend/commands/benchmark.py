"""`desirepath benchmark ...`: speed, with ratios taken in one run."""

from __future__ import annotations

from typing import Annotated

import typer

from backend.commands.output import JsonFlag, plain_errors, say

commands = typer.Typer(help="Measure speed; every ratio comes from one run on this machine.", no_args_is_help=True)


@commands.command()
@plain_errors
def simulate(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field", as_json: JsonFlag = False
) -> None:
    """Steps per second of the fast engine against PyBullet, one thread each."""
    from backend.simulation.benchmark import benchmark_simulate

    say(benchmark_simulate(setup=setup), as_json)


@commands.command()
@plain_errors
def train(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field",
    seeds: Annotated[int, typer.Option(min=1, help="Number of trainings per arm.")] = 1,
    arms: Annotated[str, typer.Option(help="Any of fast,sb3_fast,sb3_pybullet.")] = "fast,sb3_fast,sb3_pybullet",
    as_json: JsonFlag = False,
) -> None:
    """Seconds until a base policy reaches 94 % success, ours against Stable-Baselines3."""
    from backend.learning.benchmark import benchmark_train

    say(benchmark_train(setup=setup, seeds=seeds, arms=tuple(arms.split(","))), as_json)


@commands.command()
@plain_errors
def align(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field",
    mode: Annotated[str, typer.Option(help="instant, refine, from_base or thesis.")] = "refine",
    oracle: Annotated[str, typer.Option(help="Who answers.")] = "min-human-distance",
    queries: Annotated[int, typer.Option(min=2)] = 15,
    seed: Annotated[int, typer.Option()] = 0,
    noise: Annotated[float, typer.Option(min=0.0, max=1.0)] = 0.0,
    as_json: JsonFlag = False,
) -> None:
    """Seconds from the last answer to a policy ready to show, and what it gained on fresh scenes."""
    from backend.learning.benchmark_align import benchmark_align

    result = benchmark_align(setup=setup, mode=mode, oracle=oracle, queries=queries, seed=seed, noise=noise)
    say(result, as_json)


@commands.command()
@plain_errors
def serve(
    sessions: Annotated[int, typer.Option(min=1, help="Participants at once.")] = 20,
    answers: Annotated[int, typer.Option(min=1, help="Answers each of them gives.")] = 15,
    during_alignment: Annotated[bool, typer.Option(help="Let alignments run meanwhile.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Many participants at once, each with a real websocket to the stage: is every acknowledged answer stored?"""
    from backend.commands.benchmark_serve import benchmark_serve

    say(benchmark_serve(sessions=sessions, answers=answers, during_alignment=during_alignment), as_json)

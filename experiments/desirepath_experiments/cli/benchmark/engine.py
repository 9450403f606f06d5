"""Speed and parity of simulation, training and evaluation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from desirepath.cli.options import RESPONSE_MODEL, Configured, configured
from desirepath.cli.output import JsonFlag, plain_errors, say
from desirepath_experiments.cli.benchmark.group import OutOption, commands, say_and_write

if TYPE_CHECKING:
    from desirepath.learning.preferences.oracles import ResponseModel


@commands.command()
@plain_errors
def simulate(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field", as_json: JsonFlag = False
) -> None:
    """Steps per second of the fast engine against PyBullet, one thread each."""
    from desirepath_experiments.benchmarks.engines import benchmark_simulate

    say(benchmark_simulate(setup=setup), as_json)


@commands.command()
@plain_errors
def train(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field",
    seeds: Annotated[int, typer.Option(min=1, help="Number of trainings per arm.")] = 1,
    arms: Annotated[str, typer.Option(help="Any of fast,sb3_fast,sb3_pybullet.")] = "fast,sb3_fast,sb3_pybullet",
    keep: Annotated[
        Path | None, typer.Option(help="Keep finished trainings in this file; a broken run goes on from there.")
    ] = None,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Seconds until a base policy reaches 94 % success, ours against Stable-Baselines3."""
    from desirepath_experiments.benchmarks.base_training import benchmark_train

    result = benchmark_train(setup=setup, seeds=seeds, arms=tuple(arms.split(",")), keep=keep)
    say_and_write(result, out, as_json)


@commands.command()
@plain_errors
def parity(
    policy: Annotated[str, typer.Option(help="A shipped name such as study_room/base, or a path.")] = "open_field/base",
    scenes: Annotated[int, typer.Option(min=2)] = 1_000,
    seed: Annotated[int, typer.Option()] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Success on the fast engine against PyBullet with wheel motors, same scenes. Takes minutes."""
    from desirepath_experiments.benchmarks.parity import benchmark_parity

    say(benchmark_parity(policy=policy, scenes=scenes, seed=seed), as_json)


@commands.command(cls=Configured)
@plain_errors
@configured(response_model=replace(RESPONSE_MODEL, without=("peak_end",)))
def align(
    response_model: ResponseModel,
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field",
    mode: Annotated[
        str, typer.Option(help="instant, conditioning_search, fine_tuning or thesis.")
    ] = "conditioning_search",
    oracle: Annotated[str, typer.Option(help="Who answers.")] = "min-human-distance",
    queries: Annotated[int, typer.Option(min=2)] = 15,
    seed: Annotated[int, typer.Option()] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Seconds from the last answer to a policy ready to show, and what it gained on fresh scenes."""
    from desirepath_experiments.benchmarks.alignment import benchmark_align

    result = benchmark_align(
        setup=setup,
        mode=mode,
        oracle=oracle,
        queries=queries,
        seed=seed,
        response_model=response_model,
    )
    say(result, as_json)


@commands.command()
@plain_errors
def crowds(
    pedestrians: Annotated[int, typer.Option(min=1, max=18, help="Moving ones in every scene.")] = 8,
    as_json: JsonFlag = False,
) -> None:
    """Steps per second among pedestrians against PyBullet, one thread each."""
    from desirepath_experiments.benchmarks.crowds import benchmark_crowds

    say(benchmark_crowds(pedestrians=pedestrians), as_json)

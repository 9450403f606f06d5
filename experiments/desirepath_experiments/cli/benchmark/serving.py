"""The server: sessions, pages, joins, and studies walked as participants would."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from desirepath.cli.output import JsonFlag, plain_errors, say
from desirepath_experiments.cli.benchmark.group import OutOption, commands, say_and_write, tell


@commands.command()
@plain_errors
def serve(
    sessions: Annotated[int, typer.Option(min=1, help="Participants at once.")] = 20,
    answers: Annotated[int, typer.Option(min=1, help="Answers each of them gives.")] = 2,
    pace: Annotated[
        float | None,
        typer.Option(
            help="Seconds between two answers of one participant; default 20 as people take, and as much less "
            "with fewer than 50 participants."
        ),
    ] = None,
    during_alignment: Annotated[bool, typer.Option(help="Let alignments run meanwhile.")] = False,
    processes: Annotated[
        int, typer.Option(min=1, help="Server processes; more than one on a PostgreSQL server of the benchmark's own.")
    ] = 1,
    postgresql: Annotated[bool, typer.Option("--postgresql", help="On PostgreSQL with one process, too.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Many participants at once, each with a real websocket to the stage: is every acknowledged answer stored?"""
    from desirepath_experiments.benchmarks.serving import benchmark_serve

    result = benchmark_serve(
        sessions=sessions,
        answers=answers,
        pace_s=pace,
        during_alignment=during_alignment,
        processes=processes,
        postgresql=postgresql,
    )
    say(result, as_json)


@commands.command()
@plain_errors
def soak(
    sessions: Annotated[int, typer.Option(min=1, help="Participants at once.")] = 50,
    minutes: Annotated[float, typer.Option(min=0.1, help="How long; the last round ends whole.")] = 30.0,
    answers: Annotated[int, typer.Option(min=1, help="Answers of each participant, then fresh ones come.")] = 15,
    pace: Annotated[float, typer.Option(help="Seconds between two answers of one participant.")] = 20.0,
    processes: Annotated[
        int, typer.Option(min=1, help="Server processes; more than one on a PostgreSQL server of the benchmark's own.")
    ] = 1,
    postgresql: Annotated[bool, typer.Option("--postgresql", help="On PostgreSQL with one process, too.")] = False,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Participants come and go for half an hour: do the server's memory, open files and threads stay as they are?"""
    from desirepath_experiments.benchmarks.soaking import benchmark_soak

    result = benchmark_soak(
        sessions=sessions,
        minutes=minutes,
        answers=answers,
        pace_s=pace,
        processes=processes,
        postgresql=postgresql,
        tell=tell,
    )
    say_and_write(result, out, as_json)


@commands.command()
@plain_errors
def faults(
    kills: Annotated[int, typer.Option(min=1, help="How often something is killed.")] = 20,
    participants: Annotated[int, typer.Option(min=1, help="Who answer all the while.")] = 6,
    processes: Annotated[int, typer.Option(min=1, help="Server processes.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Of the moments and of what is killed.")] = 0,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Kill servers, workers and connections at random moments under load, fill the disk: what was lost? On a PostgreSQL
    server of its own."""
    from desirepath_experiments.benchmarks.faults import benchmark_faults

    result = benchmark_faults(
        kills=kills,
        participants=participants,
        processes=processes,
        seed=seed,
        tell=tell,
    )
    say_and_write(result, out, as_json)


@commands.command()
@plain_errors
def pages(
    studies: Annotated[int, typer.Option(min=1, help="Studies in the installation.")] = 20,
    participants: Annotated[int, typer.Option(min=1, help="Simulated people in each of them.")] = 31,
    restarts: Annotated[int, typer.Option(min=1, help="Starts of the server that are timed.")] = 5,
    joining: Annotated[int, typer.Option(min=1, help="People who join at once.")] = 40,
    data: Annotated[
        Path | None, typer.Option(help="Keep the installation in this folder, or take the one that is there.")
    ] = None,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """What people wait for: restart to the first page, every page of the lab, joining all at once."""
    from desirepath_experiments.benchmarks.pages import benchmark_pages

    result = benchmark_pages(
        studies=studies,
        participants=participants,
        restarts=restarts,
        joining=joining,
        data=data,
        tell=tell,
    )
    say_and_write(result, out, as_json)


@commands.command()
@plain_errors
def rest(
    minutes: Annotated[float, typer.Option(min=0.1, help="How long nobody is there.")] = 3.0,
    restarts: Annotated[int, typer.Option(min=1, help="Starts on a folder that is there.")] = 3,
    jobs: Annotated[int, typer.Option(min=0, help="Jobs that are queued one after another then.")] = 10,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """The demo with nobody there: processor time, disk writes, wake-ups, memory; seconds to start; how soon a job
    begins."""
    from desirepath_experiments.benchmarks.at_rest import benchmark_rest

    say_and_write(benchmark_rest(minutes=minutes, restarts=restarts, jobs=jobs, tell=tell), out, as_json)


@commands.command()
@plain_errors
def finish(
    participants: Annotated[int, typer.Option(min=1, help="Who give their last answer at the same moment.")] = 10,
    oracle: Annotated[str, typer.Option(help="Who answers.")] = "min-human-distance",
    seed: Annotated[int, typer.Option()] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Everybody finishes at once: seconds from the last answer to the policy, and to the search behind it."""
    from desirepath_experiments.benchmarks.finishing import benchmark_finish

    say(benchmark_finish(participants=participants, oracle=oracle, seed=seed), as_json)


@commands.command()
@plain_errors
def live(
    inputs: Annotated[int, typer.Option(min=20, help="Inputs per control and hand.")] = 120,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """From the hand on a weight to the robot's new way in the picture, in Chromium, milliseconds."""
    from desirepath_experiments.benchmarks.live_controls import benchmark_live

    result = benchmark_live(inputs=inputs, tell=tell)
    say_and_write(result, out, as_json)

"""Simulated cohorts through the whole analysis: false findings and power."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from desirepath.cli.output import JsonFlag, plain_errors
from desirepath_experiments.cli.benchmark.group import commands, say_and_write


@commands.command("null-cohorts")
@plain_errors
def null_cohorts_command(
    cohorts: Annotated[int, typer.Option(min=0, help="Studies in which nothing differs, analysed whole.")] = 1_000,
    participants: Annotated[int, typer.Option(min=2)] = 31,
    ratings_alone: Annotated[
        int, typer.Option(min=0, help="Further cohorts that only rate, for the family of ten items.")
    ] = 100_000,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="Also write the table to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: how often the analysis of the interface study finds something where there is nothing."""
    from dataclasses import asdict

    from desirepath.report.analysis_plan import AnalysisPlan
    from desirepath_experiments.cohorts.null_cohorts import null_cohorts
    from desirepath_experiments.cohorts.null_ratings import null_family

    plan = AnalysisPlan()
    rates = null_cohorts(cohorts, participants, seed=seed, plan=plan) if cohorts else []
    if ratings_alone:
        rates.append(null_family(ratings_alone, participants, seed=seed, alpha=plan.alpha))
    result = {
        "simulated": True,
        "cohorts": cohorts,
        "participants": participants,
        "seed": seed,
        "alpha": plan.alpha,
        "correction": plan.correction,
        "rates": [asdict(rate) for rate in rates],
    }
    say_and_write(result, out, as_json)


@commands.command("design-cohorts")
@plain_errors
def design_cohorts_command(
    cohorts: Annotated[int, typer.Option(min=1)] = 1_000,
    participants: Annotated[str, typer.Option(help="Numbers of people.")] = "6,12,31",
    effect: Annotated[
        float, typer.Option(help="Standard deviations by which one condition is rated higher; 0: nothing differs.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="Also write the table to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: how often each test of each design finds something, where nothing differs or where something does."""
    from desirepath_experiments.cohorts.design_cohorts import design_cohorts

    sizes = [int(number) for number in participants.split(",") if number.strip().isdecimal()]
    rates = design_cohorts(cohorts, sizes, effect=effect, seed=seed)
    result = {"simulated": True, "cohorts": cohorts, "effect": effect, "seed": seed, "alpha": 0.05, "rates": rates}
    say_and_write(result, out, as_json)


@commands.command("further-cohorts")
@plain_errors
def further_cohorts_command(
    cohorts: Annotated[int, typer.Option(min=1)] = 200,
    participants: Annotated[str, typer.Option(help="Numbers of people.")] = "6,12,31",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="Also write the table to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: how often what stands beside the declared tests is said rightly and wrongly."""
    from desirepath_experiments.cohorts.further_cohorts import further_cohorts

    sizes = [int(number) for number in participants.split(",") if number.strip().isdecimal()]
    result = {"simulated": True, "seed": seed, "alpha": 0.05, "rates": further_cohorts(cohorts, sizes, seed=seed)}
    say_and_write(result, out, as_json)


@commands.command("ranking-cohorts")
@plain_errors
def ranking_cohorts_command(
    cohorts: Annotated[int, typer.Option(min=1, help="Studies of 24 people, 12 rankings in each of 2 x 2.")] = 1_000,
    participants: Annotated[int, typer.Option(min=3)] = 24,
    null: Annotated[
        bool, typer.Option("--null/--published", help="Nothing differs, or what chapter 8 found is put in.")
    ] = True,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="Also write the table to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: how often the analysis of importance rankings finds an effect of outlines and lidar."""
    from dataclasses import asdict, replace

    from desirepath.report.simulated_rankers import PUBLISHED, RankerCohort
    from desirepath_experiments.cohorts.ranking_cohorts import ranking_cohorts

    cohort = replace(RankerCohort() if null else PUBLISHED, seed=seed)
    rates, taus = ranking_cohorts(cohort, cohorts, participants)
    result = {
        "simulated": True,
        "cohorts": cohorts,
        "participants": participants,
        "alpha": 0.05,
        "correction": "holm",
        "cohort": asdict(cohort),
        "mean_tau": taus,
        "rates": [asdict(rate) for rate in rates],
    }
    say_and_write(result, out, as_json)


@commands.command("known-cohorts")
@plain_errors
def known_cohorts_command(
    cohort: Annotated[
        Path | None, typer.Option(help="YAML of what is put in; without it what `benchmark study` puts in.")
    ] = None,
    cohorts: Annotated[int, typer.Option(min=1)] = 500,
    participants: Annotated[int, typer.Option(min=2)] = 31,
    seed: Annotated[int | None, typer.Option(min=0, help="Default: the cohort's own.")] = None,
    out: Annotated[Path | None, typer.Option(help="Also write the table to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: how often the analysis finds what was put into studies whose views differ, and anything else."""
    from dataclasses import asdict, replace

    from desirepath.report.analysis_plan import AnalysisPlan
    from desirepath.report.simulated_cohorts import VIEWS_DIFFER, read_cohort
    from desirepath_experiments.cohorts.known_cohorts import known_cohorts

    plan = AnalysisPlan()
    made_of = VIEWS_DIFFER if cohort is None else read_cohort(cohort)
    made_of = made_of if seed is None else replace(made_of, seed=seed)
    result = {
        "simulated": True,
        "cohorts": cohorts,
        "participants": participants,
        "alpha": plan.alpha,
        "correction": plan.correction,
        "cohort": made_of.as_dict(),
        "rates": [asdict(rate) for rate in known_cohorts(made_of, cohorts, participants, plan=plan)],
    }
    say_and_write(result, out, as_json)

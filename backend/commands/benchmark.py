"""`desirepath benchmark ...`: speed, with ratios taken in one run."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from backend.commands.output import IndifferenceOption, JsonFlag, MyopiaOption, NoiseOption, plain_errors, say

commands = typer.Typer(help="Measure speed; every ratio comes from one run on this machine.", no_args_is_help=True)


@commands.command()
@plain_errors
def simulate(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field", as_json: JsonFlag = False
) -> None:
    """Steps per second of the fast engine against PyBullet, one thread each."""
    from backend.experiments.benchmarks.engines import benchmark_simulate

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
    ablation_seeds: Annotated[
        int, typer.Option(min=0, help="So many seeds of our training with one thing changed, to tell causes apart.")
    ] = 0,
    instructions: Annotated[
        str, typer.Option(help="avx2, avx512 or both: ours and SB3 on the fast engine once for each, instead.")
    ] = "",
    beside: Annotated[
        str, typer.Option(help="With --instructions: numbers of processes that multiply matrices meanwhile.")
    ] = "0,1",
    out: Annotated[Path | None, typer.Option(help="Also write the result to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Seconds until a base policy reaches 94 % success, ours against Stable-Baselines3."""
    if instructions:
        from backend.experiments.benchmarks.training_cases import benchmark_cases

        cases = benchmark_cases(
            setup=setup,
            seeds=seeds,
            instructions=instructions.split(","),
            beside=[int(number) for number in beside.split(",") if number.strip().isdecimal()],
            tell=lambda words: typer.echo(words, err=True),
        )
        if out is not None:
            _write(out, cases)
        say(cases, as_json)
        return
    from backend.experiments.benchmarks.base_training import benchmark_train

    result = benchmark_train(
        setup=setup, seeds=seeds, arms=tuple(arms.split(",")), keep=keep, ablation_seeds=ablation_seeds
    )
    if out is not None:
        _write(out, result)
    say(result, as_json)


@commands.command()
@plain_errors
def limits(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field", as_json: JsonFlag = False
) -> None:
    """How far an update and the simulator are from the core's matrix products and memory."""
    from backend.experiments.benchmarks.limits import benchmark_limits

    say(benchmark_limits(setup=setup), as_json)


@commands.command()
@plain_errors
def evaluate(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field",
    episodes: Annotated[int, typer.Option(min=1)] = 2_000,
    as_json: JsonFlag = False,
) -> None:
    """Seconds to roll out many episodes at once, and to make one flow-field plot."""
    from backend.experiments.benchmarks.batched_evaluation import benchmark_evaluate

    say(benchmark_evaluate(setup=setup, episodes=episodes), as_json)


@commands.command()
@plain_errors
def explanations(
    policy: Annotated[
        str, typer.Option(help="A shipped name such as study_room/base, an id or a path.")
    ] = "study_room/base",
    scenes: Annotated[int, typer.Option(min=2)] = 40,
    seed: Annotated[int, typer.Option()] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Are explanations true? Deletion and insertion against random orders, per method; milliseconds."""
    from backend.commands.science import find_policy
    from backend.experiments.benchmarks.explanations import benchmark_explanations

    say(benchmark_explanations(find_policy(policy), policy, scenes=scenes, seed=seed), as_json)


@commands.command()
@plain_errors
def parity(
    policy: Annotated[str, typer.Option(help="A shipped name such as study_room/base, or a path.")] = "open_field/base",
    scenes: Annotated[int, typer.Option(min=2)] = 1_000,
    seed: Annotated[int, typer.Option()] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Success on the fast engine against PyBullet with wheel motors, same scenes. Takes minutes."""
    from backend.experiments.benchmarks.parity import benchmark_parity

    say(benchmark_parity(policy=policy, scenes=scenes, seed=seed), as_json)


@commands.command()
@plain_errors
def align(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "open_field",
    mode: Annotated[
        str, typer.Option(help="instant, conditioning_search, fine_tuning or thesis.")
    ] = "conditioning_search",
    oracle: Annotated[str, typer.Option(help="Who answers.")] = "min-human-distance",
    queries: Annotated[int, typer.Option(min=2)] = 15,
    seed: Annotated[int, typer.Option()] = 0,
    noise: NoiseOption = 0.0,
    indifference: IndifferenceOption = 0.0,
    myopia: MyopiaOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Seconds from the last answer to a policy ready to show, and what it gained on fresh scenes."""
    from backend.experiments.benchmarks.alignment import benchmark_align

    result = benchmark_align(
        setup=setup,
        mode=mode,
        oracle=oracle,
        queries=queries,
        seed=seed,
        noise=noise,
        indifference=indifference,
        myopia_s=myopia,
    )
    say(result, as_json)


@commands.command()
@plain_errors
def asking(
    query_set: Annotated[str, typer.Argument(help="A shipped query set or a file.")] = "study_room/queries_200",
    oracles: Annotated[str, typer.Option(help="Comma-separated; default all.")] = "",
    response_models: Annotated[
        str,
        typer.Option("--response-models", "--habits", help="Any of right,lapses,indifference,myopia; default all."),
    ] = "",
    answers: Annotated[int, typer.Option(min=1)] = 30,
    repetitions: Annotated[int, typer.Option(min=2)] = 20,
    seed: Annotated[int, typer.Option()] = 0,
    plain: Annotated[str, typer.Option(help="Another query set, asked at random, to compare with.")] = "",
    out: Annotated[Path | None, typer.Option(help="Also write every curve to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: accuracy against number of answers, for queries chosen at random, by disagreement, by information."""
    from backend.experiments.asking import RESPONSE_MODELS, AskingConfig, asking_study, summarise
    from backend.learning.policies.shipped import load_queries
    from backend.learning.preferences.oracles import ORACLE_PREFERENCES

    config = AskingConfig(
        oracles=tuple(oracles.split(",")) if oracles else tuple(ORACLE_PREFERENCES),
        response_models=tuple(response_models.split(",")) if response_models else tuple(RESPONSE_MODELS),
        answers=answers,
        repetitions=repetitions,
        seed=seed,
    )
    result = asking_study(
        load_queries(query_set),
        config,
        lambda done: typer.echo(f"{done:.0%}", err=True),
        load_queries(plain) if plain else None,
    )
    result |= {"query_set": query_set, "plain": plain or None}
    summary = summarise(result)
    if out is not None:
        _write(out, result | {"summary": summary["rows"]})
    say(summary, as_json)


@commands.command()
@plain_errors
def people(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "study_room",
    family: Annotated[
        str, typer.Option(help="Families of the card, comma-separated; tuning, held_out or all; none with --reward.")
    ] = "tuning",
    number: Annotated[int, typer.Option("--people", min=1, max=1_000, help="Of each family and seed.")] = 5,
    answers: Annotated[str, typer.Option(help="After how many it is measured, comma-separated.")] = "8,15,50",
    seeds: Annotated[str, typer.Option(help="FIRST-LAST; each has pairs, scenes and people of its own.")] = "0",
    response_model: Annotated[
        str, typer.Option(help="right, lapses, indifference, peak_end or first_seconds.")
    ] = "right",
    choose: Annotated[str, typer.Option(help="random, or information: the pair whose answer tells most.")] = "random",
    reward: Annotated[
        Path | None,
        typer.Option(help="A fitted reward as a person: a manifest (.json) or a reward model of the store (.npz)."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Also write everything to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated people outside the nine objectives: foretold how well, claimed how surely, and what their robot
    gains."""
    from backend.experiments.benchmarks.people import PeopleConfig, benchmark_people
    from backend.learning.people.card import people_card
    from backend.learning.people.reward_file import read_reward

    card = people_card()
    first, _, last = seeds.partition("-")
    if not first.isdigit() or not (last or first).isdigit() or not answers.replace(",", "").isdigit():
        raise typer.BadParameter(f"seeds = {seeds}, answers = {answers}: such as 0-2 and 8,15,50")
    groups = {"tuning": card.tuning, "held_out": card.held_out, "all": tuple(card.families), "none": ()}
    families = groups.get(family) or tuple(name for name in family.split(",") if name not in groups)
    more = {reward.stem: read_reward(reward, setup)} if reward is not None else {}
    after = tuple(sorted(int(n) for n in answers.split(",") if n))
    config = PeopleConfig(
        families=() if more else families,
        people=number,
        answers=after,
        shown_after=15 if 15 in after else after[0],
        seeds=tuple(range(int(first), int(last or first) + 1)),
        response_model=response_model,
        choose=choose,
    )
    result = benchmark_people(setup, config, more, lambda done: typer.echo(f"{done:.0%}", err=True))
    if out is not None:
        _write(out, result)
    say(result, as_json)


@commands.command("wants", hidden=True, deprecated=True)
@commands.command("preferences")
@plain_errors
def preferences_command(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "study_room",
    oracles: Annotated[str, typer.Option(help="Comma-separated; default all.")] = "",
    noises: Annotated[str, typer.Option(help="Shares of wrong answers, comma-separated.")] = "0",
    seeds: Annotated[str, typer.Option(help="Of the query sets: FIRST-LAST.")] = "70-79",
    queries: Annotated[
        str, typer.Option(help="Whose trajectories: ensemble, or varied (of the conditioned policy).")
    ] = "varied",
    answers: Annotated[int, typer.Option(min=2)] = 15,
    choose: Annotated[
        str, typer.Option(help="random: as many queries as answers; information, disagreement: from a pool of 60.")
    ] = "random",
    scenes: Annotated[int, typer.Option(min=2)] = 2_000,
    pretrainings: Annotated[
        str, typer.Option(help="Conditioned policies with cards, comma-separated; default the shipped one.")
    ] = "",
    out: Annotated[Path | None, typer.Option(help="Also write every row to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: how far each oracle's answers move the instant policy, over query sets and pre-trainings."""
    from backend.experiments.benchmarks.preference_learning import PreferencesConfig, benchmark_preferences
    from backend.learning.policies.shipped import load_conditioned
    from backend.learning.preferences.oracles import ORACLE_PREFERENCES
    from backend.learning.shipped_files import load_card

    first, _, last = seeds.partition("-")
    if queries not in ("ensemble", "varied") or not first.isdigit() or not (last or first).isdigit():
        raise typer.BadParameter(f"queries = {queries}, seeds = {seeds}: ensemble or varied; such as 70-79")
    config = PreferencesConfig(
        oracles=tuple(oracles.split(",")) if oracles else tuple(ORACLE_PREFERENCES),
        noises=tuple(float(noise) for noise in noises.split(",")),
        query_seeds=tuple(range(int(first), int(last or first) + 1)),
        queries="ensemble" if queries == "ensemble" else "varied",
        choose=choose,
        answers=answers,
        scenes=scenes,
    )
    names = pretrainings.split(",") if pretrainings else [f"{setup}/conditioned"]
    cards = [load_card(name) for name in names]
    conditioned = {f"seed {card.seed}": load_conditioned(name) for name, card in zip(names, cards, strict=True)}
    result = benchmark_preferences(setup, conditioned, config, lambda done: typer.echo(f"{done:.0%}", err=True))
    result |= {
        "pretrainings": {f"seed {card.seed}": {"command": card.command, "sha256": card.sha256} for card in cards}
    }
    if out is not None:
        _write(out, result)
    say({"setup": setup, "ceiling_m": result["ceiling_m"], "rows": result["summary"]}, as_json)


@commands.command("headline")
@plain_errors
def headline_command(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "study_room",
    seeds: Annotated[str, typer.Option(help="FIRST-LAST; each draws queries, answers and scenes of its own.")] = "0-4",
    noises: Annotated[str, typer.Option(help="Shares of wrong answers, comma-separated.")] = "0,0.1",
    conditioned: Annotated[str, typer.Option(help="A conditioned policy; default the shipped one.")] = "",
    scenes: Annotated[int, typer.Option(min=1, help="Of each seed, in which success is counted.")] = 500,
    planned: Annotated[int, typer.Option(min=1, help="Of these, in which the best rollouts are planned.")] = 50,
    out: Annotated[Path | None, typer.Option(help="Also write every row to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: what the policy of 15 answers gets of what can be attained, of 13 preferences; median and worst."""
    from backend.experiments.benchmarks.headline import HeadlineConfig, benchmark_headline
    from backend.learning.policies.shipped import load_conditioned

    first, _, last = seeds.partition("-")
    if not first.isdigit() or not (last or first).isdigit():
        raise typer.BadParameter(f"seeds = {seeds}: such as 0-4")
    config = HeadlineConfig(
        seeds=tuple(range(int(first), int(last or first) + 1)),
        lapse_rates=tuple(float(noise) for noise in noises.split(",")),
        scenes=scenes,
        planned=planned,
    )
    policy = load_conditioned(conditioned) if conditioned else None
    result = benchmark_headline(setup, policy, config, lambda done: typer.echo(f"{done:.0%}", err=True))
    if out is not None:
        _write(out, result)
    say(
        {"setup": setup, "rows": result["preferences"]}
        | {f"lapse_rate {s['lapse_rate']}": s for s in result["summary"]},
        as_json,
    )


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
    as_json: JsonFlag = False,
) -> None:
    """Many participants at once, each with a real websocket to the stage: is every acknowledged answer stored?"""
    from backend.experiments.benchmarks.serving import benchmark_serve

    say(benchmark_serve(sessions=sessions, answers=answers, pace_s=pace, during_alignment=during_alignment), as_json)


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
    out: Annotated[Path | None, typer.Option(help="Also write the result to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """What people wait for: restart to the first page, every page of the lab, joining all at once."""
    from backend.experiments.benchmarks.pages import benchmark_pages

    result = benchmark_pages(
        studies=studies,
        participants=participants,
        restarts=restarts,
        joining=joining,
        data=data,
        tell=lambda words: typer.echo(words, err=True),
    )
    if out is not None:
        _write(out, result)
    say(result, as_json)


@commands.command()
@plain_errors
def finish(
    participants: Annotated[int, typer.Option(min=1, help="Who give their last answer at the same moment.")] = 10,
    oracle: Annotated[str, typer.Option(help="Who answers.")] = "min-human-distance",
    seed: Annotated[int, typer.Option()] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Everybody finishes at once: seconds from the last answer to the policy, and to the search behind it."""
    from backend.experiments.benchmarks.finishing import benchmark_finish

    say(benchmark_finish(participants=participants, oracle=oracle, seed=seed), as_json)


@commands.command("study")
@plain_errors
def study_command(
    participants: Annotated[int, typer.Option(min=3, help="Simulated participants of the interface study.")] = 31,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="Also write the result to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: chapter 7's study over HTTP, its report, its data set there and back; what was put in is found."""
    from backend.experiments.benchmarks.interface_study import benchmark_study

    result = benchmark_study(participants=participants, seed=seed, tell=lambda words: typer.echo(words, err=True))
    if out is not None:
        _write(out, result)
    say(result, as_json)


def _write(out: Path, result: dict[str, Any]) -> None:
    """A result as a file that datasets/ can hold: its command and commit, numbers to five digits."""
    from backend.learning.cards import source_commit

    out.parent.mkdir(parents=True, exist_ok=True)
    written = {"command": " ".join(["desirepath", *sys.argv[1:]]), "commit": source_commit()} | _short(result)
    out.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, dict):
        return {key: _short(item) for key, item in value.items()}
    return [_short(item) for item in value] if isinstance(value, list | tuple) else value


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

    from backend.experiments.cohorts.null_cohorts import null_cohorts
    from backend.experiments.cohorts.null_ratings import null_family
    from backend.report.analysis_plan import AnalysisPlan

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
    if out is not None:
        _write(out, result)
    say(result, as_json)


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
    from backend.experiments.cohorts.design_cohorts import design_cohorts

    sizes = [int(number) for number in participants.split(",") if number.strip().isdecimal()]
    rates = design_cohorts(cohorts, sizes, effect=effect, seed=seed)
    result = {"simulated": True, "cohorts": cohorts, "effect": effect, "seed": seed, "alpha": 0.05, "rates": rates}
    if out is not None:
        _write(out, result)
    say(result, as_json)


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
    from backend.experiments.cohorts.further_cohorts import further_cohorts

    sizes = [int(number) for number in participants.split(",") if number.strip().isdecimal()]
    result = {"simulated": True, "seed": seed, "alpha": 0.05, "rates": further_cohorts(cohorts, sizes, seed=seed)}
    if out is not None:
        _write(out, result)
    say(result, as_json)


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

    from backend.experiments.cohorts.known_cohorts import known_cohorts
    from backend.report.analysis_plan import AnalysisPlan
    from backend.report.made_up_cohorts import VIEWS_DIFFER, read_cohort

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
    if out is not None:
        _write(out, result)
    say(result, as_json)

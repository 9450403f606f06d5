"""What is learned from answers, and what personal policies are worth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from desirepath.cli.output import JsonFlag, plain_errors, say
from desirepath_experiments.cli.benchmark.group import commands, say_and_write, seed_range, write_result


@commands.command()
@plain_errors
def people(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "study_room",
    family: Annotated[
        str,
        typer.Option(
            help="Families of the card, comma-separated, or nine; tuning, held_out or all; none with --reward."
        ),
    ] = "tuning",
    number: Annotated[int, typer.Option("--people", min=1, max=1_000, help="Of each family and seed.")] = 5,
    answers: Annotated[str, typer.Option(help="After how many it is measured, comma-separated.")] = "8,15,50",
    seeds: Annotated[str, typer.Option(help="FIRST-LAST; each has pairs, scenes and people of its own.")] = "0",
    response_model: Annotated[
        str, typer.Option(help="right, lapses, indifference, peak_end or first_seconds.")
    ] = "right",
    choose: Annotated[str, typer.Option(help="random, or information: the pair whose answer tells most.")] = "random",
    queries: Annotated[
        str,
        typer.Option(help="Asked about: policies (as they are), manners (policies in many), both."),
    ] = "policies",
    reward: Annotated[
        Path | None,
        typer.Option(help="A fitted reward as a person: a manifest (.json) or a reward model of the store (.npz)."),
    ] = None,
    before: Annotated[
        str | None,
        typer.Option(help="Instead: accuracy with so many earlier participants, comma-separated, such as 0,10,30,100."),
    ] = None,
    yardstick: Annotated[
        int | None,
        typer.Option(min=20, max=5_000, help="Instead: what a linear model on all measures reaches with so many."),
    ] = None,
    policies: Annotated[
        bool, typer.Option("--policies", help="Also share_at_once of the library's best, as `people-policies` does.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(help="Also write everything to this file, as JSON, after every person; a stopped run goes on."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated people outside the nine objectives: predicted how well, claimed how surely, and what their robot
    gains."""
    from desirepath.learning.people.asked_people import PeopleConfig, benchmark_people, known_people, result_of
    from desirepath.learning.people.card import people_card
    from desirepath.learning.people.reward_file import read_reward

    card = people_card()
    first, _, last = seeds.partition("-")
    if not first.isdigit() or not (last or first).isdigit() or not answers.replace(",", "").isdigit():
        raise typer.BadParameter(f"seeds = {seeds}, answers = {answers}: such as 0-2 and 8,15,50")
    groups = {"tuning": card.tuning, "held_out": card.held_out, "all": tuple(card.families), "none": ()}
    families = groups.get(family) or tuple(name for name in family.split(",") if name not in groups)
    more = {reward.stem: read_reward(reward, setup)} if reward is not None else {}
    after = tuple(sorted(int(n) for n in answers.split(",") if n))
    if before is not None:
        from desirepath_experiments.benchmarks.people_before import BeforeConfig, benchmark_before

        counts = tuple(sorted(int(n) for n in before.split(",") if n.isdigit()))
        asked = BeforeConfig(
            before=counts, answers=after, people=number, seeds=tuple(range(int(first), int(last or first) + 1))
        )
        result = benchmark_before(setup, asked, lambda done: typer.echo(f"{done:.0%}", err=True))
        if out is not None:
            write_result(out, result)
        return say(result, as_json)
    if yardstick is not None:
        from desirepath_experiments.benchmarks.people_yardstick import YardstickConfig, benchmark_yardstick

        measured = YardstickConfig(families, people=number, answers=yardstick, seed=int(first))
        result = benchmark_yardstick(setup, measured, lambda done: typer.echo(f"{done:.0%}", err=True))
        if out is not None:
            write_result(out, result)
        return say(result, as_json)
    config = PeopleConfig(
        families=() if more else families,
        people=number,
        answers=after,
        shown_after=15 if 15 in after else after[0],
        seeds=tuple(range(int(first), int(last or first) + 1)),
        response_model=response_model,
        choose=choose,
        queries=queries,
    )
    persons = known_people(out, setup, config) if out is not None else []

    def keep(one: dict[str, Any]) -> None:
        persons.append(one)
        if out is not None:
            write_result(out, result_of(setup, config, persons))

    result = benchmark_people(
        setup, config, more, lambda done: typer.echo(f"{done:.0%}", err=True), tuple(persons), keep
    )
    if policies:
        from desirepath_experiments.benchmarks.people_policies import PeoplePoliciesConfig, with_shares

        result = with_shares(
            result,
            setup,
            PeoplePoliciesConfig(
                config.families,
                people=number,
                answers=config.shown_after,
                seeds=config.seeds,
                fine_tuning=False,
                trained=0,
            ),
            more,
        )
    say_and_write(result, out, as_json)


@commands.command()
@plain_errors
def people_policies(
    setup: Annotated[str, typer.Option(help="study_room or open_field: with step basis and library.")] = "study_room",
    family: Annotated[
        str,
        typer.Option(help="Families of the card, comma-separated; tuning or held_out; none with --reward."),
    ] = "tuning",
    number: Annotated[int, typer.Option("--people", min=1, max=1_000, help="Of each family and seed.")] = 4,
    first: Annotated[int, typer.Option(min=0, help="Number of the first person of each family.")] = 0,
    answers: Annotated[int, typer.Option(min=2, help="Right ones, each to the pair that tells most.")] = 15,
    seeds: Annotated[
        str,
        typer.Option("--seeds", "--seed", help="FIRST-LAST; each has pairs, scenes, trainings and people of its own."),
    ] = "0",
    reward: Annotated[
        Path | None,
        typer.Option(help="A fitted reward as a person: a manifest (.json) or a reward model of the store (.npz)."),
    ] = None,
    at_once: Annotated[
        bool, typer.Option("--at-once", help="Nothing is trained; the yardstick is the library's best.")
    ] = False,
    fine_tuning: Annotated[
        bool, typer.Option(help="With --at-once: also the search behind the choice, without the yardstick's training.")
    ] = False,
    successors: Annotated[
        int, typer.Option("--successor-features", min=0, help="Also by successor features of so many policies.")
    ] = 0,
    pretraining: Annotated[
        str, typer.Option(help="A folder with SETUP/base.npz, conditioned.npz and policy_library.npz; default shipped.")
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option(help="Also write everything to this file, as JSON, after every person; a stopped run goes on."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """What the robot of simulated people outside the nine objectives gains, at once and after fine-tuning, against
    what converged training on their true reward gains."""
    from desirepath.learning.people.card import people_card
    from desirepath.learning.people.reward_file import read_reward
    from desirepath_experiments.benchmarks.people_policies import (
        PeoplePoliciesConfig,
        benchmark_seeds,
        known_persons,
        result_of,
    )

    card = people_card()
    groups = {"tuning": card.tuning, "held_out": card.held_out, "none": ()}
    families = () if reward is not None else groups.get(family, tuple(family.split(",")))
    more = {reward.stem: read_reward(reward, setup)} if reward is not None else {}
    config = PeoplePoliciesConfig(
        families=families,
        people=number,
        first=first,
        answers=answers,
        seeds=tuple(seed_range(seeds)),
        pretraining=pretraining,
        successors=successors,
    )
    if at_once:
        config = replace(config, fine_tuning=fine_tuning, trained=0)
    persons = known_persons(out, setup, config) if out is not None else []

    def keep(one: dict[str, Any]) -> None:
        persons.append(one)
        typer.echo(f"{one['person']}: {one['gain_at_once']:.2f}", err=True)
        if out is not None:
            write_result(out, result_of(setup, config, persons))

    result = benchmark_seeds(setup, config, keep, tuple(persons), more)
    say_and_write(result, out, as_json)


@commands.command()
@plain_errors
def people_harm(
    setup: Annotated[str, typer.Option(help="study_room or open_field: with step basis and library.")] = "study_room",
    family: Annotated[str, typer.Option(help="Families of the card and nine, comma-separated; or all.")] = "all",
    number: Annotated[int, typer.Option("--people", min=1, max=1_000, help="Of each family and seed.")] = 15,
    first: Annotated[int, typer.Option(min=0, help="Number of the first person of each family.")] = 200,
    seeds: Annotated[str, typer.Option(help="FIRST-LAST; each has pairs and scenes of its own.")] = "0-3",
    response_model: Annotated[str, typer.Option(help="How they answer: right, lapses, ... of the card.")] = "right",
    out: Annotated[
        Path | None,
        typer.Option(help="Also write everything to this file, as JSON, after every person; a stopped run goes on."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """How many simulated people of all families are shown a policy as theirs that is worse for them, as an alignment
    job decides it."""
    from desirepath.learning.people.card import people_card
    from desirepath_experiments.benchmarks.people_harm import (
        PeopleHarmConfig,
        benchmark_people_harm,
        known_persons,
        result_of,
    )

    families = (*people_card().families, "nine") if family == "all" else tuple(family.split(","))
    config = PeopleHarmConfig(families, number, first, seeds=seed_range(seeds), response_model=response_model)
    persons = known_persons(out, setup, config) if out is not None else []

    def keep(one: dict[str, Any]) -> None:
        persons.append(one)
        verdict = f"shown, {one['gain']:+.2f}" if one["shown"] else "shown nothing"
        typer.echo(f"{one['seed']} {one['person']}: {verdict}", err=True)
        if out is not None:
            write_result(out, result_of(setup, config, persons))

    result = benchmark_people_harm(setup, config, keep, tuple(persons))
    if out is not None:
        write_result(out, result)
    say({key: value for key, value in result.items() if key != "persons"}, as_json)


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
    from desirepath.learning.policies.shipped import load_conditioned
    from desirepath_experiments.benchmarks.headline import HeadlineConfig, benchmark_headline

    config = HeadlineConfig(
        seeds=seed_range(seeds),
        lapse_rates=tuple(float(noise) for noise in noises.split(",")),
        scenes=scenes,
        planned=planned,
    )
    policy = load_conditioned(conditioned) if conditioned else None
    result = benchmark_headline(setup, policy, config, lambda done: typer.echo(f"{done:.0%}", err=True))
    if out is not None:
        write_result(out, result)
    say(
        {"setup": setup, "rows": result["preferences"]}
        | {f"lapse_rate {s['lapse_rate']}": s for s in result["summary"]},
        as_json,
    )


@commands.command()
@plain_errors
def explanations(
    policy: Annotated[
        str, typer.Option(help="A shipped name such as study_room/base, an id or a path.")
    ] = "study_room/base",
    scenes: Annotated[int, typer.Option(min=2)] = 40,
    seed: Annotated[int, typer.Option()] = 0,
    out: Annotated[Path | None, typer.Option(help="Also write the table to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Are explanations true? Deletion and insertion against random orders, per method; milliseconds."""
    from desirepath.cli.science import find_policy
    from desirepath.learning.policies.policy import network_of
    from desirepath_experiments.benchmarks.explanations import benchmark_explanations

    result = benchmark_explanations(network_of(find_policy(policy)), policy, scenes=scenes, seed=seed)
    say_and_write(result, out, as_json)

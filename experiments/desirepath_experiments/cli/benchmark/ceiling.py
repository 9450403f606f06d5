"""What a policy can get of a preference at most: converged training for it alone, beside planned rollouts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from desirepath.cli.output import JsonFlag, plain_errors, say
from desirepath_experiments.cli.benchmark.group import commands, seed_range, write_result


@commands.command("ceiling")
@plain_errors
def ceiling_command(
    setup: Annotated[str, typer.Option(help="study_room or open_field.")] = "study_room",
    preference: Annotated[str, typer.Option(help="Comma-separated; default all 13.")] = "",
    seeds: Annotated[str, typer.Option(help="FIRST-LAST, as `headline`'s.")] = "0-2",
    conditioned: Annotated[
        str, typer.Option(help="NAME=FILE, comma-separated: more conditioned policies to begin with and to compare.")
    ] = "",
    scenes: Annotated[int, typer.Option(min=1, help="Of each seed, that policies are compared in.")] = 500,
    planned: Annotated[int, typer.Option(min=1, help="Of these, in which the best rollouts are planned.")] = 40,
    trained_from: Annotated[int, typer.Option(min=1, help="Of the best starts so many are trained on from.")] = 1,
    patience: Annotated[int, typer.Option(min=1, help="Rounds without gain after which training has converged.")] = 1,
    most_rounds: Annotated[int, typer.Option(min=1, help="Of training, from each start.")] = 4,
    work: Annotated[Path, typer.Option(help="Folder for experts and plans; a stopped run goes on there.")] = Path(
        "ceiling"
    ),
    minutes: Annotated[float, typer.Option(help="No round of training begins later; call again to go on.")] = 1e9,
    out: Annotated[Path | None, typer.Option(help="Also write every row to this file, as JSON.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated: what a policy made for one preference alone gets of it, and what 15 answers are worth of that."""
    from desirepath.learning.policies.conditioned import ConditionedPolicy
    from desirepath.learning.policies.shipped import load_conditioned
    from desirepath_experiments.benchmarks.headline import MADE_OF_OBJECTIVES
    from desirepath_experiments.benchmarks.policy_ceiling import CeilingConfig, benchmark_ceiling, train_experts
    from desirepath_experiments.training.through_simulation.experts import ExpertConfig

    others = dict(one.split("=", 1) for one in conditioned.split(",") if "=" in one)
    policies = {name: ConditionedPolicy.load(Path(file)) for name, file in others.items()}
    config = CeilingConfig(
        preferences=tuple(preference.split(",")) if preference else MADE_OF_OBJECTIVES,
        seeds=seed_range(seeds),
        scenes=scenes,
        planned=planned,
        trained_from=trained_from,
    )

    def tell(words: str) -> None:
        typer.echo(words, err=True)

    expert = ExpertConfig(setup, patience=patience, most_rounds=most_rounds)
    if not train_experts(setup, work, policies, config, expert, minutes=minutes, tell=tell):
        say({"setup": setup, "converged": False, "go_on": "call again with the same --work"}, as_json)
        return
    compared = {"conditioned": load_conditioned(f"{setup}/conditioned"), **policies}
    result = benchmark_ceiling(setup, work, compared, config, tell=tell)
    if out is not None:
        write_result(out, result)
    rows = [
        {"preference": line["preference"]}
        | {which: line[which]["share"] for which in ("expert", *compared)}
        | {"success_expert": line["success_expert"]}
        for line in result["preferences"]
    ]
    say({"setup": setup, "rows": rows, **result["summary"]}, as_json)

"""`desirepath ship WHAT SETUP --seed N`: make a shipped artefact with its card.

What is made and described lives in `shipping/`, the science in the algorithms' files.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from desirepath.cli.output import plain_errors
from desirepath.installed import DATASETS

QUERIES = 200  # as many as are shipped

What = Literal[
    "base", "ensemble", "conditioned", "sharpened", "added",
    "queries", "varied-queries", "manner-queries", "triples", "ranking-set",
    "stand-ins", "population-priors", "step-basis", "policy-library", "path-weights",
    "adaptable", "attention", "depth", "depth-perception", "words-veto",
]  # fmt: skip


@plain_errors
def ship(
    what: Annotated[What, typer.Argument(help="What is made.")],
    setup: Annotated[str, typer.Argument(help="Which setup it is made for; words-veto needs none.")] = "",
    seed: int = 0,
    count: Annotated[int, typer.Option(min=1, help="Of queries, or scenes of triples.")] = QUERIES,
    out: Annotated[Path, typer.Option(help="Folder that the setup's folder lies in.")] = DATASETS,
    work: Annotated[Path | None, typer.Option(help="Folder where trainings are kept, to go on with.")] = None,
) -> None:
    """Make a shipped artefact with its card."""
    from desirepath.simulation.setups import SETUPS, get_setup

    CROWD_CORRIDOR = get_setup("crowd_corridor")
    EXPLAINED_ROOM = get_setup("explained_room")
    HOME = get_setup("home")
    from desirepath_experiments.shipping.adaptable import ship_adaptable
    from desirepath_experiments.shipping.attended_people import ship_attended
    from desirepath_experiments.shipping.attention import ship_attention
    from desirepath_experiments.shipping.depth import ship_controllers, ship_perception
    from desirepath_experiments.shipping.explained_room import ship_explained, ship_ranking_set
    from desirepath_experiments.shipping.path_weights import ship_path_weights
    from desirepath_experiments.shipping.policies import (
        ship_added,
        ship_base,
        ship_conditioned,
        ship_ensemble,
        ship_sharpened,
    )
    from desirepath_experiments.shipping.policy_libraries import ship_policy_library
    from desirepath_experiments.shipping.population_priors import ship_population_priors
    from desirepath_experiments.shipping.query_sets import ship_manner_queries, ship_queries, ship_varied_queries
    from desirepath_experiments.shipping.second_reader import ship_second_readers
    from desirepath_experiments.shipping.stand_ins import ship_stand_ins
    from desirepath_experiments.shipping.step_bases import ship_step_basis

    if what == "words-veto":
        ship_second_readers(out)
        return
    if setup not in SETUPS:
        raise typer.BadParameter(f"setup = {setup}: one of {', '.join(SETUPS)}")

    def show(fraction: float, metrics: dict[str, float]) -> None:
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in metrics.items())
        typer.echo(f"{fraction:4.0%} {numbers}", err=True)

    given = (setup, seed, out, show)
    match what:
        case "depth" | "depth-perception":
            work = work or out / HOME.name / "work"
            ship_perception(work, out)
            if what == "depth":
                ship_controllers(work, out)
        case "adaptable":
            ship_adaptable(seed, out, work)
        case "attention":
            ship_attention(seed, out, work)
        case "ranking-set":
            (ship_attended if setup == CROWD_CORRIDOR.name else ship_ranking_set)(out)
        case "base" if setup == EXPLAINED_ROOM.name:
            ship_explained(*given[1:])
        case "population-priors":
            ship_population_priors(setup, on_progress=show)
        case "policy-library":
            ship_policy_library(*given[:3], work, show)
        case "queries" | "triples":
            ship_queries(*given, count=count, trajectories=3 if what == "triples" else 2)
        case "varied-queries":
            ship_varied_queries(*given, count=count)
        case "manner-queries":
            ship_manner_queries(*given, count=count)
        case _:
            makers: dict[str, Callable[..., Any]] = {
                "base": ship_base,
                "ensemble": ship_ensemble,
                "conditioned": ship_conditioned,
                "sharpened": ship_sharpened,
                "added": ship_added,
                "stand-ins": ship_stand_ins,
                "step-basis": ship_step_basis,
                "path-weights": ship_path_weights,
            }
            makers[what](*given)

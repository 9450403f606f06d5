"""`desirepath ship WHAT SETUP --seed N`: make a shipped artefact with its card.

What is made and described lives in `shipping/`, the science in the algorithms' files.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import typer

from desirepath.cli.output import JsonFlag, in_data_folder, say
from desirepath.installed import DATASETS

What = Literal[
    "base", "ensemble", "conditioned", "added",
    "queries", "varied-queries", "manner-queries", "triples", "ranking-set",
    "stand-ins", "population-priors", "people-in-general", "step-basis", "policy-library", "path-weights",
    "adaptable", "attention", "depth", "depth-perception", "words-veto", "example-study", "sketches",
]  # fmt: skip
MODULES = {
    "policies": ("base", "ensemble", "conditioned", "added"),
    "query_sets": ("queries", "varied-queries", "manner-queries", "triples"),
    "ranking_sets": ("ranking-set",),
    "stand_ins": ("stand-ins",),
    "population_priors": ("population-priors",),
    "people_in_general": ("people-in-general",),
    "step_bases": ("step-basis",),
    "policy_libraries": ("policy-library",),
    "path_weights": ("path-weights",),
    "adaptable": ("adaptable",),
    "attention": ("attention",),
    "depth": ("depth", "depth-perception"),
    "second_reader": ("words-veto",),
    "example_study": ("example-study",),
    "sketches": ("sketches",),
}
"""Of `shipping`, with what each makes by `ship_WHAT(request)`."""
OF_THE_PRODUCT = ("query_sets",)
OF_NO_SETUP = ("words-veto", "sketches", "people-in-general")
ONLY_OF = {
    "adaptable": "adaptable",
    "attention": "crowd_corridor",
    "depth": "home",
    "depth-perception": "home",
    "example-study": "study_room",
}


@in_data_folder
def ship(
    what: Annotated[What, typer.Argument(help="What is made.")],
    setup: Annotated[str, typer.Argument(help="Which setup it is made for, if for one.")] = "",
    seed: int = 0,
    count: Annotated[int, typer.Option(min=1, help="Of queries, or scenes of triples.")] = 200,
    out: Annotated[Path, typer.Option(help="Folder that the setup's folder lies in.")] = DATASETS,
    work: Annotated[Path | None, typer.Option(help="Folder where trainings are kept, or raters lie.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Make a shipped artefact with its card."""
    from desirepath.learning.shipping.storing import Request
    from desirepath.simulation.setups import SETUPS

    if setup not in SETUPS and what not in OF_NO_SETUP:
        raise typer.BadParameter(f"setup = {setup}: one of {', '.join(SETUPS)}")
    if setup != ONLY_OF.get(what, setup):
        raise typer.BadParameter(f"setup = {setup}: {what} is made for {ONLY_OF[what]}")

    def show(fraction: float, metrics: dict[str, float]) -> None:
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in metrics.items())
        typer.echo(f"{fraction:4.0%} {numbers}", err=True)

    (module,) = (module for module, things in MODULES.items() if what in things)
    room = "desirepath.learning" if module in OF_THE_PRODUCT else "desirepath_experiments"
    makes = getattr(import_module(f"{room}.shipping.{module}"), f"ship_{what.replace('-', '_')}")
    makes(Request(setup, seed, out, count, work, show))
    say({"made": what, "setup": setup, "folder": str(out / setup)}, as_json)

"""`python -m desirepath_experiments.ship WHAT SETUP --seed N`: base, ensemble, conditioned, sharpened, queries, ...

What is made and described lives in `shipping/`, the science in the algorithms' files.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from desirepath.learning.shipped_files import DATASETS
from desirepath.simulation.setups import CROWD_CORRIDOR, EXPLAINED_ROOM, HOME, SETUPS
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
from desirepath_experiments.shipping.query_sets import (
    SHIPPED_QUERIES,
    ship_manner_queries,
    ship_queries,
    ship_varied_queries,
)
from desirepath_experiments.shipping.stand_ins import ship_stand_ins
from desirepath_experiments.shipping.step_bases import ship_step_basis


def main() -> None:
    parser = argparse.ArgumentParser(description="Make shipped artefacts with their cards.")
    kinds = ("base", "ensemble", "conditioned", "sharpened", "queries", "varied-queries", "manner-queries")
    more = (
        "triples",
        "stand-ins",
        "population-priors",
        "step-basis",
        "policy-library",
        "ranking-set",
        "added",
        "adaptable",
        "path-weights",
        "depth",
        "depth-perception",
        "attention",
    )
    parser.add_argument("what", choices=(*kinds, *more))
    parser.add_argument("setup", choices=tuple(SETUPS), help="which it is made for")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=SHIPPED_QUERIES, help="of queries, or scenes of triples")
    parser.add_argument("--out", type=Path, default=DATASETS, help="folder that the setup's folder lies in")
    parser.add_argument("--work", type=Path, help="folder where trainings are kept, to go on with")
    arguments = parser.parse_args()

    def show(fraction: float, metrics: dict[str, float]) -> None:
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in metrics.items())
        print(f"{fraction:4.0%} {numbers}", file=sys.stderr, flush=True)

    given = (arguments.setup, arguments.seed, arguments.out, show)
    if arguments.what in ("depth", "depth-perception"):
        work = arguments.work or arguments.out / HOME.name / "work"
        ship_perception(work, arguments.out)
        if arguments.what == "depth":
            ship_controllers(work, arguments.out)
    elif arguments.what == "adaptable":
        ship_adaptable(arguments.seed, arguments.out, arguments.work)
    elif arguments.what == "attention":
        ship_attention(arguments.seed, arguments.out, arguments.work)
    elif arguments.what == "ranking-set":
        (ship_attended if arguments.setup == CROWD_CORRIDOR.name else ship_ranking_set)(arguments.out)
    elif arguments.what == "base" and arguments.setup == EXPLAINED_ROOM.name:
        ship_explained(*given[1:])
    elif arguments.what == "stand-ins":
        ship_stand_ins(*given)
    elif arguments.what == "population-priors":
        ship_population_priors(arguments.setup, on_progress=show)
    elif arguments.what == "manner-queries":
        ship_manner_queries(*given, count=arguments.count)
    elif arguments.what == "step-basis":
        ship_step_basis(*given)
    elif arguments.what == "path-weights":
        ship_path_weights(*given)
    elif arguments.what == "policy-library":
        ship_policy_library(*given[:3], arguments.work, show)
    elif arguments.what == "varied-queries":
        ship_varied_queries(*given, count=arguments.count)
    elif arguments.what in ("queries", "triples"):
        ship_queries(*given, count=arguments.count, trajectories=3 if arguments.what == "triples" else 2)
    else:
        makers = {"base": ship_base, "ensemble": ship_ensemble, "conditioned": ship_conditioned}
        {**makers, "sharpened": ship_sharpened, "added": ship_added}[arguments.what](*given)


if __name__ == "__main__":
    main()

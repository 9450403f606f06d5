"""Desire Path: people teach a mobile robot how to move around them.

What a notebook needs is imported from here, when it is asked for; `notebook.py` says what each does. One thread per
process, set before NumPy loads: the cores are shared by server, browser and trainings, and results then do not depend
on how many cores a machine has. Set the variables yourself to choose otherwise.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

for _library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_library, "1")

if TYPE_CHECKING:
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.queries.queries import Query, QuerySet
    from desirepath.notebook import (
        Posterior,
        Report,
        align,
        draw_scenes,
        evaluate,
        get_setup,
        load_policy,
        load_queries,
        make_env,
        rollout,
    )
    from desirepath.simulation.scene import Scene
    from desirepath.simulation.setups import Robot, Setup
    from desirepath.simulation.trajectory import Trajectory

__all__ = [
    "Policy",
    "Posterior",
    "Query",
    "QuerySet",
    "Report",
    "Robot",
    "Scene",
    "Setup",
    "Trajectory",
    "align",
    "draw_scenes",
    "evaluate",
    "get_setup",
    "load_policy",
    "load_queries",
    "make_env",
    "rollout",
]
_HOMES = {
    "Policy": "learning.policies.policy",
    "Query": "learning.queries.queries",
    "QuerySet": "learning.queries.queries",
    "Robot": "simulation.setups",
    "Scene": "simulation.scene",
    "Setup": "simulation.setups",
    "Trajectory": "simulation.trajectory",
}


def __getattr__(name: str) -> Any:
    """Loaded when it is first asked for: a server or a command line needs none of it."""
    if name not in __all__:
        raise AttributeError(f"module 'desirepath' has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'notebook')}"), name)


def __dir__() -> list[str]:
    return __all__

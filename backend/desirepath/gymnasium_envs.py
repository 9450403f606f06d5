"""The engine under Gymnasium's names, for other libraries: importing this registers them; nothing else is loaded.

import gymnasium, desirepath.gymnasium_envs
env = gymnasium.make("desirepath/study_room-v0")        # one reward
env = mo_gymnasium.make("desirepath/mo-study_room-v0")  # a vector of them

An episode out of steps is truncated; `make(..., time_limit="terminated")` ends it as our own learners are told.
"""

from __future__ import annotations

from gymnasium.envs.registration import register

from desirepath.simulation.setups import setup_folders, setups_with

SINGLE = "desirepath.simulation.environments:NavigationEnv"
MULTIPLE = "desirepath.learning.preferences.multi_objective_env:MultiObjectiveNavigationEnv"

for _setup in (name for name in setup_folders() if name != "adaptable"):
    register(f"desirepath/{_setup}-v0", entry_point=SINGLE, kwargs={"setup": _setup})

for _setup in setups_with("conditioned"):
    register(f"desirepath/mo-{_setup}-v0", entry_point=MULTIPLE, kwargs={"setup": _setup})

register("desirepath/adaptable-v0", entry_point=SINGLE, kwargs={"setup": "adaptable", "progress_weight": 125.0})
register("desirepath/mo-adaptable-v0", entry_point="desirepath.learning.adaptable.vector_env:AdaptableEnv")

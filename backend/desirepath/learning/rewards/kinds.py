"""The kinds of reward model by name, without what they need to run: forms and protocols ask this file."""

from __future__ import annotations

from typing import Any

from desirepath.registries import Registry

GROUP = "desirepath.reward_models"
MODELS: Registry[Any] = Registry(GROUP, "desirepath.learning.rewards", "MODEL")
"""`type[RewardModel]` by the kind that stored files name."""
FITTINGS: Registry[Any] = Registry(GROUP, "desirepath.learning.rewards", "FITTING")
"""`Fitting` by the name that jobs ask for it by; `auto` makes one of several kinds."""

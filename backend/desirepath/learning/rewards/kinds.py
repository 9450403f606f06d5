"""The kinds of reward model by name, without what they need to run: forms and protocols ask this file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from desirepath.registries import Registry

if TYPE_CHECKING:
    from desirepath.learning.rewards.reward_model import Fitting, RewardModel

GROUP = "desirepath.reward_models"
MODELS: Registry[type[RewardModel]] = Registry(GROUP, "desirepath.learning.rewards", "MODEL")
"""Class by the kind that stored files name."""
FITTINGS: Registry[Fitting] = Registry(GROUP, "desirepath.learning.rewards", "FITTING")
"""By the name that jobs ask for them by; `auto` makes one of several kinds."""

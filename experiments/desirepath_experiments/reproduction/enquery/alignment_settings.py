"""Settings of an alignment as tasks are named by: flat, with the keys of the first release, so that what was computed
before the algorithms had settings of their own is found again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.alignment.relabelling import RelabellingConfig
from desirepath.learning.alignment.thesis import ThesisConfig
from desirepath.learning.cards import read_config


def stored_alignment(config: RelabellingConfig) -> dict[str, Any]:
    """The settings as they are stored; those of the other algorithm stand beside at their defaults."""
    flat = {**FineTuningConfig().as_dict(), **config.as_dict()}
    flat["preference_weight"] = flat.pop("reward_weight")
    return {**flat, "recipe": "thesis" if isinstance(config, ThesisConfig) else "refine"}


def read_alignment(stored: Mapping[str, Any]) -> RelabellingConfig:
    """Back from `stored_alignment`."""
    algorithm: type[FineTuningConfig] | type[ThesisConfig] = (
        ThesisConfig if stored["recipe"] == "thesis" else FineTuningConfig
    )
    given = read_config({**stored, "reward_weight": stored["preference_weight"]})
    own = {one.name: given[one.name] for one in fields(algorithm) if one.name in given}
    return algorithm(**own, gate=GateRule.of(stored))

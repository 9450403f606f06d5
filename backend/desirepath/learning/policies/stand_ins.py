"""Stand-ins: preference weights that simulated people's answers spoke for, so that the first participants of a study
can be shown another person's policy, too, before any other participant has one.

Made and written by `experiments/shipping/stand_ins.py`; who is lent which is `study/personalising/lending.py`'s.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from desirepath.installed import DATASETS
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.preferences.objectives import preference_weights


@dataclass(frozen=True)
class StandInCard:
    """What is shipped per setup. people: each {"prefers", "weights", "gate_success"}: a drawn person's shares of
    objectives, the weights that their answers speak for, the success of the policy conditioned on these in the gate's
    scenes. parents: names and sha256 of what they were made from."""

    setup: str
    command: str
    seed: int
    commit: str
    query_set: str
    answers: int
    people: list[dict[str, Any]]
    parents: dict[str, str]
    notes: list[str]

    def save(self, path: Path) -> None:
        path.write_text(json.dumps(asdict(self), indent=2, sort_keys=True) + "\n", encoding="utf-8")


def card_file(setup: str, folder: Path = DATASETS) -> Path:
    """Where a setup's card lies."""
    return folder / setup / "stand_ins.card.json"


def load_stand_ins(setup: str) -> StandInCard | None:
    """The setup's card; None where none is shipped."""
    path = card_file(setup)
    return StandInCard(**json.loads(path.read_text(encoding="utf-8"))) if path.exists() else None


def stand_in_name(setup: str, number: int) -> str:
    """What a stand-in's policy is called in lineage and data sets."""
    return f"{setup}/stand_ins/{number}"


def stand_in_policy(setup: str, number: int) -> Policy:
    """The stand-in's policy: the shipped conditioned one at their weights, as recipe instant makes participants'.

    Raises LearningError for a number that the setup's card does not have.
    """
    card = load_stand_ins(setup)
    if card is None or not 0 <= number < len(card.people):
        there = f"0 to {len(card.people) - 1}" if card else "none"
        raise LearningError(f"stand_in = {number}: setup {setup} has {there}")
    weights = preference_weights(card.people[number]["weights"])
    return load_conditioned(f"{setup}/conditioned").at(weights).without_critic()

"""What an alignment is: an algorithm that turns a reward model into a policy, with what it may be asked.

Each is one file in `alignments`, or a module of another package by an entry point of `desirepath.alignments`. Light on
purpose: forms are made from the parameters. What an algorithm needs to run, its function imports; much of it is in
`aligned.py`. What is kept of its policy is `aligning.py`'s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from desirepath.jobs.params import LARGEST_SEED, MOST_NAMED, Params, SetupName, artefact, from_source
from desirepath.registries import Registry

if TYPE_CHECKING:
    from desirepath.jobs.context import JobContext
    from desirepath.learning.alignment.gate import BesideInstant, Gate
    from desirepath.learning.policies.choosing import ChoosingPolicy
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.rewards.reward_model import RewardModel
    from desirepath.store.models import Artefact

RECIPE = "recipe"
"""The parameter that says which algorithm an alignment is."""


class AlignParams(Params):
    """Turn the answers of a snapshot into a policy, and check that it may be shown: what every algorithm is asked."""

    snapshot: str = artefact("snapshot")
    setup: SetupName | None = from_source("from_snapshot", None, advanced=True)
    base: str | None = Field(None, json_schema_extra={"source": "from_setup", "artefact": "policy", "advanced": True})
    symmetry: Literal["none", "left_right"] = from_source("ours_symmetry", "none", advanced=True)
    seed: int = from_source("ours", 0, ge=0, le=LARGEST_SEED)
    gate_scenes: int = from_source("ours", 500, ge=50, le=5_000, advanced=True)
    gate_min_success: float = from_source("ours_gate", 0.90, ge=0, le=1, advanced=True)
    gate_max_loss: float = from_source("ours_five_points", 0.05, ge=0, le=1, advanced=True)
    surely_better: float = from_source("ours_surely_better", 0.0, ge=0, le=1, advanced=True)
    earlier: str = from_source("from_protocol_prior", "", advanced=True, max_length=MOST_NAMED)
    prior: Literal["none", "people_in_general"] = from_source("from_protocol_prior", "none", advanced=True)
    comparisons: int = from_source("from_protocol", 3, ge=0, le=10, advanced=True)
    hold_out: int = from_source("ours", 0, ge=0, le=10, advanced=True)
    other: str | None = Field(
        None, min_length=1, json_schema_extra={"source": "yours", "artefact": "policy", "advanced": True}
    )

    def asked(self) -> dict[str, Any]:
        return {**super().asked(), RECIPE: self.algorithm}

    @property
    def algorithm(self) -> str:
        """Which one it is, as `recipe` names it."""
        return str(getattr(self, RECIPE))

    @property
    def model_name(self) -> str:
        """The kind of reward model that the answers become."""
        return str(getattr(self, "model"))  # noqa: B009 - every algorithm has its own choice of them


class ConditionedAlignParams(AlignParams):
    """What is asked where a conditioned policy is used as it is: nothing is trained.

    neutral: in so many further scenes it is compared with itself without preferences. stand_in: number on the setup's
    card of the simulated person whose policy is compared with, where `other` names none.
    """

    conditioned: str | None = Field(
        None, json_schema_extra={"source": "from_setup", "artefact": "conditioned_policy", "advanced": True}
    )
    model: Literal["weights"] = from_source("preference_weights_only", "weights", advanced=True)
    neutral: int = from_source("ours", 0, ge=0, le=10, advanced=True)
    stand_in: int | None = from_source("ours", None, ge=0, le=1_000, advanced=True)


@dataclass(frozen=True)
class Aligned:
    """An aligned policy, what its card says, and what was measured by which `gate.decide` says whether it may be
    shown. beside: what the job's result says, too."""

    policy: Policy | ChoosingPolicy
    gate: Gate
    config: dict[str, Any]
    results: dict[str, Any] = field(default_factory=dict)
    parents: list[tuple[Artefact, str]] = field(default_factory=list)
    scenes: dict[str, Any] = field(default_factory=dict)
    departures: list[str] = field(default_factory=list)
    beside: dict[str, Any] = field(default_factory=dict)
    beside_instant: BesideInstant | None = None


@dataclass(frozen=True)
class Alignment:
    """params: what it may be asked, its name their `recipe`. makes: what lists call its policies, which one person can
    have several of. align: (context, params, base policy, reward model) -> the aligned policy. asks_directly: whether
    it is better for somebody is told by blind comparisons with the base policy afterwards, not by what their answers
    let expect (`surely_better`)."""

    params: type[AlignParams]
    makes: str
    align: Callable[[JobContext, Any, Policy, RewardModel], Aligned]
    asks_directly: bool = False


DEFAULT = "fine_tuning"
"""What is meant where none is named."""
REGISTRY: Registry[Alignment] = Registry("desirepath.alignments", "desirepath.jobs.alignments", "ALIGNMENT")

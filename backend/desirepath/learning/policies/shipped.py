"""Opening artefacts by shipped name (`study_room/base`, `open_field/ensemble/0`, `study_room/queries_500`) or path.

Where their files lie is `shipped_files.py`'s, making them `experiments/ship.py`'s.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from desirepath.learning.cards import file_sha256
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.adaptable import AdaptablePolicy
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import DrivingPolicy, Policy, network_of, read_policy
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.shipped_files import load_card, resolve, shipped_names

if TYPE_CHECKING:
    from desirepath.learning.alignment.policy_library import PolicyLibrary
    from desirepath.learning.measures.step_basis import StepBasis
    from desirepath.learning.policies.attention import AttentionPolicy


def names_policy(reference: str) -> bool:
    """Whether `load_policy` would find a file for the reference."""
    name = reference.partition("@")[0]
    return name in shipped_names() or Path(name).is_file()


def load_driving(reference: str) -> DrivingPolicy:
    """What drives, by shipped name or path, whatever kind it is stored as.

    A conditioned policy may be given preference weights, `study_room/conditioned@farther=1,smoother=0.5`; without, all
    are zero. So may an adaptable one, `adaptable/policy@demonstration=0.5,distance=0.5`; without, a third each. Raises
    LearningError or PolicyError.
    """
    return policy_conditioned_on(resolve(reference.partition("@")[0]).read_bytes(), reference)


def load_policy(reference: str) -> Policy:
    """As `load_driving`, one whose network reads the setup's observation: what trainings start from."""
    return network_of(load_driving(reference))


def policy_conditioned_on(content: bytes, reference: str) -> DrivingPolicy:
    """What drives of the policy in `content`, conditioned on what stands behind `@` in its reference. Raises
    LearningError or PolicyError.
    """
    name, _, weights = reference.partition("@")
    try:
        return read_policy(content).driving(weights)
    except LearningError as problem:
        raise type(problem)(f"{name}: {problem}") from None


def load_conditioned(name_or_path: str) -> ConditionedPolicy:
    """A conditioned policy by shipped name (`study_room/conditioned`) or path. Raises LearningError or PolicyError."""
    return ConditionedPolicy.load(resolve(name_or_path))


def load_ensemble(setup: str) -> list[Policy]:
    """The shipped ensemble of a setup, members in order."""
    names = [name for name in shipped_names() if name.startswith(f"{setup}/ensemble/")]
    if not names:
        raise LearningError(f"setup = {setup!r}: no ensemble is shipped for it")
    return [load_policy(name) for name in names]


def load_queries(name_or_path: str) -> QuerySet:
    """A query set by shipped name or path. Raises LearningError."""
    return QuerySet.load(resolve(name_or_path))


def load_step_basis(setup: str) -> StepBasis | None:
    """The shipped step basis of a setup, None where there is none. Raises LearningError for a damaged file."""
    from desirepath.learning.measures.step_basis import StepBasis  # which reads shipped queries, by this file

    name = f"{setup}/step_basis"
    return StepBasis.load(resolve(name)) if name in shipped_names() else None


def load_policy_library(setup: str) -> PolicyLibrary | None:
    """The shipped library of a setup, None where there is none. Raises LearningError for a damaged file."""
    from desirepath.learning.alignment.policy_library import PolicyLibrary

    name = f"{setup}/policy_library"
    return PolicyLibrary.load(resolve(name)) if name in shipped_names() else None


Shipped: TypeAlias = (
    "Policy | AdaptablePolicy | AttentionPolicy | ConditionedPolicy | QuerySet | StepBasis | PolicyLibrary"
)


def load_shipped(name: str) -> Shipped:
    """The shipped artefact of that name, its bytes checked against its card.

    Raises LearningError if the name is unknown or file and card disagree.
    """
    from desirepath.learning.alignment.policy_library import PolicyLibrary
    from desirepath.learning.measures.step_basis import StepBasis
    from desirepath.learning.policies.attention import AttentionPolicy

    path, card = resolve(name), load_card(name)
    if file_sha256(path) != card.sha256:
        raise LearningError(f"{name}: file and card disagree (sha256); restore both from the repository")
    kinds: dict[str, type[Shipped]] = {
        "policy": Policy,
        "adaptable_policy": AdaptablePolicy,
        "attention_policy": AttentionPolicy,
        "conditioned_policy": ConditionedPolicy,
        "query_set": QuerySet,
        "step_basis": StepBasis,
        "policy_library": PolicyLibrary,
    }
    if card.kind not in kinds:
        raise LearningError(f"{name} is a {card.kind}; `rewards.reward_model.RewardModel.load` opens it")
    return kinds[card.kind].load(path)

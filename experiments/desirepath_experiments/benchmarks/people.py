"""`desirepath benchmark people`, and what the benchmarks of simulated people outside the nine objectives share: in what
order they are asked, what a robot has of a policy library, and that a stopped run goes on.

What is asked and measured by `people` itself is `learning/people/asked_people.py`'s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from desirepath.learning.alignment.policy_library import PolicyLibrary
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.step_basis import StepBasis
from desirepath.learning.people import asked_people
from desirepath.learning.people.card import people_card
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.people.reward_file import read_reward
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy, load_policy_library, load_step_basis
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.benchmarks.results import Progress

Doubles = NDArray[np.float64]
Room = TypeVar("Room")
FAMILY = (
    "Families of the card, comma-separated, nine, or raters; tuning, held_out, all (both), unseen; none with --reward."
)
REWARD = "A fitted reward as a person: a manifest (.json) or a reward model of the store (.npz)."


@pydantic.dataclasses.dataclass(frozen=True)
class PeopleOptions:
    """Who is asked how often about what."""

    setup: Annotated[str, Field(description="study_room or open_field.")] = "study_room"
    family: Annotated[str, Field(description=FAMILY)] = "tuning"
    people: Annotated[int, Field(ge=1, le=1_000, description="Of each family and seed.")] = 5
    answers: Annotated[tuple[int, ...], Field(min_length=1, description="After how many it is measured.")] = (8, 15, 50)
    seeds: Annotated[
        tuple[int, ...], Field(min_length=1, description="FIRST-LAST; each has pairs, scenes and people of its own.")
    ] = (0,)
    response_model: Annotated[str, Field(description="right, lapses, indifference, peak_end or first_seconds.")] = (
        "right"
    )
    choose: Annotated[
        Literal["random", "information"], Field(description="information: the pair whose answer tells most.")
    ] = "random"
    queries: Annotated[
        Literal["policies", "manners", "both"], Field(description="Asked about: as they are, or in many manners.")
    ] = "policies"
    prior: Annotated[
        Literal["none", "people_in_general"], Field(description="By the light of what own answers are read.")
    ] = "none"
    reward: Annotated[Path | None, Field(description=REWARD)] = None
    policies: Annotated[
        bool, Field(description="Also share_at_once of the library's best, as `people-policies` does.")
    ] = False


def benchmark_people(config: PeopleOptions, progress: Progress) -> dict[str, Any]:
    """As `asked_people.benchmark_people`; with `policies` also what the library's policies gain."""
    families, setup, after = read_families(config.family), config.setup, tuple(sorted(config.answers))
    more = {config.reward.stem: read_reward(config.reward, setup)} if config.reward is not None else {}
    people_config = asked_people.PeopleConfig(
        families=() if more else families,
        people=config.people,
        answers=after,
        shown_after=15 if 15 in after else after[0],
        seeds=config.seeds,
        response_model=config.response_model,
        choose=config.choose,
        queries=config.queries,
        prior=config.prior,
    )
    persons = asked_people.known_people(progress.out, setup, people_config) if progress.out is not None else []

    def keep(person: dict[str, Any]) -> None:
        persons.append(person)
        progress.keep(asked_people.result_of(setup, people_config, persons))

    result = asked_people.benchmark_people(
        setup, people_config, more, lambda done: progress.tell(f"{done:.0%}"), tuple(persons), keep
    )
    if not config.policies:
        return result
    from desirepath_experiments.benchmarks.people_policies import PeoplePoliciesConfig, with_shares

    of_library = PeoplePoliciesConfig(
        setup,
        ",".join(people_config.families),
        config.people,
        answers=people_config.shown_after,
        seeds=config.seeds,
    )
    return with_shares(result, of_library, more)


def read_families(names: str) -> tuple[str, ...]:
    """Families by name, or all of a group."""
    card = people_card()
    everybody = tuple(name for name in card.families if name not in card.unseen)
    groups = {"tuning": card.tuning, "held_out": card.held_out, "unseen": card.unseen, "all": everybody, "none": ()}
    return groups.get(names) or tuple(name for name in names.split(",") if name and name not in groups)


def measure_everybody(
    config: Any,
    everybody: Callable[[int], Iterable[tuple[str, str, FamilyMember]]],
    open_room: Callable[[int], Room],
    measure: Callable[[FamilyMember, Room], dict[str, Any]],
    summarise: Callable[[Sequence[dict[str, Any]]], Mapping[str, Any]],
    progress: Progress,
) -> dict[str, Any]:
    """{"simulated", "setup", "config", what `summarise` says of all, "persons"}, of every seed of the configuration.

    everybody: family, name and person of a seed's people, families in turns, so that an unfinished run is of all of
    them. open_room: what all people of a seed share.
    """
    done = {(stored["seed"], stored["person"]): stored for stored in progress.kept_persons(config.setup, config)}
    persons: list[dict[str, Any]] = []

    def result() -> dict[str, Any]:
        head = {"simulated": True, "setup": config.setup, "config": asdict(config)}
        return head | dict(summarise(persons)) | {"persons": persons}

    for seed in config.seeds:
        room: Room | None = None
        for family, name, person in everybody(seed):
            if (seed, name) not in done:
                room = room if room is not None else open_room(seed)
                measured = measure(person, room)
                done[seed, name] = {"family": family, "person": name, "seed": seed} | measured
                persons.append(done[seed, name])
                progress.tell(f"{seed} {name}")
                progress.keep(result())
            else:
                persons.append(done[seed, name])
    return result()


@dataclass(frozen=True)
class RobotOfLibrary:
    """What a setup's robot has without training: its base policy, the conditioned one, and the library of others."""

    setup: str
    base: Policy
    conditioned: ConditionedPolicy
    library: PolicyLibrary
    basis: StepBasis

    @classmethod
    def load(cls, setup: str, pretraining: str = "") -> RobotOfLibrary:
        """pretraining: a folder with the setup's folder in it; empty: what is shipped. Raises LearningError where the
        setup has no step basis or no policy library."""
        basis, library = load_step_basis(setup), load_policy_library(setup)
        if basis is None or library is None:
            raise LearningError(f"setup = {setup!r}: no step basis or no policy library is shipped for it")
        if not pretraining:
            return cls(setup, load_policy(f"{setup}/base"), load_conditioned(f"{setup}/conditioned"), library, basis)
        folder = Path(pretraining) / setup
        return cls(
            setup,
            Policy.load(folder / "base.npz"),
            ConditionedPolicy.load(folder / "conditioned.npz"),
            PolicyLibrary.load(folder / "policy_library.npz"),
            basis,
        )

    def policy(self, place: int) -> Policy:
        return self.library.policy(place, self.conditioned, self.base)


def roll_out(policy: Policy, scenes: Sequence[Scene]) -> list[Trajectory]:
    return list(rollout(get_setup(policy.setup), policy.rollout_policy, list(scenes)))

"""A personal robot that is several policies and a choice: in each scene the one drives whose rollout there somebody's
answers let expect most of; where they are not sure of that, the base policy.

It goes by what a robot knows of such a scene: its map, where the person stands, its goal. Nobody who walks is foreseen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.bundle import MOST_CHOICES, MOST_NUMBERS, MOST_RECOVERIES
from desirepath.learning.errors import LearningError
from desirepath.learning.measures.embedding import SIZE
from desirepath.learning.measures.named import NAMES
from desirepath.learning.measures.pairs import PairDifferences, measured
from desirepath.learning.measures.step_basis import Doubles, Floats, StepBasis
from desirepath.learning.policies.policy import DrivingPolicy, Policy, PolicyError, read_slowing
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.policies.side_by_side import Drivers, SideBySide
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.measures import MEASURES
from desirepath.learning.preferences.population_prior import EARLIER, IN_GENERAL, WeightPrior
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.spans import SPANS_S
from desirepath.learning.preferences.step_posterior import StepPosterior
from desirepath.npz import Arrays
from desirepath.simulation.acting import EpisodeActs, Rows, SensingPolicy, begin
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.stored import StoredArrays
from desirepath.simulation.trajectory import Trajectory, arrived

CAUTION = 0.2
"""Standard deviations that are taken off what a rollout is expected to gain. Chosen on 30 people of tuning families,
with comparisons that decide afterwards: 0.4, as before those, gains half as much by nine answers, 0.1 no more by 15;
nobody who is shown theirs is harmed with 0.2."""
FIRST_CAUTION, LARGEST_CAUTION = 0.4, 10.0  # of files that do not name theirs; of any
MOST_PEOPLE, MOST_ANSWERS = 100, 500  # answers of each
MOST_LAYERS = 40  # of a policy; arrays of weights and of biases
AT_ONCE = 20  # scenes, whose rollouts are in memory together
OF_PAIRS = ("seen", "named", "embedding")
OF_BEFORE = ("free_mean", "free_factor", "steps_mean", "steps_factor")


@dataclass(frozen=True)
class Before:
    """What other people weigh, by both posteriors' columns; both parts as `fit_people` has them. steps: None where they
    say nothing of steps (`people_in_general`)."""

    free: WeightPrior
    steps: tuple[Doubles, Doubles] | None = None

    def to_arrays(self) -> dict[str, Doubles]:
        parts = (self.free.mean, self.free.factor, *(self.steps or ()))
        return {f"before_{name}": part for name, part in zip(OF_BEFORE, parts, strict=False)}

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Before:
        """Raises LearningError for what is not finite, ValueError for what does not fit."""
        names = OF_BEFORE if "before_steps_mean" in arrays else OF_BEFORE[:2]
        free_mean, free_factor, *steps = (_finite(arrays, f"before_{name}") for name in names)
        if free_factor.shape[:1] != free_mean.shape or (steps and steps[1].shape != (len(steps[0]), len(steps[0]))):
            shapes = [part.shape for part in (free_mean, free_factor, *steps)]
            raise ValueError(f"before has shapes {shapes}")
        return cls(
            WeightPrior(EARLIER if steps else IN_GENERAL, free_mean, free_factor),
            (steps[0], steps[1]) if steps else None,
        )


@dataclass(frozen=True)
class Answers:
    """Pairs that one person answered: how the first of each differs from the second, by what trajectories measure and
    by means over their steps (`step_differences`), and whether the first was chosen. before: by the light of which
    earlier people's they are read. caution: `CAUTION`."""

    pairs: PairDifferences
    steps: Doubles
    chosen: NDArray[np.bool_]
    left_right_symmetry: bool = False
    before: Before | None = None
    caution: float = CAUTION

    @property
    def setup(self) -> str:
        return self.pairs.setup

    def __len__(self) -> int:
        return len(self.chosen)

    @cached_property
    def believed(self) -> tuple[FreePosterior, StepPosterior]:
        """What they say, by both posteriors."""
        config = FreeConfig(posterior=PosteriorConfig(left_right_symmetry=self.left_right_symmetry))
        return (
            FreePosterior.from_answers(self.pairs, self.chosen, config, self.before.free if self.before else None),
            StepPosterior.from_answers(self.steps, self.chosen, self.before.steps if self.before else None),
        )


class _MeanOverPeople:
    """What one more person of these is expected to want: the mean of what each one's posterior expects, in the scale of
    each; how unsure: by how much they differ, and how unsure each posterior is."""

    def __init__(self, posteriors: Sequence[FreePosterior | StepPosterior], scales: Doubles, symmetry: bool) -> None:
        self._posteriors, self._scales, self.left_right_symmetry = posteriors, scales, symmetry

    def advantages(self, differences: Any) -> tuple[Doubles, Doubles]:
        means, deviations = map(
            np.array, zip(*(posterior.advantages(differences) for posterior in self._posteriors), strict=True)
        )
        means, deviations = means / self._scales[:, None], deviations / self._scales[:, None]
        spread = means.var(0, ddof=1) if len(means) > 1 else 0.0
        return means.mean(0), np.sqrt(spread + np.square(deviations).mean(0))


@dataclass(frozen=True)
class PeopleInGeneral:
    """What several people answered, each for themselves. of_people (n, 2): the largest gain that each one's posteriors
    expect of any policy on average: in these, everybody counts alike."""

    people: tuple[Answers, ...]
    of_people: Doubles

    caution = 0.3
    """As CAUTION, of what one more person wants. Chosen on populations of the tuning families (six, two seeds each):
    with 0.2 more is gained, and more of the new people are harmed, by more."""

    @property
    def setup(self) -> str:
        return self.people[0].setup

    @property
    def left_right_symmetry(self) -> bool:
        return self.people[0].left_right_symmetry

    def __len__(self) -> int:
        return sum(map(len, self.people))

    @cached_property
    def believed(self) -> tuple[_MeanOverPeople, _MeanOverPeople]:
        free, steps = ([person.believed[k] for person in self.people] for k in range(2))
        symmetry = self.left_right_symmetry
        return (
            _MeanOverPeople(free, self.of_people[:, 0], symmetry),
            _MeanOverPeople(steps, self.of_people[:, 1], symmetry),
        )


@dataclass(frozen=True)
class RolloutDifferences:
    """How what n policies do in the same scenes differs from what the base policy does there, policy by policy, scene
    by scene. usable (n, scenes): both arrive."""

    usable: NDArray[np.bool_]
    pairs: PairDifferences
    steps: Doubles

    @classmethod
    def of(
        cls,
        basis: StepBasis,
        usual: Sequence[Trajectory],
        own: Sequence[Sequence[Trajectory]],
        *,
        left_right_symmetry: bool = False,
    ) -> RolloutDifferences:
        """usual, own: rollouts of the base policy and of each of the others, in the same scenes."""
        everyone = [trajectory for of_one in (usual, *own) for trajectory in of_one]
        n = len(usual)
        of_all = measured(basis.setup, everyone, left_right_symmetry=left_right_symmetry)
        means, again = basis.means(everyone), np.tile(np.arange(n), len(own))
        usable = np.array([arrived(of_one) for of_one in own]) & arrived(usual)
        pairs = PairDifferences.between(basis.setup, of_all[n:], of_all[again])
        return cls(usable, pairs, basis.between(means[n:], means[again]))

    def expected(self, answers: Answers | PeopleInGeneral, scales: Doubles) -> Doubles:
        """(n, scenes) what each rollout is expected to gain over the base policy's by both posteriors, less the
        caution; minus infinity of those that are not usable. scales (2,): gains that count as much by the one as by
        the other."""
        free, steps = answers.believed
        gains = np.zeros(self.usable.size)
        for (mean, deviation), scale in zip(
            (free.advantages(self.pairs), steps.advantages(self.steps)), scales, strict=True
        ):
            gains += (mean - answers.caution * deviation) / scale
        return np.where(self.usable, gains.reshape(self.usable.shape), -np.inf)


@dataclass(frozen=True)
class ChoosingPolicy(StoredArrays, DrivingPolicy):
    """policies: of one setup, of which in each scene one drives; the first is the base policy. basis, answers, scales:
    what says which (`RolloutDifferences.expected`). made_for: as of a `Policy`."""

    setup: str
    policies: tuple[Policy, ...]
    basis: StepBasis
    answers: Answers | PeopleInGeneral
    scales: Doubles
    made_for: str = ""

    noun, raises = "choosing policy", PolicyError
    reads = "rollouts of several policies in a scene whose map and person it knows, to choose the one that drives there"
    file_format = "desirepath-choosing-1"

    def __post_init__(self) -> None:
        named = {f"policy {k}": policy.setup for k, policy in enumerate(self.policies)}
        require_same(setup=self.setup, basis=self.basis.setup, answers=self.answers.setup, **named)
        if not 2 <= len(self.policies) <= MOST_CHOICES:
            raise PolicyError(
                f"policies = {len(self.policies)}: needs the base policy and 1 to {MOST_CHOICES - 1} more"
            )
        networks = [actor for one in self.policies for actor in (one.actor, *one.recovery_policies)]
        numbers = sum(layer.size for actor in networks for layer in actor)
        if numbers > MOST_NUMBERS:
            raise PolicyError(f"policies have {numbers:,} weights together: at most {MOST_NUMBERS:,}")
        if len(self.people) > MOST_PEOPLE:
            raise PolicyError(f"answers of {len(self.people)} people: at most {MOST_PEOPLE}")
        if (answers := max(map(len, self.people), default=0)) > MOST_ANSWERS:
            raise PolicyError(f"answers = {answers}: at most {MOST_ANSWERS} of each")
        if self.scales.shape != (2,) or not (np.isfinite(self.scales) & (self.scales > 0)).all():
            raise PolicyError(f"scales = {self.scales.tolist()}: needs two numbers above 0")

    @property
    def people(self) -> tuple[Answers, ...]:
        """Whose answers it goes by, each for themselves."""
        return self.answers.people if isinstance(self.answers, PeopleInGeneral) else (self.answers,)

    @property
    def rollout_policy(self) -> SensingPolicy:
        """Chooses as an episode begins, then drives by what was chosen."""
        return _ChoosesAndDrives(self)

    def places(self, scenes: Sequence[Scene]) -> NDArray[np.int64]:
        """(scenes,) which of the policies drives in each, 0: the base policy."""
        some = [self._places(scenes[first : first + AT_ONCE]) for first in range(0, len(scenes), AT_ONCE)]
        return np.concatenate(some) if some else np.zeros(0, dtype=np.int64)

    def _places(self, scenes: Sequence[Scene]) -> NDArray[np.int64]:
        symmetry = self.answers.left_right_symmetry
        rollouts = roll_out_all(self.side_by_side, self.basis, scenes, left_right_symmetry=symmetry)
        expected = rollouts.expected(self.answers, self.scales)
        return np.where(expected.max(0) > 0, expected.argmax(0) + 1, 0)

    @cached_property
    def side_by_side(self) -> SideBySide:
        """All of the policies."""
        return SideBySide(self.policies)

    def gains(self, usual: Trajectory, others: Sequence[Trajectory]) -> Doubles:
        """(n,) how much more is expected of each than of what is usual, from the same moment on, less the caution."""
        symmetry = self.answers.left_right_symmetry
        alone = [[other] for other in others]
        compared = RolloutDifferences.of(self.basis, [usual], alone, left_right_symmetry=symmetry)
        return compared.expected(self.answers, self.scales)[:, 0]

    def in_scene(self, scene: Scene) -> Policy:
        """The one that drives there."""
        return self.policies[int(self.places([scene])[0])]

    def manifest(self) -> dict[str, object]:
        return {
            "setup": self.setup,
            "chooses": "in each scene the policy whose rollout there is expected to be liked most, else the first",
            "policies": [policy.digest() for policy in self.policies],
            "answers": len(self.answers),
            "caution": self.answers.caution,
            "policy_sha256": self.digest(),
        }

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        """Layers that several policies share are kept once, in half precision where that loses nothing."""
        layers: dict[tuple[tuple[int, ...], bytes], int] = {}
        arrays: Arrays = {}

        def numbers(actor: Sequence[Floats]) -> list[int]:
            found = []
            for layer in actor:
                number = layers.setdefault((layer.shape, layer.tobytes()), len(layers))
                arrays[f"layer_{number:04d}"] = _smallest(layer)
                found.append(number)
            return found

        policies = [
            {
                "shape": policy.shape.as_dict(),
                "actor": numbers(policy.actor),
                "recovery": [numbers(actor) for actor in policy.recovery_policies],
                **({"slowing": policy.slowing.as_dict()} if policy.slowing else {}),
            }
            for policy in self.policies
        ]
        people = self.people
        arrays |= {f"pairs_{name}": np.concatenate([getattr(one.pairs, name) for one in people]) for name in OF_PAIRS}
        arrays |= {"steps": np.concatenate([one.steps for one in people]), "scales": self.scales}
        arrays |= {"chosen": np.concatenate([one.chosen for one in people])}
        arrays |= {f"basis_{name}": part for name, part in self.basis.to_arrays().items()}
        header: dict[str, object] = {
            "setup": self.setup,
            "made_for": self.made_for,
            "symmetry": self.answers.left_right_symmetry,
            "policies": policies,
        }
        if isinstance(self.answers, Answers):
            header["caution"] = self.answers.caution
        if isinstance(self.answers, Answers) and self.answers.before is not None:
            header["before"] = True
            arrays |= self.answers.before.to_arrays()
        if isinstance(self.answers, PeopleInGeneral):
            header["people"] = [len(one) for one in people]
            arrays["of_people"] = self.answers.of_people
        return header, arrays

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> Self:
        setup = str(header["setup"])

        layers = {name: part.astype(np.float32) for name, part in arrays.items() if name.startswith("layer_")}

        def actor(numbers: Sequence[int]) -> tuple[Floats, ...]:
            return tuple(layers[f"layer_{number:04d}"] for number in numbers[:MOST_LAYERS])

        policies = tuple(
            Policy(
                setup,
                NetworkShape.from_dict(of["shape"]),
                actor(of["actor"]),
                recovery_policies=tuple(actor(numbers) for numbers in of["recovery"][:MOST_RECOVERIES]),
                slowing=read_slowing(of),
            )
            for of in header["policies"][: MOST_CHOICES + 1]
        )
        pairs = PairDifferences(setup, *(_finite(arrays, f"pairs_{name}") for name in OF_PAIRS))
        caution = float(header.get("caution", FIRST_CAUTION))
        if not 0 <= caution <= LARGEST_CAUTION:
            raise ValueError(f"caution = {caution}: must be from 0 to {LARGEST_CAUTION}")
        chosen = arrays["chosen"].astype(np.bool_)
        answers = Answers(pairs, _finite(arrays, "steps"), chosen, bool(header["symmetry"]), caution=caution)
        basis = StepBasis.from_arrays(
            setup, {key.removeprefix("basis_"): part for key, part in arrays.items() if key.startswith("basis_")}
        )
        n = len(answers.chosen)
        shapes = [part.shape for part in (pairs.seen, pairs.named, pairs.embedding, answers.steps, answers.chosen)]
        expected = [(n, len(SPANS_S), len(MEASURES)), (n, len(NAMES)), (n, SIZE), (n, basis.size), (n,)]
        if shapes != expected:
            raise ValueError(f"answers have shapes {shapes}; needed are {expected}")
        believer: Answers | PeopleInGeneral = answers
        if header.get("before"):
            believer = replace(answers, before=_before(arrays, basis))
        if "people" in header:
            believer = _several(answers, [int(count) for count in header["people"]], _finite(arrays, "of_people"))
        return cls(setup, policies, basis, believer, _finite(arrays, "scales"), str(header.get("made_for", "")))


class _ChoosesAndDrives(SensingPolicy):
    def __init__(self, policy: ChoosingPolicy) -> None:
        self._policy = policy

    def begin_in(self, engine: Any) -> EpisodeActs:
        policies, episodes = self._policy.policies, engine.n_envs
        driving = self._policy.places([engine.scene(k) for k in range(episodes)])
        acts = {place: begin(policies[place].rollout_policy, episodes) for place in set(driving.tolist())}

        def act(observations: Floats, rows: Rows) -> Floats:
            actions = np.zeros((len(rows), 2), dtype=np.float32)
            for place in np.unique(driving[rows]):
                these = driving[rows] == place
                actions[these] = acts[place](observations[these], rows[these])
            return actions

        return act


def roll_out_all(
    policies: SideBySide, basis: StepBasis, scenes: Sequence[Scene], *, left_right_symmetry: bool
) -> RolloutDifferences:
    """All but the first of the policies beside the first, in each of the scenes."""
    drivers = Drivers(policies, np.repeat(np.arange(len(policies)), len(scenes)))
    trajectories = rollout(get_setup(basis.setup), drivers, [*scenes] * len(policies))
    usual, *own = [trajectories[k : k + len(scenes)] for k in range(0, len(trajectories), len(scenes))]
    return RolloutDifferences.of(basis, usual, own, left_right_symmetry=left_right_symmetry)


def _before(arrays: Arrays, basis: StepBasis) -> Before:
    """Raises ValueError for what is of other columns."""
    before = Before.from_arrays(arrays)
    of_steps = basis.size if before.steps is None else len(before.steps[0])
    if (len(before.free.mean), of_steps) != (len(NAMES) + SIZE, basis.size):
        raise ValueError(f"before has {len(before.free.mean)} and {of_steps} columns")
    return before


def _several(answers: Answers, counts: Sequence[int], of_people: Doubles) -> PeopleInGeneral:
    """Everybody's, of who stands behind whom. Raises ValueError for counts or scales that do not fit."""
    if min(counts, default=0) < 1 or sum(counts) != len(answers) or of_people.shape != (len(counts), 2):
        raise ValueError(f"people = {list(counts)}: {len(answers)} answers and {of_people.shape} scales do not fit")
    if not (of_people > 0).all():
        raise ValueError("of_people: needs numbers above 0")
    ends = np.cumsum(counts)
    rows = [slice(int(end - count), int(end)) for end, count in zip(ends, counts, strict=True)]
    people = [
        Answers(answers.pairs[row], answers.steps[row], answers.chosen[row], answers.left_right_symmetry)
        for row in rows
    ]
    return PeopleInGeneral(tuple(people), of_people)


def _smallest(layer: Floats) -> NDArray[np.floating[Any]]:
    half = layer.astype(np.float16)
    return half if np.array_equal(half.astype(np.float32), layer) else layer


def _finite(arrays: Arrays, name: str) -> Doubles:
    """Raises LearningError for what is not finite."""
    values = arrays[name].astype(np.float64)
    if not np.isfinite(values).all():
        raise LearningError(f"{name} holds what is not finite")
    return values


STORED = ChoosingPolicy

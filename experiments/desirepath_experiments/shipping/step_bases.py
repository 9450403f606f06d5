"""The shipped step basis: what explains most of how random people's scores differ within a scene, and how much of that
it can say, by family.

People are drawn from the tuning families of `people/card.yaml` and from words of a step; families that are held out
have no part in it, not even on the card. All ours.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from desirepath.learning.cards import Card
from desirepath.learning.measures.step_basis import Doubles, StepBasis, StepLayer
from desirepath.learning.measures.steps import WORDS, SeenSteps, scale_words
from desirepath.learning.people.card import members, people_card
from desirepath.learning.people.families.network import NetworkFamily
from desirepath.learning.policies.shipped import load_conditioned, load_ensemble, load_policy
from desirepath.learning.queries.varied_queries import draw_weights
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.learning.shipping.storing import Request
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

StepReward = Callable[[SeenSteps], Doubles]
FIRST_SEED = 7_000  # of the scenes, of no card and no benchmark
FIRST_MEMBER = 200  # of those that the basis is measured on: of no benchmark
MEASURED = 6


def ship_step_basis(request: Request) -> Card:
    """Fit and store `SETUP/step_basis.npz`."""
    setup, config = request.setup, StepBasisConfig()
    basis = fit_step_basis(setup, config)
    request.on_progress(0.7, {"size": basis.size})
    rollouts = roll_out_varied(setup, config, seed=FIRST_SEED + 1)
    explained = {
        family: [
            explain(basis, rollouts, person.scores(rollouts), config.scenes)
            for person in members(family, MEASURED, setup, FIRST_MEMBER).values()
        ]
        for family in people_card().tuning
    }
    conditioned = load_conditioned(f"{setup}/conditioned").as_trained().digest()
    return request.store(
        "step_basis",
        "step_basis",
        basis.save,
        f"step-basis {setup}",
        config=asdict(config),
        scenes={
            "fitted": describe(Purpose.ALIGN_SELECT, config.scenes, FIRST_SEED),
            "measured": describe(Purpose.ALIGN_SELECT, config.scenes, FIRST_SEED + 1),
        },
        results={
            "explained_within_scenes": {name: round(float(np.mean(of)), 3) for name, of in explained.items()},
            "least": {name: round(float(np.min(of)), 3) for name, of in explained.items()},
            "people_of_each": MEASURED,
        },
        parents=request.parents("base") | {f"{setup}/conditioned": conditioned},
        departures=["step_basis"],
        notes=["Its random layer depends on the shipped varied queries, whose steps scale the inputs."],
    )


@dataclass(frozen=True)
class StepBasisConfig:
    """size: K. people: drawn. scenes, settings: rollouts of the conditioned policy at so many settings, the ensemble
    and the base policy. gain: of networks, from-to. ridge: of fitting a person's reward to the features."""

    size: int = 24
    features: int = 256
    people: int = 480
    scenes: int = 60
    settings: int = 40
    gain: tuple[float, float] = (0.6, 2.0)
    ridge: float = 3e-4


def fit_step_basis(setup: str, config: StepBasisConfig | None = None) -> StepBasis:
    """The basis of a setup; the same settings give the same one."""
    config = config or StepBasisConfig()
    rollouts = roll_out_varied(setup, config)
    steps = SeenSteps.of_trajectories(rollouts)
    layer = StepLayer.drawn(setup, config.features)
    raw = layer.of(steps).astype(np.float64)
    mean, spread = raw.mean(0), np.maximum(raw.std(0), 1e-4)
    features = (raw - mean) / spread
    rewards = np.stack([reward(steps) for reward in draw_rewards(setup, config.people, config.gain)], axis=1)
    rewards -= rewards.mean(0)
    rewards /= mean_within_scenes(steps, rewards, config.scenes).std(0)
    gram = features.T @ features / len(features) + config.ridge * np.eye(features.shape[1])
    fitted = np.linalg.solve(gram, features.T @ rewards / len(features))
    apart = mean_within_scenes(steps, features, config.scenes) @ fitted
    _, _, directions = np.linalg.svd(apart, full_matrices=False)
    mix = fitted @ directions[: config.size].T / math.sqrt(config.people) / spread[:, None]
    values = raw @ mix - mean @ mix
    return StepBasis(
        setup,
        layer,
        mix.astype(np.float32),
        (mean @ mix).astype(np.float32),
        np.cov(mean_within_scenes(steps, values, config.scenes).T).astype(np.float32),
    )


def roll_out_varied(setup: str, config: StepBasisConfig, seed: int = FIRST_SEED) -> list[Trajectory]:
    """By policy, then by scene."""
    scenes = scene_set(setup, config.scenes, purpose=Purpose.ALIGN_SELECT, seed=seed)
    conditioned = load_conditioned(f"{setup}/conditioned").as_trained()
    policies = [conditioned.at(weights) for weights in draw_weights(config.settings, seed)]
    policies += [*load_ensemble(setup), load_policy(f"{setup}/base")]
    return [
        trajectory for policy in policies for trajectory in rollout(get_setup(setup), policy.rollout_policy, scenes)
    ]


def mean_within_scenes(steps: SeenSteps, values: Doubles, scenes: int) -> Doubles:
    """(trajectories, columns) means of (n, columns) over each trajectory, less what all in its scene have."""
    starts = np.flatnonzero(np.diff(steps.of, prepend=-1))
    means = np.add.reduceat(values, starts, axis=0) / np.bincount(steps.of)[:, None]
    return _subtract_scene(means, scenes)


def draw_rewards(setup: str, count: int, gain: tuple[float, float]) -> list[StepReward]:
    """Rewards of a step: three of four are random networks, the others thresholds and weighed words in turn."""
    card, random = people_card(), np.random.default_rng([0, 88])
    networks, thresholds = card.family("network"), card.family("thresholds")
    assert isinstance(networks, NetworkFamily)  # noqa: S101  the card's families are of their classes
    rewards: list[StepReward] = []
    for k in range(count):
        if k % 4 < 3:
            drawn = float(np.exp(random.uniform(math.log(gain[0]), math.log(gain[1]))))
            rewards.append(networks.model_copy(update={"gain": drawn}).draw(setup, random).step_scores)
        elif k % 8 == 3:
            rewards.append(thresholds.draw(setup, random).step_scores)  # type: ignore[attr-defined]
        else:
            size = int(random.integers(1, 5))
            words = [WORDS[j] for j in random.choice(len(WORDS), size, replace=False)]
            weights = random.normal(0, 1, size)
            rewards.append(_weigh(words, weights / np.linalg.norm(weights)))
    return rewards


def _weigh(words: Sequence[str], weights: Doubles) -> StepReward:
    def reward(steps: SeenSteps) -> Doubles:
        return scale_words(steps, words) @ weights

    return reward


def explain(basis: StepBasis, rollouts: Sequence[Trajectory], scores: Doubles, scenes: int) -> float:
    """The share of how somebody's scores (n,) of `roll_out_varied` vary within scenes that the basis can say."""
    columns, wanted = _subtract_scene(basis.means(rollouts), scenes), _subtract_scene(scores[:, None], scenes)[:, 0]
    gram = columns.T @ columns / len(wanted) + 2e-3 * np.eye(columns.shape[1])
    left = wanted - columns @ np.linalg.solve(gram, columns.T @ wanted / len(wanted))
    return 1 - float(left.var() / max(float(wanted.var()), 1e-12))


def _subtract_scene(values: Doubles, scenes: int) -> Doubles:
    by_scene = values.reshape(-1, scenes, values.shape[1])
    apart: Doubles = by_scene - by_scene.mean(0)
    return apart.reshape(values.shape)

"""What each task of chapter 5 computes. Which there are: `plan.py`; the numbers made of them: `results.py`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.frechet import frechet_distance
from desirepath.analysis.metrics import collision_rate, success_rate, timeout_rate
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.learning.adaptable.objectives import NAMES, thesis_vectors
from desirepath.learning.policies.adaptable import AdaptablePolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.rewards.ranked_rollouts import RankedRewardModel
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.scene_sets import Purpose, first_seed, scene_set
from desirepath.simulation.demonstration_scenes import demonstration_scenes
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory
from desirepath_experiments.reproduction.adaptable.adaptable_scenes import intersection, walking_scenes
from desirepath_experiments.reproduction.adaptable.drawn_rollouts import augmented_all, scenes_beside
from desirepath_experiments.reproduction.adaptable.ranked_judging import judged as judge_reward
from desirepath_experiments.reproduction.tasks import Function, TaskResult, as_bytes
from desirepath_experiments.training.adaptable.cloning import CloningConfig, clone_policy
from desirepath_experiments.training.adaptable.demonstrator import demonstrate_in, demonstrate_paths
from desirepath_experiments.training.adaptable.ranking import RankedConfig, RankedRollouts, fit_ranked, rank_by_noise
from desirepath_experiments.training.adaptable.rollouts import PreferenceAct, PreferenceRollouts, roll_out_preferences
from desirepath_experiments.training.adaptable.training import (
    MEASURE_OF,
    AdaptableConfig,
    train_adaptable,
    without_person,
)

ADAPTABLE = get_setup("adaptable")

Floats = NDArray[np.float32]
RANKED_IN, HELD_OUT = 300, 100  # scenes of the noise-ranked rollouts, and of those that judge the reward
SHOWN = 2  # scenes of each kind that figures show
DISTURBED = 0.15
HELD_OUT_SEED = 1_000  # added to the seed for what judges


def demonstration(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Clone, noise-ranked rollouts, reward network; judged on rollouts in other scenes."""
    del needs
    seed = params["seed"]
    if params["source"] == "drawn":
        drawn = [
            demonstrate(params["style"], scene, seed * params["per_pair"] + again)
            for scene in demonstration_scenes(params["environment"])
            for again in range(params["per_pair"])
        ]
        demonstrations = augmented_all(drawn)
        scenes, _ = scenes_beside(drawn, RANKED_IN, seed)
        held_out, way = scenes_beside(drawn, HELD_OUT, seed + HELD_OUT_SEED)
    else:
        layouts = scene_set(ADAPTABLE.name, 3 * params["layouts"], purpose=Purpose.SELECT, seed=seed)
        demonstrations = demonstrate_in(layouts, disturbed=DISTURBED, seed=seed)[: params["layouts"]]
        scenes = [trajectory.scene for trajectory in demonstrations[:RANKED_IN]]
        fresh = scene_set(ADAPTABLE.name, 3 * HELD_OUT, purpose=Purpose.REPORT, seed=seed)
        held_out = [trajectory.scene for trajectory in demonstrate_in(fresh)][:HELD_OUT]
        way = demonstrate_paths(held_out)
    hide = without_person if params["without_person"] else (lambda seen: seen)
    clone = clone_policy(_hidden(demonstrations, hide), CloningConfig(seed, params["cloning_updates"]))
    ranked = rank_by_noise(lambda seen: clone.act(hide(seen)), scenes, seed=seed)
    shown = RankedRollouts(_hidden(ranked.trajectories, hide), ranked.levels)
    reward = fit_ranked(shown, RankedConfig(seed, params["reward_updates"]))
    other = rank_by_noise(lambda seen: clone.act(hide(seen)), held_out, seed=seed + HELD_OUT_SEED)
    unseen = RankedRollouts(_hidden(other.trajectories, hide), other.levels)
    first = other.trajectories[: len(held_out)]
    apart = [
        frechet_distance(trajectory.poses[:, :2].astype(float), b, exact_m=1e-3)
        for trajectory, b in zip(first, way, strict=True)
    ]
    meta = {
        "judged": judge_reward(reward, unseen, way).as_dict(),
        "demonstrations": len(demonstrations),
        "steps": sum(len(trajectory.actions) for trajectory in demonstrations),
        "clone": {
            "success": success_rate([trajectory.outcome for trajectory in first]),
            "frechet_m": float(np.mean(apart)),
            "frechet_median_m": float(np.median(apart)),
        },
    }
    return TaskResult(meta, {"clone": as_bytes(clone.to_bytes()), "reward": as_bytes(reward.to_bytes())})


def _hidden(trajectories: Sequence[Trajectory], hide: Callable[[Floats], Floats]) -> list[Trajectory]:
    return [replace(trajectory, observations=hide(trajectory.observations)) for trajectory in trajectories]


def reward_of(result: TaskResult) -> RankedRewardModel:
    model = RewardModel.from_bytes(result.content("reward"))
    if not isinstance(model, RankedRewardModel):
        raise ValueError(f"reward of kind {model.kind!r}: a demonstration task stores ranked_rollouts")
    return model


def adaptable(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Train MO-TD3-HER on the demonstration's reward."""
    config = AdaptableConfig(**params["config"])
    model, clone = reward_of(needs[0]), Policy.from_bytes(needs[0].content("clone"))
    hide = without_person if config.without_person else (lambda seen: seen)
    trained = train_adaptable(config, lambda seen, actions: model.rewards(hide(seen), actions), clone.act)
    meta = {
        "history": trained.history,
        "transitions": trained.transitions,
        "selection_success": trained.selection_success,
        "config": config.as_dict(),
    }
    return TaskResult(meta, {"policy": as_bytes(trained.policy.to_bytes()), "solutions": trained.solutions})


def sac(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Stable-Baselines3's SAC on the parameterised scalar reward, with as many updates; without the clone's
    transitions."""
    from stable_baselines3 import SAC

    from desirepath.learning.policies.networks import use_one_thread
    from desirepath_experiments.training.adaptable.scalar_env import ScalarVecEnv

    use_one_thread()
    config = AdaptableConfig(seed=params["seed"], updates=params["updates"])
    env = ScalarVecEnv(reward_of(needs[0]).rewards, config.n_envs, seed=config.seed, scale=config.reward_scale)
    learner = SAC(
        "MlpPolicy", env, learning_rate=config.learning_rate, buffer_size=config.buffer_size,
        learning_starts=config.random_transitions, batch_size=config.batch_size, tau=config.tau,
        gamma=params["gamma"], train_freq=1, gradient_steps=config.updates_per_step,
        policy_kwargs={"net_arch": list(config.heads)}, seed=config.seed, device="cpu",
    )  # fmt: skip
    learner.learn(config.random_transitions + config.updates * config.n_envs // config.updates_per_step)
    layers = [*learner.actor.latent_pi, learner.actor.mu]
    arrays = {}
    for k, layer in enumerate(module for module in layers if hasattr(module, "weight")):
        arrays[f"layer_{k:02d}_weight"] = layer.weight.detach().numpy().T.copy()
        arrays[f"layer_{k:02d}_bias"] = layer.bias.detach().numpy().copy()
    return TaskResult({"transitions": int(learner.num_timesteps)}, arrays)


def acting(result: TaskResult) -> PreferenceAct:
    """How a trained policy of either kind acts."""
    if "policy" in result.arrays:
        return AdaptablePolicy.from_bytes(result.content("policy")).act
    layers = [result.arrays[name] for name in sorted(result.arrays)]  # bias before weight, as their names sort
    pairs = [(layers[k + 1], layers[k]) for k in range(0, len(layers), 2)]

    def act(observations: Floats, preferences: Floats) -> Floats:
        hidden = np.concatenate([observations, preferences], axis=1)
        for weight, bias in pairs[:-1]:
            hidden = np.maximum(hidden @ weight + bias, 0)
        actions: Floats = np.tanh(hidden @ pairs[-1][0] + pairs[-1][1])
        return actions

    return act


def judged(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """33 vectors in the same reporting scenes, with a walking person and at the intersection; rollouts for figures."""
    act, model = acting(needs[0]), reward_of(needs[1])
    vectors, n = thesis_vectors(), params["rollouts"]
    seed, first = params["seed"], first_seed(Purpose.REPORT, params["seed"])
    kinds = {
        "static": scene_set(ADAPTABLE.name, n, purpose=Purpose.REPORT, seed=seed),
        "walking": walking_scenes(params["elsewhere"], first),
        "intersection": [intersection(first + k) for k in range(params["elsewhere"])],
    }
    meta: dict[str, Any] = {}
    arrays: dict[str, NDArray[Any]] = {}
    for kind, scenes in kinds.items():
        repeated = np.repeat(vectors, len(scenes), axis=0)
        rollouts = roll_out_preferences(act, scenes * len(vectors), repeated, model.rewards)
        meta[kind] = rates(rollouts.outcome)
        shaped: dict[str, NDArray[Any]] = {
            "outcome": rollouts.outcome,
            "time_s": rollouts.time_s,
            "human_m": rollouts.human_m,
        }
        shaped |= {"obstacle_m": rollouts.obstacle_m}
        if kind == "static":
            ways = demonstrate_paths(scenes)
            shaped["frechet_m"] = rollouts.frechet_m(ways * len(vectors))
            arrays["returns"] = rollouts.returns.reshape(len(vectors), len(scenes), -1)
            free = {demonstrated.scene.seed for demonstrated in demonstrate_in(scenes)}
            arrays["free"] = np.array([scene.seed in free for scene in scenes])
            arrays |= _pad("way", ways[:SHOWN])
        arrays |= {f"{kind}_{name}": value.reshape(len(vectors), -1) for name, value in shaped.items()}
        arrays |= _pad(f"{kind}_path", _shown_paths(rollouts, len(vectors), len(scenes)))
        meta[kind]["shown"] = [scene.as_dict() for scene in scenes[:SHOWN]]
    return TaskResult(meta, arrays)


def alone(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The single-objective policy under that objective's full weight, in the scenes that `judged` rolls out in."""
    model = reward_of(needs[1])
    scenes = scene_set(ADAPTABLE.name, params["rollouts"], purpose=Purpose.REPORT, seed=params["seed"])
    k = NAMES.index(params["objective"])
    preferences = np.tile(np.eye(len(NAMES), dtype=np.float32)[k], (len(scenes), 1))
    rollouts = roll_out_preferences(acting(needs[0]), scenes, preferences, model.rewards)
    measure = MEASURE_OF[k]
    values = rollouts.frechet_m(demonstrate_paths(scenes)) if measure == "frechet_m" else getattr(rollouts, measure)
    arrived = values[rollouts.success]
    return TaskResult(
        rates(rollouts.outcome) | {"measure": measure, "mean": float(arrived.mean()) if len(arrived) else None}, {}
    )


def rates(outcome: NDArray[np.int8]) -> dict[str, Any]:
    """In %."""
    return {
        "success": 100 * success_rate(outcome),
        "collision": 100 * collision_rate(outcome),
        "timeout": 100 * timeout_rate(outcome),
    }


def _shown_paths(rollouts: PreferenceRollouts, vectors: int, scenes: int) -> list[NDArray[np.float64]]:
    return [rollouts.paths[v * scenes + s] for v in range(vectors) for s in range(min(SHOWN, scenes))]


def _pad(name: str, paths: Sequence[NDArray[np.float64]]) -> dict[str, NDArray[Any]]:
    """Paths as one array (paths, points, 2), the rest NaN."""
    padded = np.full((len(paths), max(map(len, paths)), 2), np.nan, dtype=np.float32)
    for row, path in zip(padded, paths, strict=True):
        row[: len(path)] = path
    return {name: padded}


FUNCTIONS: dict[str, Function] = {
    function.__name__: function for function in (demonstration, adaptable, sac, judged, alone)
}

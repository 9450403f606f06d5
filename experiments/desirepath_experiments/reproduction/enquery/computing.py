"""What each task of chapter 6 computes. Which there are: `plan.py`; the numbers made of them: `results.py`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.metrics import action_diversity
from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig, search_conditioning
from desirepath.learning.alignment.relabelling import align
from desirepath.learning.alignment.thesis import ThesisConfig
from desirepath.learning.cards import read_config
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.evaluate import episodes
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_ensemble, load_policy
from desirepath.learning.preferences.oracles import make_oracle
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.queries.queries import Query, QueryConfig, generate_queries
from desirepath.learning.rewards.held_out import accuracy
from desirepath.learning.rewards.linear import fit_linear
from desirepath.learning.rewards.mlp import MlpConfig, fit_mlp
from desirepath.learning.rewards.reward_model import RewardModel
from desirepath.learning.rewards.weights import fit_weights
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import BaseConfig, train_base
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig, train_ensemble
from desirepath.learning.td3.replay import collect
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath_experiments.reproduction.enquery.plan import MODELS, ORACLE, SETUP, SOURCES, Source, read_alignment
from desirepath_experiments.reproduction.tasks import Function, TaskResult


def table_scenes(chosen: dict[str, int]) -> list[Scene]:
    """The scenes that a table's trajectories run in, the same for every policy."""
    return scene_set(SETUP, chosen["n"], purpose=Purpose.REPORT, seed=chosen["seed"])


def stored_policies(result: TaskResult) -> list[Policy]:
    """The policies in a task's result, in order."""
    return [Policy.from_bytes(result.arrays[name].tobytes()) for name in sorted(result.arrays) if "policy" in name]


def _with_policies(policies: Sequence[Policy], meta: dict[str, Any], **arrays: NDArray[Any]) -> TaskResult:
    stored = {f"policy_{k}": np.frombuffer(p.to_bytes(), dtype=np.uint8) for k, p in enumerate(policies)}
    return TaskResult(meta, {**arrays, **stored})


def take_shipped_base(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    return _with_policies([load_policy(params["name"])], {})


def take_shipped_ensemble(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    return _with_policies(load_ensemble(SETUP), {})


def train_base_task(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    result = train_base(BaseConfig(**read_config(params)))
    return _with_policies([result.policy], {"selection_success_rate": result.selection_success})


def train_ensemble_task(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    base = stored_policies(needs[0])[0]
    result = train_ensemble(base, PolicyEnsembleConfig(**read_config(params)), threads=1)  # tasks are made side by side
    return _with_policies(result.members, {"success_rates": result.success_rates, "diversity": result.diversity})


def sweep_task(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Success and action diversity of an ensemble at some numbers of steps (figure 6.2), its last weights each time.

    success_rates: (marks, members). diversity: (marks,), over states of the regenerated base buffer.
    """
    base, config = stored_policies(needs[0])[0], PolicyEnsembleConfig(**read_config(params["config"]))
    chosen = params["scenes"]
    scenes = scene_set(SETUP, chosen["n"], purpose=Purpose.SELECT, seed=chosen["seed"])
    seen = np.asarray(collect(base, config.base_transitions, noise=config.exploration, seed=config.seed).filled()[0])
    states = seen[np.random.default_rng([config.seed, 62]).choice(len(seen), params["states"])]
    success: list[list[float]] = []
    diversity: list[float] = []

    def look(steps: int, members: list[Policy]) -> None:
        success.append([float((episodes(member, scenes).outcome == Outcome.SUCCESS).mean()) for member in members])
        diversity.append(action_diversity([member.act(states) for member in members]))

    train_ensemble(base, config, marks=params["marks"], on_members=look, threads=1)
    return TaskResult({}, {"success_rates": np.array(success), "diversity": np.array(diversity)})


def ensemble_answers(members: Sequence[Policy], count: int, seed: int) -> list[Preference]:
    """The oracle's answers to pairs of ensemble trajectories, filtered as in the thesis and no further."""
    config = QueryConfig(
        count=count,
        seed=seed,
        max_duration_s=float("inf"),
        min_duration_s=0.0,
        min_gap_m=0.0,
        scenes_per_round=16 + count,  # changes no query, only how many scenes are rolled out beyond those needed
        max_scenes=256 + 4 * count,  # all are drawn before the first trajectory
    )
    return make_oracle(ORACLE).answer(generate_queries(members, config).queries)


def segment_answers(base: Policy, count: int, seed: int) -> list[Preference]:
    """The oracle's answers to the baseline's pairs of 20-step segments."""
    pairs = segment_queries(base, count, seed=seed)
    return make_oracle(ORACLE).answer([Query(a.scene, a, b, (0, 0)) for a, b in pairs])


def answers_of(source: Source, needs: Sequence[TaskResult], count: int, seed: int) -> list[Preference]:
    """`needs`: base, ensemble."""
    if source == "BL":
        return segment_answers(stored_policies(needs[0])[0], count, seed)
    return ensemble_answers(stored_policies(needs[1]), count, seed)


def accuracy_task(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """One repetition of figure 6.4: share of test pairs predicted, (models, sources, numbers of answers, test sets).

    Only the neural model can be fitted to one answer: NaN for the others.
    """
    tests = [
        answers_of("EnQ", needs, params["test_pairs"], params["test_seed"]),
        answers_of("BL", needs, params["test_pairs"], params["test_seed"]),
    ]
    values = np.full((len(MODELS), len(SOURCES), len(params["answers"]), len(tests)), np.nan)
    heads = (params["heads"][0], params["heads"][1])
    for s, source in enumerate(SOURCES):
        preferences = answers_of(source, needs, max(params["answers"]), params["query_seed"])
        for k, count in enumerate(params["answers"]):
            models: list[RewardModel] = [
                fit_mlp(preferences[:count], MlpConfig(seed=params["seed"], heads=heads, fewest_answers=1))
            ]
            if count > 1:
                models += [fit_linear(preferences[:count]), fit_weights(preferences[:count])]
            for m, model in enumerate(models):
                values[m, s, k] = [accuracy(model, test) for test in tests]
    return TaskResult({}, {"accuracy": values})


def alignment_task(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """One alignment and its trajectories in the table's scenes."""
    config = read_alignment(params["config"])
    preferences = answers_of(params["source"], needs, params["queries"], params["query_seed"])
    heads = (params["heads"][0], params["heads"][1])
    model: RewardModel = (
        fit_mlp(preferences, MlpConfig(seed=config.seed, heads=heads))
        if isinstance(config, ThesisConfig)
        else fit_linear(preferences)
    )
    result = align(stored_policies(needs[0])[0], model, config)
    meta = {
        "chosen": result.chosen,
        "history": result.history,
        "gate_passed": result.gate.passed,
        "preference_weight": result.reward_weight,
        "replay_sha256": result.replay_sha256,
    }
    return _roll_out(result.policy, params["scenes"], meta)


def instant_task(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The conditioned policy at the weights that the answers say, and its trajectories in the table's scenes."""
    weights = weights_said(params, needs)
    policy = load_conditioned(params["conditioned"]).at(weights).without_critic()
    return _roll_out(policy, params["scenes"], {"weights": weights.tolist()})


def search_task(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The same, searched on; trajectories are the conditioned policy's where the search was no improvement."""
    weights = weights_said(params, needs)
    conditioned = load_conditioned(params["conditioned"])
    base = stored_policies(needs[0])[0]
    result = search_conditioning(conditioned, weights, base, ConditioningSearchConfig.of(params["config"]))
    shown = result.policy if result.takes_over else conditioned.at(weights).without_critic()
    meta = {
        "weights": weights.tolist(),
        "offsets": result.offsets.tolist(),
        "takes_over": result.takes_over,
        "preferred": result.preferred.as_dict(),
        "score": result.score.as_dict(),
        "gate_passed": result.gate.passed,
        "chosen": result.chosen,
        "history": result.history,
    }
    return _roll_out(shown, params["scenes"], meta)


def weights_said(params: dict[str, Any], needs: Sequence[TaskResult]) -> NDArray[np.float32]:
    """What the answers of one run ask of the conditioned policy."""
    preferences = answers_of(params["source"], needs, params["queries"], params["query_seed"])
    return fit_weights(preferences).preference_weights()


def raw_task(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The base policy's trajectories in the table's scenes."""
    return _roll_out(stored_policies(needs[0])[0].without_critic(), params["scenes"], {})


def _roll_out(policy: Policy, scenes: dict[str, int], meta: dict[str, Any]) -> TaskResult:
    table = episodes(policy, table_scenes(scenes))
    return _with_policies(
        [policy],
        meta,
        outcome=table.outcome,
        min_human_distance=table.min_human_distance,
        path_length=table.path_length,
        time=table.time,
        self_intersections=table.self_intersections,
        ceiling=table.ceiling,
    )


FUNCTIONS: dict[str, Function] = {
    "shipped_base": take_shipped_base,
    "shipped_ensemble": take_shipped_ensemble,
    "train_base": train_base_task,
    "train_ensemble": train_ensemble_task,
    "sweep": sweep_task,
    "accuracy": accuracy_task,
    "raw": raw_task,
    "alignment": alignment_task,
    "instant": instant_task,
    "refined": search_task,
}


def segment_queries(
    base: Policy, count: int, *, seed: int, segment_steps: int = 20, pool_scenes: int = 400
) -> list[tuple[Trajectory, Trajectory]]:
    """The baseline (6.4.3): uniform pairs of 20-step segments of base-policy trajectories in different scenes."""
    setup = get_setup(base.setup)
    pool = rollout(setup, base.rollout_policy, scene_set(setup.name, pool_scenes, purpose=Purpose.QUERIES, seed=seed))
    long_enough = [trajectory for trajectory in pool if len(trajectory.actions) >= segment_steps]
    if len(long_enough) < 2:
        raise LearningError(
            f"segment_steps = {segment_steps}: fewer than two of {pool_scenes} trajectories are that long"
        )
    random = np.random.default_rng([seed, 20])
    pairs = []
    for _ in range(count):
        chosen = random.choice(len(long_enough), 2, replace=False)
        segments = [_segment(long_enough[int(k)], segment_steps, random) for k in chosen]
        pairs.append((segments[0], segments[1]))
    return pairs


def _segment(trajectory: Trajectory, steps: int, random: np.random.Generator) -> Trajectory:
    first = int(random.integers(0, len(trajectory.actions) - steps + 1))
    rows = slice(first, first + steps)
    return replace(
        trajectory,
        outcome=trajectory.outcome if trajectory.dones[rows].any() else Outcome.RUNNING,
        poses=trajectory.poses[first : first + steps + 1],
        observations=trajectory.observations[rows],
        actions=trajectory.actions[rows],
        rewards=trajectory.rewards[rows],
        next_observations=trajectory.next_observations[rows],
        dones=trajectory.dones[rows],
        self_intersections=0,
    )

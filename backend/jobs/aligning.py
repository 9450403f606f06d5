"""Jobs that learn from answers: a snapshot becomes a reward model, the reward model a policy that may be shown.

The algorithms are `backend.learning`'s; here the answers are loaded, everything made is kept with its lineage, and the
trajectories for the participant's comparison are prepared, so that no page has to wait for them.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.jobs.context import JobContext
from backend.jobs.kept_artefacts import Parent, find_artefact, keep, keep_trajectory, load_policy
from backend.jobs.kinds import AlignParams, Params, RewardModelParams
from backend.learning.alignment.align import AlignConfig, Gate, check_gate, thesis_config
from backend.learning.alignment.align import align as learn_policy
from backend.learning.alignment.conditioning_search import PLACES, ConditioningSearchConfig, search_conditioning
from backend.learning.cards import DEPARTURES
from backend.learning.errors import LearningError, TooFewAnswers
from backend.learning.policies.conditioned import ConditionedPolicy
from backend.learning.policies.policy import Policy
from backend.learning.preferences.objectives import NAMES
from backend.learning.preferences.posterior import PosteriorConfig
from backend.learning.preferences.preferences import Preference
from backend.learning.queries.queries import QueryConfig, flaw, look_alike
from backend.learning.rewards.free_form import choose_reward_model
from backend.learning.rewards.holding_out import Fit, predicted_in_new_scenes
from backend.learning.rewards.reward_interface import InterfaceConfig, fit_interface
from backend.learning.rewards.reward_mlp import MlpConfig, fit_mlp
from backend.learning.rewards.reward_model import (
    LinearConfig,
    LinearRewardModel,
    Reduction,
    RewardModel,
    accuracy,
    fit_linear,
    held_out_accuracy,
    reward_model_to_bytes,
)
from backend.learning.rewards.reward_weights import WeightsRewardModel, fit_weights
from backend.learning.scene_sets import Purpose, describe, scene_set
from backend.simulation.fast import rollout
from backend.simulation.setups import get_setup, require_same
from backend.simulation.trajectory import Trajectory
from backend.store.artefacts import load_trajectory
from backend.store.models import Artefact
from backend.store.snapshots import Answer, Snapshot, load_snapshot

COMPARISON_CANDIDATES = 60  # scenes that are tried before a participant sees fewer comparisons than planned
COMPARISON_SECONDS = 20.0  # ours: people watch both trajectories of every comparison


def learn_reward_model(context: JobContext, params: RewardModelParams) -> dict[str, Any]:
    """A reward model of all answers, and per participant how well such models predict answers they did not see."""
    artefact, snapshot = _load_snapshot(context, params.snapshot)
    of_participant = _preferences(context, snapshot)
    everything = [preference for preferences in of_participant.values() for preference in preferences]
    fit = _fit(params.model, params.reduction, params.seed)
    context.progress(0.1)
    model = fit(everything)
    held_out: list[dict[str, Any]] = []
    for number, (code, preferences) in enumerate(of_participant.items()):
        held_out.append({"participant": code, **_held_out(preferences, fit, params)})
        context.progress(0.2 + 0.7 * (number + 1) / len(of_participant))
    result = {
        "training_accuracy": accuracy(model, everything),
        "answers": len(everything),
        "held_out": held_out,
        **_weights(model),
    }
    kept = _keep_reward_model(context, params, artefact, snapshot, model, params.model, params.reduction, result)
    return {"reward_model": kept, **result}


def _held_out(preferences: Sequence[Preference], fit: Fit, params: RewardModelParams) -> dict[str, Any]:
    """How well models predict a participant's answers that they did not see; `reason` where nothing can be held out."""
    try:
        return asdict(held_out_accuracy(preferences, fit, folds=params.folds, seed=params.seed))
    except TooFewAnswers:
        return {"n": len(preferences), "reason": "too_few_answers"}


def align(context: JobContext, params: AlignParams) -> dict[str, Any]:
    """A policy aligned with the answers, its gate, and trajectories of it and the base policy for a blind comparison.

    The result holds `policy` (artefact id), `passed`, and `comparisons`: [{scene, scene_seed, base, own, look_alike}],
    `scene` a hash, `base` and `own` ids of stored trajectories; empty where the gate was not passed. `yoked`: the same
    with `other` instead of `base`, in other scenes, where another participant's policy is named.
    """
    began = time.monotonic()
    snapshot_artefact, snapshot = _load_snapshot(context, params.snapshot)
    setup = require_same(snapshot=snapshot.setup, asked_for=params.setup or snapshot.setup)
    base_artefact, base = load_policy(context, params.base or f"{setup}/base")
    require_same(base=base.setup, snapshot=setup)
    preferences = [p for of_one in _preferences(context, snapshot).values() for p in of_one]
    model_name = params.model or _usual_model(params)
    fit = _fit(model_name, "sum", params.seed, params.symmetry)
    model = fit(preferences)
    fitted = {"training_accuracy": accuracy(model, preferences), "answers": len(preferences), **_weights(model)}
    if params.hold_out:
        held_out = predicted_in_new_scenes(preferences, fit, folds=max(2, params.hold_out), seed=params.seed)
        fitted["held_out"] = asdict(held_out)
    reward_model = _keep_reward_model(context, params, snapshot_artefact, snapshot, model, model_name, "sum", fitted)
    context.progress(0.03)
    if params.recipe == "instant":
        made = _instant(context, params, base, model)
    elif params.recipe == "refine" and params.start == "conditioned":
        made = _refine(context, params, base, model)
    else:
        made = _train(context, params, base, model)
    gate = {
        "passed": made.gate.passed,  # of the success gate; a refinement must be better, too (`passed` of the result)
        "success_rate": made.gate.success_rate,
        "base_success_rate": made.gate.base_success_rate,
        "scenes": made.gate.scenes,
    }
    with context.database.session() as s:
        reward_model_artefact = find_artefact(s, reward_model, "reward_model")
    parents = [(base_artefact, "base"), (reward_model_artefact, "reward_model"), (snapshot_artefact, "answers")]
    policy = keep(
        context,
        kind="policy",
        name=f"{_what(params)} {snapshot_artefact.name}",
        setup=setup,
        # Many people prefer the same: without their names on them, these would be one policy, first made for the first.
        content=replace(made.policy, made_for=snapshot_artefact.id).to_bytes(),
        params=params,
        config=made.config,
        results={"gate": gate, **made.results},
        parents=[*parents, *made.parents],
        scenes={"gate": describe(Purpose.GATE, made.gate.scenes, params.seed), **made.scenes},
        departures=made.departures,
    )
    context.progress(0.93)
    comparisons: list[dict[str, Any]] = []
    yoked: list[dict[str, Any]] = []
    if made.may_be_shown and params.comparisons:
        comparisons = _comparisons(context, params, "base", (base, base_artefact.id), (made.policy, policy))
        if params.other is not None:
            lent_artefact, lent = load_policy(context, params.other)
            seen = {one["scene_seed"] for one in comparisons}
            yoked = _comparisons(context, params, "other", (lent, lent_artefact.id), (made.policy, policy), seen)
    return {
        "policy": policy,
        "reward_model": reward_model,
        "training_accuracy": fitted["training_accuracy"],
        "held_out": fitted.get("held_out"),
        "passed": made.may_be_shown,
        "gate": gate,
        **made.beside,
        "comparisons": comparisons,
        "yoked": yoked,
        "seconds": round(time.monotonic() - began, 2),
    }


@dataclass(frozen=True)
class _Made:
    """An aligned policy, whether it may be shown, and what its card says."""

    policy: Policy
    gate: Gate
    may_be_shown: bool
    config: dict[str, Any]
    results: dict[str, Any]
    parents: list[Parent]
    scenes: dict[str, Any]
    departures: list[str]
    beside: dict[str, Any] = field(default_factory=dict)  # what the job's result says beside


def _instant(context: JobContext, params: AlignParams, base: Policy, model: RewardModel) -> _Made:
    """Recipe A: the conditioned policy at the weights that the answers speak for. No training."""
    artefact, conditioned, weights = _conditioned(context, params, base, model)
    policy = conditioned.at(weights).without_critic()
    gate = check_gate(policy, base, align_config(params))
    return _Made(
        policy=policy,
        gate=gate,
        may_be_shown=gate.passed,
        config={"recipe": "instant", "preference_weights": _by_name(weights)},
        results={},
        parents=[(artefact, "conditioned")],
        scenes={},
        departures=_departures(conditioned, "instant"),
    )


def _refine(context: JobContext, params: AlignParams, base: Policy, model: RewardModel) -> _Made:
    """Behind recipe A: search what else to tell the conditioned policy, and where. Shown if it is better."""
    artefact, conditioned, weights = _conditioned(context, params, base, model)
    config = search_config(params)
    refined = search_conditioning(conditioned, weights, base, config, context.progress.part(0.03, 0.9))
    judged = {
        "better_than_instant": refined.score.as_dict(),
        "wanted_better_than_instant": refined.wanted.as_dict(),
        "takes_over": refined.takes_over,
    }
    return _Made(
        policy=refined.policy,
        gate=refined.gate,
        may_be_shown=refined.takes_over,
        config={**config.as_dict(), "preference_weights": _by_name(weights)},
        results={
            **judged,
            "told": dict(zip(PLACES, map(_by_name, refined.offsets), strict=True)),
            "chosen": refined.chosen,
            "history": refined.history,
        },
        parents=[(artefact, "conditioned")],
        scenes={"select": describe(Purpose.ALIGN_SELECT, config.selection_scenes, params.seed)},
        departures=_departures(conditioned, "instant", "conditioning_search"),
        # On its card, too; but where nothing better was found, the policy and its card are the instant one's.
        beside=judged,
    )


def _conditioned(
    context: JobContext, params: AlignParams, base: Policy, model: RewardModel
) -> tuple[Artefact, ConditionedPolicy, NDArray[np.float32]]:
    """The conditioned policy with its artefact, and the weights that the answers speak for."""
    if not isinstance(model, WeightsRewardModel):
        raise LearningError(f"model = {params.model!r}: a conditioned policy needs preference weights: model = weights")
    reference = params.conditioned or f"{base.setup}/conditioned"
    with context.database.session() as s:
        artefact = find_artefact(s, reference, "conditioned_policy")
    conditioned = ConditionedPolicy.from_bytes(context.files.get(artefact.id))
    require_same(base=base.setup, conditioned=conditioned.setup)
    return artefact, conditioned, model.preference_weights()


def _departures(conditioned: ConditionedPolicy, *keys: str) -> list[str]:
    """Of a policy made from the conditioned one: its robots recover where that one's do."""
    return [DEPARTURES[key] for key in (*keys, *(("recovery",) if conditioned.base else ()))]


def _by_name(weights: NDArray[np.float32]) -> dict[str, float]:
    return {name: round(float(weight), 3) for name, weight in zip(NAMES, weights, strict=True) if weight}


def _train(context: JobContext, params: AlignParams, base: Policy, model: RewardModel) -> _Made:
    """Recipe B, or the thesis's."""
    config = align_config(params)
    aligned = learn_policy(base, model, config, context.progress.part(0.03, 0.9))
    return _Made(
        policy=aligned.policy,
        gate=aligned.gate,
        may_be_shown=aligned.gate.passed,
        config={**config.as_dict(), "replay_sha256": aligned.replay_sha256},
        results={"chosen_checkpoint": aligned.chosen, "history": aligned.history},
        parents=[],
        scenes={"select": describe(Purpose.ALIGN_SELECT, config.selection_scenes, params.seed)},
        departures=[DEPARTURES["fine_tuning"]] if params.recipe == "refine" else [],
    )


def _what(params: AlignParams) -> str:
    """How lists tell the two policies apart that one person can have."""
    if params.recipe == "instant":
        return "instant policy for"
    return "refined policy for" if params.start == "conditioned" else "aligned with"


def _usual_model(params: AlignParams) -> str:
    if params.recipe == "instant" or params.start == "conditioned":
        return "weights"
    return "mlp" if params.recipe == "thesis" else "linear"


def search_config(params: AlignParams) -> ConditioningSearchConfig:
    """How the instant policy is refined, with what the parameters change. Raises LearningError for a reward weight."""
    if params.reward_weight is not None:
        raise LearningError(
            f"reward_weight = {params.reward_weight}: from the conditioned policy nothing is trained, so no reward is "
            "weighted; leave it out"
        )
    usual = ConditioningSearchConfig()
    return replace(
        usual,
        seed=params.seed,
        tried=params.updates or usual.tried,
        gate_scenes=max(params.gate_scenes, usual.gate_scenes),
        gate_min_success=params.gate_least_success,
        gate_max_loss=params.gate_most_loss,
    )


def align_config(params: AlignParams) -> AlignConfig:
    """The recipe's configuration with what the parameters change."""
    config = thesis_config(seed=params.seed) if params.recipe == "thesis" else AlignConfig(seed=params.seed)
    changes: dict[str, Any] = {
        "gate_scenes": params.gate_scenes,
        "gate_min_success": params.gate_least_success,
        "gate_max_loss": params.gate_most_loss,
    }
    if params.reward_weight is not None:
        if params.recipe == "thesis" and params.reward_weight > 1:
            raise LearningError(f"reward_weight = {params.reward_weight}: the thesis's lambda is a share from 0 to 1")
        changes["preference_weight"] = params.reward_weight
    if params.updates is not None:
        changes |= {"updates": params.updates, "checkpoints": min(config.checkpoints, params.updates)}
    return replace(config, **changes)


def _load_snapshot(context: JobContext, reference: str) -> tuple[Artefact, Snapshot]:
    with context.database.session() as s:
        artefact = find_artefact(s, reference, "snapshot")
        snapshot = load_snapshot(s, context.files, artefact.id)
    return artefact, snapshot


def _preferences(context: JobContext, snapshot: Snapshot) -> dict[str, list[Preference]]:
    """The independent answers by participant. Probes ask the same again: they measure, they do not teach."""
    loaded: dict[str, Trajectory] = {}

    def trajectory(trajectory_id: str) -> Trajectory:
        if trajectory_id not in loaded:
            loaded[trajectory_id] = load_trajectory(context.files, trajectory_id)
        return loaded[trajectory_id]

    def preference(answer: Answer) -> Preference:
        return Preference(trajectory(answer.chosen), trajectory(answer.rejected), answer.source)

    found: dict[str, list[Preference]] = {}
    for answer in snapshot.training_answers():
        found.setdefault(answer.participant, []).append(preference(answer))
    return found


def _fit(model: str, reduction: Reduction, seed: int, symmetry: str = "none") -> Fit:
    if model == "weights":
        config = PosteriorConfig(left_right_symmetry=symmetry == "left_right")
        return lambda preferences: fit_weights(preferences, config)
    if model == "auto":
        mirrored = symmetry == "left_right"
        return lambda preferences: choose_reward_model(preferences, seed=seed, left_right_symmetry=mirrored).model
    if model == "linear":
        return lambda preferences: fit_linear(preferences, LinearConfig(reduction=reduction))
    if model == "interface":
        return lambda preferences: fit_interface(preferences, InterfaceConfig(seed=seed))
    return lambda preferences: fit_mlp(preferences, MlpConfig(seed=seed, reduction=reduction))


def _weights(model: RewardModel) -> dict[str, Any]:
    """Which kind of model it became, and what the answers were about, where it can say so."""
    described = {"kind": model.to_arrays()[0]["kind"]}
    return (
        described | {"importance": model.importance()}
        if isinstance(model, LinearRewardModel | WeightsRewardModel)
        else described
    )


def _keep_reward_model(
    context: JobContext,
    params: Params,
    snapshot_artefact: Artefact,
    snapshot: Snapshot,
    model: RewardModel,
    model_name: str,
    reduction: str,
    result: dict[str, Any],
) -> str:
    return keep(
        context,
        kind="reward_model",
        name=f"{model_name} reward model of {snapshot_artefact.name}",
        setup=snapshot.setup,
        content=reward_model_to_bytes(model),
        params=params,
        config={"model": model_name, "reduction": reduction},
        results=result,
        parents=[(snapshot_artefact, "answers")],
    )


def _comparisons(
    context: JobContext,
    params: AlignParams,
    against: str,
    rival: tuple[Policy, str],
    own: tuple[Policy, str],
    seen: Collection[int] = (),
) -> list[dict[str, Any]]:
    """Trajectories of both policies in fresh scenes in which both arrive soon; pairs that look different come first.

    against: what the rival is called. seen: seeds of scenes that are shown already.
    """
    setup = get_setup(require_same(rival=rival[0].setup, own=own[0].setup))
    candidates = scene_set(setup.name, COMPARISON_CANDIDATES, purpose=Purpose.COMPARISON, seed=params.seed)
    scenes = [scene for scene in candidates if scene.seed not in seen]
    rules = QueryConfig(max_duration_s=COMPARISON_SECONDS)
    different: list[tuple[Trajectory, Trajectory]] = []
    alike: list[tuple[Trajectory, Trajectory]] = []
    rollouts = [rollout(setup, policy.rollout_policy, scenes) for policy, _ in (rival, own)]
    for of_rival, of_own in zip(*rollouts, strict=True):
        if flaw(of_rival, rules) is None and flaw(of_own, rules) is None:
            (alike if look_alike(of_rival, of_own, rules) else different).append((of_rival, of_own))
    chosen = (different + alike)[: params.comparisons]
    return [
        {
            "scene": of_rival.scene.digest(),
            "scene_seed": of_rival.scene.seed,
            against: keep_trajectory(context, of_rival, rival[1]),
            "own": keep_trajectory(context, of_own, own[1]),
            "look_alike": look_alike(of_rival, of_own, rules),
        }
        for of_rival, of_own in chosen
    ]

"""The job that turns a snapshot's answers into a policy that may be shown.

The answers are loaded and fitted by `answers.py`, the policy is made by one of `alignments`; here
everything made is kept with its lineage, and the trajectories for the participant's comparison are prepared, so that no
page has to wait for them.
"""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import asdict, replace
from typing import Any

import structlog

from desirepath.jobs.alignment import REGISTRY, Aligned, AlignParams, ConditionedAlignParams
from desirepath.jobs.alignments.each_scene import ChoiceParams
from desirepath.jobs.answers import (
    describe_model,
    earlier_people,
    fit_of,
    keep_reward_model,
    posterior_of_person,
    prediction_of,
    preferences_of,
    snapshot_of,
)
from desirepath.jobs.context import JobContext
from desirepath.jobs.free_form import free_form
from desirepath.jobs.in_general import policy_in_general
from desirepath.jobs.kept_artefacts import (
    find_artefact,
    keep,
    keep_trajectory,
    load_any_policy,
    load_conditioned,
    load_policy,
)
from desirepath.learning.alignment.gate import decide
from desirepath.learning.alignment.never_worse import JUDGING_SEED, SCENES, better_for_person
from desirepath.learning.policies.policy import DrivingPolicy
from desirepath.learning.policies.stand_ins import stand_in_name, stand_in_policy
from desirepath.learning.preferences.objectives import preference_weights
from desirepath.learning.preferences.people_in_general import people_in_general
from desirepath.learning.preferences.population_prior import IN_GENERAL, prior_of_earlier
from desirepath.learning.queries.queries import QueryConfig, flaw, look_alike
from desirepath.learning.rewards.held_out import accuracy, predict_in_new_scenes
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactError

COMPARISON_CANDIDATES = 60  # scenes that are tried before a participant sees fewer comparisons than planned
LOOKED_AT_ONCE = 20  # of these
log = structlog.get_logger("desirepath.jobs")

COMPARISON_SECONDS = 20.0  # ours: people watch both trajectories of every comparison


def align(context: JobContext, params: AlignParams) -> dict[str, Any]:
    """A policy aligned with the answers, its gate, and trajectories of it and the base policy for a blind comparison.

    The result holds `policy` (artefact id), `passed`, and `comparisons`: [{scene, scene_seed, base, own, look_alike}],
    `scene` a hash, `base` and `own` ids of stored trajectories; empty where the policy may not be shown. `yoked`: the
    same with `other` instead of `base`, in other scenes, where another participant's policy or a stand-in is named;
    `neutral`: with the conditioned policy without preferences, where that is asked for; `population`: with the one by
    what earlier participants want, and how that was made (`in_general`). Of one person's answers, where
    `surely_better` asks: `personal` (`PersonalVerdict`: below it is not shown as theirs), `check` (`PredictiveCheck`).
    """
    began = time.monotonic()
    answers = snapshot_of(context, params.snapshot)
    snapshot_artefact, snapshot = answers
    setup = require_same(snapshot=snapshot.setup, asked_for=params.setup or snapshot.setup)
    base_artefact, base = load_policy(context, params.base or f"{setup}/base")
    require_same(base=base.setup, snapshot=setup)
    of_participant = preferences_of(context, snapshot)
    preferences = [p for of_one in of_participant.values() for p in of_one]
    model_name = params.model_name
    fit = fit_of(model_name, "sum", params.seed, params.symmetry)
    model = fit(preferences)
    fitted = {"training_accuracy": accuracy(model, preferences), "answers": len(preferences), **describe_model(model)}
    predicted = prediction_of(answers, of_participant, model_name, seed=params.seed, symmetry=params.symmetry).as_dict()
    fitted["predicted"] = predicted
    if params.hold_out:
        held_out = predict_in_new_scenes(preferences, fit, folds=max(2, params.hold_out), seed=params.seed)
        fitted["held_out"] = asdict(held_out)
    reward_model = keep_reward_model(context, params, answers, model, name=model_name, reduction="sum", results=fitted)
    context.progress(0.03)
    algorithm = REGISTRY[params.algorithm]
    aligned = algorithm.align(context, params, base, model)
    believed, independent = None, of_participant
    if params.surely_better:  # else nobody asks, and it takes seconds
        shared = snapshot.ratings or snapshot.marks  # choices that these imply are not independent
        independent = preferences_of(context, snapshot, independent=True) if shared else of_participant
        earlier = earlier_people(context, params.earlier, setup, params.symmetry)
        before = people_in_general(setup) if params.prior == IN_GENERAL else prior_of_earlier(setup, earlier)
        believed = posterior_of_person(independent, params.symmetry, before)
    verdict, judging = None, None if believed is None or algorithm.asks_directly else believed[0]
    if judging is not None and decide(aligned.gate, beside_instant=aligned.beside_instant).passed:
        verdict = better_for_person(judging, aligned.policy, base, seed=params.seed, needed=params.surely_better)
    if judging is not None and not (verdict is not None and verdict.passed):
        otherwise = free_form(
            context, params, base, judging, [preference for of in independent.values() for preference in of]
        )
        if otherwise is not None and decide(otherwise[0].gate, surely=otherwise[1].passed).passed:
            aligned, verdict = otherwise
    surely = verdict.passed if verdict is not None else None
    decision = decide(aligned.gate, beside_instant=aligned.beside_instant, surely=surely)
    own = {
        **({"personal": verdict.as_dict()} if verdict is not None else {}),
        **({"check": believed[1].as_dict()} if believed is not None else {}),
        **(
            {"prior": {"earlier_participants": len(aligned.parents) if algorithm.asks_directly else len(earlier)}}
            if believed is not None and params.earlier
            else {}
        ),
        **({"prior": {IN_GENERAL: True}} if believed is not None and params.prior == IN_GENERAL else {}),
    }
    # `passed` here is the gate's; the result's is the whole decision
    gate = aligned.gate.as_dict()
    with context.database.session() as s:
        reward_model_artefact = find_artefact(s, reward_model, "reward_model")
    parents = [(base_artefact, "base"), (reward_model_artefact, "reward_model"), (snapshot_artefact, "answers")]

    def kept(aligned: Aligned) -> str:
        return keep(
            context,
            kind="policy",
            name=f"{algorithm.makes}: {snapshot_artefact.name}, seed {params.seed}",
            setup=setup,
            # Many prefer the same: without their names on them, these would be one policy, first made for the first.
            content=replace(aligned.policy, made_for=snapshot_artefact.id).to_bytes(),
            params=params,
            config=aligned.config,
            results={"gate": gate, "predicted": predicted, **own, **aligned.results},
            parents=[*parents, *aligned.parents],
            scenes={
                "gate": describe(Purpose.GATE, aligned.gate.scenes, params.seed),
                **({"personal": describe(Purpose.GATE, SCENES, JUDGING_SEED + params.seed)} if verdict else {}),
                **aligned.scenes,
            },
            departures=aligned.departures,
        )

    try:
        policy = kept(aligned)
    except ArtefactError as gone:
        if not aligned.parents:
            raise
        log.warning("somebody whose answers were used is gone", problem=str(gone))
        aligned = algorithm.align(context, params, base, model)  # which leaves them out
        if algorithm.asks_directly and "prior" in own and params.prior != IN_GENERAL:
            own["prior"] = {"earlier_participants": len(aligned.parents)}
        policy = kept(aligned)
    context.progress(0.93)
    comparisons: list[dict[str, Any]] = []
    further: dict[str, list[dict[str, Any]]] = {}
    if decision.passed and params.comparisons:
        own_and_base = (base, base_artefact.id), (aligned.policy, policy)
        comparisons = comparison_rollouts(
            context, params, "base", *own_and_base, with_alike=not algorithm.asks_directly
        )
        seen = {comparison["scene_seed"] for comparison in comparisons}
        rivals = _rivals(context, params, setup)
        if isinstance(params, ChoiceParams) and params.population:
            own["in_general"], in_general = policy_in_general(context, params, (base, base_artefact), snapshot_artefact)
            rivals |= {"population": in_general} if in_general is not None else {}
        for against, rival in rivals.items():
            count = getattr(params, against) if against in ("neutral", "population") else None
            try:
                further[against] = comparison_rollouts(
                    context, params, against, rival, (aligned.policy, policy), seen, count
                )
            except ArtefactError as gone:
                if against != "population":
                    raise
                log.warning("the policy in general is gone", problem=str(gone))  # with who was erased meanwhile
                continue
            seen |= {comparison["scene_seed"] for comparison in further[against]}
    return {
        "policy": policy,
        "reward_model": reward_model,
        "training_accuracy": fitted["training_accuracy"],
        "held_out": fitted.get("held_out"),
        "predicted": predicted,
        "passed": decision.passed,
        "why": decision.why,
        "gate": gate,
        **aligned.beside,
        **own,
        "comparisons": comparisons,
        "yoked": further.get("other", []),
        **{against: further[against] for against in ("neutral", "population") if against in further},
        "seconds": round(time.monotonic() - began, 2),
    }


def _rivals(context: JobContext, params: AlignParams, setup: str) -> dict[str, tuple[DrivingPolicy, str]]:
    """What the own policy is compared with beside the base policy, each with what it is called."""
    rivals: dict[str, tuple[DrivingPolicy, str]] = {}
    if params.other is not None:
        try:
            artefact, lent = load_any_policy(context, params.other)
        except ArtefactError as gone:  # whose it was has been erased since; the own policy is compared all the same
            log.warning("the lent policy is gone", problem=str(gone))
        else:
            rivals["other"] = (lent, artefact.id)
    if isinstance(params, ConditionedAlignParams):
        if params.other is None and params.stand_in is not None:
            rivals["other"] = (stand_in_policy(setup, params.stand_in), stand_in_name(setup, params.stand_in))
        if params.neutral:
            artefact, conditioned = load_conditioned(context, params.conditioned or f"{setup}/conditioned")
            rivals["neutral"] = (conditioned.at(preference_weights({})).without_critic(), artefact.id)
    return rivals


def comparison_rollouts(
    context: JobContext,
    params: AlignParams,
    against: str,
    rival: tuple[DrivingPolicy, str],
    own: tuple[DrivingPolicy, str],
    seen: Collection[int] = (),
    count: int | None = None,
    *,
    with_alike: bool = True,
) -> list[dict[str, Any]]:
    """Trajectories of both policies in fresh scenes in which both arrive soon; pairs that look different come first.

    against: what the rival is called. seen: seeds of scenes that are shown already. count: default as with the base.
    with_alike: pairs that can hardly be told apart fill up; without, there may be fewer.
    """
    setup = get_setup(require_same(rival=rival[0].setup, own=own[0].setup))
    candidates = scene_set(setup.name, COMPARISON_CANDIDATES, purpose=Purpose.COMPARISON, seed=params.seed)
    scenes = [scene for scene in candidates if scene.seed not in seen]
    rules, wanted = QueryConfig(max_duration_s=COMPARISON_SECONDS), params.comparisons if count is None else count
    different: list[tuple[Trajectory, Trajectory]] = []
    alike: list[tuple[Trajectory, Trajectory]] = []
    for first in range(0, len(scenes), LOOKED_AT_ONCE):
        some = scenes[first : first + LOOKED_AT_ONCE]
        rollouts = [rollout(setup, policy.rollout_policy, some) for policy, _ in (rival, own)]
        for of_rival, of_own in zip(*rollouts, strict=True):
            if flaw(of_rival, rules) is None and flaw(of_own, rules) is None:
                (alike if look_alike(of_rival, of_own, rules) else different).append((of_rival, of_own))
        if len(different) >= wanted:
            break
    chosen = (different + (alike if with_alike else []))[:wanted]
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

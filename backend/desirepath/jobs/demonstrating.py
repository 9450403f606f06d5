"""The job that learns a personal controller from kept demonstrations of one environment (ch. 2 and 3).

What is learned and by which sensor is `controller_training.py`'s; here the demonstrations are loaded, the controller,
its rollouts and what they are compared with are kept.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from desirepath.demonstrations.controllers import BASELINES, roll_out
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.judging import judge_rollouts
from desirepath.jobs.context import JobContext
from desirepath.jobs.controller_training import Learned, learn
from desirepath.jobs.kept_artefacts import find_artefact, keep, keep_trajectories
from desirepath.jobs.kinds import TrainDemonstrationsParams
from desirepath.learning.alignment.gate import GateRule, decide, verdict
from desirepath.learning.queries.queries import QueryConfig, look_alike
from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath.simulation.trajectory import Outcome
from desirepath.store.demonstration_snapshots import KeptDemonstration, read_demonstrations
from desirepath.store.models import Artefact


def train_demonstrations(context: JobContext, params: TrainDemonstrationsParams) -> dict[str, Any]:
    """A controller learned from a snapshot of demonstrations, its rollouts from their starts, and blind comparisons.

    The result holds `policy` (artefact id), `passed` (success from the demonstrated starts), `judged` (those rollouts
    against the demonstrations), `rollouts`: [{demonstration (sha256), pair, trajectory}], and `situations`, one per
    demonstrated pair in turn: [{scene, scene_seed, base, own, social_cost, look_alike}]. `base`, the word for what an
    own policy is compared with, is the rollout of the dynamic window approach; rollouts are ids of stored trajectories.
    `comparisons` are those of them in which both that are compared arrive, at most as many as asked for; who rates the
    controllers one by one is shown every situation, arrived or not.
    """
    began = time.monotonic()
    artefact, paths, demonstrations = _demonstrations(context, params.snapshot)
    learned = learn(demonstrations, params, context.progress.part(0.02, 0.9))
    driven = learned.roll_out([d.scene for d in demonstrations])
    judged = judge_rollouts(driven, demonstrations)
    # From the demonstrated starts; nothing else was rolled out there, so there is nothing to compare it with.
    rule = GateRule(scenes=len(demonstrations), min_success=params.gate_min_success, max_loss=None)
    gate = verdict(rule, judged.success_rate, scenes=rule.scenes)
    decision = decide(gate)
    policy_id = keep(
        context,
        kind=learned.kind,
        name=f"controller: {artefact.name}, seed {params.seed}",
        setup=learned.setup,
        content=learned.content,
        params=params,
        config=learned.config,
        results={"gate": gate.as_dict(), "judged": judged.as_dict(), **learned.results},
        parents=[(artefact, "demonstrations")],
        scenes=learned.scenes,
        departures=learned.departures,
    )
    rollouts = [
        {"demonstration": demonstrated.demonstration, "pair": demonstrated.pair, "trajectory": trajectory}
        for demonstrated, trajectory in zip(paths, keep_trajectories(context, driven, policy_id), strict=True)
    ]
    context.progress(0.95)
    pairs = sorted({path.pair for path in paths})
    situations, both_arrive = _situations(context, pairs, learned, policy_id) if decision.passed else ([], [])
    return {
        "policy": policy_id,
        "passed": decision.passed,
        "why": decision.why,
        "gate": gate.as_dict(),
        "judged": judged.as_dict(),
        "rollouts": rollouts,
        "situations": situations,
        "comparisons": [situation for situation, both in zip(situations, both_arrive, strict=True) if both][
            : params.comparisons
        ],
        "seconds": round(time.monotonic() - began, 2),
    }


def _demonstrations(
    context: JobContext, reference: str
) -> tuple[Artefact, Sequence[KeptDemonstration], list[Demonstration]]:
    with context.database.session() as s:
        artefact = find_artefact(s, reference, "demonstrations")
    _, paths = read_demonstrations(context.files.get(artefact.id))
    return artefact, paths, [Demonstration.from_bytes(context.files.get(path.demonstration)) for path in paths]


def _situations(
    context: JobContext, pairs: Sequence[int], learned: Learned, policy_id: str
) -> tuple[list[dict[str, Any]], list[bool]]:
    """Rollouts of all three controllers in the demonstrated pairs, and where own and dynamic window both arrive."""
    scenes = [demonstration_scene(learned.setup, pair) for pair in pairs]
    own = learned.roll_out(scenes)
    dwa, social = (roll_out(controller, scenes) for controller in BASELINES)
    rolled_out = zip(
        scenes,
        own,
        dwa,
        keep_trajectories(context, own, policy_id),
        keep_trajectories(context, dwa, None),
        keep_trajectories(context, social, None),
        strict=True,
    )
    situations = [
        {
            "scene": scene.digest(),
            "scene_seed": scene.seed,
            "base": dwa_id,
            "own": own_id,
            "social_cost": social_id,
            "look_alike": look_alike(of_dwa, of_own, QueryConfig()),
        }
        for scene, of_own, of_dwa, own_id, dwa_id, social_id in rolled_out
    ]
    return situations, [a.outcome == b.outcome == Outcome.SUCCESS for a, b in zip(own, dwa, strict=True)]

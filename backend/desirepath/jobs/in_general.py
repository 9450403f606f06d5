"""The policy by what earlier participants want, which a participant's own one is compared with: made anew for each, of
whoever there is then, so that nobody who was erased is in it. Whether they have anything in common is tried before."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import structlog

from desirepath.jobs.aligned import gate_rule
from desirepath.jobs.alignments.each_scene import ChoiceParams, earlier_answers
from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import keep
from desirepath.learning.alignment.each_scene import (
    FEWEST_PEOPLE,
    choose_each_scene,
    leave_each_out,
    people_in_general,
)
from desirepath.learning.alignment.gate import at_gate, decide
from desirepath.learning.cards import DEPARTURES
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import DrivingPolicy, Policy, PolicyError
from desirepath.store.artefacts import ArtefactError
from desirepath.store.erasure import SEVERAL_PEOPLE
from desirepath.store.models import Artefact

log = structlog.get_logger("desirepath.jobs")


def policy_in_general(
    context: JobContext, params: ChoiceParams, base: tuple[Policy, Artefact], own: Artefact
) -> tuple[dict[str, Any], tuple[DrivingPolicy, str] | None]:
    """How it was made, for the job's result, and the policy with its id; None where there are too few people, or they
    have too little in common, or it does not pass the gate: nobody's own comparison depends on it. own: the snapshot of
    who compares with it."""
    people, snapshots = earlier_answers(context, params.people, params.symmetry, base[0].setup)
    if len(people) < FEWEST_PEOPLE:
        return {"people": len(people), "passed": False}, None
    everybody = people_in_general(people)
    common = leave_each_out(everybody)
    told: dict[str, Any] = {**asdict(common), "passed": False}
    if not common.in_common:
        return told, None
    try:
        policy = choose_each_scene(everybody, kept=params.policies)
    except (LearningError, PolicyError) as none:
        log.warning("no policy in general", problem=str(none))
        return told, None
    gate = at_gate(policy, base[0], gate_rule(params), seed=params.seed)
    if not decide(gate).passed:
        return told, None
    try:
        artefact = keep(
            context,
            kind="policy",
            name=f"policy in general: {len(people)} people before {own.name}, seed {params.seed}",
            setup=policy.setup,
            content=replace(policy, made_for=own.id).to_bytes(),
            params=params,
            config={"recipe": params.algorithm, SEVERAL_PEOPLE: len(people), "policies": len(policy.policies)},
            results={"gate": gate.as_dict(), "left_out": asdict(common)},
            parents=[
                (base[1], "base"),
                (own, "compared_by"),
                *((snapshot, f"answers {number}") for number, snapshot in enumerate(snapshots, 1)),
            ],
            departures=[DEPARTURES["each_scene"], DEPARTURES["policy_library"], DEPARTURES["recovery"]],
        )
    except ArtefactError as gone:  # somebody of them is being erased; the own policy is compared all the same
        log.warning("earlier answers are gone", problem=str(gone))
        return told, None
    return {**told, "passed": True}, (policy, artefact)

"""How jobs find what they work on and keep what they made: with a card, and a lineage back to the answers."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DbSession

from desirepath.jobs.context import JobContext
from desirepath.jobs.kinds import ANY_POLICY
from desirepath.jobs.params import Params
from desirepath.learning.cards import source_commit
from desirepath.learning.policies.policy import DrivingPolicy, Policy, network_of, read_policy
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefact_upkeep import LONGEST_NAME
from desirepath.store.artefacts import QUARANTINED, ArtefactError, save_artefact, save_trajectories
from desirepath.store.models import Artefact, Job
from desirepath.store.shipped_policies import policy_artefact

if TYPE_CHECKING:  # brings the simulator, and pages ask this file for names only
    from desirepath.learning.policies.conditioned import ConditionedPolicy

Parent = tuple[Artefact, str]  # the artefact and its role in what is made from it


def find_artefact(s: DbSession, reference: str, kind: str) -> Artefact:
    """The artefact with that id, or the shipped policy of that name (`study_room/base`). kind: or any of several,
    with `|` between them.

    Raises ArtefactError: unknown, another kind, or quarantined because somebody's answers behind it were erased.
    """
    words = kind.replace("|", " or ").replace("_", " ")
    artefact = policy_artefact(s, reference) if "/" in reference else s.get(Artefact, reference)
    if artefact is None:
        raise ArtefactError(f"no {words} {reference!r}; it needs an id from the lists, or a shipped name")
    if artefact.kind not in kind.split("|"):
        raise ArtefactError(f"{reference!r} is a {artefact.kind}, needed is a {words}")
    if artefact.quarantined_at is not None:
        raise ArtefactError(f"{words} {reference!r} is quarantined: {QUARANTINED}")
    if artefact.kind == "reward_model" and artefact.card.get("uploaded_by") and not artefact.card.get("looks_right"):
        raise ArtefactError(
            f"{words} {artefact.name!r} was taken in and nobody has said yet that it looks right: see what it says of "
            f"three trajectories (/lab/rewards/{artefact.id})"
        )
    return artefact


def free_name(s: DbSession, kind: str, name: str) -> str:
    """The name with what tells it from others of its kind: a number where the same was made with other settings. Long
    ones lose their middle, which is a study's name or another artefact's."""

    def fitting(ending: str) -> str:
        room = LONGEST_NAME - len(ending)
        return (name if len(name) <= room else f"{name[: room // 3]}…{name[-(room - room // 3 - 1) :]}") + ending

    names = set(
        s.scalars(select(Artefact.name).where(Artefact.kind == kind, Artefact.name.startswith(fitting("")[:40])))
    )
    number = 1
    while (candidate := fitting(f" ({number})" if number > 1 else "")) in names:
        number += 1
    return candidate


def load_policy(context: JobContext, reference: str) -> tuple[Artefact, Policy]:
    """A policy and its artefact. Raises ArtefactError as `find_artefact` does, LearningError for one of somebody else
    whose network is none of ours."""
    with context.database.session() as s:
        artefact = find_artefact(s, reference, "policy")
    return artefact, network_of(read_policy(context.files.get(artefact.id)).driving())


def load_conditioned(context: JobContext, reference: str) -> tuple[Artefact, ConditionedPolicy]:
    """A conditioned policy and its artefact. Raises ArtefactError as `find_artefact` does."""
    from desirepath.learning.policies.conditioned import ConditionedPolicy

    with context.database.session() as s:
        artefact = find_artefact(s, reference, "conditioned_policy")
    return artefact, ConditionedPolicy.from_bytes(context.files.get(artefact.id))


def load_any_policy(context: JobContext, reference: str, weights: str = "") -> tuple[Artefact, DrivingPolicy]:
    """A policy and its artefact, a conditioned one at these weights (`farther=1`).

    Raises ArtefactError as `find_artefact` does, LearningError for weights that it does not take.
    """
    from desirepath.learning.policies.shipped import policy_conditioned_on

    with context.database.session() as s:
        artefact = find_artefact(s, reference, ANY_POLICY)
    named = f"{artefact.name}@{weights}" if weights else artefact.name
    return artefact, policy_conditioned_on(context.files.get(artefact.id), named)


def keep(
    context: JobContext,
    *,
    kind: str,
    name: str,
    setup: str,
    content: bytes,
    params: Params,
    config: Mapping[str, Any],
    results: Mapping[str, Any],
    parents: Sequence[Parent] = (),
    scenes: Mapping[str, Any] | None = None,
    departures: Sequence[str] = (),
) -> str:
    """Store an artefact of this job with its card; returns its id.

    Raises ArtefactError if a parent was erased or quarantined while the job ran: nothing is kept then.
    """
    with context.database.transaction() as s:
        require_job(s, context)
        for parent, _ in parents:
            find_artefact(s, parent.id, parent.kind)
        name = free_name(s, kind, name)
        card = {
            "kind": kind,
            "name": name,
            "setup": setup,
            **card_of(context, params, config=config, results=results, parents=parents, scenes=scenes),
            "departures": list(departures),
        }
        artefact = save_artefact(
            s,
            context.files,
            kind=kind,
            name=name,
            setup=setup,
            content=content,
            card=card,
            parents=[(parent.id, role) for parent, role in parents],
            study_id=context.job.study_id,
            job_id=context.job.id,
        )
        return artefact.id


def card_of(
    context: JobContext,
    params: Params,
    *,
    config: Mapping[str, Any],
    results: Mapping[str, Any],
    parents: Sequence[Parent] = (),
    scenes: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """How an artefact came to be, enough to make it again; the keys are those of `desirepath.learning.cards.Card`."""
    return {
        "command": command_of(context.job.kind, params),
        "job": context.job.id,
        "seed": params.model_dump().get("seed"),
        "commit": source_commit(),
        "config": dict(config),
        "scenes": dict(scenes or {}),
        "results": dict(results),
        "parents": {f"{role}: {parent.name}": parent.id for parent, role in parents},
    }


def keep_trajectories(context: JobContext, trajectories: Sequence[Trajectory], made_by: str | None) -> list[str]:
    """Store rollouts of a policy (None: of a programmed controller); returns their ids.

    Raises ArtefactError if the job, the policy, or what the job learns from, was erased or quarantined while it ran: no
    file is written then.
    """
    with context.database.transaction() as s:
        require_job(s, context)
        if (learned_from := context.job.params.get("snapshot")) is not None:
            # Locked where rows can be (PostgreSQL), so that no erasure passes between this look and the file.
            snapshot = s.get(Artefact, learned_from, with_for_update={"read": True})
            if snapshot is None or snapshot.quarantined_at is not None:
                raise ArtefactError(f"what job {context.job.id} learns from is quarantined or erased: {QUARANTINED}")
        return [row.id for row in save_trajectories(s, context.files, trajectories, made_by)]


def keep_trajectory(context: JobContext, trajectory: Trajectory, made_by: str) -> str:
    """`keep_trajectories` of one."""
    return keep_trajectories(context, [trajectory], made_by)[0]


def require_job(s: DbSession, context: JobContext) -> None:
    """Raises ArtefactError if the job's row is gone: somebody's answers were erased while it ran, and nothing of what
    it makes may be kept."""
    if s.get(Job, context.job.id, with_for_update={"read": True}) is None:
        raise ArtefactError(f"job {context.job.id} is not there any more; was a participant erased?")


def command_of(kind: str, params: Params) -> str:
    """The command that starts the same job again."""
    settings: list[str] = []
    for name, value in params.asked().items():
        settings += ["--set", f"{name}={json.dumps(value) if isinstance(value, list) else value}"]
    return shlex.join(["desirepath", "jobs", "start", kind, *settings])

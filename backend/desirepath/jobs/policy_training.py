"""Jobs that train without answers: base policies, ensembles, and the queries made from an ensemble's trajectories."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import card_of, keep, load_any_policy, load_policy
from desirepath.jobs.kinds import EnsembleParams, QueriesParams, TrainBaseParams
from desirepath.learning.cards import DEPARTURES
from desirepath.learning.policies.shape import FAST_HEADS
from desirepath.learning.queries.queries import QueryConfig
from desirepath.learning.queries.queries import generate_queries as make_queries
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.td3.base import BaseConfig, base_config
from desirepath.learning.td3.base import train_base as learn_base
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig
from desirepath.learning.td3.ensemble import train_ensemble as learn_ensemble
from desirepath.store.query_sets import save_query_set

BASE_DEPARTURES = ("environments", "average")
SHORT_TRANSITIONS, SHORT_PER_UPDATE = 50_000, 16  # of a short training, before a critic judges
ENSEMBLE_DEPARTURES = ("ensemble_start", "ensemble_choice")


def config_of(params: TrainBaseParams) -> BaseConfig:
    """The training that is asked for, with the network that the setup's base policy has; a short one, asked for to see
    that it runs, is smoothed no longer than it learns, and imitates for less long."""
    config = replace(base_config(params.setup), **params.model_dump(exclude_none=True))
    if params.updates is None:
        return config
    smoothing = min(config.smoothing_updates, params.updates)
    first = min(config.random_transitions, max(SHORT_TRANSITIONS, params.updates * SHORT_PER_UPDATE))
    return replace(config, smoothing_updates=smoothing, random_transitions=first)


def train_base(context: JobContext, params: TrainBaseParams) -> dict[str, Any]:
    """A new base policy of a setup."""
    config = config_of(params)
    trained = learn_base(config, context.progress)
    result = {"selection_success": trained.selection_success, "transitions": trained.transitions}
    defaults = {
        "progress": params.progress_weight,
        "smoothness": params.smoothness_penalty,
        "heads": config.heads == FAST_HEADS,
    }
    kept = keep(
        context,
        kind="policy",
        name=f"base, seed {params.seed}",
        setup=params.setup,
        content=trained.policy.to_bytes(),
        params=params,
        config=config.as_dict(),
        results=result,
        scenes={"select": describe(Purpose.SELECT, params.selection_scenes, params.seed)},
        departures=[
            DEPARTURES[name] for name in (*(term for term, weight in defaults.items() if weight), *BASE_DEPARTURES)
        ],
    )
    return {"policy": kept, **result}


def train_ensemble(context: JobContext, params: EnsembleParams) -> dict[str, Any]:
    """Members that start from one base policy; one artefact each."""
    base_artefact, base = load_policy(context, params.base)
    config = PolicyEnsembleConfig(**params.model_dump(exclude={"base"}))
    trained = learn_ensemble(base, config, context.progress)
    kept = [
        keep(
            context,
            kind="policy",
            name=f"ensemble member {k}, seed {params.seed}",
            setup=base.setup,
            content=member.to_bytes(),
            params=params,
            config={**config.as_dict(), "base_buffer_sha256": trained.base_buffer_sha256},
            results={"selection_success": success, "diversity": trained.diversity},
            parents=[(base_artefact, "base")],
            scenes={"select": describe(Purpose.SELECT, config.selection_scenes, params.seed)},
            departures=[DEPARTURES[name] for name in ENSEMBLE_DEPARTURES],
        )
        for k, (member, success) in enumerate(zip(trained.members, trained.success_rates, strict=True))
    ]
    return {"policies": kept, "success_rates": trained.success_rates, "diversity": trained.diversity}


def make_query_set(context: JobContext, params: QueriesParams) -> dict[str, Any]:
    """A query set of the members' trajectories."""
    members = [load_any_policy(context, reference) for reference in params.members]
    config = QueryConfig(**params.model_dump(exclude={"members"}))
    made = make_queries([policy for _, policy in members], config, context.progress)
    result = {"queries": len(made), "filtered": made.filtered}
    name = f"{len(made)} queries, seed {params.seed}"
    parents = [(artefact, f"member_{k}") for k, (artefact, _) in enumerate(members)]
    scenes = {"queries": describe(Purpose.QUERIES, made.filtered["scenes"], params.seed)}
    with context.database.transaction() as s:
        kept = save_query_set(
            s,
            context.files,
            made,
            name=name,
            card=card_of(context, params, config=config.as_dict(), results=result, parents=parents, scenes=scenes),
            parents=[(artefact.id, role) for artefact, role in parents],
            job_id=context.job.id,
        ).id
    return {"query_set": kept, **result}

"""Jobs that measure policies on fresh scenes, alone or side by side. The numbers are `learning.policies.evaluate`'s."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import keep, keep_trajectory, load_any_policy
from desirepath.jobs.kinds import WEIGHED, CompareParams, EvaluateParams
from desirepath.learning.policies.evaluate import compare_tables, describe_table, episode_columns, episodes
from desirepath.learning.policies.policy import DrivingPolicy
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.simulation.fast import EPISODE_COLUMNS, EpisodeTable, rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup, require_same
from desirepath.simulation.social_metrics import join

SCENES_AT_ONCE = 500  # the bar moves, and a cancel is heeded between two batches


def evaluate_policy(context: JobContext, params: EvaluateParams) -> dict[str, Any]:
    """One policy on `params.scenes` fresh scenes; keeps an evaluation with one row per scene."""
    artefact, policy = load_any_policy(context, params.policy)
    scenes = _scenes(policy.setup, params.scenes, params.seed)
    table = _roll_out(context, policy, scenes, 0.0, 0.95)
    measured = {**describe_table(policy.setup, table), "engine": "fast", "seed": params.seed}
    content = {
        "format": "desirepath-evaluation-1",
        "setup": policy.setup,
        "policies": [{"id": artefact.id, "name": artefact.name, "measured": measured}],
        "scenes": _rows(scenes, [table]),
    }
    artefact_id = keep(
        context,
        kind="evaluation",
        name=f"{artefact.name}, {params.scenes} scenes, seed {params.seed}",
        setup=policy.setup,
        content=_json(content),
        params=params,
        config=params.model_dump(mode="json"),
        results=measured,
        parents=[(artefact, "policy")],
        scenes={"report": describe(Purpose.REPORT, params.scenes, params.seed)},
    )
    return {"evaluation": artefact_id, "measured": measured}


def compare_two(context: JobContext, params: CompareParams) -> dict[str, Any]:
    """Two policies on the same fresh scenes; keeps rows, paired differences, and some trajectories to look at."""
    artefact_a, policy_a = load_any_policy(context, params.policy_a, params.weights_a)
    artefact_b, policy_b = load_any_policy(context, params.policy_b, params.weights_b)
    weights = (params.weights_a, params.weights_b)
    names = [
        f"{each.name}@{of}" if of else each.name for each, of in zip((artefact_a, artefact_b), weights, strict=True)
    ]
    setup = require_same(policy_a=policy_a.setup, policy_b=policy_b.setup)
    scenes = _scenes(setup, params.scenes, params.seed)
    a = _roll_out(context, policy_a, scenes, 0.0, 0.45)
    b = _roll_out(context, policy_b, scenes, 0.45, 0.9)
    compared = compare_tables(a, b)
    sides = [(artefact_a, policy_a, a), (artefact_b, policy_b, b)]
    shown = scenes[: params.replays]
    trajectories = [rollout(get_setup(setup), policy.rollout_policy, shown) if shown else [] for _, policy, _ in sides]
    content = {
        "format": "desirepath-comparison-1",
        "setup": setup,
        "seed": params.seed,
        "engine": "fast",
        "policies": [
            {
                "id": artefact.id,
                "name": name,
                **({"weights": of} if artefact.kind in WEIGHED else {}),
                "measured": describe_table(setup, table),
            }
            for (artefact, _, table), name, of in zip(sides, names, weights, strict=True)
        ],
        "compared": compared,
        "scenes": _rows(scenes, [a, b]),
        "replays": [
            {
                "scene_seed": scene.seed,
                "trajectories": [
                    keep_trajectory(context, trajectory[k], artefact.id)
                    for (artefact, _, _), trajectory in zip(sides, trajectories, strict=True)
                ],
            }
            for k, scene in enumerate(shown)
        ],
    }
    context.progress(0.98)
    artefact_id = keep(
        context,
        kind="evaluation",
        name=f"{names[1]} against {names[0]}, {params.scenes} scenes, seed {params.seed}",
        setup=setup,
        content=_json(content),
        params=params,
        config={k: v for k, v in params.model_dump(mode="json").items() if v or not k.startswith("weights")},
        results=compared,
        parents=[(artefact_a, "policy_a"), (artefact_b, "policy_b")],
        scenes={"report": describe(Purpose.REPORT, params.scenes, params.seed)},
    )
    return {"evaluation": artefact_id, "compared": compared}


def _scenes(setup: str, n: int, seed: int) -> list[Scene]:
    return scene_set(setup, n, purpose=Purpose.REPORT, seed=seed)


def _roll_out(
    context: JobContext, policy: DrivingPolicy, scenes: list[Scene], first: float, last: float
) -> EpisodeTable:
    """Every scene once, in batches."""
    part = context.progress.part(first, last)
    tables = []
    for start in range(0, len(scenes), SCENES_AT_ONCE):
        tables.append(episodes(policy, scenes[start : start + SCENES_AT_ONCE]))
        done = min(len(scenes), start + SCENES_AT_ONCE)
        part(done / len(scenes), {"scenes": done})
    return concatenate(tables)


def concatenate(tables: list[EpisodeTable]) -> EpisodeTable:
    """The tables' episodes in one table, in order."""
    if len(tables) == 1:
        return tables[0]
    arrays = {name: np.concatenate([getattr(table, name) for table in tables]) for name in EPISODE_COLUMNS}
    return EpisodeTable(**arrays, social=join([table.social for table in tables]), dt=tables[0].dt)


def _rows(scenes: list[Scene], tables: list[EpisodeTable]) -> dict[str, Any]:
    """Columns, one value per scene: the scene's seed, and per policy what happened. Rounded to the micrometre."""
    return {
        "scene_seed": [scene.seed for scene in scenes],
        "policies": [
            {
                "outcome": table.outcome.tolist(),
                **{name: np.round(column.astype(float), 6).tolist() for name, column in episode_columns(table).items()},
            }
            for table in tables
        ],
    }


def _json(content: dict[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True).encode()

"""The shipped policy of chapter 5 and the reward of its programmed demonstration, each with its card.

Both are tasks of the reproduction; what they compute lives in `reproduction/adaptable/computing.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from desirepath.installed import DATASETS
from desirepath.learning.cards import Card, card_path, file_sha256
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.adaptable.computing import FUNCTIONS
from desirepath_experiments.reproduction.adaptable.departures import DEPARTURES
from desirepath_experiments.reproduction.adaptable.plan import BUDGETS, OURS, PROGRAMMED, make_plan
from desirepath_experiments.reproduction.adaptable.results import row_of
from desirepath_experiments.reproduction.tasks import TaskResult, results_of

ADAPTABLE = get_setup("adaptable")

REWARD_NAME, POLICY_NAME = "adaptable/demonstration_reward", "adaptable/policy"


def ship_adaptable(seed: int = 0, folder: Path = DATASETS, work: Path | None = None) -> list[Card]:
    """Clone, rank, train, roll out and store: reward and policy, as `reproduce adaptable --budget full` makes them.

    work: the `work` folder of such a reproduction, whose finished tasks are used and not computed again.
    """
    plan = make_plan(BUDGETS["full"], (seed,))
    tasks = (plan.learned[PROGRAMMED, seed], plan.trained[OURS, seed], plan.judged[OURS, seed])
    demonstration, policy, rolled = results_of(tasks, FUNCTIONS, work)
    return [store_reward(demonstration, seed, folder), store_policy(policy, rolled, seed, folder)]


def store_reward(made: TaskResult, seed: int, folder: Path = DATASETS) -> Card:
    """Write the reward of a demonstration task with its card."""
    params = made.meta["params"]
    return _store(
        "demonstration_reward",
        REWARD_NAME,
        made.arrays["reward"].tobytes(),
        made.meta["made"],
        seed,
        folder,
        config=params,
        scenes={"demonstrated": describe(Purpose.SELECT, 3 * params["layouts"], seed), "held_out": "reporting scenes"},
        results={key: made.meta[key] for key in ("judged", "clone", "demonstrations", "steps")},
    )


def store_policy(made: TaskResult, rolled: TaskResult, seed: int, folder: Path = DATASETS) -> Card:
    """Write the policy of a training task with its card: as it is judged in the reproduction."""
    reward = folder / f"{REWARD_NAME}.npz"
    return _store(
        "adaptable_policy",
        POLICY_NAME,
        made.arrays["policy"].tobytes(),
        made.meta["made"],
        seed,
        folder,
        config=made.meta["config"],
        scenes={
            "select": describe(Purpose.ALIGN_SELECT, made.meta["config"]["selection_scenes"], seed),
            "report": [describe(Purpose.REPORT, rolled.meta["params"]["rollouts"], seed)],
        },
        results=row_of(rolled)
        | {key: made.meta[key] for key in ("selection_success", "transitions")}
        | {"solutions": made.arrays["solutions"].tolist()},
        parents={REWARD_NAME: file_sha256(reward)},
    )


def _store(
    kind: str, name: str, content: bytes, made: Mapping[str, Any], seed: int, folder: Path, **fields: Any
) -> Card:
    """made: what the task stored of itself; the card says its commit and its seconds."""
    path = folder / f"{name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    card = Card(
        kind=kind,
        name=name,
        setup=ADAPTABLE.name,
        file=path.name,
        sha256=file_sha256(path),
        command=f"desirepath ship adaptable {ADAPTABLE.name} --seed {seed}",
        seed=seed,
        commit=made["commit"],
        departures=DEPARTURES,
        notes=[
            "Simulated: the demonstration is programmed (section 5.3.4.3).",
            f"{made['cpu_seconds']:.0f} seconds of one core, finished {made['finished']}.",
        ],
        **fields,
    )
    card.save(card_path(path))
    return card

"""The shipped policy of chapter 5 and the reward of its programmed demonstration.

Both are tasks of the reproduction; what they compute lives in `reproduction/adaptable/computing.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from desirepath.learning.cards import Card
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.shipping.storing import Request
from desirepath_experiments.reproduction.adaptable.chapter import row_of
from desirepath_experiments.reproduction.adaptable.computing import FUNCTIONS
from desirepath_experiments.reproduction.adaptable.plan import BUDGETS, OURS, PROGRAMMED, make_plan
from desirepath_experiments.reproduction.reports import report_of
from desirepath_experiments.reproduction.tasks import results_of


def ship_adaptable(request: Request) -> list[Card]:
    """Clone, rank, train, roll out and store: reward and policy, as `reproduce adaptable --budget full` makes them;
    tasks that are finished in the request's `work` are not computed again."""
    plan, seed = make_plan(BUDGETS["full"], (request.seed,)), request.seed
    tasks = (plan.learned[PROGRAMMED, seed], plan.trained[OURS, seed], plan.judged[OURS, seed])
    demonstration, policy, rolled = results_of(tasks, FUNCTIONS, request.work)

    def store(kind: str, name: str, content: bytes, about: Mapping[str, Any], **fields: Any) -> Card:
        notes = [
            "Simulated: the demonstration is programmed (section 5.3.4.3).",
            f"{about['cpu_seconds']:.0f} seconds of one core, finished {about['finished']}.",
        ]
        common = {"commit": about["commit"], "departures": report_of("adaptable").departures, "notes": notes}
        return request.store(kind, name, content, f"adaptable {request.setup}", **common, **fields)

    params, config = demonstration.meta["params"], policy.meta["config"]
    reward = store(
        "demonstration_reward",
        "demonstration_reward",
        demonstration.arrays["reward"].tobytes(),
        demonstration.meta["made"],
        config=params,
        scenes={"demonstrated": describe(Purpose.SELECT, 3 * params["layouts"], seed), "held_out": "reporting scenes"},
        results={key: demonstration.meta[key] for key in ("judged", "clone", "demonstrations", "steps")},
    )
    trained = store(
        "adaptable_policy",
        "policy",
        policy.arrays["policy"].tobytes(),
        policy.meta["made"],
        config=config,
        scenes={
            "select": describe(Purpose.ALIGN_SELECT, config["selection_scenes"], seed),
            "report": [describe(Purpose.REPORT, rolled.meta["params"]["rollouts"], seed)],
        },
        results=row_of(rolled)
        | {key: policy.meta[key] for key in ("selection_success", "transitions")}
        | {"solutions": policy.arrays["solutions"].tolist()},
        parents=request.parents("demonstration_reward"),
    )
    return [reward, trained]

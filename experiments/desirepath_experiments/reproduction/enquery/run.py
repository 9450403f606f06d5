"""`desirepath reproduce enquery`, without the command line: work, figures, report."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Any

from desirepath.learning.cards import DEPARTURES
from desirepath.learning.policies.shape import FAST_HEADS
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.td3.base import BaseConfig, BaseTraining
from desirepath_experiments.reproduction.driver import Chapter, Finished, Made
from desirepath_experiments.reproduction.enquery.budgets import BUDGETS, SETUP, EnqueryBudget
from desirepath_experiments.reproduction.enquery.computing import FUNCTIONS
from desirepath_experiments.reproduction.enquery.plan import EnqueryPlan, Speed, make_plan
from desirepath_experiments.reproduction.enquery.results import TableRow, results_of

TIMED_UPDATES = 60


def measure_speed(heads: tuple[int, int]) -> Speed:
    """Seconds of one TD3 update of this machine, with its share of environment steps, by a few real ones."""
    per_update = {}
    for width in {FAST_HEADS, heads}:
        config = BaseConfig(SETUP, heads=width, n_envs=64, random_transitions=1_024, buffer_size=10_000)
        training = BaseTraining(config)
        while training.agent.updates < config.updates_per_step:  # the first ones are slow: they compile and warm up
            training.vector_step()
        before, began = training.agent.updates, time.process_time()
        while training.agent.updates < before + TIMED_UPDATES:
            training.vector_step()
        per_update[width] = (time.process_time() - began) / (training.agent.updates - before)
    return Speed(per_update)


def plan_of(budget: EnqueryBudget, seed: int) -> EnqueryPlan:
    """The plan, its seconds by this machine's speed."""
    return make_plan(budget, seed, measure_speed(budget.heads))


def make(finished: Finished) -> Made:
    """Ensembles, accuracy of reward models, aligned policies and flow fields."""
    from desirepath_experiments.reproduction.enquery.figures import pictures  # matplotlib is slow to load
    from desirepath_experiments.reproduction.enquery.report import brief, facts, sections

    plan: EnqueryPlan = finished.plan
    results = results_of(plan, finished.load)
    finished.tell("drawing")
    drawn = pictures(plan, finished.load, results)
    files = [path for picture in drawn for path in picture.save(finished.figures)]
    tables = {recipe: {row.name: _row_summary(row) for row in rows} for recipe, rows in results.tables.items()}
    found = {"tables": tables, "ceiling_m": results.ceiling_m, "crossings": results.crossings}
    return Made(
        {"setup": SETUP, "seed": plan.seed, "results": asdict(results)},
        head={"budget": plan.budget.name, "seed": plan.seed},
        sections=sections(plan, results, drawn, finished.figures),
        facts=facts(plan, finished.run),
        more={"brief": brief(plan, results)},
        answer={"seed": plan.seed, **found},
        files=files,
        card=_card(plan, found),
    )


CHAPTER = Chapter("enquery", BUDGETS, FUNCTIONS, plan_of, lambda plan: plan.tasks(), make, options={"seed": 0})


def _card(plan: EnqueryPlan, found: dict[str, Any]) -> dict[str, Any]:
    """What the numbers were made of and how."""
    scenes = plan.raw.params["scenes"]
    begun = (plan.base, plan.ensemble, *(task.needs[0] for task in plan.sweep.values()))
    parents = {
        task.params["name"]: ", ".join(task.params["sha256"]) for task in begun if task.kind.startswith("shipped")
    }
    conditioned = [p.params for tasks in plan.alignments.values() for p in tasks if "conditioned" in p.params]
    if conditioned:
        parents[conditioned[0]["conditioned"]] = conditioned[0]["sha256"]
    heads = ["heads"] if plan.budget.heads == FAST_HEADS else []
    trained = ["progress", "smoothness", *heads, "environments", "average", "ensemble_start", "ensemble_choice"]
    keys = [*trained, "fine_tuning", *(["instant", "conditioning_search"] if conditioned else [])]
    return {
        "name": f"{SETUP}/reproduce_{plan.budget.name}",
        "setup": SETUP,
        "seed": plan.seed,
        "config": asdict(plan.budget),
        "scenes": {
            "table": describe(Purpose.REPORT, scenes["n"], scenes["seed"]),
            "sweep": describe(Purpose.SELECT, plan.budget.sweep_scenes, scenes["seed"]),
        },
        "results": found,
        "parents": parents,
        "departures": [DEPARTURES[key] for key in keys],
        "notes": [
            "Simulated throughout: the answers are the oracle's, which prefers the larger minimum human distance."
        ],
    }


def _row_summary(row: TableRow) -> dict[str, Any]:
    names = ("min_human_distance_m", "success_rate", "collision_rate", "timeout_rate", "share_of_the_way")
    p = row.per_alignment_test.p_corrected if row.per_alignment_test else None
    return {name: getattr(row, name) for name in names} | {"p": p}

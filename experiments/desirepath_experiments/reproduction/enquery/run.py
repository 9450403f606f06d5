"""`desirepath reproduce enquery`, without the command line: work, figures, report."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256
from desirepath.learning.policies.shape import FAST_HEADS
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.td3.base import BaseConfig, BaseTraining
from desirepath_experiments.reproduction.chapter_report import RESULTS, said
from desirepath_experiments.reproduction.enquery.budgets import SETUP, EnqueryBudget
from desirepath_experiments.reproduction.enquery.computing import FUNCTIONS
from desirepath_experiments.reproduction.enquery.plan import EnqueryPlan, Speed, make_plan
from desirepath_experiments.reproduction.enquery.results import EnqueryResults, TableRow, results_of
from desirepath_experiments.reproduction.running import Tell, compute, write_results
from desirepath_experiments.reproduction.tasks import Run, Work

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


def reproduce_enquery(
    out: Path,
    budget: EnqueryBudget,
    *,
    seed: int = 0,
    processes: int = 2,
    command: str = "",
    tell: Tell = lambda words: None,
) -> dict[str, Any]:
    """Compute what is missing under `out`/work, then write figures, results.json and report.html.

    Stopped in any way and started again, it goes on with the first task that is not stored. Raises RuntimeError if
    another run works in the same folder, ValueError for a seed or number of processes that cannot be.
    """
    from desirepath_experiments.reproduction.enquery.figures import pictures  # matplotlib is slow to load
    from desirepath_experiments.reproduction.enquery.report import print_report

    plan = make_plan(budget, seed, measure_speed(budget.heads))
    work = Work(out / "work")
    with work.claimed():
        run = compute(
            plan.tasks(),
            FUNCTIONS,
            work,
            command=command,
            processes=processes,
            tell=tell,
            name=lambda task: task.kind.replace("_", " "),
        )
        results = results_of(plan, work.load)
        tell("drawing")
        drawn = pictures(plan, work.load, results)
        files = [path for picture in drawn for path in picture.save(out / "figures")]
        print_report(out, plan, results, drawn, run)
        results_file = out / RESULTS
        summary = write_results(results_file, run, budget, setup=SETUP, seed=seed, results=asdict(results))
        _card(plan, results, run, results_file).save(card_path(results_file))
    return {
        **said(out, summary, ("budget", "seed", "seconds", "computed", "core_seconds", "commit"), files),
        "tables": {recipe: {row.name: _row_summary(row) for row in rows} for recipe, rows in results.tables.items()},
        "crossings": results.crossings,
        "ceiling_m": results.ceiling_m,
    }


def _card(plan: EnqueryPlan, results: EnqueryResults, run: Run, file: Path) -> Card:
    """What the numbers were made of and how, beside them like every other artefact's card."""
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
    return Card(
        kind="reproduction",
        name=f"{SETUP}/reproduce_{plan.budget.name}",
        setup=SETUP,
        file=file.name,
        sha256=file_sha256(file),
        command=run.command,
        seed=plan.seed,
        commit=run.commit,
        config=asdict(plan.budget),
        scenes={
            "table": describe(Purpose.REPORT, scenes["n"], scenes["seed"]),
            "sweep": describe(Purpose.SELECT, plan.budget.sweep_scenes, scenes["seed"]),
        },
        results={
            "tables": {
                recipe: {row.name: _row_summary(row) for row in rows} for recipe, rows in results.tables.items()
            },
            "ceiling_m": results.ceiling_m,
            "crossings": results.crossings,
            "core_seconds": run.core_seconds,
        },
        parents=parents,
        departures=[DEPARTURES[key] for key in keys],
        notes=["Simulated throughout: the answers are the oracle's, which prefers the larger minimum human distance."],
    )


def _row_summary(row: TableRow) -> dict[str, Any]:
    names = ("min_human_distance_m", "success_rate", "collision_rate", "timeout_rate", "share_of_the_way")
    p = row.per_alignment_test.p_corrected if row.per_alignment_test else None
    return {name: getattr(row, name) for name in names} | {"p": p}

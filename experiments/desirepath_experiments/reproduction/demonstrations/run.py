"""`desirepath reproduce demonstrations`, without the command line: work, figures, report."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from desirepath.demonstrations.td3_bc.configuration import DEPARTURES, DemonstrationConfig
from desirepath_experiments.reproduction.chapter_report import RESULTS, said, save_card
from desirepath_experiments.reproduction.demonstrations.computing import FUNCTIONS
from desirepath_experiments.reproduction.demonstrations.plan import DemonstrationsBudget, make_plan
from desirepath_experiments.reproduction.demonstrations.results import BARS, rows_of
from desirepath_experiments.reproduction.running import Tell, compute, write_results
from desirepath_experiments.reproduction.tasks import Task, Work


def reproduce_demonstrations(
    out: Path, budget: DemonstrationsBudget, *, processes: int = 2, command: str = "", tell: Tell = lambda words: None
) -> dict[str, Any]:
    """Compute what is missing under `out`/work, then write figures, results.json with its card, and report.html.

    Stopped in any way and started again, it goes on with the first task that is not stored. Raises RuntimeError if
    another run works in the same folder.
    """
    from desirepath_experiments.reproduction.demonstrations.figures import pictures  # matplotlib is slow to load
    from desirepath_experiments.reproduction.demonstrations.report import brief, print_report

    plan = make_plan(budget)
    work = Work(out / "work")
    with work.claimed():
        run = compute(plan.tasks(), FUNCTIONS, work, command=command, processes=processes, tell=tell, name=_name)
        rows = rows_of(plan, work.load)
        brief_text = brief(plan, rows, work.load)
        tell("drawing")
        drawn = pictures(plan, work.load)
        files = [path for picture in drawn for path in picture.save(out / "figures")]
        print_report(out, plan, rows, work.load, drawn, run)
        summary = write_results(
            out / RESULTS,
            run,
            budget,
            bars={name: asdict(bar) for name, bar in BARS.items()},
            rows=[asdict(row) for row in rows],
            brief=brief_text,
        )
        save_card(
            out,
            "demonstrations",
            run,
            budget,
            setup=", ".join(budget.environments),
            config={**asdict(budget), "training": DemonstrationConfig(updates=budget.updates).as_dict()},
            scenes={"unseen": f"reporting scenes of seeds {', '.join(map(str, budget.seeds))}"},
            found={"brief": brief_text},
            departures=DEPARTURES,
            note="Simulated throughout: those who demonstrate are programmed demonstrators.",
        )
    return said(out, summary, ("budget", "seconds", "computed", "core_seconds", "commit", "brief"), files)


def _name(task: Task) -> str:
    whose = task.params.get("style", task.params.get("controller", ""))
    return f"{task.kind}, {whose} in the {task.params['environment']}"

"""`desirepath reproduce demonstrations`, without the command line: work, figures, report."""

from __future__ import annotations

from dataclasses import asdict

from desirepath.demonstrations.td3_bc.configuration import DEPARTURES, DemonstrationConfig
from desirepath_experiments.reproduction.chapter_report import seeds_words
from desirepath_experiments.reproduction.demonstrations.computing import FUNCTIONS
from desirepath_experiments.reproduction.demonstrations.plan import BUDGETS, make_plan
from desirepath_experiments.reproduction.demonstrations.results import BARS, rows_of
from desirepath_experiments.reproduction.driver import Chapter, Finished, Made
from desirepath_experiments.reproduction.tasks import Task


def make(finished: Finished) -> Made:
    """Bars and measures, beside the baselines'."""
    from desirepath_experiments.reproduction.demonstrations.figures import pictures  # matplotlib is slow to load
    from desirepath_experiments.reproduction.demonstrations.report import brief, facts, sections

    plan, load = finished.plan, finished.load
    budget = plan.budget
    rows = rows_of(plan, load)
    brief_text = brief(plan, rows, load)
    finished.tell("drawing")
    drawn = pictures(plan, load)
    files = [path for picture in drawn for path in picture.save(finished.figures)]
    return Made(
        {
            "bars": {name: asdict(bar) for name, bar in BARS.items()},
            "rows": [asdict(row) for row in rows],
            "brief": brief_text,
        },
        head=seeds_words(budget),
        sections=sections(plan, rows, load, drawn, finished.figures),
        facts=facts(plan, finished.run),
        more={"brief": brief_text},
        answer={"brief": brief_text},
        files=files,
        card={
            "setup": ", ".join(budget.environments),
            "seed": budget.seeds[0],
            "config": {**asdict(budget), "training": DemonstrationConfig(updates=budget.updates).as_dict()},
            "scenes": {"unseen": f"reporting scenes of seeds {', '.join(map(str, budget.seeds))}"},
            "results": {"brief": brief_text},
            "departures": DEPARTURES,
            "notes": ["Simulated throughout: those who demonstrate are programmed demonstrators."],
        },
    )


def _name(task: Task) -> str:
    whose = task.params.get("style", task.params.get("controller", ""))
    return f"{task.kind}, {whose} in the {task.params['environment']}"


CHAPTER = Chapter("demonstrations", BUDGETS, FUNCTIONS, make_plan, lambda plan: plan.tasks(), make, task_name=_name)

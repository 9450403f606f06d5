"""`desirepath reproduce interface`, without the command line: work, tables 7.1-7.3 beside the printed ones, report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from desirepath.explain.printed import Section, Table
from desirepath_experiments.reproduction.driver import Chapter, Finished, Made
from desirepath_experiments.reproduction.interface.computing import FUNCTIONS, LAMBDA, PER_VIEW, SETUP
from desirepath_experiments.reproduction.interface.published_numbers import (
    AGREEMENT,
    FIRST,
    PAIRS,
    PRINTED,
    RANKINGS,
    RESPONSE_MODELS,
    ROLLOUTS,
    VIEWS,
)
from desirepath_experiments.reproduction.tasks import Task, TaskResult

BASE = "baseline"
PRINTED_WITH_BASE = (*(PRINTED[view] for view in VIEWS), "baseline")


@dataclass(frozen=True)
class InterfaceBudget:
    """How much is computed. participants: 31, as there; updates: of each view's alignment; scenes: 1,000, as there."""

    name: str
    participants: int = 31
    epochs: int = 200
    updates: int = 4_000
    transitions: int = 60_000
    scenes: int = 1_000


BUDGETS = {
    budget.name: budget
    for budget in (InterfaceBudget("small"), InterfaceBudget("full", updates=30_000, transitions=150_000))
}


@dataclass(frozen=True)
class InterfacePlan:
    """answers: of everybody; rolled_out: by view, and of the base policy."""

    budget: InterfaceBudget
    seed: int
    answers: Task
    aligned: dict[str, Task]
    rolled_out: dict[str, Task]


def make_plan(budget: InterfaceBudget, seed: int) -> InterfacePlan:
    """Which tasks a budget has. Raises ValueError for a seed without people of its own."""
    if not 0 <= seed <= 9:
        raise ValueError(f"seed = {seed}: between 0 and 9")
    answers = Task("answers", {"participants": budget.participants, "seed": seed}, seconds=20)
    learned = {"seed": seed, "updates": budget.updates, "transitions": budget.transitions, "epochs": budget.epochs}
    aligned = {
        view: Task("aligned", {"view": view, **learned}, (answers,), 30 + 0.004 * budget.updates) for view in VIEWS
    }
    measured = {"scenes": budget.scenes, "seed": seed}
    rolled_out = {view: Task("rolled_out", measured, (aligned[view],), 2) for view in VIEWS}
    return InterfacePlan(budget, seed, answers, aligned, {**rolled_out, BASE: Task("rolled_out", measured, (), 2)})


def make(finished: Finished) -> Made:
    """Tables 7.1 to 7.3."""
    plan: InterfacePlan = finished.plan
    answers = finished.load(plan.answers.key)
    rows = {name: finished.load(task.key).meta for name, task in plan.rolled_out.items()}
    found = {
        "table_7_1": first_choices(answers),
        "table_7_2": agreements(answers),
        "table_7_3": {name: {key: of[key] for key in ("values", "standard_errors")} for name, of in rows.items()},
        "training_accuracy": {v: finished.load(task.key).meta["training_accuracy"] for v, task in plan.aligned.items()},
        "people": answers.meta["people"],
    }
    return Made(
        found,
        head={"budget": plan.budget.name, "seed": plan.seed, "participants": plan.budget.participants},
        sections=_sections(found, plan.budget),
        further=[("Setup", SETUP)],
        answer={key: found[key] for key in ("table_7_1", "table_7_2")}
        | {"table_7_3": {name: of["values"] for name, of in found["table_7_3"].items()}},
    )


CHAPTER = Chapter(
    "interface",
    BUDGETS,
    FUNCTIONS,
    make_plan,
    lambda plan: [plan.answers, *plan.aligned.values(), *plan.rolled_out.values()],
    make,
    task_name=lambda task: _name(task),
    options={"seed": 0},
)


def first_choices(answers: TaskResult) -> dict[str, dict[str, float]]:
    """By ranking and view, share of people (%) who put it first."""
    return {
        ranking: {view: 100 * float(np.mean([one == view for one in given])) for view in VIEWS}
        for ranking, given in answers.meta["first_choice"].items()
    }


def agreements(answers: TaskResult) -> dict[str, dict[str, float]]:
    """By pair of views, mean and standard deviation over people (%), and how alike one view's answers are when asked
    again, mean of the two views."""
    found = {}
    for pair in PAIRS:
        shares = 100 * np.array(answers.meta["agreement"]["/".join(pair)])
        again = 50 * sum(float(np.mean(answers.meta["consistency"][view])) for view in pair)
        found["/".join(pair)] = {"mean": float(shares.mean()), "sd": float(shares.std(ddof=1)), "asked_again": again}
    return found


def _sections(found: dict[str, Any], budget: InterfaceBudget) -> list[Section]:
    printed_first = [
        [RANKINGS[ranking], *(_both(found["table_7_1"][ranking][view], FIRST[ranking].get(view)) for view in VIEWS)]
        for ranking in RANKINGS
    ]
    alike = [
        [
            " - ".join(PRINTED[view] for view in pair),
            f"{of['mean']:.1f} ± {of['sd']:.1f}",
            f"{AGREEMENT[pair][0]} ± {AGREEMENT[pair][1]}",
            f"{of['asked_again']:.1f}",
        ]
        for pair in PAIRS
        for of in [found["table_7_2"]["/".join(pair)]]
    ]
    rolled_out = [
        [
            name,
            *(
                _both(found["table_7_3"][who]["values"][name], printed[k], digits=2)
                for k, who in enumerate((*VIEWS, BASE))
            ),
        ]
        for name, printed in ROLLOUTS.items()
    ]
    noise = ", ".join(
        f"{PRINTED[view]}: {100 * of.lapse_rate:.0f} % lapses, differences below {of.indifference} typical ones unseen"
        for view, of in RESPONSE_MODELS.items()
    )
    accuracies = ", ".join(f"{PRINTED[view]} {100 * of:.0f} %" for view, of in found["training_accuracy"].items())
    heads = [f"{name}: here (printed)" for name in PRINTED_WITH_BASE]
    return [
        Section(
            "Table 7.1: rankings",
            ["What is put in stands near what was printed; so this shows the way through, and finds nothing out."],
            [Table("First choices, %: here (printed)", ["ranked by", *heads[:3]], printed_first)],
        ),
        Section(
            "Table 7.2: agreement between views",
            [
                f"Everybody prefers the same in all views; views differ in how answers stray ({noise}). Agreement is "
                "what these let through, beside how alike answers are when the same view asks again."
            ],
            [Table("Agreement over people, %", ["views", "here", "printed", "asked again, here"], alike)],
        ),
        Section(
            "Table 7.3: policies",
            [
                f"One reward model per view (chapter 7's network, {budget.participants * PER_VIEW} answers of "
                f"{budget.participants} people; right on its own answers: {accuracies}), one policy each, "
                f"lambda {LAMBDA}."
            ],
            [Table(f"{budget.scenes:,} fresh scenes, the same for all", ["measure", *heads], rolled_out)],
            [
                "Trained on from the shipped base policy for "
                f"{budget.updates:,} updates, half of each batch new experience; there 500,000 steps from scratch.",
                "The learned reward is normalised over the buffer; there it lies between -1 and 1.",
                "Scenes, robot and base policy are ours; so numbers are compared across a row, not down a column.",
            ],
        ),
    ]


def _both(here: float, printed: float | None, digits: int = 1) -> str:
    return f"{here:.{digits}f} ({'-' if printed is None else printed})"


def _name(task: Task) -> str:
    return f"{task.kind.replace('_', ' ')} {task.params.get('view', '')}".strip()

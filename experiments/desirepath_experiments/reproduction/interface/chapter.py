"""Chapter 7 reproduced: three views, one reward model and one policy per view. Its tasks, and tables 7.1 to 7.3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from desirepath_experiments.reproduction.driver import Chapter, Made, read_budgets
from desirepath_experiments.reproduction.interface.computing import (
    FUNCTIONS,
    LAMBDA,
    PAIRS,
    PER_VIEW,
    RANKINGS,
    RESPONSE_MODELS,
    VIEWS,
)
from desirepath_experiments.reproduction.tasks import Load, Task, TaskResult

BASE = "baseline"


@dataclass(frozen=True)
class InterfaceBudget:
    """How much is computed. participants: 31, as there; updates: of each view's alignment; scenes: 1,000, as there."""

    name: str
    participants: int = 31
    epochs: int = 200
    updates: int = 4_000
    transitions: int = 60_000
    scenes: int = 1_000


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


def make(plan: InterfacePlan, load: Load) -> Made:
    """Tables 7.1 to 7.3."""
    answers = load(plan.answers)
    rows = {name: load(task).meta for name, task in plan.rolled_out.items()}
    results = {
        "table_7_1": first_choices(answers),
        "table_7_2": agreements(answers),
        "table_7_3": {name: {key: of[key] for key in ("values", "standard_errors")} for name, of in rows.items()},
        "training_accuracy": {view: load(task).meta["training_accuracy"] for view, task in plan.aligned.items()},
        "people": answers.meta["people"],
    }
    return Made(
        results,
        more={"views": VIEWS, "rankings": RANKINGS, "models": RESPONSE_MODELS, "per_view": PER_VIEW, "weight": LAMBDA},
        answer={key: results[key] for key in ("table_7_1", "table_7_2")}
        | {"table_7_3": {name: of["values"] for name, of in rows.items()}},
    )


CHAPTER = Chapter(
    "interface", read_budgets("interface", InterfaceBudget), FUNCTIONS, make_plan, make, options={"seed": 0}
)


def first_choices(answers: TaskResult) -> dict[str, dict[str, float]]:
    """By ranking and view, share of people (%) who put it first."""
    return {
        ranking: {view: 100 * float(np.mean([choice == view for choice in choices])) for view in VIEWS}
        for ranking, choices in answers.meta["first_choice"].items()
    }


def agreements(answers: TaskResult) -> dict[str, dict[str, float]]:
    """By pair of views, mean and standard deviation over people (%), and how alike one view's answers are when asked
    again, mean of the two views."""
    shares_of_pairs = {}
    for pair in PAIRS:
        shares = 100 * np.array(answers.meta["agreement"]["/".join(pair)])
        again = 50 * sum(float(np.mean(answers.meta["consistency"][view])) for view in pair)
        shares_of_pairs["/".join(pair)] = {
            "mean": float(shares.mean()),
            "sd": float(shares.std(ddof=1)),
            "asked_again": again,
        }
    return shares_of_pairs

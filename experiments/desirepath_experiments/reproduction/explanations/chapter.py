"""Chapter 8 reproduced: a policy explained in 48 scenarios, simulated rankers. Its tasks, and tables 8.1 and 8.2."""

from __future__ import annotations

from dataclasses import dataclass

from desirepath_experiments.reproduction.driver import Chapter, Made, read_budgets
from desirepath_experiments.reproduction.explanations.computing import FUNCTIONS, NOISE_PLACES, RATED, TRUST
from desirepath_experiments.reproduction.tasks import Load, Task

EFFECTS = {"outline": "XAI", "lidar": "Lidar", "outline x lidar": "XAI × Lidar"}
"""Effect -> as the tables print it; all with 1 and 23 degrees of freedom."""
SCALES = {"awareness": "Q1-6: SIPA", "trust": "Q7: trust", "plausibility": "Q8: plausibility"}


@dataclass(frozen=True)
class ExplanationsBudget:
    """How much is computed. participants: 24, as there. train: the policy anew, instead of the shipped one. studies: of
    which the first is shown, and all say how often each effect is found."""

    name: str
    train: bool = False
    scenes: int = 2_000
    participants: int = 24
    studies: int = 100


@dataclass(frozen=True)
class ExplanationsPlan:
    budget: ExplanationsBudget
    seed: int
    policy: Task
    scenarios: Task
    rankers: Task


def make_plan(budget: ExplanationsBudget, seed: int) -> ExplanationsPlan:
    """Which tasks a budget has."""
    trained = {"seed": seed if budget.train else None, "scenes": budget.scenes}
    policy = Task("policy", trained, seconds=10 + 600 * budget.train)
    scenarios = Task("explained_scenarios", {"method": "saliency"}, (policy,), 5)
    ranked = {"participants": budget.participants, "studies": budget.studies, "seed": seed}
    rankers = Task("rankers", ranked, (scenarios,), 0.6 * budget.studies)
    return ExplanationsPlan(budget, seed, policy, scenarios, rankers)


def make(plan: ExplanationsPlan, load: Load) -> Made:
    """Tables 8.1 and 8.2, and how often each effect is found."""
    policy, scenarios, ranked = (load(task).meta for task in (plan.policy, plan.scenarios, plan.rankers))
    tests = {
        about: {effect: ranked["tests"][f"{about}, {effect.replace(' x ', ' × ')}"] for effect in EFFECTS}
        for about in ("tau", *SCALES)
    }
    results = {
        "policy": {key: policy[key] for key in ("success", "collision", "timeout", "selection_success", "slowing")},
        "scenarios": {key: scenarios[key] for key in ("scenarios", "with_tied_scores", "objects_without_score")},
        "table_8_1": tests["tau"],
        "table_8_2": {scale: tests[scale] for scale in SCALES},
        **{key: ranked[key] for key in ("tau", "means", "found", "rankings")},
    }
    return Made(
        {"seed": plan.seed, **results},
        more={"effects": EFFECTS, "scales": SCALES, "noise": NOISE_PLACES, "trust": TRUST, "rated": RATED},
        answer={"simulated": True} | {key: results[key] for key in ("tau", "table_8_1", "table_8_2", "found")},
    )


CHAPTER = Chapter(
    "explanations", read_budgets("explanations", ExplanationsBudget), FUNCTIONS, make_plan, make, options={"seed": 0}
)

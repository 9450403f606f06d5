"""`desirepath reproduce explanations`, without the command line: work, tables 8.1 and 8.2 beside the printed ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from desirepath.analysis.tested import p_in_words
from desirepath.explain.printed import Section, Table
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.driver import Chapter, Finished, Made
from desirepath_experiments.reproduction.explanations.computing import FUNCTIONS
from desirepath_experiments.reproduction.explanations.published_numbers import (
    EFFECTS,
    NOISE_PLACES,
    RATED,
    SCALES,
    SIPA,
    TABLE_8_1,
    TABLE_8_2,
    TAU,
    TRUST,
)
from desirepath_experiments.reproduction.tasks import Task

EXPLAINED_ROOM = get_setup("explained_room")


@dataclass(frozen=True)
class ExplanationsBudget:
    """How much is computed. participants: 24, as there. train: the policy anew, instead of the shipped one. studies: of
    which the first is shown, and all say how often each effect is found."""

    name: str
    train: bool = False
    scenes: int = 2_000
    participants: int = 24
    studies: int = 100


BUDGETS = {
    budget.name: budget for budget in (ExplanationsBudget("small"), ExplanationsBudget("full", True, 10_000, 24, 500))
}


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
    return ExplanationsPlan(
        budget, seed, policy, scenarios, Task("rankers", ranked, (scenarios,), 0.6 * budget.studies)
    )


def make(finished: Finished) -> Made:
    """Tables 8.1 and 8.2, and how often each effect is found."""
    plan: ExplanationsPlan = finished.plan
    budget = plan.budget
    policy, scenarios, ranked = (finished.load(t.key).meta for t in (plan.policy, plan.scenarios, plan.rankers))
    found = {
        "policy": {key: policy[key] for key in ("success", "collision", "timeout", "selection_success", "slowing")},
        "scenarios": {key: scenarios[key] for key in ("scenarios", "with_tied_scores", "objects_without_score")},
        "table_8_1": {effect: ranked["tests"][_about("tau", effect)] for effect in EFFECTS},
        "table_8_2": {key: {effect: ranked["tests"][_about(key, effect)] for effect in EFFECTS} for key in TABLE_8_2},
        "tau": ranked["tau"],
        "means": ranked["means"],
        "found": ranked["found"],
        "rankings": ranked["rankings"],
    }
    return Made(
        {"seed": plan.seed, **found},
        head={"budget": budget.name, "seed": plan.seed, "participants": budget.participants},
        sections=_sections(found, budget),
        further=[("Setup", EXPLAINED_ROOM.name)],
        answer={"simulated": True} | {key: found[key] for key in ("tau", "table_8_1", "table_8_2", "found")},
    )


CHAPTER = Chapter("explanations", BUDGETS, FUNCTIONS, make_plan, lambda plan: [plan.rankers], make, options={"seed": 0})


def _about(outcome: str, effect: str) -> str:
    """A test's name in the analysis."""
    return f"{outcome}, {effect.replace(' x ', ' × ')}"


def _sections(found: Mapping[str, Any], budget: ExplanationsBudget) -> list[Section]:
    return [_policy(found), _ranked(found, budget), _rated(found, budget)]


def _policy(found: Mapping[str, Any]) -> Section:
    of, scenarios = found["policy"], found["scenarios"]
    slowed = of["slowing"]
    share = slowed["share_of_trajectories_that_slow_down"]
    times = sum(slowed["for_what"].values()) or 1
    causes = ", ".join(f"{thing} {100 * count / times:.0f} %" for thing, count in list(slowed["for_what"].items())[:6])
    return Section(
        "Policy and scenarios",
        [
            f"{100 * of['success']:.1f} % of fresh scenes succeed, {100 * of['collision']:.1f} % end in a collision. "
            f"The policy slows down in {100 * share:.0f} % of the trajectories; for what, by "
            f"taking things out where it drives slowest: {causes}.",
            f"{scenarios['scenarios']} scenarios of five objects; scores where the robot halts are tied in "
            f"{scenarios['with_tied_scores']}, {scenarios['objects_without_score']} objects are not seen and score 0.",
        ],
    )


def _ranked(found: Mapping[str, Any], budget: ExplanationsBudget) -> Section:
    tau = [
        [f"{'with' if on else 'without'} outlines", *(f"{one:.2f}" for one in found["tau"][str(on)]),
         f"{TAU[on][0]} ({TAU[on][1]})"]
        for on in (True, False)
    ]  # fmt: skip
    return Section(
        "Table 8.1: agreement of rankings with what moved the robot",
        [
            f"{budget.participants} simulated rankers, {found['rankings']:,} rankings, all 24 orders of the blocks. "
            "Where outlines are shown, a ranker goes by them to a share of "
            f"{TRUST[0]:.1f} to {TRUST[1]:.1f}, else by what lies near and ahead, and is unsure by "
            f"{NOISE_PLACES[0]} to {NOISE_PLACES[1]} places. These were chosen near what was printed: the tables "
            "show the way through, and find nothing out about people. The lidar's rays tell a simulated ranker "
            "nothing.",
        ],
        [
            Table("Kendall's tau-b over people", ["", "mean, here", "SD, here", "printed: mean (SD)"], tau),
            _table("Tau-b, analysis of variance", found["table_8_1"], TABLE_8_1, found["found"], "tau", budget),
        ],
    )


def _rated(found: Mapping[str, Any], budget: ExplanationsBudget) -> Section:
    put_in = "; ".join(f"{SCALES[name]}: {', '.join(f'{one:+.2f}' for one in of)}" for name, of in RATED.items())
    awareness = [
        [name, *(f"{one:.1f}" for one in found["means"]["awareness"][name]), f"{SIPA[name][0]} ({SIPA[name][1]})"]
        for name in SIPA
    ]
    tables = [
        _table(SCALES[key], found["table_8_2"][key], TABLE_8_2[key], found["found"], key, budget) for key in TABLE_8_2
    ]
    return Section(
        "Table 8.2: what was said after each block",
        [
            "Opinions are made up: what outlines, lidar, and both beyond their sum add to them is put in, in standard "
            f"deviations ({put_in}; trust: nothing). Reversed items are inverted, p is uncorrected as printed there."
        ],
        [Table("SIPA over people", ["", "mean, here", "SD, here", "printed: mean (SD)"], awareness), *tables],
    )


def _table(
    title: str,
    here: Mapping[str, Mapping[str, float]],
    printed: Mapping[str, Sequence[str]],
    found: Mapping[str, float],
    outcome: str,
    budget: ExplanationsBudget,
) -> Table:
    rows = [
        [
            EFFECTS[effect],
            f"{of['F']:.2f} ({printed[effect][0]})",
            f"{p_in_words(of['p'])} (p {'' if '<' in printed[effect][1] else '= '}{printed[effect][1]})",
            f"{of['effect']:.2f} ({printed[effect][2]})",
            f"{100 * found[_about(outcome, effect)]:.0f} %",
        ]
        for effect, of in here.items()
    ]
    degrees = f"F(1, {budget.participants - 1})"
    heads = ["effect", f"{degrees}: here (printed)", "p", "partial η²", f"found at .05 in {budget.studies} studies"]
    return Table(title, heads, rows)

"""Chapter 6 as a report: what we found beside what was published, in words computed from the numbers.

A sentence that explains a difference is only written where the numbers carry it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from desirepath.explain.pictures import Picture
from desirepath.explain.printed import Section, Shown, embed_picture
from desirepath.learning.cards import DEPARTURES
from desirepath_experiments.reproduction.enquery import published_numbers as thesis
from desirepath_experiments.reproduction.enquery.budgets import MODELS, RECIPES, TEST_SETS
from desirepath_experiments.reproduction.enquery.plan import EnqueryPlan, query_seed
from desirepath_experiments.reproduction.enquery.results import (
    FIRST,
    RAW,
    EnqueryResults,
    nearest_cell,
)
from desirepath_experiments.reproduction.enquery.tables import (
    accuracy_table,
    alignment_table,
    difference_table,
    named,
    share,
    t_test_table,
)
from desirepath_experiments.reproduction.tasks import Run

LOW_QUERIES = 15


def brief(plan: EnqueryPlan, results: EnqueryResults) -> list[str]:
    """The result in a few sentences."""
    sentences = []
    for recipe, rows in results.tables.items():
        first = named(rows, FIRST)
        sentences.append(
            f"{FIRST} by {RECIPES[recipe]}: minimum human distance {_m(first.min_human_distance_m)}, "
            f"{share(first.share_of_the_way)} of the way from RAW ({_m(named(rows, RAW).min_human_distance_m)}) to "
            f"the ceiling ({_m(results.ceiling_m)}), success {share(first.success_rate)}. The thesis: "
            f"{_m(first.published.min_human_distance_m)}, success {share(first.published.success_rate)}."
        )
    sentences.append(_accuracy_sentence(results))
    sentences.append(_sweep_sentence(plan, results))
    return sentences


def sections(plan: EnqueryPlan, results: EnqueryResults, pictures: Sequence[Picture], folder: Path) -> list[Section]:
    """The report's parts in order."""

    def shown(*beginnings: str) -> list[Shown]:
        return [embed_picture(one, folder) for one in pictures if one.name.startswith(beginnings)]

    tables = results.tables
    return [
        Section("Ensembles over kappa and training steps", [_sweep_sentence(plan, results)], pictures=shown("sweep")),
        Section("Trajectories of all members", pictures=shown("members")),
        Section(
            "Accuracy of the reward models",
            [_accuracy_sentence(results), _crossing_sentence(results)],
            tables=[accuracy_table(results, test_set) for test_set in TEST_SETS],
            pictures=shown("accuracy"),
        ),
        Section(
            "Aligned policies",
            [
                f"{plan.budget.alignments} alignments per row, each with answers of its own, then trajectories in the "
                f"same {plan.budget.rollouts} scenes. All recipes are given the same answers; all start from the same "
                "base policy, but for the conditioned one, which is shipped. The share of the way is that from RAW to "
                "the ceiling of these scenes, the mean of min(start to person, goal to person).",
            ],
            tables=[alignment_table(recipe, rows) for recipe, rows in tables.items()],
            pictures=shown("distances"),
        ),
        Section(
            "Tests",
            [
                f"Two-sided Student's t-tests of {FIRST} against every other row, as in table 6.2, p corrected by Holm "
                "over the four tests of a recipe. Alignments are the units; RAW is one policy and enters as a fixed "
                "value. Beside it the same test with every trajectory as a unit: those of one policy are not "
                "independent, so its p is too small; the thesis does not say which was used.",
            ],
            tables=[t_test_table(recipe, rows) for recipe, rows in tables.items()],
            points=[
                row.per_alignment_test.sentence(f"By {RECIPES[recipe]}, {FIRST}", row.name, "m")
                for recipe, rows in tables.items()
                for row in rows
                if row.per_alignment_test is not None
            ],
        ),
        Section(
            "Where our numbers differ from the thesis",
            tables=[difference_table(recipe, rows) for recipe, rows in tables.items()],
            points=explanations(plan, results),
        ),
        Section("Raw and aligned trajectories", pictures=shown("aligned")),
        Section("Flow fields", pictures=shown("flow")),
    ]


def explanations(plan: EnqueryPlan, results: EnqueryResults) -> list[str]:
    """What accounts for the differences, as far as our own numbers show it."""
    paragraphs = []
    raw = named(results.tables["thesis"], RAW)
    above = [name for name, row in thesis.TABLE_6_2.items() if row.min_human_distance_m > results.ceiling_m]
    first = thesis.TABLE_6_2[FIRST].min_human_distance_m
    if above:
        paragraphs.append(
            f"The scenes. No policy can keep more than {_m(results.ceiling_m)} on average in ours, less than the "
            f"published {', '.join(above)}; {_m(first)} or more is possible in "
            f"{share(results.reachable_share[FIRST])} of them. Scenes or the measure must have been different there, "
            "so metres cannot be compared, only shares of the way."
        )
    gap = raw.min_human_distance_m - raw.published.min_human_distance_m
    paragraphs.append(
        f"The starting point. Our RAW keeps {_m(raw.min_human_distance_m)}, {_m(abs(gap))} "
        f"{'more' if gap > 0 else 'less'} than the published RAW, before anything was learned from answers."
    )
    gains = {recipe: named(rows, FIRST).share_of_the_way for recipe, rows in results.tables.items()}
    ours = max((recipe for recipe in gains if recipe != "thesis"), key=lambda recipe: gains[recipe])
    if gains[ours] > gains["thesis"]:
        paragraphs.append(
            "The recipe. From the same answers, in the same scenes, the thesis's recipe (lambda 0.06, neural reward "
            f"model, relabelled buffer alone) goes {share(gains['thesis'])} of the way, {RECIPES[ours]} "
            f"{share(gains[ours])}: the answers hold more than the published recipe takes from them."
        )
    at = {
        (p.model, p.source): p.accuracy
        for p in results.curves
        if p.answers == LOW_QUERIES and p.test_set == TEST_SETS[0]
    }
    better = [model for model in MODELS if ("mlp", "EnQ") in at and at[model, "EnQ"] > at["mlp", "EnQ"]]
    if better:
        others = ", ".join(f"the model {MODELS[model]!r} {share(at[model, 'EnQ'])}" for model in better)
        paragraphs.append(
            f"The reward model. With {LOW_QUERIES} answers the neural model predicts {share(at['mlp', 'EnQ'])} of the "
            f"ensemble test pairs, {others}."
        )
    paragraphs.append(_diversity_explanation(results))
    paragraphs += [
        "The simulator. Fast kinematic engine instead of iGibson; observations, limits and rewards are the chapter's.",
        "The replay buffer is regenerated from the base policy and the seed, not the one that filled up during its "
        "training.",
        *(f"Base and ensemble. {DEPARTURES[key]}" for key in ("progress", "smoothness", "average", "ensemble_choice")),
    ]
    heads = "-".join(str(width) for width in plan.budget.heads)
    paragraphs.append(
        f"The networks. Heads of {heads} for base, ensemble, reward models and alignments (the thesis: 400-300); the "
        "sweep over kappa starts from the shipped base policy with its smaller heads."
    )
    return paragraphs


def _diversity_explanation(results: EnqueryResults) -> str:
    cell = nearest_cell(results.sweep, thesis.KAPPA, thesis.ENSEMBLE_STEPS)
    control = [other.diversity for other in results.sweep if other.kappa == 0.0 and other.steps == cell.steps]
    without = f" Without the term members that start alike already differ by {control[0]:.2f}." if control else ""
    ratio = cell.diversity / thesis.ENSEMBLE_DIVERSITY
    return (
        f"The action diversity. Ours is {cell.diversity:.2f} at kappa = {cell.kappa:g} and {cell.steps:,} steps, "
        f"{ratio:.1f} times the published {thesis.ENSEMBLE_DIVERSITY}.{without} Ours is the formula of 6.5.1.1 with "
        "actions in [-1, 1], summed over the other members and over both parts of an action; averaged over the two "
        f"parts it would be {cell.diversity / 2:.2f}. The thesis says neither which it is nor in which unit actions "
        "enter, so how much of the difference is behaviour remains unexplained."
    )


def facts(plan: EnqueryPlan, run: Run) -> list[tuple[str, str]]:
    """Command, seeds, durations."""
    budget = plan.budget
    scenes = plan.raw.params["scenes"]
    return [
        ("command", run.command),
        ("commit", run.commit),
        ("this run", f"{run.computed} tasks computed in {_duration(run.seconds)} by {run.processes} process(es)"),
        ("all tasks", f"{len(run.made)} tasks, {_duration(run.core_seconds)} of one core"),
        ("network heads", "-".join(str(width) for width in budget.heads)),
        ("base policy", _policy_words(plan)),
        ("table's scenes", f"{scenes['n']} reporting scenes of seed {scenes['seed']}"),
        (
            "queries",
            f"seeds {query_seed(plan.seed, 0)} and following, one per repetition and alignment; test pairs "
            f"{plan.accuracies[0].params['test_seed']}",
        ),
        (
            "training seeds",
            f"{'base, ensemble, ' if budget.train else ''}sweep: {plan.seed}; alignments and reward models: their "
            f"number from 0 to {max(budget.alignments, budget.repetitions) - 1}",
        ),
        (
            "thesis's recipe",
            f"{budget.thesis_epochs} epochs of {budget.thesis_updates:,} updates, lambda 0.06, best epoch kept",
        ),
        (
            RECIPES["fine_tuning"],
            f"{budget.fine_tuning_updates:,} updates, {budget.fine_tuning_checkpoints} checkpoints",
        ),
    ]


def _policy_words(plan: EnqueryPlan) -> str:
    if plan.budget.train:
        return "trained in this reproduction, with its own ensemble of four"
    return "the shipped one and its shipped ensemble of four"


def _sweep_sentence(plan: EnqueryPlan, results: EnqueryResults) -> str:
    cell = nearest_cell(results.sweep, thesis.KAPPA, thesis.ENSEMBLE_STEPS)
    last = max(plan.budget.marks)
    final = {cell.kappa: cell for cell in results.sweep if cell.steps == last}
    control = f" The control without the term: diversity {final[0.0].diversity:.2f}." if 0.0 in final else ""
    above = [cell.success_rate for kappa, cell in final.items() if kappa > thesis.KAPPA_WHERE_SUCCESS_FALLS]
    below = [cell.success_rate for kappa, cell in final.items() if kappa <= thesis.KAPPA_WHERE_SUCCESS_FALLS]
    falls = ""
    if above and below:
        falls = (
            f" After {last:,} steps the mean success is {share(sum(below) / len(below))} for kappa up to "
            f"{thesis.KAPPA_WHERE_SUCCESS_FALLS} and {share(sum(above) / len(above))} above, where the thesis saw it "
            "fall rapidly."
        )
    return (
        f"At kappa = {cell.kappa:g} and {cell.steps:,} steps members succeed in {share(cell.success_rate)} (worst "
        f"{share(cell.worst_member)}) at an action diversity of {cell.diversity:.2f}; the thesis reports "
        f"{share(thesis.ENSEMBLE_SUCCESS)} and {thesis.ENSEMBLE_DIVERSITY} for kappa = {thesis.KAPPA} and "
        f"{thesis.ENSEMBLE_STEPS:,} steps.{control}{falls}"
    )


def _accuracy_sentence(results: EnqueryResults) -> str:
    points = [p for p in results.curves if p.model == "mlp" and p.test_set == TEST_SETS[0]]
    count = min({p.answers for p in points}, key=lambda answers: abs(answers - LOW_QUERIES))
    at = {p.source: p for p in points if p.answers == count}
    return (
        f"With {count} answers the neural reward model predicts {share(at['EnQ'].accuracy)} of the ensemble test "
        f"pairs when it learned from ensemble pairs ({share(at['EnQ'].low)} to {share(at['EnQ'].high)}), "
        f"{share(at['BL'].accuracy)} when it learned from segments ({share(at['BL'].low)} to "
        f"{share(at['BL'].high)})."
    )


def _crossing_sentence(results: EnqueryResults) -> str:
    def words(count: int | None) -> str:
        return "never" if count is None else f"from {count} answers on"

    crossings = "; ".join(f"{pairing}: {words(count)}" for pairing, count in results.crossings.items())
    return (
        f"From how many answers the baseline's mean stays above EnQuery's. {crossings}. The thesis: from "
        f"{thesis.QUERIES_WHERE_BASELINE_OVERTAKES}. Only the numbers of answers that were tried can be found."
    )


def _m(value: float) -> str:
    return f"{value:.2f} m"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5_400 else f"{seconds / 3_600:.1f} h"

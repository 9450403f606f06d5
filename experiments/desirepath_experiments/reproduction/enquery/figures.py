"""Figures of chapter 6: heat maps over kappa and steps, accuracies, distances, trajectories and flow fields."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from desirepath.explain.flow_field import COLUMNS, difference, flow_field, rollouts_from, spread_starts
from desirepath.explain.pictures import Rows, quiet
from desirepath.explain.scene_plots import DATA, PAPER, SOFT, pair_figure, starts_figure
from desirepath.learning.policies.policy import Policy
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.enquery.chapter import FIRST, RAW, EnqueryResults, SweepCell
from desirepath_experiments.reproduction.enquery.computing import stored_policies, table_scenes
from desirepath_experiments.reproduction.enquery.plan import MODELS, RECIPES, SETUP, TEST_SETS, EnqueryPlan
from desirepath_experiments.reproduction.figures import Drawn, curve, dots, heat_map, legend_below, panels
from desirepath_experiments.reproduction.tasks import Load

GOOD = LinearSegmentedColormap.from_list("good", ["#f2e3c9", "#dfeadb", "#8fbf95"])
APART = LinearSegmentedColormap.from_list("apart", [PAPER, "#e4d5e9", "#b795c4"])
SOURCE_COLOURS = {"EnQ": DATA[0], "BL": DATA[1]}
DASHES = dict(zip(MODELS, ("-", (0, (1, 1.5)), (0, (4, 1.5))), strict=True))
LONG_WAY_M = 6.0  # scenes shown have at least this far from start to goal: little can differ on a short way


def draw(plan: EnqueryPlan, load: Load, results: EnqueryResults) -> list[Drawn]:
    """All figures of the report, in its order."""
    seen, budget = drawn_scenes(plan), plan.budget
    starts = [spread_starts(scene, budget.starts) for scene in seen]
    base, members = stored_policies(load(plan.base))[0], stored_policies(load(plan.ensemble))
    first = {key: stored_policies(load(runs[0]))[0] for key, runs in plan.alignments.items()}
    drawn = [draw_sweep(results.sweep), draw_accuracy(results), draw_distances(results)]
    for letter, from_starts in zip("ab", starts, strict=False):
        policies = {f"member {k}": member for k, member in enumerate(members)}
        title = f"All members of the ensemble, scene {letter}"
        drawn.append(draw_trajectories(f"members_{letter}", title, policies, from_starts))
    for recipe, words in plan.recipes.items():
        policies = {RAW: base, FIRST: first[recipe, FIRST]}
        drawn.append(draw_trajectories(f"aligned_{recipe}", f"{RAW} and {FIRST} by {words}", policies, starts[0]))
    return drawn + [
        draw_flow(f"flow_{recipe}_{name.lower()}", words, name, base, first[recipe, name], seen[0])
        for recipe, words in plan.recipes.items()
        for name in budget.flow_fields
        if recipe == "thesis" or name == FIRST
    ]


def drawn_scenes(plan: EnqueryPlan) -> list[Scene]:
    """The table's first two scenes with a long way; the first two, where there are none."""
    scenes = table_scenes(plan.raw.params["scenes"])
    far = [s for s in scenes if math.dist((s.start.x, s.start.y), (s.goal.x, s.goal.y)) >= LONG_WAY_M]
    return (far or scenes)[:2]


def draw_sweep(cells: Sequence[SweepCell]) -> Drawn:
    """Figure 6.2: action diversity and success over kappa and training steps."""
    kappas, marks = sorted({cell.kappa for cell in cells}), sorted({cell.steps for cell in cells})
    by_kappa = {(cell.kappa, cell.steps): cell for cell in cells}
    maps = (
        ("a  action diversity", "diversity", ".2f", APART),
        ("b  success rate, mean of the members", "success_rate", ".0%", GOOD),
    )
    width, height = max(6.4, 1.6 + 1.1 * len(kappas)), 0.9 + 0.42 * max(4, len(marks))
    with panels(2, width, height) as (figure, axes):
        for ax, (title, name, number_format, colours) in zip(axes, maps, strict=True):
            values = np.array([[getattr(by_kappa[kappa, steps], name) for kappa in kappas] for steps in marks])
            heat_map(figure, ax, values, title, number_format, colours)
            ax.set_xticks(range(len(kappas)), [f"{kappa:.3g}" for kappa in kappas])
            ax.set_yticks(range(len(marks)), [f"{steps:,}" for steps in marks])
            ax.set(xlabel="kappa", ylabel="training steps per member")
    rows: Rows = [
        {
            "kappa": cell.kappa,
            "steps": cell.steps,
            "action_diversity": cell.diversity,
            "success_rate": cell.success_rate,
            "worst_member_success_rate": cell.worst_member,
        }
        for cell in cells
    ]
    return Drawn("sweep", "sweep", figure, rows)


def draw_accuracy(results: EnqueryResults) -> Drawn:
    """Figure 6.4: accuracy on both test sets against the number of answers."""
    points = results.curves
    lowest = min(0.4, *(p.accuracy - 0.02 for p in points))
    with panels(len(TEST_SETS), 7.2, 3.3) as (figure, axes):
        for ax, test_set in zip(axes, TEST_SETS, strict=True):
            for source, colour in SOURCE_COLOURS.items():
                for model, label in MODELS.items():
                    line = [p for p in points if (p.model, p.source, p.test_set) == (model, source, test_set)]
                    # a band for every line would hide all of them
                    band = ([p.low for p in line], [p.high for p in line]) if model == "mlp" else None
                    curve(
                        ax, [p.answers for p in line], [p.accuracy for p in line], colour=colour, band=band, shade=0.13,
                        linestyle=DASHES[model], linewidth=1.4, label=f"{source}, {label}", marker=".", markersize=3.5,
                    )  # fmt: skip
            quiet(ax)
            ax.axhline(0.5, color=SOFT, linewidth=0.6, linestyle=(0, (1, 2)))
            ax.set(title=f"tested on {test_set}", xlabel="answers", ylim=(lowest, 1.02))
        axes[0].set_ylabel("share of test pairs predicted")
        legend_below(figure, axes[0], 6)
    rows: Rows = [
        {
            "model": p.model,
            "answers_about": p.source,
            "test_set": p.test_set,
            "answers": p.answers,
            "accuracy": p.accuracy,
            "low": p.low,
            "high": p.high,
            "standard_deviation": p.deviation,
            "repetitions": p.repetitions,
        }
        for p in points
    ]
    return Drawn("accuracy", "accuracy", figure, rows)


def draw_distances(results: EnqueryResults) -> Drawn:
    """Table 6.2 as dots: one per alignment, with what was published beside."""
    lines = math.ceil(len(results.tables) / 2)
    with panels(2, 7.0, 0.5 + 2.7 * lines, rows=lines) as (figure, axes):
        for ax, (recipe, of_recipe) in zip(axes, results.tables.items(), strict=False):
            colours = [SOURCE_COLOURS.get(row.name.partition("-")[0], SOFT) for row in of_recipe]
            dots(
                ax,
                [
                    (
                        row.name,
                        colour,
                        row.per_alignment,
                        row.min_human_distance_m,
                        row.published["min_human_distance_m"],
                    )
                    for row, colour in zip(of_recipe, colours, strict=True)
                ],
            )
            ax.axhline(results.ceiling_m, color=SOFT, linewidth=1, linestyle=(0, (4, 2)), label="ceiling of the scenes")
            ax.set(title=f"by {RECIPES[recipe]}", ylim=(0, None))
            quiet(ax)
        for ax in axes[len(results.tables) :]:
            ax.set_visible(False)
        for ax in axes[::2]:
            ax.set_ylabel("minimum human distance (m)")
        top = max(ax.get_ylim()[1] for ax in axes)
        for ax in axes:
            ax.set_ylim(0, top)
        legend_below(figure, axes[0], 4)
    rows: Rows = [
        {
            "recipe": row.recipe,
            "condition": row.name,
            "alignment": run,
            "min_human_distance_m": value,
            "mean_of_condition_m": row.min_human_distance_m,
            "published_m": row.published["min_human_distance_m"],
            "ceiling_m": results.ceiling_m,
        }
        for of_recipe in results.tables.values()
        for row in of_recipe
        for run, value in enumerate(row.per_alignment)
    ]
    return Drawn("distances", "distances", figure, rows)


def draw_trajectories(name: str, title: str, policies: Mapping[str, Policy], starts: Sequence[Scene]) -> Drawn:
    """Figures 6.3 and 6.7: several policies from the same starts."""
    rollouts = rollouts_from(
        {whose: policy.rollout_policy for whose, policy in policies.items()}, get_setup(SETUP), starts
    )
    rows: Rows = [
        {
            "policy": whose,
            "start": start,
            "time_s": round(float(time), 3),
            "x_m": round(float(pose[0]), 4),
            "y_m": round(float(pose[1]), 4),
            "heading_rad": round(float(pose[2]), 4),
            "outcome": trajectory.outcome.name.lower(),
        }
        for whose, trajectories in rollouts.items()
        for start, trajectory in enumerate(trajectories)
        for time, pose in zip(trajectory.times, trajectory.poses, strict=True)
    ]
    about = {"title": title, "scene": starts[0].seed, "starts": len(starts)}
    return Drawn("trajectories", name, starts_figure(rollouts, title=title), rows, about)


def draw_flow(name: str, recipe: str, condition: str, base: Policy, aligned: Policy, scene: Scene) -> Drawn:
    """Figures 6.5 and 6.6: raw against aligned, as flow fields with their difference."""
    setup = get_setup(SETUP)
    fields = flow_field(base.rollout_policy, setup, scene), flow_field(aligned.rollout_policy, setup, scene)
    apart = difference(*fields)
    rows: Rows = [
        {"policy": whose, **dict(zip(COLUMNS, values, strict=True))}
        for whose, field in zip((RAW, condition), fields, strict=True)
        for values in field.rows()
    ]
    figure = pair_figure(apart, titles=(f"A  {RAW}", f"B  {condition}, {recipe}"))
    about = {"recipe": recipe, "condition": condition, "scene": scene.seed, "angle": apart.mean_angle}
    return Drawn("flow", name, figure, rows, about)

"""Chapter 6 in pictures, each beside a CSV with exactly what is drawn.

Scenes with trajectories and flow fields are drawn by `explain/scene_plots.py`, whose colours and type
are used here, too. Importing this loads matplotlib, which is slow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap

from desirepath.explain.flow_field import COLUMNS, difference, flow_field, rollouts_from, spread_starts
from desirepath.explain.pictures import Picture, Rows, blank, quiet
from desirepath.explain.scene_plots import DATA, INK, PAPER, SOFT, STYLE, pair_figure, starts_figure
from desirepath.learning.policies.policy import Policy
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.enquery import published_numbers as thesis
from desirepath_experiments.reproduction.enquery.budgets import CONDITIONS, MODELS, RECIPES, SETUP, TEST_SETS
from desirepath_experiments.reproduction.enquery.computing import stored_policies, table_scenes
from desirepath_experiments.reproduction.enquery.plan import EnqueryPlan
from desirepath_experiments.reproduction.enquery.results import (
    FIRST,
    RAW,
    CurvePoint,
    EnqueryResults,
    Load,
    SweepCell,
    TableRow,
)

GOOD = LinearSegmentedColormap.from_list("good", ["#f2e3c9", "#dfeadb", "#8fbf95"])
APART = LinearSegmentedColormap.from_list("apart", [PAPER, "#e4d5e9", "#b795c4"])
SOURCE_COLOURS = {"EnQ": DATA[0], "BL": DATA[1]}
LONG_WAY_M = 6.0  # scenes shown have at least this far from start to goal: little can differ on a short way


def pictures(plan: EnqueryPlan, load: Load, results: EnqueryResults) -> list[Picture]:
    """All figures of the report, in its order."""
    seen = drawn_scenes(plan)
    base = stored_policies(load(plan.base.key))[0]
    members = stored_policies(load(plan.ensemble.key))
    first_runs = {
        (recipe, name): stored_policies(load(plan.alignments[recipe, name][0].key))[0]
        for recipe in plan.recipes
        for name in CONDITIONS
    }
    members_shown = [
        trajectories_picture(
            f"members_{letter}",
            f"All members of the ensemble, scene {letter}",
            {f"member {k}": member for k, member in enumerate(members)},
            spread_starts(scene, plan.budget.starts),
        )
        for letter, scene in zip("ab", seen, strict=False)
    ]
    compared = [
        trajectories_picture(
            f"aligned_{recipe}",
            f"RAW and {FIRST} by {words}",
            {RAW: base, FIRST: first_runs[recipe, FIRST]},
            spread_starts(seen[0], plan.budget.starts),
        )
        for recipe, words in plan.recipes.items()
    ]
    fields = [
        flow_picture(f"flow_{recipe}_{name.lower()}", words, name, base, first_runs[recipe, name], seen[0])
        for recipe, words in plan.recipes.items()
        for name in plan.budget.flow_fields
        if recipe == "thesis" or name == FIRST
    ]
    return [
        sweep_picture(results.sweep),
        accuracy_picture(results),
        table_picture(results),
        *members_shown,
        *compared,
        *fields,
    ]


def drawn_scenes(plan: EnqueryPlan) -> list[Scene]:
    """The table's first two scenes with a long way; the first two, where there are none."""
    scenes = table_scenes(plan.raw.params["scenes"])
    far = [s for s in scenes if math.dist((s.start.x, s.start.y), (s.goal.x, s.goal.y)) >= LONG_WAY_M]
    return (far or scenes)[:2]


def sweep_picture(cells: Sequence[SweepCell]) -> Picture:
    """Figure 6.2: action diversity and success over kappa and training steps."""
    kappas, marks = sorted({cell.kappa for cell in cells}), sorted({cell.steps for cell in cells})
    found = {(cell.kappa, cell.steps): cell for cell in cells}

    def panel(ax: Axes, title: str, value: Callable[[SweepCell], float], number_format: str, colours: Colormap) -> None:
        values = np.array([[value(found[kappa, steps]) for kappa in kappas] for steps in marks])
        image = ax.imshow(values, origin="lower", aspect="auto", cmap=colours)
        for (row, column), number in np.ndenumerate(values):
            ax.text(column, row, format(number, number_format), ha="center", va="center", fontsize=7, color=INK)
        ax.set_xticks(range(len(kappas)), [f"{kappa:.3g}" for kappa in kappas])
        ax.set_yticks(range(len(marks)), [f"{steps:,}" for steps in marks])
        ax.set(title=title, xlabel="kappa", ylabel="training steps per member")
        bar = figure.colorbar(image, ax=ax, pad=0.02, aspect=28)
        bar.outline.set_linewidth(0.5)

    with mpl.rc_context(STYLE):
        figure, axes = blank(2, max(6.4, 1.6 + 1.1 * len(kappas)), 0.9 + 0.42 * max(4, len(marks)))
        panel(axes[0], "a  action diversity", lambda cell: cell.diversity, ".2f", APART)
        panel(axes[1], "b  success rate, mean of the members", lambda cell: cell.success_rate, ".0%", GOOD)
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
    caption = (
        "Action diversity (mean over states and members of the summed squared distances to the other members' actions) "
        "and success rate over the weight kappa of the diversity term and the training steps. kappa = 0 is the control "
        f"without the term. The thesis's figure 6.2; it settled on kappa = {thesis.KAPPA} and "
        f"{thesis.ENSEMBLE_STEPS:,} steps."
    )
    return Picture("sweep", "Ensembles over kappa and training steps", caption, figure, rows)


def accuracy_picture(results: EnqueryResults) -> Picture:
    """Figure 6.4: accuracy on both test sets against the number of answers."""
    points = results.curves
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(TEST_SETS), 7.2, 3.3)
        for ax, test_set in zip(axes, TEST_SETS, strict=True):
            for source, colour in SOURCE_COLOURS.items():
                for (model, label), dashes in zip(MODELS.items(), ("-", (0, (1, 1.5)), (0, (4, 1.5))), strict=True):
                    line = [p for p in points if (p.model, p.source, p.test_set) == (model, source, test_set)]
                    _curve(ax, line, colour, dashes, f"{source}, {label}")
            quiet(ax)
            ax.axhline(0.5, color=SOFT, linewidth=0.6, linestyle=(0, (1, 2)))
            lowest = min(0.4, *(p.accuracy - 0.02 for p in points))
            ax.set(title=f"tested on {test_set}", xlabel="answers", ylim=(lowest, 1.02))
        axes[0].set_ylabel("share of test pairs predicted")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    repetitions = max(point.repetitions for point in points)
    caption = (
        f"Accuracy of reward models learned from pairs of ensemble trajectories (EnQ) and of 20-step segments (BL), "
        f"mean of {repetitions} repetitions. Bands: 95 % intervals (Student's t) of the neural model, which the "
        "thesis's figure 6.4 shows; those of our two are in the CSV. Dotted line: guessing. Our two models are given "
        "measures of a trajectory, the smallest human distance among them, by which this oracle judges; the neural one "
        "has to find it in the observations."
    )
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
    return Picture("accuracy", "Accuracy of reward models", caption, figure, rows)


def _curve(ax: Axes, line: Sequence[CurvePoint], colour: str, dashes: object, label: str) -> None:
    x = [point.answers for point in line]
    ax.plot(
        x, [point.accuracy for point in line], color=colour, linestyle=dashes, linewidth=1.4, label=label, marker=".",
        markersize=3.5,
    )  # fmt: skip
    if line and line[0].model == "mlp":  # a band for every line would hide all of them
        bounds = [point.low for point in line], [point.high for point in line]
        ax.fill_between(x, *bounds, color=colour, alpha=0.13, linewidth=0)


def table_picture(results: EnqueryResults) -> Picture:
    """Table 6.2 as dots: one per alignment, with what was published beside."""
    with mpl.rc_context(STYLE):
        lines = math.ceil(len(results.tables) / 2)
        figure, axes = blank(2, 7.0, 0.5 + 2.7 * lines, rows=lines)
        for ax, (recipe, rows_of_recipe) in zip(axes, results.tables.items(), strict=False):
            _dots(ax, rows_of_recipe)
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
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    rows: Rows = [
        {
            "recipe": row.recipe,
            "condition": row.name,
            "alignment": run,
            "min_human_distance_m": value,
            "mean_of_condition_m": row.min_human_distance_m,
            "published_m": row.published.min_human_distance_m,
            "ceiling_m": results.ceiling_m,
        }
        for of_recipe in results.tables.values()
        for row in of_recipe
        for run, value in enumerate(row.per_alignment)
    ]
    episodes = results.tables[next(iter(results.tables))][0]
    caption = (
        "Minimum distance to the person, centre to centre: each dot is the mean of one alignment's trajectories in the "
        f"same {episodes.episodes // episodes.alignments} scenes, a bar the mean over the alignments, a diamond what "
        f"the thesis published ({thesis.TABLE_6_2_SOURCE}). No policy can exceed the ceiling in these scenes."
    )
    return Picture("distances", "Minimum human distance of every alignment", caption, figure, rows)


def _dots(ax: Axes, rows: Sequence[TableRow]) -> None:
    for k, row in enumerate(rows):
        colour = SOURCE_COLOURS.get(row.name.partition("-")[0], SOFT)
        spread = np.linspace(-0.18, 0.18, len(row.per_alignment)) if len(row.per_alignment) > 1 else np.zeros(1)
        ax.scatter(
            k + spread, row.per_alignment, s=14, color=colour, alpha=0.75, linewidths=0, zorder=3,
            label="one alignment" if k == 0 else None,
        )  # fmt: skip
        ax.plot([k - 0.3, k + 0.3], [row.min_human_distance_m] * 2, color=INK, linewidth=1.4, zorder=4,
                label="mean" if k == 0 else None)  # fmt: skip
        ax.scatter(
            k, row.published.min_human_distance_m, marker="D", s=20, facecolor=PAPER, edgecolor=INK, linewidths=0.9,
            zorder=5, label="thesis" if k == 0 else None,
        )  # fmt: skip
    ax.set_xticks(range(len(rows)), [row.name for row in rows])


def trajectories_picture(name: str, title: str, policies: Mapping[str, Policy], starts: Sequence[Scene]) -> Picture:
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
    caption = (
        f"Scene {starts[0].seed} of the open field, {len(starts)} starts: the scene's own, then each time the free "
        "place farthest from all others and the goal. A cross marks where a trajectory ended without arriving."
    )
    return Picture(name, title, caption, starts_figure(rollouts, title=title), rows)


def flow_picture(name: str, recipe: str, condition: str, base: Policy, aligned: Policy, scene: Scene) -> Picture:
    """Figures 6.5 and 6.6: raw against aligned, as flow fields with their difference."""
    setup = get_setup(SETUP)
    fields = flow_field(base.rollout_policy, setup, scene), flow_field(aligned.rollout_policy, setup, scene)
    apart = difference(*fields)
    rows: Rows = [
        {"policy": whose, **dict(zip(COLUMNS, values, strict=True))}
        for whose, field in zip((RAW, condition), fields, strict=True)
        for values in field.rows()
    ]
    caption = (
        f"Scene {scene.seed}; A is RAW, B the first alignment of {condition} by {recipe}. Above: settled headings as "
        "streamlines over the number of trajectories through each cell, one from every free cell. Below: the angle "
        f"between the headings (mean {apart.mean_angle:.2f} rad) and the difference of the trajectories."
    )
    title = f"Flow fields of RAW and {condition} by {recipe}"
    figure = pair_figure(apart, titles=(f"A  {RAW}", f"B  {condition}, {recipe}"))
    return Picture(name, title, caption, figure, rows)

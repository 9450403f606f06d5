"""Chapter 2 in pictures, each beside a CSV with exactly what is drawn.

Importing this loads matplotlib, which is slow.
"""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from desirepath.demonstrations.judging import KINDS, PROFILE_POINTS
from desirepath.explain.pictures import Picture, Rows, blank, quiet
from desirepath.explain.scene_plots import DATA, INK, STYLE, draw_person, draw_solids
from desirepath.simulation.demonstration_scenes import demonstration_scenes
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath_experiments.reproduction.demonstrations.plan import (
    CONTROLLERS,
    OURS,
    VARIANTS,
    WITHOUT,
    DemonstrationsPlan,
)
from desirepath_experiments.reproduction.demonstrations.results import (
    DEMONSTRATED,
    MEASURES,
    NAMES,
    SHOWN,
    Load,
    curves_of,
    first_cell,
    measured,
)

COLOURS = {DEMONSTRATED: DATA[4], OURS: DATA[0], "social_cost": DATA[2], "dwa": DATA[1]}
VARIANT_COLOURS = dict(zip(VARIANTS, DATA, strict=False))
CURVES = {
    "frechet_m": "Frechet distance f(t*) (m)",
    "followed_rate": "rollouts that follow",
    "success_rate": "success, demonstrated starts",
    "unseen_success_rate": "success, unseen scenes",
}


def pictures(plan: DemonstrationsPlan, load: Load) -> list[Picture]:
    """All figures of the report, in its order."""
    found = []
    for environment in plan.budget.environments:
        found += [paths_picture(plan, load, environment), measures_picture(plan, load, environment)]
        found.append(unseen_picture(plan, load, environment))
    found += [speeds_picture(plan, load, environment) for environment in plan.budget.environments]
    first = plan.budget.environments[0]
    return [*found, curves_picture(plan, load, first, plan.budget.ablated)]


def _poses(plan: DemonstrationsPlan, load: Load, environment: str, style: str, controller: str) -> NDArray[Any]:
    """(rollouts, steps, 3) of the first seed."""
    source = OURS if controller == DEMONSTRATED else controller
    arrays = load(plan.judged[first_cell(plan, environment, style, source)].key).arrays
    return arrays["demonstrated_poses" if controller == DEMONSTRATED else "driven_poses"]


def paths_picture(plan: DemonstrationsPlan, load: Load, environment: str) -> Picture:
    """Figure 2.3 a-d: demonstrations and rollouts from their starts, a colour per position-orientation pair."""
    scenes, styles = demonstration_scenes(environment), plan.budget.styles
    room = scenes[0].room
    shape = room.width / room.length if room is not None else 1.0
    rows: Rows = []
    with mpl.rc_context(STYLE):
        columns = (*SHOWN, WITHOUT) if plan.budget.controls else SHOWN
        height = len(styles) * (8.8 / len(columns) * shape + 0.35) + 0.3
        figure, axes = blank(len(columns), 9.6, height, rows=len(styles))
        for number, ax in enumerate(axes):
            style, controller = styles[number // len(columns)], columns[number % len(columns)]
            draw_solids(ax, scenes[0])
            for pair, scene in enumerate(scenes):
                draw_person(ax, scene, DATA[pair])
            for number, poses in enumerate(_poses(plan, load, environment, style, controller)):
                pair, path = number // plan.budget.per_pair, poses[np.isfinite(poses[:, 0])]
                ax.plot(path[:, 0], path[:, 1], color=DATA[pair], linewidth=0.8, alpha=0.8, zorder=5)
                speeds = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1) / CONTROL_DT_S
                rows += [
                    {
                        "style": style,
                        "controller": controller,
                        "pair": pair,
                        "rollout": number,
                        "time_s": round(step * CONTROL_DT_S, 1),
                        "x_m": round(float(path[step, 0]), 4),
                        "y_m": round(float(path[step, 1]), 4),
                        "speed_m_s": round(float(speeds[step - 1]), 4) if step else "",
                    }
                    for step in range(0, len(path), 5)
                ]
            ax.set(aspect="equal", xticks=[], yticks=[])
            ax.spines[:].set_visible(False)
            if number < len(columns):
                ax.set_title(NAMES[controller].replace(" without", "\nwithout"))
            if number % len(columns) == 0:
                ax.set_ylabel(style.replace("_", " "))
    return Picture(
        f"paths_{environment}",
        f"Demonstrations and rollouts in the {environment}",
        "Rows: programmed demonstrators. Columns: what they demonstrated, and what the controllers do from the same "
        "starts; TD3 without demonstrations is the same controller in every row. A colour per position-orientation "
        "pair; noses show where the person looks. After figure 2.3 a-d.",
        figure,
        rows,
    )


def measures_picture(plan: DemonstrationsPlan, load: Load, environment: str) -> Picture:
    """Figure 2.3 e-g: path length, distance and area by controller, median and quartiles over rollouts."""
    styles = plan.budget.styles
    rows: Rows = []
    width = 0.8 / len(SHOWN)
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(MEASURES), 9.6, 2.9)
        for ax, (name, words) in zip(axes, MEASURES.items(), strict=True):
            for k, controller in enumerate(SHOWN):
                values = [measured(plan, load, environment, style, controller, name) for style in styles]
                quartiles = np.array([np.quantile(found, [0.25, 0.5, 0.75]) for found in values])
                places = np.arange(len(styles)) + (k - (len(SHOWN) - 1) / 2) * width
                spread = np.abs(quartiles[:, [0, 2]].T - quartiles[:, 1])
                ax.bar(places, quartiles[:, 1], width * 0.92, color=COLOURS[controller], label=NAMES[controller])
                ax.errorbar(places, quartiles[:, 1], spread, fmt="none", ecolor=INK, elinewidth=0.7)
                rows += [
                    {
                        "measure": name,
                        "style": style,
                        "controller": controller,
                        "rollouts": len(found),
                        "lower_quartile": low,
                        "median": middle,
                        "upper_quartile": high,
                    }
                    for style, found, (low, middle, high) in zip(styles, values, quartiles.tolist(), strict=True)
                ]
            ax.set_title(words)
            ax.set_xticks(range(len(styles)), [style.replace("_", "\n") for style in styles])
            quiet(ax)
        _legend_below(figure, axes[0])
    return Picture(
        f"measures_{environment}",
        f"Path length, distance and area in the {environment}",
        "Medians over all rollouts from demonstrated starts, lines from the lower to the upper quartile. Relative path "
        "length: driven over straight; path area: between the path and the straight line. After figure 2.3 e-g.",
        figure,
        rows,
    )


def unseen_picture(plan: DemonstrationsPlan, load: Load, environment: str) -> Picture:
    """What figure 2.5 b-d shows in examples, counted: success where nothing was demonstrated."""
    styles = plan.budget.styles
    rows: Rows = []
    width = 0.8 / len(CONTROLLERS)
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(KINDS), 9.6, 2.6)
        for ax, kind in zip(axes, KINDS, strict=True):
            for k, controller in enumerate(CONTROLLERS):
                rates, spread = [], []
                for style in styles:
                    cells = [
                        c
                        for c in plan.judged
                        if (c.environment, c.style, c.controller) == (environment, style, controller)
                    ]
                    found = [load(plan.unseen[cell].key).meta["unseen"][kind] for cell in cells]
                    of_seeds = [one["success_rate"] for one in found]
                    rates.append(float(np.mean(of_seeds)))
                    spread.append((rates[-1] - min(of_seeds), max(of_seeds) - rates[-1]))
                    rows.append(
                        {
                            "drawn": kind,
                            "style": style,
                            "controller": controller,
                            "scenes": sum(one["n"] for one in found),
                            **{
                                name: float(np.mean([one[name] for one in found]))
                                for name in ("success_rate", "collision_rate", "timeout_rate", "min_human_distance_m")
                            },
                        }
                    )
                places = np.arange(len(styles)) + (k - (len(CONTROLLERS) - 1) / 2) * width
                ax.bar(places, rates, width * 0.92, color=COLOURS[controller], label=NAMES[controller])
                spreads = np.maximum(np.transpose(spread), 0)  # equal seeds' mean may lie beyond them by a rounding
                ax.errorbar(places, rates, spreads, fmt="none", ecolor=INK, elinewidth=0.7)
            ax.axhline(0.9, color=INK, linewidth=0.6, linestyle=":")
            ax.set(title=f"random {kind}" if kind != "anywhere" else "everything random", ylim=(0, 1.02))
            ax.set_xticks(range(len(styles)), [style.replace("_", "\n") for style in styles], fontsize=6)
            quiet(ax)
        axes[0].set_ylabel("success rate")
        _legend_below(figure, axes[0])
    return Picture(
        f"unseen_{environment}",
        f"Success where nothing was demonstrated, {environment}",
        "Share of scenes in which the goal was reached, with robot start, goal, or person drawn at random, or all "
        "three; lines: worst and best seed. Dotted: 90 %. The scenes are reporting scenes; no checkpoint was chosen on "
        "them.",
        figure,
        rows,
    )


def speeds_picture(plan: DemonstrationsPlan, load: Load, environment: str) -> Picture:
    """Figure 2.5a: the speeds demonstrated near the person, and those executed."""
    limits = get_setup(environment).robot.limits
    style = "slow_near_person" if "slow_near_person" in plan.budget.styles else plan.budget.styles[0]
    arrays = load(plan.judged[first_cell(plan, environment, style, OURS)].key).arrays
    share = np.linspace(0, 1, PROFILE_POINTS)
    rows: Rows = []
    with mpl.rc_context(STYLE):
        figure, axes = blank(4, 9.6, 2.2)
        for pair, ax in enumerate(axes):
            of_pair = slice(pair * plan.budget.per_pair, (pair + 1) * plan.budget.per_pair)
            for whose, controller in (("demonstrated", DEMONSTRATED), ("driven", OURS)):
                for number, profile in enumerate(arrays[f"{whose}_speeds"][of_pair]):
                    _profile(ax, share, profile, COLOURS[controller])
                    rows += [
                        {
                            "pair": pair,
                            "whose": whose,
                            "rollout": number,
                            "share": round(float(s), 4),
                            "speed_m_s": float(v),
                        }
                        for s, v in zip(share, profile, strict=True)
                    ]
            ax.set(title=f"pair {pair + 1}", xlabel="share of the path", ylim=(0, limits.v_max * 1.15))
            quiet(ax)
        axes[0].set_ylabel("speed (m/s)")
        lines = [Line2D([], [], color=COLOURS[name], label=NAMES[name]) for name in (DEMONSTRATED, OURS)]
        figure.legend(handles=lines, frameon=False, fontsize=7, ncols=2, loc="outside lower center")
    return Picture(
        f"speeds_{environment}",
        f"Speed profiles in the {environment}, {style.replace('_', ' ')}",
        "Forward speed along the path, of every demonstration and of the rollout from its start. After figure 2.5 a.",
        figure,
        rows,
    )


def _profile(ax: Axes, share: NDArray[Any], profile: NDArray[Any], colour: str) -> None:
    ax.plot(share, profile, color=colour, linewidth=0.8, alpha=0.8)


def _legend_below(figure: Figure, ax: Axes) -> None:
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, fontsize=7, ncols=len(labels), loc="outside lower center")


def curves_picture(plan: DemonstrationsPlan, load: Load, environment: str, style: str) -> Picture:
    """What a controller can do after how much computing, with and without each part of the training."""
    curves = curves_of(plan, load, environment, style)
    rows: Rows = []
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(CURVES), 9.6, 2.5)
        for variant, whole in curves.items():
            colour, label = VARIANT_COLOURS[variant], NAMES[variant]
            averaged = [[point for point in curve if point["averaged"]] for curve in whole]
            seconds = np.array([[point["cpu_s"] for point in curve] for curve in averaged])
            for ax, name in zip(axes, CURVES, strict=True):
                values = np.array([[point[name] for point in curve] for curve in averaged])
                ax.plot(seconds.T, values.T, linewidth=0.5, color=colour, alpha=0.5)
                ax.plot(
                    seconds.mean(axis=0),
                    values.mean(axis=0),
                    ".-",
                    markersize=3,
                    linewidth=1.3,
                    color=colour,
                    label=label,
                )
            rows += [
                {"variant": variant, "seed": seed, "cpu_s": p["cpu_s"], "updates": p["updates"]}
                | {name: p[name] for name in CURVES}
                for seed, curve in zip(plan.budget.seeds, averaged, strict=True)
                for p in curve
            ]
        for ax, (name, words) in zip(axes, CURVES.items(), strict=True):
            ax.set(title=words, xlabel="CPU seconds", ylim=(0, None if name == "frechet_m" else 1.02))
            quiet(ax)
        axes[0].axhline(0.25, color=INK, linewidth=0.6, linestyle=":")
        _legend_below(figure, axes[0])
    return Picture(
        f"curves_{environment}_{style}",
        f"Learning curves, {style.replace('_', ' ')} in the {environment}",
        "From demonstrated starts: the median deviation-aware Frechet distance (dotted: the bar, which means nothing "
        "where rollouts leave their demonstration early), the share of rollouts that follow one to the goal (arrived, "
        " f at most 0.25 m, t* at least 0.8), success; then success in unseen selection scenes. Thin: each "
        "seed, with averaged weights; thick: their mean. "
        "Seconds of one core, the measuring at every point included.",
        figure,
        rows,
    )

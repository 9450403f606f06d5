"""Figures of chapter 2: paths, measures and success of every controller, speed profiles, learning curves."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from desirepath.demonstrations.judging import KINDS, PROFILE_POINTS
from desirepath.explain.pictures import Rows, quiet
from desirepath.explain.scene_plots import DATA, INK, draw_person, draw_solids
from desirepath.simulation.demonstration_scenes import demonstration_scenes
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath_experiments.reproduction.demonstrations.chapter import DEMONSTRATED, MEASURES, NAMES, SHOWN, rollouts_of
from desirepath_experiments.reproduction.demonstrations.plan import (
    CONTROLLERS,
    OURS,
    VARIANTS,
    WITHOUT,
    DemonstrationsPlan,
)
from desirepath_experiments.reproduction.figures import Drawn, curve, draw_lines, grouped_bars, legend_below, panels
from desirepath_experiments.reproduction.tasks import Load

COLOURS = {DEMONSTRATED: DATA[4], OURS: DATA[0], "social_cost": DATA[2], "dwa": DATA[1]}
CURVES = {
    "frechet_m": "Frechet distance f(t*) (m)",
    "followed_rate": "rollouts that follow",
    "success_rate": "success, demonstrated starts",
    "unseen_success_rate": "success, unseen scenes",
}
RATES = ("success_rate", "collision_rate", "timeout_rate", "min_human_distance_m")


def draw(plan: DemonstrationsPlan, load: Load) -> list[Drawn]:
    """All figures of the report, in its order."""
    environments = plan.budget.environments
    of_each = (draw_paths, draw_measures, draw_unseen)
    drawn = [draw_one(plan, load, environment) for environment in environments for draw_one in of_each]
    drawn += [draw_speeds(plan, load, environment) for environment in environments]
    return [*drawn, draw_curves(plan, load, environments[0], plan.budget.ablated)]


def draw_paths(plan: DemonstrationsPlan, load: Load, environment: str) -> Drawn:
    """Figure 2.3 a-d: demonstrations and rollouts from their starts, a colour per position-orientation pair."""
    scenes, styles, per_pair = demonstration_scenes(environment), plan.budget.styles, plan.budget.per_pair
    room = scenes[0].room
    shape = room.width / room.length if room is not None else 1.0
    columns = (*SHOWN, WITHOUT) if plan.budget.controls else SHOWN
    height = len(styles) * (8.8 / len(columns) * shape + 0.35) + 0.3
    rows: Rows = []
    with panels(len(columns), 9.6, height, rows=len(styles)) as (figure, axes):
        for ax, (style, controller) in zip(axes, product(styles, columns), strict=True):
            poses = rollouts_of(plan, load, environment, style, controller)[0]["poses"]
            draw_solids(ax, scenes[0])
            for pair, scene in enumerate(scenes):
                draw_person(ax, scene, DATA[pair])
            paths = draw_lines(ax, list(poses), lambda k: DATA[k // per_pair], linewidth=0.8, alpha=0.8)
            for number, path in enumerate(paths):
                speeds = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1) / CONTROL_DT_S
                rows += [
                    {
                        "style": style,
                        "controller": controller,
                        "pair": number // per_pair,
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
            if style == styles[0]:
                ax.set_title(NAMES[controller].replace(" without", "\nwithout"))
            if controller == columns[0]:
                ax.set_ylabel(style.replace("_", " "))
    return Drawn("paths", f"paths_{environment}", figure, rows, {"environment": environment})


def draw_measures(plan: DemonstrationsPlan, load: Load, environment: str) -> Drawn:
    """Figure 2.3 e-g: path length, distance and area by controller, median and quartiles over rollouts."""
    rows: Rows = []
    for name, controller, style in product(MEASURES, SHOWN, plan.budget.styles):
        pooled = np.concatenate([of[name] for of in rollouts_of(plan, load, environment, style, controller)])
        low, middle, high = np.quantile(pooled, [0.25, 0.5, 0.75]).tolist()
        about = {"measure": name, "style": style, "controller": controller, "rollouts": len(pooled)}
        rows.append({**about, "lower_quartile": low, "median": middle, "upper_quartile": high})
    series = {controller: (NAMES[controller], COLOURS[controller]) for controller in SHOWN}
    values = ("median", "lower_quartile", "upper_quartile")
    with panels(len(MEASURES), 9.6, 2.9) as (figure, axes):
        for ax, (name, words) in zip(axes, MEASURES.items(), strict=True):
            of_measure = [row for row in rows if row["measure"] == name]
            grouped_bars(ax, of_measure, place="style", series=series, of="controller", values=values)
            ax.set_title(words)
        legend_below(figure, axes[0], fontsize=7)
    return Drawn("measures", f"measures_{environment}", figure, rows, {"environment": environment})


def draw_unseen(plan: DemonstrationsPlan, load: Load, environment: str) -> Drawn:
    """What figure 2.5 b-d shows in examples, counted: success where nothing was demonstrated."""
    rows: Rows = []
    for kind, controller, style in product(KINDS, CONTROLLERS, plan.budget.styles):
        cells = plan.cells(environment, style, controller)
        of_cells = [load(plan.unseen[cell]).meta["unseen"][kind] for cell in cells]
        seeds = [of_cell["success_rate"] for of_cell in of_cells]
        about = {
            "drawn": kind,
            "style": style,
            "controller": controller,
            "scenes": sum(of_cell["n"] for of_cell in of_cells),
        }
        rates = {name: float(np.mean([of_cell[name] for of_cell in of_cells])) for name in RATES}
        rows.append({**about, **rates, "worst_seed": min(seeds), "best_seed": max(seeds)})
    series = {controller: (NAMES[controller], COLOURS[controller]) for controller in CONTROLLERS}
    values = ("success_rate", "worst_seed", "best_seed")
    with panels(len(KINDS), 9.6, 2.6) as (figure, axes):
        for ax, kind in zip(axes, KINDS, strict=True):
            of_kind = [row for row in rows if row["drawn"] == kind]
            grouped_bars(ax, of_kind, place="style", series=series, of="controller", values=values, fontsize=6)
            ax.axhline(0.9, color=INK, linewidth=0.6, linestyle=":")
            ax.set(title=f"random {kind}" if kind != "anywhere" else "everything random", ylim=(0, 1.02))
        axes[0].set_ylabel("success rate")
        legend_below(figure, axes[0], fontsize=7)
    return Drawn("unseen", f"unseen_{environment}", figure, rows, {"environment": environment})


def draw_speeds(plan: DemonstrationsPlan, load: Load, environment: str) -> Drawn:
    """Figure 2.5a: the speeds demonstrated near the person, and those executed."""
    per_pair, styles = plan.budget.per_pair, plan.budget.styles
    style = "slow_near_person" if "slow_near_person" in styles else styles[0]
    share = np.linspace(0, 1, PROFILE_POINTS)
    rows: Rows = []
    with panels(4, 9.6, 2.2) as (figure, axes):
        for pair, ax in enumerate(axes):
            for whose, controller in (("demonstrated", DEMONSTRATED), ("driven", OURS)):
                speeds = rollouts_of(plan, load, environment, style, controller)[0]["speeds"]
                for number, profile in enumerate(speeds[pair * per_pair : (pair + 1) * per_pair]):
                    curve(ax, share, profile, colour=COLOURS[controller], linewidth=0.8, alpha=0.8)
                    about = {"pair": pair, "whose": whose, "rollout": number}
                    rows += [
                        {**about, "share": round(float(s), 4), "speed_m_s": float(v)}
                        for s, v in zip(share, profile, strict=True)
                    ]
            top = get_setup(environment).robot.limits.v_max * 1.15
            ax.set(title=f"pair {pair + 1}", xlabel="share of the path", ylim=(0, top))
            quiet(ax)
        axes[0].set_ylabel("speed (m/s)")
        lines = [Line2D([], [], color=COLOURS[name], label=NAMES[name]) for name in (DEMONSTRATED, OURS)]
        figure.legend(handles=lines, frameon=False, fontsize=7, ncols=2, loc="outside lower center")
    return Drawn("speeds", f"speeds_{environment}", figure, rows, {"environment": environment, "style": style})


def draw_curves(plan: DemonstrationsPlan, load: Load, environment: str, style: str) -> Drawn:
    """What a controller can do after how much computing, with and without each part of the training."""
    rows: Rows = []
    variants = [cell.controller for cell in plan.trained if cell[:2] == (environment, style)]
    with panels(len(CURVES), 9.6, 2.5) as (figure, axes):
        for variant in dict.fromkeys(variants):
            colour = DATA[list(VARIANTS).index(variant)]
            histories = [load(plan.trained[cell]).meta["curve"] for cell in plan.cells(environment, style, variant)]
            averaged: list[list[dict[str, Any]]] = [[p for p in curve if p["averaged"]] for curve in histories]
            seconds = np.array([[point["cpu_s"] for point in curve] for curve in averaged])
            for ax, name in zip(axes, CURVES, strict=True):
                values = np.array([[point[name] for point in curve] for curve in averaged])
                curve(ax, seconds.T, values.T, colour=colour, linewidth=0.5, alpha=0.5)
                thick: dict[str, Any] = {"markersize": 3, "linewidth": 1.3, "label": NAMES[variant], "marker": "."}
                curve(ax, seconds.mean(axis=0), values.mean(axis=0), colour=colour, **thick)
            rows += [
                {"variant": variant, "seed": seed, "cpu_s": p["cpu_s"], "updates": p["updates"]}
                | {name: p[name] for name in CURVES}
                for seed, points in zip(plan.budget.seeds, averaged, strict=True)
                for p in points
            ]
        for ax, (name, words) in zip(axes, CURVES.items(), strict=True):
            ax.set(title=words, xlabel="CPU seconds", ylim=(0, None if name == "frechet_m" else 1.02))
            quiet(ax)
        axes[0].axhline(0.25, color=INK, linewidth=0.6, linestyle=":")
        legend_below(figure, axes[0], fontsize=7)
    about = {"environment": environment, "style": style}
    return Drawn("curves", f"curves_{environment}_{style}", figure, rows, about)

"""Figures of chapter 5: rollouts over the edges of the preference triangle, and what they measure."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from desirepath.explain.pictures import Rows, quiet
from desirepath.explain.scene_plots import DATA, INK, draw_person, draw_solids
from desirepath.learning.adaptable.objectives import EDGES, NAMES, thesis_vectors
from desirepath.simulation.scene import Scene
from desirepath_experiments.reproduction.adaptable.plan import OURS, AdaptablePlan
from desirepath_experiments.reproduction.figures import Drawn, curve, draw_lines, panels
from desirepath_experiments.reproduction.tasks import Load, TaskResult

COLOURS = dict(zip(NAMES, (DATA[1], DATA[2], DATA[4]), strict=True))
MEASURED = {
    "time_s": "navigation time (s)",
    "frechet_m": "Frechet distance to the demonstration (m)",
    "obstacle_m": "least distance to an obstacle (m)",
    "human_m": "least distance to the person (m)",
}
PER_EDGE = 11


def draw(plan: AdaptablePlan, load: Load) -> list[Drawn]:
    """All figures of the report: rollouts of the first seed of ours, measures of all seeds."""
    result = load(plan.judged[OURS, plan.budget.seeds[0]])
    runs = [load(task).arrays for (variant, _), task in plan.judged.items() if variant == OURS]
    return [*(draw_edges(result, kind) for kind in ("static", "walking", "intersection")), draw_measures(runs)]


def draw_edges(result: TaskResult, kind: str) -> Drawn:
    """Figure 5.3: rollouts over the three edges of the preference triangle, in scenes of one kind."""
    scenes = [Scene.from_dict(stored) for stored in result.meta[kind]["shown"]]
    paths = result.arrays[f"{kind}_path"].reshape(len(thesis_vectors()), len(scenes), -1, 2)
    ways: Any = result.arrays["way"] if kind == "static" else ()
    shares = [step / (PER_EDGE - 1) for step in range(PER_EDGE)]
    rows: Rows = []
    with panels(len(scenes), 3.4 * len(scenes), 8.6, rows=len(EDGES)) as (figure, axes):
        for number, ax in enumerate(axes):
            edge, shown = number // len(scenes), number % len(scenes)
            rising, falling = (NAMES[k] for k in EDGES[edge])
            colours = LinearSegmentedColormap.from_list("edge", [COLOURS[falling], COLOURS[rising]])(shares)
            scene, of_edge = scenes[shown], paths[edge * PER_EDGE :][:PER_EDGE, shown]
            draw_solids(ax, scene)
            draw_person(ax, scene)
            if shown < len(ways):
                ax.plot(*ways[shown].T, color=INK, linewidth=1.0, linestyle=":", zorder=4)
            drawn = draw_lines(ax, list(of_edge), colours.__getitem__, linewidth=0.9)
            about = {"from": falling, "to": rising}
            rows += [
                {**about, "share": share, "scene": scene.seed, "x_m": float(x), "y_m": float(y)}
                for share, path in zip(shares, drawn, strict=True)
                for x, y in path
            ]
            ax.plot(scene.start.x, scene.start.y, "o", color=INK, markersize=3, zorder=7)
            ax.plot(scene.goal.x, scene.goal.y, "*", color=INK, markersize=6, zorder=7)
            ax.set(title=f"{falling} to {rising}", aspect="equal")
            ax.autoscale_view()
    return Drawn("edges", f"edges_{kind}", figure, rows, {"kind": kind, "colours": COLOURS})


def draw_measures(runs: list[dict[str, NDArray[Any]]]) -> Drawn:
    """Figure 5.4: time, Frechet, obstacle and human distance against the vector; a band over seeds."""
    rows: Rows = []
    with panels(2, 7.2, 5.4, rows=2) as (figure, axes):
        for ax, (measure, title) in zip(axes, MEASURED.items(), strict=True):
            means = np.array([_means(arrays, measure) for arrays in runs])
            low, middle, high = means.min(axis=0), means.mean(axis=0), means.max(axis=0)
            for edge in range(len(EDGES)):
                at = np.arange(edge * PER_EDGE, (edge + 1) * PER_EDGE)
                curve(ax, at, middle[at], colour=DATA[0], band=(low[at], high[at]), linewidth=1.2)
            for k, vector in enumerate(thesis_vectors().tolist()):
                interval = {"mean": float(middle[k]), "least": float(low[k]), "most": float(high[k])}
                rows.append({"measure": measure, **dict(zip(NAMES, vector, strict=True)), **interval})
            names = [f"{NAMES[falling]}\nto {NAMES[rising]}" for rising, falling in EDGES]
            ax.set_ylabel(title)
            ax.set_xticks([5, 16, 27], names, fontsize=6)
            quiet(ax)
    return Drawn("measures", "measures", figure, rows)


def _means(arrays: dict[str, NDArray[Any]], measure: str) -> NDArray[Any]:
    arrived = arrays["static_outcome"] == 1
    with np.errstate(invalid="ignore"):
        means: NDArray[Any] = np.where(arrived, arrays[f"static_{measure}"], 0).sum(1) / arrived.sum(1)
    return means

"""Chapter 5 in pictures, each beside a CSV with exactly what is drawn.

Importing this loads matplotlib, which is slow.
"""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from desirepath.explain.pictures import Picture, Rows, blank, quiet
from desirepath.explain.scene_plots import DATA, INK, STYLE, draw_person, draw_solids
from desirepath.learning.adaptable.objectives import EDGES, NAMES, thesis_vectors
from desirepath.simulation.scene import Scene
from desirepath_experiments.reproduction.adaptable.plan import OURS, AdaptablePlan
from desirepath_experiments.reproduction.adaptable.results import Load

COLOURS = dict(zip(NAMES, (DATA[1], DATA[2], DATA[4]), strict=True))
MEASURED = {
    "time_s": "navigation time (s)",
    "frechet_m": "Frechet distance to the demonstration (m)",
    "obstacle_m": "least distance to an obstacle (m)",
    "human_m": "least distance to the person (m)",
}
PER_EDGE = 11


def pictures(plan: AdaptablePlan, load: Load) -> list[Picture]:
    """All figures of the report, in its order: of the first seed of ours."""
    made = load(plan.judged[OURS, plan.budget.seeds[0]].key)
    kinds = ("static", "walking", "intersection")
    return [*(edges_picture(made.meta, made.arrays, kind) for kind in kinds), measures_picture(plan, load)]


def edges_picture(meta: dict[str, Any], arrays: dict[str, NDArray[Any]], kind: str) -> Picture:
    """Figure 5.3: rollouts over the three edges of the preference triangle, in scenes of one kind."""
    scenes = [Scene.from_dict(one) for one in meta[kind]["shown"]]
    paths = arrays[f"{kind}_path"].reshape(len(thesis_vectors()), len(scenes), -1, 2)
    rows: Rows = []
    with mpl.rc_context(STYLE):
        figure, axes = blank(len(scenes), 3.4 * len(scenes), 8.6, rows=len(EDGES))
        for number, ax in enumerate(axes):
            edge, shown = number // len(scenes), number % len(scenes)
            rising, falling = (NAMES[k] for k in EDGES[edge])
            colours = LinearSegmentedColormap.from_list("edge", [COLOURS[falling], COLOURS[rising]])
            scene = scenes[shown]
            draw_solids(ax, scene)
            draw_person(ax, scene)
            if kind == "static" and shown < len(arrays["way"]):
                ax.plot(*arrays["way"][shown].T, color=INK, linewidth=1.0, linestyle=":", zorder=4)
            for step in range(PER_EDGE):
                path = paths[edge * PER_EDGE + step, shown]
                path = path[np.isfinite(path[:, 0])]
                ax.plot(*path.T, color=colours(step / (PER_EDGE - 1)), linewidth=0.9, zorder=5)
                rows += [
                    {
                        "from": falling,
                        "to": rising,
                        "share": step / (PER_EDGE - 1),
                        "scene": scene.seed,
                        "x_m": float(x),
                        "y_m": float(y),
                    }
                    for x, y in path
                ]
            ax.plot(scene.start.x, scene.start.y, "o", color=INK, markersize=3, zorder=7)
            ax.plot(scene.goal.x, scene.goal.y, "*", color=INK, markersize=6, zorder=7)
            ax.set_title(f"{falling} to {rising}")
            ax.set_aspect("equal")
            ax.autoscale_view()
    caption = (
        "Rollouts under eleven preferences along each edge of the triangle, the third weight 0; colours go from "
        f"{', '.join(f'{name} {COLOURS[name]}' for name in NAMES)}. Dot: start, star: goal, dotted: the demonstration."
    )
    return Picture(f"edges_{kind}", f"Rollouts over the edges, {kind}", caption, figure, rows)


def measures_picture(plan: AdaptablePlan, load: Load) -> Picture:
    """Figure 5.4: time, Frechet, obstacle and human distance against the vector; a band over seeds."""
    vectors, rows = thesis_vectors(), Rows()
    runs = [load(task.key).arrays for (variant, _), task in plan.judged.items() if variant == OURS]
    with mpl.rc_context(STYLE):
        figure, axes = blank(2, 7.2, 5.4, rows=2)
        for ax, (measure, title) in zip(axes, MEASURED.items(), strict=True):
            means = np.array([_means(arrays, measure) for arrays in runs])
            for edge in range(len(EDGES)):
                at = np.arange(edge * PER_EDGE, (edge + 1) * PER_EDGE)
                ax.plot(at, means[:, at].mean(axis=0), color=DATA[0], linewidth=1.2)
                ax.fill_between(at, means[:, at].min(axis=0), means[:, at].max(axis=0), color=DATA[0], alpha=0.2)
            for k, vector in enumerate(vectors):
                of = {name: float(weight) for name, weight in zip(NAMES, vector, strict=True)}
                low, middle, high = means[:, k].min(), means[:, k].mean(), means[:, k].max()
                rows.append({"measure": measure, **of, "mean": float(middle), "least": float(low), "most": float(high)})
            ax.set_ylabel(title)
            ax.set_xticks(
                [5, 16, 27], [f"{NAMES[falling]}\nto {NAMES[rising]}" for rising, falling in EDGES], fontsize=6
            )
            quiet(ax)
    caption = "Means over the rollouts that arrived, along the three edges; the band spans the seeds."
    return Picture("measures", "Measures against the preference", caption, figure, rows)


def _means(arrays: dict[str, NDArray[Any]], measure: str) -> NDArray[Any]:
    arrived = arrays["static_outcome"] == 1
    with np.errstate(invalid="ignore"):
        found: NDArray[Any] = np.where(arrived, arrays[f"static_{measure}"], 0).sum(1) / arrived.sum(1)
    return found

"""Figures for papers with matplotlib: flow fields, two of them with their difference, rollouts from several starts.

Numbers come from `flow_field.py`; texts can be given in any language. Importing this loads matplotlib, which is slow:
import it where a figure is drawn. No pyplot, so nothing is kept between figures.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize, SymLogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from desirepath.explain.flow_field import FlowDifference, FlowField, grid_of
from desirepath.explain.flow_words import ENGLISH, Words
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import walls_of
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory

Extent = tuple[float, float, float, float]
"""left, right, bottom, top in metres."""

# tokens.css, light scheme: paper is white-ish in print and on the page
INK, SOFT, LINE, PAPER = "#211f1a", "#575247", "#d9d1c0", "#fffdf8"
SOLID, PERSON = "#b9ae97", "#8c7a1e"
DATA = ("#2f6a3d", "#b5541c", "#3b5f9e", "#8a5a9b", "#8c7a1e")
FIRST, SECOND = DATA[2], DATA[1]  # the colours of the two robots on the stage
MANY = LinearSegmentedColormap.from_list("many", [PAPER, "#dfeadb", "#a5cba5", "#6aa874"])
APART = LinearSegmentedColormap.from_list("apart", [PAPER, "#d9c4e0", DATA[3]])
MORE = LinearSegmentedColormap.from_list("more", [FIRST, "#c9d3e6", PAPER, "#eed3c1", SECOND])

PANEL_IN = 3.4  # width of one scene: two fit a page of text
DOTS_PER_INCH = 200
STREAM_GAP_M = 0.5  # ours: about this far between streamlines
THINNEST, THICKEST = 0.3, 1.2  # points, for 0 m/s and the setup's fastest
MARGIN_M = 0.25  # around trajectories that leave the grid
ALIKE_DRIVES = 10  # differences of fewer traversals are drawn linearly, larger ones by their logarithm
STYLE: Any = {  # matplotlib's own type is a literal of all its settings
    "font.size": 8,
    "axes.titlesize": 9,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": SOFT,
    "text.color": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "svg.fonttype": "path",  # looks alike wherever it is opened
    "svg.hashsalt": "desirepath",  # the same figure, the same bytes
}


def flow_figure(field: FlowField, *, title: str, words: Words = ENGLISH) -> Figure:
    """One policy in one scene: streamlines of its settled headings, thick where fast, over the heat map of rollouts."""
    with mpl.rc_context(STYLE):
        figure, axes = _panels(field.grid.extent, 1, 1, legend_lines=2)
        axes[0].set_title(title)
        image = _flow(axes[0], field, _counts(field))
        _bar(figure, image, axes[0], words.traversals)
        _frame(axes, field.scene, field.grid.extent, words, columns=1)
        _legend(figure, words, field.scene)
    return figure


def pair_figure(apart: FlowDifference, *, titles: tuple[str, str], words: Words = ENGLISH) -> Figure:
    """Two policies in one scene above; below the angle between their headings and the difference of their rollouts."""
    with mpl.rc_context(STYLE):
        scene, extent = apart.first.scene, apart.first.grid.extent
        figure, axes = _panels(extent, 2, 2, legend_lines=1)
        counts = _counts(apart.first, apart.second)
        for ax, field, title in zip(axes[:2], (apart.first, apart.second), titles, strict=True):
            ax.set_title(title)
            image = _flow(ax, field, counts)
            _bar(figure, image, ax, words.traversals)
        angle = _image(axes[2], np.abs(apart.heading), extent, APART, Normalize(0, math.pi))
        _bar(figure, angle, axes[2], words.heading_difference)
        for field, colour in ((apart.first, FIRST), (apart.second, SECOND)):
            _headings(axes[2], field, colour)
        axes[2].set_title(words.arrows)
        most = max(ALIKE_DRIVES, int(np.abs(apart.traversals).max(initial=0)))
        more = np.where(apart.first.free, apart.traversals, np.nan)
        image = _image(axes[3], more, extent, MORE, SymLogNorm(ALIKE_DRIVES, vmin=-most, vmax=most, base=10))
        _bar(figure, image, axes[3], words.traversals_difference)
        _frame(axes, scene, extent, words, columns=2)
        _legend(figure, words, scene)
    return figure


def starts_figure(rollouts: Mapping[str, Sequence[Trajectory]], *, title: str, words: Words = ENGLISH) -> Figure:
    """Several policies from the same starts in one scene, one colour each; a cross where one did not arrive.

    rollouts: trajectories per policy, all in one scene but for the start. Raises ValueError for none.
    """
    every = [trajectory for trajectories in rollouts.values() for trajectory in trajectories]
    if not every:
        raise ValueError("rollouts: none given")
    scene = every[0].scene
    extent = _around(grid_of(scene).extent, every)
    with mpl.rc_context(STYLE):
        figure, axes = _panels(extent, 1, 1, legend_lines=max(3, len(rollouts)))
        ax = axes[0]
        ax.set_title(title)
        lines = []
        for number, (name, trajectories) in enumerate(rollouts.items()):
            colour = DATA[number % len(DATA)]
            dashes: Literal["-", "--"] = "--" if number // len(DATA) % 2 else "-"  # more policies than colours
            paths = [trajectory.poses[:, :2] for trajectory in trajectories]
            ax.add_collection(LineCollection(paths, colors=colour, linewidths=1.2, linestyles=[dashes], zorder=4))
            lines.append(Line2D([], [], color=colour, linestyle=dashes, linewidth=1.6, label=name))
            lost = [
                path[-1] for path, driven in zip(paths, trajectories, strict=True) if driven.outcome != Outcome.SUCCESS
            ]
            if lost:
                x, y = np.array(lost).T
                ax.scatter(x, y, marker="x", color=colour, s=22, linewidths=1.2, zorder=5)
        for start in {driven.scene.start for driven in every} - {scene.start}:
            ax.add_patch(Circle((start.x, start.y), 0.06, facecolor=PAPER, edgecolor=INK, linewidth=0.8, zorder=6))
        _frame(axes, scene, extent, words, columns=1)
        _legend(figure, words, None, lines)
    return figure


def _around(extent: Extent, trajectories: Sequence[Trajectory]) -> Extent:
    """The extent (m), wider where a trajectory leaves it: in an open field nothing holds a robot back."""
    places = np.concatenate([trajectory.poses[:, :2] for trajectory in trajectories])
    low, high = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
    left, right, bottom, top = extent
    return min(left, float(low[0])), max(right, float(high[0])), min(bottom, float(low[1])), max(top, float(high[1]))


def encode_figure(figure: Figure, form: Literal["png", "svg"], about: str) -> bytes:
    """The figure as a file that says in its metadata what it is about; the same figure always gives the same bytes."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        # No date and no program, so that a figure made again is the same file.
        unsaid = {"Date": None, "Creator": None} if form == "svg" else {"Software": None}
        metadata = {"Description": about, **unsaid}
        figure.savefig(
            out,
            format=form,
            dpi=DOTS_PER_INCH,
            facecolor=PAPER,
            metadata=metadata,
            bbox_inches="tight",
            pad_inches=0.06,
        )
    return out.getvalue()


def _panels(extent: Extent, rows: int, columns: int, *, legend_lines: int) -> tuple[Figure, list[Axes]]:
    left, right, bottom, top = extent
    height = PANEL_IN * (top - bottom) / (right - left)
    figure = Figure(
        figsize=(columns * (PANEL_IN + 0.9), rows * (height + 0.45) + 0.25 + 0.2 * legend_lines), layout="constrained"
    )
    FigureCanvasAgg(figure)
    return figure, list(np.ravel(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)))


def _counts(*fields: FlowField) -> LogNorm:
    """One scale for all fields, so that equal shades mean equal numbers."""
    return LogNorm(1, max(2, *(int(field.traversals.max(initial=0)) for field in fields)))


def _image(ax: Axes, values: NDArray[np.floating], extent: Extent, colours: Colormap, norm: Normalize) -> AxesImage:
    return ax.imshow(
        np.ma.masked_invalid(values),
        extent=extent,
        origin="lower",
        cmap=colours,
        norm=norm,
        interpolation="nearest",
        zorder=0,
    )


def _flow(ax: Axes, field: FlowField, norm: LogNorm) -> AxesImage:
    entered = np.where(field.traversals > 0, field.traversals.astype(float), np.nan)
    image = _image(ax, entered, field.grid.extent, MANY, norm)
    along_x, along_y = (np.ma.masked_invalid(part) for part in field.velocity())
    if along_x.count() > 0 and min(field.grid.shape) > 1:
        fastest = get_setup(field.scene.setup).robot.limits.v_max
        width = THINNEST + (THICKEST - THINNEST) * np.nan_to_num(field.speed) / fastest
        left, right, bottom, top = field.grid.extent
        ax.streamplot(
            field.grid.xs,
            field.grid.ys,
            along_x,
            along_y,
            # matplotlib draws about 30 streamlines across for a density of 1
            density=((right - left) / STREAM_GAP_M / 30 * 2, (top - bottom) / STREAM_GAP_M / 30 * 2),
            color=INK,
            linewidth=width,
            arrowsize=0.6,
            zorder=2,
        )
    return image


def _headings(ax: Axes, field: FlowField, colour: str) -> None:
    """An arrow of equal length in every second cell."""
    every = slice(None, None, 2)
    known = np.isfinite(field.heading[every, every])
    x, y = np.meshgrid(field.grid.xs[every], field.grid.ys[every])
    heading = field.heading[every, every][known]
    ax.quiver(
        x[known],
        y[known],
        np.cos(heading),
        np.sin(heading),
        color=colour,
        angles="xy",
        scale_units="xy",
        scale=1 / (1.6 * field.grid.cell_m),
        width=0.0035,
        headwidth=4,
        zorder=3,
    )


def _bar(figure: Figure, image: AxesImage, ax: Axes, label: str) -> None:
    bar = figure.colorbar(image, ax=ax, shrink=0.7, pad=0.02, aspect=28)
    bar.set_label(label)
    bar.formatter = StrMethodFormatter("{x:g}")
    bar.minorformatter = NullFormatter()
    bar.outline.set_linewidth(0.5)


def _frame(axes: Sequence[Axes], scene: Scene, extent: Extent, words: Words, *, columns: int) -> None:
    """The scene's outlines, equal scales, and labels at the outer axes."""
    for number, ax in enumerate(axes):
        draw_solids(ax, scene)
        draw_person(ax, scene)
        goal = (scene.goal.x, scene.goal.y)
        ax.add_patch(Circle(goal, scene.goal_radius, fill=False, edgecolor=INK, linewidth=1.3, zorder=6))
        ax.plot(*goal, marker="x", color=INK, markersize=4, zorder=6)
        start = scene.start
        ax.add_patch(
            Circle(
                (start.x, start.y), get_setup(scene.setup).robot.radius_m * 0.6, facecolor=INK, linewidth=0, zorder=6
            )
        )
        reach = 0.4
        ax.plot(
            [start.x, start.x + reach * math.cos(start.yaw)],
            [start.y, start.y + reach * math.sin(start.yaw)],
            color=INK,
            linewidth=1.4,
            zorder=6,
        )
        ax.set(xlim=extent[:2], ylim=extent[2:], aspect="equal")
        if number >= len(axes) - columns:
            ax.set_xlabel(words.x)
        if number % columns == 0:
            ax.set_ylabel(words.y)


def draw_solids(ax: Axes, scene: Scene) -> None:
    """Obstacles, what a map has, and the room's outline."""
    bodies = [Polygon(solid.corners()) for solid in scene.obstacles]
    bodies += [Polygon([(x1, y1), (x2, y1), (x2, y2), (x1, y2)]) for x1, y1, x2, y2 in walls_of(scene)]
    ax.add_collection(PatchCollection(bodies, facecolor=SOLID, edgecolor=INK, linewidth=0.7, zorder=3))
    if scene.room is not None:
        x, y = scene.room.length / 2, scene.room.width / 2
        outline = Polygon([(-x, -y), (x, -y), (x, y), (-x, y)], fill=False, edgecolor=INK, linewidth=1.6, zorder=3)
        outline.set_clip_on(False)
        ax.add_patch(outline)


def draw_person(ax: Axes, scene: Scene, colour: str = PERSON) -> None:
    """The person from above, with a nose where they look; nothing where none was recorded."""
    if not scene.has_person:
        return
    pose, radius = scene.person.pose, scene.person.radius
    nose = [
        (pose.x + reach * math.cos(pose.yaw + turn), pose.y + reach * math.sin(pose.yaw + turn))
        for reach, turn in ((radius, 0.6), (1.75 * radius, 0.0), (radius, -0.6))
    ]
    for patch in (Polygon(nose), Circle((pose.x, pose.y), radius)):
        patch.set(facecolor=colour, edgecolor=PAPER, linewidth=0.6, zorder=6)
        ax.add_patch(patch)


def _legend(figure: Figure, words: Words, flowing: Scene | None, lines: Sequence[Line2D] = ()) -> None:
    """What the marks mean; `flowing` where streamlines are drawn, `lines` for trajectories."""
    marks = [
        Line2D([], [], linestyle="none", marker="o", color=INK, markersize=4, label=words.start),
        Line2D([], [], linestyle="none", marker="o", color=INK, markersize=6, fillstyle="none", label=words.goal),
        Line2D([], [], linestyle="none", marker="o", color=PERSON, markersize=6, label=words.person),
    ]
    if flowing is not None:
        fastest = get_setup(flowing.setup).robot.limits.v_max
        marks.append(Line2D([], [], color=INK, linewidth=THICKEST, label=words.streams.format(fastest=f"{fastest:g}")))
    columns = 2 if lines or figure.get_figwidth() < 1.5 * PANEL_IN else 4
    handles = [*marks, *lines]
    if lines:  # marks left, trajectories right
        longest = max(len(marks), len(lines))
        empty = [Line2D([], [], linestyle="none", label=" ") for _ in range(longest - len(marks))]
        handles = [*marks, *empty, *lines]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, handletextpad=0.5)

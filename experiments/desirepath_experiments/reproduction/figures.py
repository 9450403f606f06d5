"""The kinds of figure that chapters share: grouped bars, curves with bands, paths over a scene, heat maps, dots.

Which numbers, names and sizes is the chapters'. Importing this loads matplotlib, which is slow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from desirepath.explain.pictures import Picture, Rows, blank, quiet
from desirepath.explain.scene_plots import INK, PAPER, STYLE

BAR_WIDTH = 0.8  # of all bars of one place together


@dataclass(frozen=True)
class Drawn:
    """A figure with its data. kind: under which the report has its title and caption, filled in with `about`."""

    kind: str
    name: str
    figure: Figure
    rows: Rows
    about: Mapping[str, Any] = field(default_factory=dict)

    def picture(self, title: str, caption: str) -> Picture:
        return Picture(self.name, title, caption, self.figure, self.rows)

    def save_alone(self, folder: Path) -> Path:
        """As PNG, where there are no rows: what is drawn are pictures."""
        folder.mkdir(parents=True, exist_ok=True)
        self.figure.savefig(folder / f"{self.name}.png", dpi=110)
        return folder / f"{self.name}.png"


@contextmanager
def panels(columns: int, width: float, height: float, *, rows: int = 1) -> Iterator[tuple[Figure, list[Axes]]]:
    """An empty figure (inches) in the style of all reports; its axes row by row."""
    with mpl.rc_context(STYLE):
        yield blank(columns, width, height, rows=rows)


def legend_below(figure: Figure, ax: Axes, columns: int | None = None, **style: Any) -> None:
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=columns or len(labels), loc="outside lower center", **style)


def grouped_bars(
    ax: Axes,
    rows: Sequence[Mapping[str, Any]],
    *,
    place: str,
    series: Mapping[str, tuple[str, str]],
    of: str,
    values: tuple[str, str, str],
    **ticks: Any,
) -> None:
    """A bar per row: `place` and `of` are columns, series: of the latter, label and colour. values: columns of the
    bar's height and of the ends of the line on it."""
    places = list(dict.fromkeys(row[place] for row in rows))
    width = BAR_WIDTH / len(series)
    for k, (name, (label, colour)) in enumerate(series.items()):
        height, low, high = (
            np.array([row[column] for row in rows if row[of] == name], dtype=float) for column in values
        )
        at = np.arange(len(places)) + (k - (len(series) - 1) / 2) * width
        ax.bar(at, height, width * 0.92, color=colour, label=label)
        # a mean of equal numbers may lie beyond them by a rounding
        ends = np.maximum([height - low, high - height], 0)
        ax.errorbar(at, height, ends, fmt="none", ecolor=INK, elinewidth=0.7)
    ax.set_xticks(range(len(places)), [name.replace("_", "\n") for name in places], **ticks)
    quiet(ax)


def curve(
    ax: Axes, x: ArrayLike, y: ArrayLike, *, colour: str, band: tuple[ArrayLike, ArrayLike] | None = None,
    shade: float = 0.2, **style: Any,
) -> None:  # fmt: skip
    """A line, and a band from low to high."""
    ax.plot(x, y, color=colour, **style)
    if band is not None:
        ax.fill_between(np.asarray(x), np.asarray(band[0]), np.asarray(band[1]), color=colour, alpha=shade, linewidth=0)


def draw_lines(
    ax: Axes, paths: Sequence[NDArray[Any]], colour: Callable[[int], Any], **style: Any
) -> list[NDArray[Any]]:
    """Paths (points, at least 2) m over a scene, in the colour of their number; returns them without their NaN."""
    drawn = [path[np.isfinite(path[:, 0])] for path in paths]
    for number, path in enumerate(drawn):
        ax.plot(path[:, 0], path[:, 1], color=colour(number), zorder=5, **style)
    return drawn


def heat_map(
    figure: Figure, ax: Axes, values: NDArray[np.float64], title: str, number_format: str, colours: Colormap
) -> None:
    """values (rows from below, columns), each with its number in it."""
    image = ax.imshow(values, origin="lower", aspect="auto", cmap=colours)
    for (row, column), number in np.ndenumerate(values):
        ax.text(column, row, format(number, number_format), ha="center", va="center", fontsize=7, color=INK)
    ax.set(title=title)
    bar = figure.colorbar(image, ax=ax, pad=0.02, aspect=28)
    bar.outline.set_linewidth(0.5)


def dots(ax: Axes, samples: Sequence[tuple[str, str, Sequence[float], float, float]]) -> None:
    """By name and colour: a dot per value, a bar at their mean, a diamond at what was published."""
    for k, (_, colour, values, mean, published) in enumerate(samples):
        labels = ("one alignment", "mean", "thesis") if k == 0 else (None, None, None)
        spread = np.linspace(-0.18, 0.18, len(values)) if len(values) > 1 else np.zeros(1)
        ax.scatter(k + spread, values, s=14, color=colour, alpha=0.75, linewidths=0, zorder=3, label=labels[0])
        ax.plot([k - 0.3, k + 0.3], [mean] * 2, color=INK, linewidth=1.4, zorder=4, label=labels[1])
        diamond: dict[str, Any] = {
            "marker": "D",
            "s": 20,
            "facecolor": PAPER,
            "edgecolor": INK,
            "linewidths": 0.9,
            "zorder": 5,
        }
        ax.scatter(k, published, label=labels[2], **diamond)
    ax.set_xticks(range(len(samples)), [name for name, *_ in samples])


def picture_rows(name: str, pictures: Mapping[str, NDArray[Any]], range_m: float) -> Drawn:
    """Depth pictures (n, rows, columns) m, a line of them for each title; drawn as PNG alone, which is their data."""
    columns = len(next(iter(pictures.values())))
    figure, places = blank(columns, 1.9 * columns, 4.0, rows=len(pictures))
    for line, (title, frames) in enumerate(pictures.items()):
        for place, frame in zip(places[line * columns :], frames, strict=False):
            place.imshow(frame, vmin=0.0, vmax=range_m, cmap="viridis")
            place.set(xticks=[], yticks=[])
        places[line * columns].set_ylabel(title)
    return Drawn(name, name, figure, [])

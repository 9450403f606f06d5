"""A figure with its data, kept as PNG, SVG and CSV, and what charts of any report share. What is drawn lives elsewhere.

Importing this loads matplotlib, which is slow: import it where a figure is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from desirepath.csv_text import csv_text
from desirepath.explain.scene_plots import LINE, encode_figure

Rows = list[dict[str, object]]


@dataclass(frozen=True)
class Picture:
    """A figure with its data. caption: what is seen, in sentences, with units."""

    name: str
    title: str
    caption: str
    figure: Figure
    rows: Rows

    def save(self, folder: Path) -> list[Path]:
        """PNG, SVG and CSV; the paths written."""
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / f"{self.name}.{form}" for form in ("png", "svg", "csv")]
        paths[0].write_bytes(encode_figure(self.figure, "png", self.title))
        paths[1].write_bytes(encode_figure(self.figure, "svg", self.title))
        write_csv(paths[2], self.rows)
        return paths


def write_csv(path: Path, rows: Rows) -> None:
    """All rows have the keys of the first one. Raises ValueError for no rows."""
    if not rows:
        raise ValueError(f"{path.name}: no rows to write")
    names = list(rows[0])
    text = csv_text([names, *([row[name] for name in names] for row in rows)])
    path.write_text(text, newline="\r\n", encoding="utf-8")


def blank(columns: int, width: float, height: float, *, rows: int = 1) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(np.ravel(figure.subplots(rows, columns, squeeze=False)))


def quiet(ax: Axes) -> None:
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color=LINE, linewidth=0.5)
    ax.set_axisbelow(True)

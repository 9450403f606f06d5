"""Figures as SVG from plain numbers: curves, intervals, histograms of differences, rollouts seen from above.

Every figure carries its colours twice: as attributes (a file opened on white paper) and as classes that analyst.css
colours by the page's scheme. Texts are given by the caller; nothing is read from the store here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from html import escape
from textwrap import wrap

import numpy as np
from numpy.typing import ArrayLike, NDArray

from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import walls_of
from desirepath.simulation.trajectory import Trajectory

INK, SOFT, LINE, PAPER = "#211f1a", "#575247", "#d9d1c0", "#fffdf8"
MAIN = "#2f6a3d"  # tokens.css: --data-1
SIDES = ("#3b5f9e", "#b5541c")  # --data-3, --data-2: the colours of the two robots on the stage
PERSON = "#8c7a1e"  # --data-5
DRAWN = ((MAIN, "line-0"), (SIDES[0], "line-1"), ("#8a5a9b", "line-3"))  # --data-1, --data-3, --data-4
LEARNED = (SIDES[1], "line-2")  # --data-2
WALKED = (PERSON, "person-line")  # where the person went, in the person's colour
STANDS_STEPS = 8  # ours: how long moving robots stand at the goal before they begin anew
SCALE = ("#b5541c", "#a56247", "#8f6f69", "#6d7286", "#3b5f9e")  # from least to most; analyst.css: .scale-0 to -4
FONT = "system-ui, sans-serif"

Number = Callable[[float], str]
WriteNumber = Callable[[float, int], str]


@dataclass(frozen=True)
class Interval:
    """One row of `intervals`: a value in [0, 1] with its bounds, and what is said at its end."""

    name: str
    value: float
    low: float
    high: float
    in_words: str


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers from `low` to `high`, roughly `about` of them."""
    if not high > low:
        return [low]
    raw = (high - low) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 10) for k in range(first, math.floor(high / step + 1e-9) + 1)]


def exact(write: WriteNumber) -> Number:
    """`write(value, decimals)` with as many decimals as the value has, up to six digits: nothing small becomes 0."""

    def write_exact(value: float) -> str:
        digits = f"{value:.6g}"
        return digits if "e" in digits else write(value, len(digits.partition(".")[2]))

    return write_exact


class _Drawing:
    """Collects SVG elements; coordinates are pixels of the view box."""

    def __init__(self, width: float, height: float, title: str, *, group: bool = False) -> None:
        """group: parts of it are links, so it is more than one picture."""
        role = "group" if group else "img"
        self._head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" class="plot" viewBox="0 0 {width:g} {height:g}" '
            f'width="{width:g}" height="{height:g}" role="{role}" aria-label="{escape(title)}" font-family="{FONT}" '
            f'font-size="12"><title>{escape(title)}</title>'
        )
        self._parts: list[str] = []
        self.rect(0, 0, width, height, fill=PAPER, css="paper")

    def rect(self, x: float, y: float, w: float, h: float, *, fill: str, css: str, opacity: float = 1.0) -> None:
        faint = "" if opacity == 1.0 else f' fill-opacity="{opacity:.3f}"'
        self._parts.append(
            f'<rect class="{css}" x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill="{fill}"{faint}/>'
        )

    def line(self, x1: float, y1: float, x2: float, y2: float, *, stroke: str, css: str, width: float = 1.0) -> None:
        self._parts.append(
            f'<line class="{css}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{stroke}" '
            f'stroke-width="{width:g}"/>'
        )

    def path(self, points: Sequence[tuple[float, float]], *, stroke: str, css: str, width: float = 2.0) -> None:
        coordinates = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        self._parts.append(
            f'<polyline class="{css}" points="{coordinates}" fill="none" stroke="{stroke}" stroke-width="{width:g}" '
            'stroke-linejoin="round" stroke-linecap="round"/>'
        )

    def polygon(self, points: Sequence[tuple[float, float]], *, fill: str, css: str) -> None:
        coordinates = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        self._parts.append(f'<polygon class="{css}" points="{coordinates}" fill="{fill}"/>')

    def circle(self, x: float, y: float, r: float, *, fill: str, css: str, stroke: str = "none") -> None:
        self._parts.append(
            f'<circle class="{css}" cx="{x:.1f}" cy="{y:.1f}" r="{r:.1f}" fill="{fill}" stroke="{stroke}"/>'
        )

    def moving_circle(
        self, way: Sequence[tuple[float, float]], r: float, *, seconds: float, fill: str, css: str
    ) -> None:
        """A circle that goes along the points, one after the other in equal times, over and over; the style sheet
        hides it (`moving`) from who wants little movement."""
        rounds = f'dur="{seconds:.1f}s" repeatCount="indefinite"'
        moves = "".join(
            f'<animate attributeName="{name}" values="{";".join(f"{point[k]:.1f}" for point in way)}" {rounds}/>'
            for k, name in enumerate(("cx", "cy"))
        )
        self._parts.append(f'<circle class="{css} moving" r="{r}" fill="{fill}">{moves}</circle>')

    def text(
        self, x: float, y: float, words: str, *, anchor: str = "start", fill: str = SOFT, css: str = "soft"
    ) -> None:
        self._parts.append(
            f'<text class="{css}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{fill}">{escape(words)}</text>'
        )

    @contextmanager
    def link_to(self, href: str, words: str) -> Iterator[None]:
        """What is drawn meanwhile leads there."""
        self._parts.append(f'<a href="{escape(href)}" aria-label="{escape(words)}"><title>{escape(words)}</title>')
        yield
        self._parts.append("</a>")

    def svg(self) -> str:
        return self._head + "".join(self._parts) + "</svg>"


def _number(value: float) -> str:
    return f"{value:g}"


def curves(
    lines: Mapping[str, Sequence[tuple[float, float]]],
    *,
    title: str,
    x_label: str,
    y_label: str = "",
    number: Number = _number,
    width: int = 420,
) -> str:
    """Lines through (step, value) points by name; several are named below the figure."""
    below = 22 if len(lines) > 1 else 0
    height, left, right, top, bottom = 210 + below, 56, 28, 26, 40 + below
    drawing = _Drawing(width, height, title)
    points = [point for line in lines.values() for point in line]
    xs, ys = [p[0] for p in points], [p[1] for p in points]
    x_low, x_high = min(xs), max(max(xs), min(xs) + 1)
    y_low, y_high = min(ys), max(ys)
    spare = (y_high - y_low) * 0.08 or abs(y_high) * 0.05 or 0.5
    y_low, y_high = y_low - spare, y_high + spare

    def at(x: float, y: float) -> tuple[float, float]:
        return (
            left + (x - x_low) / (x_high - x_low) * (width - left - right),
            height - bottom - (y - y_low) / (y_high - y_low) * (height - top - bottom),
        )

    drawing.text(6, 14, y_label, anchor="start")
    for tick in ticks(y_low, y_high, 4):
        _, y = at(x_low, tick)
        drawing.line(left, y, width - right, y, stroke=LINE, css="grid")
        drawing.text(left - 6, y + 4, number(tick), anchor="end")
    for tick in ticks(x_low, x_high, 4):
        x, _ = at(tick, y_low)
        drawing.text(x, height - bottom + 16, number(tick), anchor="middle")
    drawing.text((left + width - right) / 2, height - 6 - below, x_label, anchor="middle")
    for k, ((name, line), (colour, css)) in enumerate(zip(lines.items(), DRAWN, strict=False)):
        fill = css.replace("line", "fill")
        drawing.path([at(*point) for point in line], stroke=colour, css=css)
        drawing.circle(*at(*line[-1]), 3.5, fill=colour, css=fill)
        if below:
            x = left + k * (width - left - right) / len(lines)
            drawing.circle(x, height - 10, 4.5, fill=colour, css=fill)
            drawing.text(x + 10, height - 6, name, anchor="start")
    return drawing.svg()


def intervals(rows: Sequence[Interval], *, title: str, x_label: str, chance: float | None = None) -> str:
    """Shares from 0 to 1 with their intervals, one row each; `chance` is a line to compare with."""
    width, left, right, row_height, top, bottom = 640, 130, 130, 26, 10, 44
    height = top + row_height * len(rows) + bottom
    drawing = _Drawing(width, height, title)

    def at(share: float) -> float:
        return left + share * (width - left - right)

    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        css = "chance" if tick == chance else "grid"
        drawing.line(at(tick), top, at(tick), height - bottom, stroke=SOFT if tick == chance else LINE, css=css)
        drawing.text(at(tick), height - bottom + 16, f"{tick:.0%}", anchor="middle")
    drawing.text(at(0.5), height - 6, x_label, anchor="middle")
    for k, row in enumerate(rows):
        y = top + row_height * (k + 0.5)
        drawing.text(left - 10, y + 4, row.name, anchor="end", fill=INK, css="ink")
        drawing.line(at(row.low), y, at(row.high), y, stroke=MAIN, css="line-0", width=2)
        drawing.circle(at(row.value), y, 4.5, fill=MAIN, css="fill-0")
        drawing.text(width - right + 12, y + 4, row.in_words, fill=INK, css="ink")
    return drawing.svg()


@dataclass(frozen=True)
class Panel:
    """One measure of `small_multiples`. link: where its name leads, and what that does; sorted: the rows are by it."""

    name: str
    number: Number
    link: tuple[str, str] | None = None
    sorted: bool = False


@dataclass(frozen=True)
class PanelRow:
    """One row across all panels. values: (value, low, high) for each; words: all about it; link: where it leads;
    hollow: its dots are."""

    name: str
    words: str
    values: Sequence[tuple[float, float, float]]
    link: str | None = None
    hollow: bool = False


ACROSS = 6


def small_multiples(rows: Sequence[PanelRow], panels: Sequence[Panel], *, title: str) -> str:
    """Values with their intervals, a row across all panels, so that one thing is followed from measure to measure;
    ACROSS panels beside each other, then further ones below."""
    left, wide, gap, row_height, foot = 220, 92, 18, 26, 28
    bands = [range(first, min(first + ACROSS, len(panels))) for first in range(0, len(panels), ACROSS)]
    named = [wrap(panel.name, 12, break_long_words=False) for panel in panels]
    heads = [14 * max(len(named[k]) for k in band) + 8 for band in bands]
    height = sum(head + row_height * len(rows) + foot for head in heads)
    linked = any(panel.link for panel in panels) or any(row.link for row in rows)
    drawing = _Drawing(left + (wide + gap) * min(ACROSS, len(panels)), height, title, group=linked)
    top = 0.0
    for band, head in zip(bands, heads, strict=True):
        lows = [min(row.values[k][1] for row in rows) for k in band]
        highs = [max(row.values[k][2] for row in rows) for k in band]
        spare = [(high - low) * 0.06 or abs(high) * 0.05 or 0.5 for low, high in zip(lows, highs, strict=True)]
        bottom = top + head + row_height * len(rows)

        def at(place: int, x: float, lows: Sequence[float] = lows, highs: Sequence[float] = highs) -> float:
            low, high = lows[place] - spare[place], highs[place] + spare[place]  # noqa: B023 - called in this band
            return left + (wide + gap) * place + (x - low) / (high - low) * wide

        for place, k in enumerate(band):
            panel, x = panels[k], left + (wide + gap) * place
            with drawing.link_to(*panel.link) if panel.link else nullcontext():
                if panel.link:
                    drawing.rect(x, top, wide, head - 4, fill="none", css="hit")
                fill, css = (INK, "ink strong") if panel.sorted else (SOFT, "soft")
                for line, words in enumerate(named[k]):
                    drawing.text(x, top + 14 * (line + 1), words, fill=fill, css=css)
            marked = ticks(lows[place], highs[place], 3)
            if len(marked) > 2 and 8 * sum(len(panel.number(tick)) for tick in marked) > wide:
                marked = marked[:: len(marked) - 1]
            for tick in marked:
                drawing.line(at(place, tick), top + head, at(place, tick), bottom, stroke=LINE, css="grid")
                drawing.text(at(place, tick), bottom + 14, panel.number(tick), anchor="middle")
        for k, row in enumerate(rows):
            y = top + head + row_height * (k + 0.5)
            with drawing.link_to(row.link, row.words) if row.link else nullcontext():
                if row.link:
                    drawing.rect(
                        0, y - row_height / 2, left + (wide + gap) * len(band), row_height, fill="none", css="hit"
                    )
                shortened = row.name if len(row.name) <= 33 else f"{row.name[:32]}…"
                drawing.text(6, y + 4, shortened, fill=INK, css="ink")
                for place, one in enumerate(band):
                    value, low, high = row.values[one]
                    drawing.line(at(place, low), y, at(place, high), y, stroke=MAIN, css="line-0", width=2)
                    if row.hollow:
                        drawing.circle(at(place, value), y, 4, fill=PAPER, css="paper line-0", stroke=MAIN)
                    else:
                        drawing.circle(at(place, value), y, 4.5, fill=MAIN, css="fill-0")
        top = bottom + foot
    return drawing.svg()


@dataclass(frozen=True)
class DifferenceBins:
    """Bars of a histogram of differences around zero. edges: (bars + 1,); which: the bar of every value, from 0; what
    lies beyond the last edges is in the last bars."""

    edges: NDArray[np.float64]
    which: NDArray[np.intp]

    @classmethod
    def of(cls, values: ArrayLike, mean: tuple[float, float, float], bars: int = 41) -> DifferenceBins:
        data = np.asarray(values, dtype=float)
        reach = float(np.quantile(np.abs(data), 0.99)) if len(data) else 1.0
        reach = max(reach, *(abs(bound) for bound in mean)) * 1.05 or 1.0
        edges = np.linspace(-reach, reach, bars + 1)
        return cls(edges, np.digitize(data, edges[1:-1]))

    @property
    def counts(self) -> NDArray[np.intp]:
        return np.bincount(self.which, minlength=len(self.edges) - 1)


def differences(
    bars: DifferenceBins,
    *,
    mean: tuple[float, float, float],
    title: str,
    x_label: str,
    y_label: str,
    number: Number = _number,
    link: Callable[[int], tuple[str, str]] | None = None,
) -> str:
    """A histogram of paired differences around zero, with their mean and its interval (mean, low, high) above.

    link: of a bar, the address of what is behind it and its words.
    """
    width, height, left, right, top, bottom = 640, 260, 56, 16, 34, 44
    drawing = _Drawing(width, height, title, group=link is not None)
    counts, edges, reach = bars.counts, bars.edges, float(bars.edges[-1])
    highest = max(1, int(counts.max()))

    def at(x: float) -> float:
        return left + (x + reach) / (2 * reach) * (width - left - right)

    def up(count: float) -> float:
        return height - bottom - count / highest * (height - top - bottom)

    for tick in ticks(0, highest, 4):
        drawing.line(left, up(tick), width - right, up(tick), stroke=LINE, css="grid")
        drawing.text(left - 6, up(tick) + 4, number(tick), anchor="end")
    for bar, (count, first, last) in enumerate(zip(counts, edges[:-1], edges[1:], strict=True)):
        if count:
            middle = (first + last) / 2
            side = int(middle > 0)
            fill, css = (SOFT, "fill-none") if abs(middle) < reach / len(counts) else (SIDES[side], f"fill-{side + 1}")
            x, y = at(first) + 0.5, up(count)
            with drawing.link_to(*link(bar)) if link else nullcontext():
                if link:  # a low bar is hard to hit: the whole column leads there
                    drawing.rect(x, top, at(last) - at(first) - 1, up(0) - top, fill="none", css="hit")
                drawing.rect(x, y, at(last) - at(first) - 1, up(0) - y, fill=fill, css=css)
    drawing.line(at(0), top, at(0), height - bottom, stroke=INK, css="ink-line")
    for tick in ticks(-reach, reach, 6):
        drawing.text(at(tick), height - bottom + 16, number(tick), anchor="middle")
    drawing.line(at(mean[1]), 20, at(mean[2]), 20, stroke=INK, css="ink-line", width=2)
    drawing.circle(at(mean[0]), 20, 4.5, fill=INK, css="ink-fill")
    drawing.text((left + width - right) / 2, height - 6, x_label, anchor="middle")
    drawing.text(left, 12, y_label, anchor="start")
    return drawing.svg()


def shares_by_answer(
    history: Sequence[Mapping[str, float]], *, names: Mapping[str, str], title: str, x_label: str, percent: Number
) -> str:
    """Shares (0 to 1) of things after each answer: a row per thing, a column per answer, a stronger colour is more."""
    left, right, row_height, bottom = 290, 60, 24, 40
    column = min(34.0, 500 / len(history))
    width, height = left + column * len(history) + right, row_height * len(names) + bottom
    drawing = _Drawing(width, height, title)
    for row, (name, words) in enumerate(names.items()):
        y = row * row_height
        drawing.text(left - 8, y + 16, words, anchor="end", fill=INK, css="ink")
        for k, shares in enumerate(history):
            drawing.rect(left + k * column, y + 2, column - 1, row_height - 4, fill=LINE, css="cell")
            drawing.rect(
                left + k * column, y + 2, column - 1, row_height - 4, fill=MAIN, css="fill-0", opacity=shares[name]
            )
        drawing.text(width - right + 8, y + 16, percent(history[-1][name]), fill=INK, css="ink")
    every = max(1, math.ceil(20 / column))
    for k in range(0, len(history), every):
        drawing.text(left + (k + 0.5) * column, height - bottom + 16, str(k + 1), anchor="middle")
    drawing.text(left + column * len(history) / 2, height - 6, x_label, anchor="middle")
    return drawing.svg()


class _Plan:
    """A scene from above with room for a legend below it; `at` turns metres into pixels of `drawing`."""

    def __init__(self, scene: Scene, paths: Sequence[ArrayLike], *, legend_lines: int, title: str) -> None:
        spare = 0.8 if scene.room is None else 0.05
        poses = (scene.start, scene.goal, *((scene.person.pose,) if scene.has_person else ()))
        points = np.concatenate(
            [
                *(np.asarray(path, float)[:, :2] for path in paths),
                [[p.x, p.y] for p in (*poses, *(o.pose for o in scene.obstacles))],
                *([wall.corners() for wall in scene.room.walls()] if scene.room else []),
            ]
        )
        (x_low, y_low), (x_high, y_high) = points.min(0) - spare, points.max(0) + spare
        self._scale = min(600 / (x_high - x_low), 440 / (y_high - y_low))
        self._left, self._top = x_low, y_high
        self._legend_top = (y_high - y_low) * self._scale
        self._lines = 0
        self._width = (x_high - x_low) * self._scale
        self.drawing = _Drawing(self._width, self._legend_top + 22 * legend_lines + 6, title)
        self._add(scene)

    def at(self, x: float, y: float) -> tuple[float, float]:
        return (x - self._left) * self._scale, (self._top - y) * self._scale

    def path(self, points: ArrayLike, *, stroke: str, css: str, width: float) -> tuple[float, float]:
        """Draw a path of points (n, 2 or more) in metres; returns its end in pixels."""
        places = [self.at(float(x), float(y)) for x, y in np.asarray(points)[:, :2]]
        self.drawing.path(places, stroke=stroke, css=css, width=width)
        return places[-1]

    def tell(self, name: str, *, stroke: str, css: str) -> None:
        """A line of the legend."""
        y = self._legend_top + 22 * self._lines + 14
        self._lines += 1
        self.drawing.line(8, y, 30, y, stroke=stroke, css=css, width=3)
        fits = int((self._width - 44) / 6.5)
        shortened = name if len(name) <= fits else f"{name[: fits - 1]}…"
        self.drawing.text(36, y + 4, shortened, fill=INK, css="ink")

    def say(self, words: str) -> None:
        """A line of the legend in words alone."""
        self.drawing.text(8, self._legend_top + 22 * self._lines + 18, words, fill=INK, css="ink")
        self._lines += 1

    def tell_scale(self, least: str, most: str) -> None:
        """The scale of colours as a line of the legend."""
        y, left, each = self._legend_top + 22 * self._lines + 14, 8 + 7.5 * len(least) + 6, 28
        self._lines += 1
        self.drawing.text(8, y + 4, least, fill=INK, css="ink")
        for shade, colour in enumerate(SCALE):
            x = left + each * shade
            self.drawing.line(x, y, x + each, y, stroke=colour, css=f"scale-{shade}", width=8)
        self.drawing.text(left + each * len(SCALE) + 8, y + 4, most, fill=INK, css="ink")

    def _add(self, scene: Scene) -> None:
        drawing, scale, at = self.drawing, self._scale, self.at
        for x1, y1, x2, y2 in walls_of(scene):
            corners = [at(*corner) for corner in ((x1, y1), (x2, y1), (x2, y2), (x1, y2))]
            if all(0 <= x <= self._width and 0 <= y <= self._legend_top for x, y in corners):
                drawing.polygon(corners, fill="#b9ae97", css="solid wall")
        for solid in scene.solids():
            drawing.polygon([at(*corner) for corner in solid.corners()], fill="#b9ae97", css=f"solid {solid.kind}")
        drawing.circle(*at(scene.goal.x, scene.goal.y), scene.goal_radius * scale, fill="none", css="goal", stroke=INK)
        drawing.circle(*at(scene.start.x, scene.start.y), 4, fill=INK, css="ink-fill")
        if not scene.has_person:
            return
        person = scene.person.pose
        drawing.circle(*at(person.x, person.y), scene.person.radius * scale, fill=PERSON, css="person")
        nose = 0.55
        drawing.line(
            *at(person.x, person.y),
            *at(person.x + nose * math.cos(person.yaw), person.y + nose * math.sin(person.yaw)),
            stroke=PERSON,
            css="person-line",
            width=3,
        )


def rollouts(
    scene: Scene, trajectories: Sequence[Trajectory], *, names: Sequence[str], title: str, moving: bool = False
) -> str:
    """One scene from above with up to two rollouts in it: what the 3D stage shows, for print and without WebGL.

    moving: robots drive them in real time, over and over, the earlier one waiting for the later one at its end.
    """
    steps = max(len(trajectory.poses) for trajectory in trajectories) + STANDS_STEPS
    plan = _Plan(scene, [t.poses for t in trajectories], legend_lines=len(trajectories), title=title)
    for k, (trajectory, name) in enumerate(zip(trajectories, names, strict=True)):
        end = plan.path(trajectory.poses, stroke=SIDES[k], css=f"line-{k + 1}", width=3)
        plan.drawing.circle(*end, 4.5, fill=SIDES[k], css=f"fill-{k + 1}")
        plan.tell(name, stroke=SIDES[k], css=f"line-{k + 1}")
        if moving:
            poses = trajectory.poses.tolist()
            way = [plan.at(x, y) for x, y, _ in poses + poses[-1:] * (steps - len(poses))]
            plan.drawing.moving_circle(way, 7, seconds=steps * trajectory.dt, fill=SIDES[k], css=f"fill-{k + 1}")
    return plan.drawing.svg()


def paths(
    scene: Scene,
    drawn: Mapping[str, Sequence[ArrayLike]],
    *,
    title: str,
    learned: Mapping[str, Sequence[ArrayLike]] | None = None,
    walked: Mapping[str, Sequence[ArrayLike]] | None = None,
) -> str:
    """Many paths in one scene from above, laid over each other. drawn: name of a group -> paths (n, 2 or more) in
    metres; groups are told apart by colour, in turn, and named below. learned, walked: groups that lie over them, the
    robot's rollouts and the person's ways.
    """
    groups = [(*one, *DRAWN[k % len(DRAWN)]) for k, one in enumerate(drawn.items())]
    groups += [(*item, *LEARNED) for item in (learned or {}).items()]
    groups += [(*item, *WALKED) for item in (walked or {}).items()]
    plan = _Plan(scene, [path for _, group, *_ in groups for path in group], legend_lines=len(groups), title=title)
    for name, group, colour, css in groups:
        for path in group:
            plan.path(path, stroke=colour, css=css, width=2)
        plan.tell(name, stroke=colour, css=css)
    return plan.drawing.svg()


def valued_paths(
    scene: Scene,
    trajectories: Sequence[Trajectory],
    values: Sequence[ArrayLike],
    *,
    names: Sequence[str],
    title: str,
    scale_label: str,
    number: Number = _number,
) -> str:
    """Trajectories in one scene from above, every step in the colour of its value; numbered on their way, and the
    scale, from least to most of all, below their names. values: (steps,) of each trajectory."""
    plan = _Plan(scene, [one.poses for one in trajectories], legend_lines=len(names) + 2, title=title)
    low, high = (float(bound(np.concatenate([np.asarray(one) for one in values]))) for bound in (np.min, np.max))
    edges = np.linspace(low, high, len(SCALE) + 1)[1:-1]
    for trajectory, said in zip(trajectories, values, strict=True):
        shades = np.digitize(np.asarray(said), edges) if high > low else np.zeros(len(np.asarray(said)), dtype=int)
        first = 0
        for step in range(1, len(shades) + 1):
            if step == len(shades) or shades[step] != shades[first]:
                shade = int(shades[first])
                plan.path(trajectory.poses[first : step + 1], stroke=SCALE[shade], css=f"scale-{shade}", width=4)
                first = step
    for number_of, trajectory in enumerate(trajectories, start=1):  # under way, each elsewhere: all end at the goal
        step = len(trajectory.poses) * number_of // (len(trajectories) + 1)
        x, y = plan.at(*(float(place) for place in trajectory.poses[step, :2]))
        plan.drawing.circle(x, y, 9, fill=PAPER, css="paper", stroke=INK)
        plan.drawing.text(x, y + 4, str(number_of), anchor="middle", fill=INK, css="ink")
    for number_of, name in enumerate(names, start=1):
        plan.say(f"{number_of}  {name}")
    plan.say(scale_label)
    plan.tell_scale(number(low), number(high))
    return plan.drawing.svg()

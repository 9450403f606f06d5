"""Scores over time, one lane per thing, with the moment under the cursor: SVG for the page, numbers for its script.

A lane's height is the score, so no colour has to be told from another. What moves the cursor: `js/moment-chart.js`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from markupsafe import Markup

from desirepath.web.core.svg_figures import FONT, INK, LINE, MAIN, PAPER, SOFT, ticks

LANES = 7  # things with a lane; of more, those that never score much say nothing
LANE, GAP, LEFT, RIGHT, TOP, BOTTOM, WIDTH = 26, 6, 120, 52, 22, 30, 560
LEAST = 0.02  # a thing that never scores more has no lane


@dataclass(frozen=True)
class Lane:
    """One thing. name: in the reader's words; scores: (T,) from 0 to 1."""

    name: str
    scores: Sequence[float]


@dataclass(frozen=True)
class MomentChart:
    """svg: the lanes with a cursor at the first moment. data: what the script needs, JSON-ready."""

    svg: Markup
    data: dict[str, Any]


def moment_chart(lanes: Sequence[Lane], dt: float, *, title: str, time_label: str, at_s: float = 0.0) -> MomentChart:
    """Lanes in the order given; at_s: where the cursor stands at first."""
    steps = max((len(lane.scores) for lane in lanes), default=0)
    last = max(steps - 1, 1)
    width = WIDTH - LEFT - RIGHT
    height = TOP + len(lanes) * (LANE + GAP) + BOTTOM

    def x_of(step: float) -> float:
        return LEFT + width * step / last

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" class="plot moments" viewBox="0 0 {WIDTH} {height}" role="img" '
        f'aria-label="{escape(title)}" font-family="{FONT}" font-size="12"><title>{escape(title)}</title>'
        f'<rect class="paper" width="{WIDTH}" height="{height}" fill="{PAPER}"/>'
    ]
    bottom = TOP + len(lanes) * (LANE + GAP)
    for tick in ticks(0.0, last * dt):
        x = x_of(tick / dt)
        parts.append(
            f'<line class="grid" x1="{x:.1f}" y1="{TOP}" x2="{x:.1f}" y2="{bottom}" stroke="{LINE}"/>'
            f'<text class="soft" x="{x:.1f}" y="{bottom + 14}" text-anchor="middle" fill="{SOFT}">{tick:g}</text>'
        )
    parts.append(
        f'<text class="soft" x="{LEFT + width / 2:.1f}" y="{bottom + 27}" text-anchor="middle" fill="{SOFT}">'
        f"{escape(time_label)}</text>"
    )
    for k, lane in enumerate(lanes):
        base = TOP + (k + 1) * (LANE + GAP) - GAP / 2
        top = " ".join(f"{x_of(step):.1f},{base - LANE * score:.1f}" for step, score in enumerate(lane.scores))
        area = f"{x_of(0):.1f},{base:.1f} {top} {x_of(len(lane.scores) - 1):.1f},{base:.1f}"
        parts.append(
            f'<polygon class="area-0" points="{area}" fill="{MAIN}"/>'
            f'<line class="grid" x1="{LEFT}" y1="{base:.1f}" x2="{LEFT + width}" y2="{base:.1f}" stroke="{LINE}"/>'
            f'<text class="ink" x="{LEFT - 8}" y="{base - 7:.1f}" text-anchor="end" fill="{INK}">{escape(lane.name)}'
            f'</text><text class="soft lane-value" x="{LEFT + width + 8}" y="{base - 7:.1f}" fill="{SOFT}"></text>'
        )
    start = min(max(round(at_s / dt), 0), steps - 1) if steps else 0
    parts.append(
        f'<line class="ink-line cursor" x1="{x_of(start):.1f}" y1="{TOP - 4}" x2="{x_of(start):.1f}" y2="{bottom}" '
        f'stroke="{INK}" stroke-width="1.5"/></svg>'
    )
    data = {
        "dt": dt,
        "left": LEFT,
        "width": width,
        "at": start,
        "lanes": [{"name": lane.name, "scores": [round(float(score), 3) for score in lane.scores]} for lane in lanes],
    }
    return MomentChart(Markup("".join(parts)), data)  # noqa: S704 - names are escaped above


def lanes_of(things: Sequence[str], scores: Sequence[Sequence[float]], named: Mapping[str, str]) -> list[Lane]:
    """The things that score most somewhere, in the scene's order. scores: one row per moment."""
    columns = list(zip(*scores, strict=True)) or [()] * len(things)
    most = sorted(range(len(things)), key=lambda k: -max(columns[k], default=0.0))[:LANES]
    return [
        Lane(named.get(things[k], things[k]), columns[k])
        for k in sorted(most)
        if max(columns[k], default=0.0) > LEAST
    ]  # fmt: skip


@dataclass(frozen=True)
class ScoresOverTime:
    """Scores of a whole trajectory as an explanation's CSV has them. scores: one row per moment, a column per thing."""

    things: tuple[str, ...]
    scores: list[list[float]]
    dt: float

    @property
    def means(self) -> dict[str, float]:
        """Thing -> mean over the trajectory."""
        n = max(len(self.scores), 1)
        return {thing: sum(row[k] for row in self.scores) / n for k, thing in enumerate(self.things)}


def scores_in(table: bytes) -> ScoresOverTime:
    """Read `explanation.csv` back: one row per moment and thing."""
    things: list[str] = []
    found: dict[int, list[float]] = {}
    times: dict[int, float] = {}
    for row in csv.DictReader(io.StringIO(table.decode("utf-8"))):
        step = int(row["step"])
        if step == 0:
            things.append(row["thing"])
        found.setdefault(step, []).append(float(row["score"]))
        times[step] = float(row["time_s"])
    dt = times[1] - times[0] if len(times) > 1 else 0.2
    return ScoresOverTime(tuple(things), [found[step] for step in sorted(found)], round(dt, 6))


@dataclass(frozen=True)
class LookedAt:
    """How much a thing moved two policies on the whole, and which of them more."""

    thing: str
    first: float
    second: float

    @property
    def difference(self) -> float:
        return self.first - self.second


def compare_charts(first: ScoresOverTime, second: ScoresOverTime) -> list[LookedAt]:
    """Thing by thing, the greatest difference first: what one looks at that the other does not."""
    a, b = first.means, second.means
    both = [LookedAt(thing, a[thing], b.get(thing, 0.0)) for thing in a if max(a[thing], b.get(thing, 0.0)) > LEAST]
    return sorted(both, key=lambda one: -abs(one.difference))

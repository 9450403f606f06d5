"""The numbers of chapter 2 from the finished tasks, and the bars they are held against."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.judging import KINDS
from desirepath_experiments.reproduction.demonstrations.plan import (
    CONTROLLERS,
    OURS,
    ControllerCell,
    DemonstrationsPlan,
)
from desirepath_experiments.reproduction.tasks import TaskResult

Load = Callable[[str], TaskResult]
DEMONSTRATED = "demonstrations"
MEASURES = {  # figure 2.3 e-g
    "relative_path_length": "relative path length",
    "min_human_distance": "minimum human distance (m)",
    "path_area": "path area (m²)",
}


@dataclass(frozen=True)
class Bar:
    """A bar of the specification: met where `value` is at least, or at most, `bound`."""

    name: str
    bound: float
    at_least: bool

    def met(self, value: float | None) -> bool | None:
        """None where there is nothing to judge."""
        if value is None or math.isnan(value):
            return None
        return value >= self.bound if self.at_least else value <= self.bound


BARS = {
    "success_rate": Bar("success from demonstrated starts", 0.95, True),
    "frechet_m": Bar("deviation-aware Frechet distance, median (m)", 0.25, False),
    "t_star": Bar("deviation point t*, median", 0.8, True),
    "followed_rate": Bar("rollouts that follow a demonstration to the goal", 0.5, True),
    "speed_correlation": Bar("correlation of speed profiles, median", 0.8, True),
    "starts": Bar("success from random starts", 0.9, True),
    "goals": Bar("success to random goals", 0.9, True),
    "anywhere": Bar("success with start, goal and person random", 0.9, True),
}
FOLLOWING = ("frechet_m", "t_star", "followed_rate")  # together the bar on the Frechet distance


@dataclass(frozen=True)
class ControllerRow:
    """One controller of one demonstrator in one environment, means over seeds; None where nothing can be said.

    values: keys of BARS and more of the unseen kinds. worst: of each of these, the worst seed. cpu_s: of its training.
    ready_s: CPU seconds until the first checkpoint that meets the bars on demonstrated starts, on selection scenes and
    its own measuring included, of the slowest seed; None where one never does.
    """

    environment: str
    style: str
    controller: str
    seeds: int
    values: dict[str, float | None]
    worst: dict[str, float | None]
    cpu_s: float | None
    ready_s: float | None

    @property
    def follows(self) -> bool:
        """Whether it meets the bar on the Frechet distance: median f, median t*, and both by the same rollouts."""
        return all(BARS[name].met(self.values[name]) is True for name in FOLLOWING)


def rows_of(plan: DemonstrationsPlan, load: Load) -> list[ControllerRow]:
    """All rows, in the plan's order."""
    grouped: dict[tuple[str, str, str], list[ControllerCell]] = {}
    for cell in plan.judged:
        grouped.setdefault((cell.environment, cell.style, cell.controller), []).append(cell)
    return [_row(plan, load, cells) for cells in grouped.values()]


def _row(plan: DemonstrationsPlan, load: Load, cells: Sequence[ControllerCell]) -> ControllerRow:
    judged = []
    for cell in cells:
        unseen = load(plan.unseen[cell].key).meta["unseen"]
        rates = {kind: found["success_rate"] for kind, found in unseen.items()}
        judged.append({**load(plan.judged[cell].key).meta["judged"], **rates})
    values = {name: _over([one[name] for one in judged], np.mean) for name in judged[0]}
    larger_is_better = {**{name: bar.at_least for name, bar in BARS.items()}, **dict.fromkeys(KINDS, True)}
    worst = {
        name: _over([one[name] for one in judged], np.min if at_least else np.max)
        for name, at_least in larger_is_better.items()
    }
    trained = [load(plan.trained[cell].key).meta for cell in cells if cell in plan.trained]
    ready = [_ready_s(meta["curve"]) for meta in trained]
    first = cells[0]
    return ControllerRow(
        first.environment,
        first.style,
        first.controller,
        len(cells),
        values,
        worst,
        float(np.mean([meta["made"]["cpu_seconds"] for meta in trained])) if trained else None,
        max((s for s in ready if s is not None), default=None) if None not in ready else None,
    )


def _ready_s(curve: Sequence[dict[str, Any]]) -> float | None:
    on_demonstrated = ("success_rate", *FOLLOWING)
    return next((p["cpu_s"] for p in curve if all(BARS[name].met(p[name]) for name in on_demonstrated)), None)


def _over(values: Sequence[float | None], statistic: Callable[[list[float]], Any]) -> float | None:
    known = [value for value in values if value is not None]
    return float(statistic(known)) if known else None


def measured(
    plan: DemonstrationsPlan, load: Load, environment: str, style: str, controller: str, name: str
) -> NDArray[Any]:
    """A measure of figure 2.3 over all rollouts of all seeds; controller DEMONSTRATED: of the demonstrations."""
    source = OURS if controller == DEMONSTRATED else controller
    whose = "demonstrated" if controller == DEMONSTRATED else "driven"
    cells = [c for c in plan.judged if (c.environment, c.style, c.controller) == (environment, style, source)]
    return np.concatenate([load(plan.judged[cell].key).arrays[f"{whose}_{name}"] for cell in cells])


def curves_of(
    plan: DemonstrationsPlan, load: Load, environment: str, style: str
) -> dict[str, list[list[dict[str, Any]]]]:
    """Per variant that was trained, the learning curve of every seed."""
    curves: dict[str, list[list[dict[str, Any]]]] = {}
    for cell, task in plan.trained.items():
        if (cell.environment, cell.style) == (environment, style):
            curves.setdefault(cell.controller, []).append(load(task.key).meta["curve"])
    return curves


def first_cell(plan: DemonstrationsPlan, environment: str, style: str, controller: str) -> ControllerCell:
    """The cell of the first seed, which figures show."""
    return ControllerCell(environment, style, controller, plan.budget.seeds[0])


SHOWN = (DEMONSTRATED, *CONTROLLERS)
NAMES = {
    DEMONSTRATED: "demonstrations",
    OURS: "ours",
    "dwa": "DWA",
    "social_cost": "social cost",
    "no_cloning": "without cloning",
    "no_boost": "without goal boost",
    "neither": "without both",
    "no_demonstrations": "TD3 without demonstrations",
}

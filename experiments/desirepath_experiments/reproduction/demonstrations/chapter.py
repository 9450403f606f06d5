"""Chapter 2 reproduced: the numbers of its finished tasks, and the bars they are held against."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.demonstrations.controllers import BASELINES
from desirepath.demonstrations.judging import KINDS
from desirepath.demonstrations.td3_bc.configuration import DEPARTURES, DemonstrationConfig
from desirepath_experiments.reproduction.demonstrations.computing import FUNCTIONS
from desirepath_experiments.reproduction.demonstrations.plan import (
    BUDGETS,
    CONTROLLERS,
    OURS,
    VARIANTS,
    WITHOUT,
    ControllerCell,
    DemonstrationsPlan,
    make_plan,
)
from desirepath_experiments.reproduction.driver import Chapter, Made
from desirepath_experiments.reproduction.tasks import Load

DEMONSTRATED = "demonstrations"
SHOWN = (DEMONSTRATED, *CONTROLLERS)
MEASURES = {  # figure 2.3 e-g
    "relative_path_length": "relative path length",
    "min_human_distance": "minimum human distance (m)",
    "path_area": "path area (m²)",
}
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


def make(plan: DemonstrationsPlan, load: Load) -> Made:
    """Bars and measures, beside the baselines'."""
    from desirepath_experiments.reproduction.demonstrations.figures import draw  # matplotlib is slow to load

    budget, rows = plan.budget, rows_of(plan, load)
    of_ours = [row for row in rows if row.controller == OURS]
    measured = list(_measure(plan, load))
    whole = (budget.environments[0], budget.ablated)
    return Made(
        {"bars": {name: asdict(bar) for name, bar in BARS.items()}, "rows": [asdict(row) for row in rows]},
        more={
            "verdicts": [_verdict(name, bar, of_ours) for name, bar in BARS.items()],
            "ours": of_ours,
            "plain": [row for row in rows if row.controller == WITHOUT],
            "above": {name: _times_above(measured, name) for name in MEASURES},
            "main": [row for row in rows if row.controller in (*CONTROLLERS, WITHOUT)],
            "ablated": [r for r in rows if (r.environment, r.style) == whole and r.controller in VARIANTS],
            "measured": measured,
            "names": NAMES | MEASURES,
            "kinds": KINDS,
            "departures": DEPARTURES,
        },
        drawn=draw(plan, load),
        card={
            "config": {**asdict(budget), "training": DemonstrationConfig(updates=budget.updates).as_dict()},
            "departures": DEPARTURES,
        },
    )


CHAPTER = Chapter("demonstrations", BUDGETS, FUNCTIONS, make_plan, make)


def _verdict(name: str, bar: Bar, rows: Sequence[ControllerRow]) -> dict[str, Any]:
    """How many controllers can be held against a bar, and which miss it."""
    met = [(row, bar.met(row.values[name])) for row in rows]
    missed = [(row, row.values[name]) for row, known in met if known is False]
    return {"bar": bar, "known": sum(known is not None for _, known in met), "missed": missed}


def rollouts_of(
    plan: DemonstrationsPlan, load: Load, environment: str, style: str, controller: str
) -> list[dict[str, NDArray[Any]]]:
    """Of every seed what is known of its rollouts (`computing.judged`); controller DEMONSTRATED: of what was shown."""
    source, whose = (OURS, "demonstrated_") if controller == DEMONSTRATED else (controller, "driven_")
    return [
        {name.removeprefix(whose): value for name, value in load(plan.judged[cell]).arrays.items() if whose in name}
        for cell in plan.cells(environment, style, source)
    ]


def _measure(plan: DemonstrationsPlan, load: Load) -> Iterator[dict[str, Any]]:
    """Mean and standard deviation of every measure over all rollouts of all seeds."""
    for environment, style, controller in product(plan.budget.environments, plan.budget.styles, SHOWN):
        rollouts = rollouts_of(plan, load, environment, style, controller)
        values = {name: np.concatenate([of[name] for of in rollouts]) for name in MEASURES}
        yield {
            "environment": environment,
            "style": style,
            "controller": controller,
            "rollouts": len(values["path_area"]),
            **{name: (float(np.mean(of)), float(np.std(of))) for name, of in values.items()},
        }


def _times_above(measured: Sequence[dict[str, Any]], name: str) -> dict[str, int]:
    """In how many environments and styles ours has more of a measure than each baseline: what the thesis says of it."""
    means = {(row["environment"], row["style"], row["controller"]): row[name][0] for row in measured}
    cases = {(environment, style) for environment, style, _ in means}
    return {baseline: sum(means[*case, OURS] > means[*case, baseline] for case in cases) for baseline in BASELINES}


def rows_of(plan: DemonstrationsPlan, load: Load) -> list[ControllerRow]:
    """All rows, in the plan's order."""
    return [_row(plan, load, plan.cells(*whose)) for whose in dict.fromkeys(cell[:3] for cell in plan.judged)]


def _row(plan: DemonstrationsPlan, load: Load, cells: Sequence[ControllerCell]) -> ControllerRow:
    judged = []
    for cell in cells:
        unseen = load(plan.unseen[cell]).meta["unseen"]
        rates = {kind: of_kind["success_rate"] for kind, of_kind in unseen.items()}
        judged.append({**load(plan.judged[cell]).meta["judged"], **rates})
    larger_is_better = {name: bar.at_least for name, bar in BARS.items()} | dict.fromkeys(KINDS, True)
    trained = [load(plan.trained[cell]).meta for cell in cells if cell in plan.trained]
    ready = [_ready_s(meta["curve"]) for meta in trained]
    return ControllerRow(
        *cells[0][:3],
        seeds=len(cells),
        values={name: _over([of_seed[name] for of_seed in judged], np.mean) for name in judged[0]},
        worst={
            name: _over([of_seed[name] for of_seed in judged], np.min if at_least else np.max)
            for name, at_least in larger_is_better.items()
        },
        cpu_s=_over([meta["made"]["cpu_seconds"] for meta in trained], np.mean),
        ready_s=None if None in ready else _over(ready, np.max),
    )


def _ready_s(curve: Sequence[dict[str, Any]]) -> float | None:
    on_demonstrated = ("success_rate", *FOLLOWING)
    return next((p["cpu_s"] for p in curve if all(BARS[name].met(p[name]) for name in on_demonstrated)), None)


def _over(values: Sequence[float | None], statistic: Callable[[list[float]], Any]) -> float | None:
    known = [value for value in values if value is not None]
    return float(statistic(known)) if known else None

"""`desirepath reproduce depth`, without the command line: work, tables, pictures, report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from desirepath.demonstrations.depth.states import CONFIGURATIONS
from desirepath.demonstrations.depth.training import DEPARTURES, DepthTrainingConfig
from desirepath.explain.printed import Section, Table
from desirepath.simulation.depth_camera import DEPTH_CAMERA
from desirepath_experiments.reproduction.chapter_report import seeds_words
from desirepath_experiments.reproduction.depth.computing import FUNCTIONS
from desirepath_experiments.reproduction.depth.plan import BUDGETS, DepthBudget, DepthPlan, make_plan
from desirepath_experiments.reproduction.driver import Chapter, Finished, Made
from desirepath_experiments.reproduction.tasks import Task, TaskResult

SUCCESS_BAR = 0.9  # of VAE-HA over the modes, in unseen homes
RATES = ("success_rate", "collision_rate", "timeout_rate")


def plan_of(budget: DepthBudget, seeds: Sequence[int] | None) -> DepthPlan:
    """seeds: instead of the budget's own."""
    return make_plan(budget if seeds is None else replace(budget, seeds=tuple(seeds)))


def make(finished: Finished) -> Made:
    """Six configurations, the encoder's pictures, the bars."""
    plan: DepthPlan = finished.plan
    budget = plan.budget
    found = findings(plan, finished.load)
    picture = finished.figures / "reconstruction.png"
    draw_reconstruction(finished.load(plan.encoder.key), picture)
    return Made(
        found,
        head=seeds_words(budget),
        sections=_sections(found),
        further=[("Updates", f"{budget.updates:,} per controller")],
        answer={"bars": found["bars"]},
        files=[picture],
        card={
            "setup": "home",
            "seed": budget.seeds[0],
            "config": DepthTrainingConfig(updates=budget.updates).as_dict(),
            "scenes": {"unseen": f"{budget.unseen} reporting homes, each with four modes of the person"},
            "results": {"bars": found["bars"]},
            "departures": DEPARTURES,
            "notes": ["Simulated throughout: people and demonstrators are programmed."],
        },
    )


CHAPTER = Chapter(
    "depth",
    BUDGETS,
    FUNCTIONS,
    plan_of,
    lambda plan: plan.tasks(),
    make,
    task_name=lambda task: _name(task),
    options={"seeds": None},
    processes=1,
)


def findings(plan: DepthPlan, load: Callable[[str], TaskResult]) -> dict[str, Any]:
    """All that was measured: configurations with means over seeds and every seed's own, the encoder, the bars."""
    configurations: dict[str, Any] = {}
    for name in CONFIGURATIONS:
        of_seeds = [load(plan.judged[name, seed].key).meta for seed in plan.budget.seeds]
        configurations[name] = {
            "unseen": {
                mode: {rate: float(np.mean([one["unseen"][mode][rate] for one in of_seeds])) for rate in RATES}
                for mode in of_seeds[0]["unseen"]
            },
            "demonstrated": {
                removed: {
                    part: float(np.mean([one["demonstrated"][removed][part] for one in of_seeds]))
                    for part in (*RATES, "t_star", "f_m")
                }
                for removed in of_seeds[0]["demonstrated"]
            },
            "styles": {
                style: {
                    part: float(np.mean([one["demonstrated"]["nothing"]["styles"][style][part] for one in of_seeds]))
                    for part in ("t_star", "f_m")
                }
                for style in of_seeds[0]["demonstrated"]["nothing"]["styles"]
            },
            "spread": {
                "success_rate": _spread([one["unseen"]["all"]["success_rate"] for one in of_seeds]),
                **{
                    part: _spread([one["demonstrated"]["nothing"][part] for one in of_seeds])
                    for part in ("t_star", "f_m")
                },
            },
            "seeds": [{"unseen": one["unseen"]["all"], "demonstrated": one["demonstrated"]} for one in of_seeds],
        }
    perceived = load(plan.encoder.key).meta
    success = configurations["VAE-HA"]["unseen"]["all"]["success_rate"]
    closest = min(CONFIGURATIONS, key=lambda name: configurations[name]["demonstrated"]["nothing"]["f_m"])
    return {
        "configurations": configurations,
        "perception": {key: perceived[key] for key in ("reconstruction", "prediction", "last_training_rms_m")},
        "avoider": {"selection_success": load(plan.avoider.key).meta["selection_success"]},
        "bars": [
            {
                "name": "VAE-HA arrives in unseen homes",
                "bound": SUCCESS_BAR,
                "value": success,
                "met": success >= SUCCESS_BAR,
            },
            {"name": "smallest f at t*", "bound": "VAE-HA", "value": closest, "met": closest == "VAE-HA"},
        ],
    }


def _spread(values: list[float]) -> list[float]:
    """The smallest and the largest over seeds."""
    return [min(values), max(values)]


def draw_reconstruction(perceived: TaskResult, path: Path) -> None:
    """What 32 latents keep: clean, as the camera gives it, decoded; near people, then thin legs."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = [perceived.arrays[f"shown_{part}"] for part in ("clean", "seen", "decoded")]
    columns = len(rows[0])
    figure = Figure(figsize=(1.9 * columns, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    places = figure.subplots(3, columns, squeeze=False)
    for line, (frames, title) in enumerate(zip(rows, ("clean", "seen", "decoded"), strict=True)):
        for place, frame in zip(places[line], frames, strict=True):
            place.imshow(frame, vmin=0.0, vmax=DEPTH_CAMERA.range_m, cmap="viridis")
            place.set_xticks([])
            place.set_yticks([])
        places[line][0].set_ylabel(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _sections(found: dict[str, Any]) -> list[Section]:
    configurations, perceived = found["configurations"], found["perception"]
    modes = list(next(iter(configurations.values()))["unseen"])
    return [
        Section(
            "Bars",
            tables=[
                Table(
                    "Bars of the specification",
                    ["bar", "bound", "found", "met"],
                    [
                        [b["name"], _cell(b["bound"]), _cell(b["value"]), "yes" if b["met"] else "no"]
                        for b in found["bars"]
                    ],
                )
            ],
        ),
        Section(
            "In homes that nothing was trained in",
            ["Success / collisions / timeouts, %, by what the person does; means over seeds. Success: of each seed."],
            [
                Table(
                    "Unseen homes",
                    ["configuration", *modes, "success by seed"],
                    [
                        [
                            name,
                            *(_rates(of["unseen"][mode]) for mode in modes),
                            ", ".join(f"{100 * one['unseen']['success_rate']:.0f}" for one in of["seeds"]),
                        ]
                        for name, of in configurations.items()
                    ],
                )
            ],
        ),
        Section(
            "Where something was demonstrated",
            ["t* (share of the path that follows) with f there in metres: read both together. Medians over rollouts."],
            [
                Table(
                    "Mode 5, with things taken away",
                    ["configuration", "rates", *(f"without {removed}: t*, f" for removed in _removed(configurations))],
                    [
                        [
                            name,
                            _rates(of["demonstrated"]["nothing"]),
                            *(f"{one['t_star']:.2f}, {one['f_m']:.2f}" for one in of["demonstrated"].values()),
                        ]
                        for name, of in configurations.items()
                    ],
                ),
                Table(
                    "By preference, nothing taken away; and from the least to the largest over seeds",
                    [
                        "configuration",
                        *(f"{style}: t*, f" for style in _styles(configurations)),
                        "t* by seed",
                        "f by seed",
                    ],
                    [
                        [
                            name,
                            *(f"{one['t_star']:.2f}, {one['f_m']:.2f}" for one in of["styles"].values()),
                            *(
                                " to ".join(f"{value:.2f}" for value in of["spread"][part])
                                for part in ("t_star", "f_m")
                            ),
                        ]
                        for name, of in configurations.items()
                    ],
                ),
            ],
        ),
        Section(
            "What 32 latents keep",
            [
                "Metres between decoded and clean pictures in homes that the encoder has not seen. Kept: share of the "
                "pixels within 0.5 m (thin things: 0.3 m). Pictures: figures/reconstruction.png."
            ],
            [
                Table(
                    "Reconstruction",
                    ["pixels of", "median, m", "mean, m", "kept"],
                    [
                        [name, _cell(one["median_m"]), _cell(one["mean_m"]), _cell(one["kept"])]
                        for name, one in perceived["reconstruction"].items()
                    ],
                ),
                Table(
                    "The person one step ahead",
                    ["what", "value"],
                    [[key, _cell(value)] for key, value in perceived["prediction"].items()],
                ),
            ],
        ),
        Section("Where this departs from the thesis", points=DEPARTURES),
    ]


def _removed(configurations: dict[str, Any]) -> list[str]:
    return list(next(iter(configurations.values()))["demonstrated"])


def _styles(configurations: dict[str, Any]) -> list[str]:
    return list(next(iter(configurations.values()))["styles"])


def _rates(of: dict[str, float]) -> str:
    return " / ".join(f"{100 * of[rate]:.0f}" for rate in RATES)


def _cell(value: float | str | None) -> str:
    return "-" if value is None else value if isinstance(value, str) else f"{value:.3g}"


def _name(task: Task) -> str:
    return f"{task.kind} {task.params.get('configuration', '')} {task.params.get('seed', '')}".rstrip()

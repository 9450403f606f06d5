"""A flow field as files: the figure as PNG and SVG, its numbers as CSV, and what they amount to.

Made alike for the command line and the analysts' pages. The numbers come from `flow_field.py`, the pictures from
`scene_plots.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from desirepath.csv_text import csv_text
from desirepath.explain import flow_field as flow
from desirepath.explain.flow_words import ENGLISH, Words
from desirepath.simulation.acting import ActFunction, EpisodicPolicy
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import Setup
from desirepath.simulation.trajectory import Outcome, Trajectory


@dataclass(frozen=True)
class FigureFiles:
    """A figure with everything that stands beside it. files: by name, ending included; numbers: JSON-ready, SI."""

    files: Mapping[str, bytes]
    numbers: Mapping[str, Any]


def flow_files(
    policies: Sequence[tuple[str, ActFunction | EpisodicPolicy]],
    setup: Setup,
    scene: Scene,
    *,
    cell_m: float = flow.CELL_M,
    words: Words = ENGLISH,
) -> FigureFiles:
    """The flow field of one named policy, or of two with their difference.

    Files: flow_field.png, .svg and .csv; for two policies flow_field_a.csv, flow_field_b.csv and difference.csv.
    Raises ValueError for another number of policies, else what `flow_field` raises.
    """
    from desirepath.explain import scene_plots  # matplotlib is slow to import

    fields = [flow.flow_field(act, setup, scene, cell_m=cell_m) for _, act in policies]
    numbers: dict[str, Any] = {
        "setup": setup.name,
        "scene_seed": scene.seed,
        "cell_m": cell_m,
        "policies": [_describe(name, field) for (name, _), field in zip(policies, fields, strict=True)],
    }
    if len(fields) == 1:
        figure = scene_plots.flow_figure(fields[0], title=policies[0][0], words=words)
        tables = {"flow_field.csv": table_bytes(flow.COLUMNS, fields[0].rows())}
    elif len(fields) == 2:
        apart = flow.difference(*fields)
        titles = (f"A: {policies[0][0]}", f"B: {policies[1][0]}")
        figure = scene_plots.pair_figure(apart, titles=titles, words=words)
        tables = {f"flow_field_{x}.csv": table_bytes(flow.COLUMNS, f.rows()) for x, f in zip("ab", fields, strict=True)}
        tables["difference.csv"] = table_bytes(flow.DIFFERENCE_COLUMNS, apart.rows())
        numbers["mean_heading_difference_rad"] = _finite(apart.mean_angle)
    else:
        raise ValueError(f"policies: {len(fields)} given; a flow-field figure shows one or two")
    about = f"flow field, {setup.name} scene {scene.seed}, cells of {cell_m} m: " + ", ".join(n for n, _ in policies)
    pictures = {
        "flow_field.png": scene_plots.encode_figure(figure, "png", about),
        "flow_field.svg": scene_plots.encode_figure(figure, "svg", about),
    }
    return FigureFiles({**pictures, **tables}, numbers)


def starts_files(
    policies: Mapping[str, ActFunction | EpisodicPolicy], setup: Setup, scene: Scene, *, starts: int
) -> FigureFiles:
    """All named policies from the same starts in one scene: trajectories.png, .svg and .csv."""
    from desirepath.explain import scene_plots  # matplotlib is slow to import

    rollouts = flow.rollouts_from(policies, setup, flow.spread_starts(scene, starts))
    figure = scene_plots.starts_figure(rollouts, title=f"{setup.name} {scene.seed}")
    about = f"trajectories, {setup.name} scene {scene.seed}: " + ", ".join(policies)
    shown = len(next(iter(rollouts.values())))
    numbers = {
        "setup": setup.name,
        "scene_seed": scene.seed,
        "starts": shown,
        "policies": [
            {"name": name, "arrived": sum(trajectory.outcome == Outcome.SUCCESS for trajectory in of_one)}
            for name, of_one in rollouts.items()
        ],
    }
    columns = ("policy", "start", "time_s", "x_m", "y_m", "yaw_rad", "outcome")
    files = {
        "trajectories.png": scene_plots.encode_figure(figure, "png", about),
        "trajectories.svg": scene_plots.encode_figure(figure, "svg", about),
        "trajectories.csv": table_bytes(columns, _poses(rollouts)),
    }
    return FigureFiles(files, numbers)


def _poses(rollouts: Mapping[str, Sequence[Trajectory]]) -> Iterable[tuple[object, ...]]:
    for name, of_one in rollouts.items():
        for start, trajectory in enumerate(of_one):
            for time, pose in zip(trajectory.times, trajectory.poses, strict=True):
                rounded = (round(float(value), 4) for value in pose)
                yield (name, start, round(float(time), 1), *rounded, trajectory.outcome.name.lower())


def _describe(name: str, field: flow.FlowField) -> dict[str, Any]:
    swinging = field.oscillation[field.free & np.isfinite(field.oscillation)]
    return {
        "name": name,
        "free_cells": int(field.free.sum()),
        "cells_without_heading": int((field.free & np.isnan(field.heading)).sum()),
        "mean_oscillation_rad": _finite(float(swinging.mean())) if swinging.size else None,
        "trajectories": field.rollouts,
        "success_rate": _finite(field.share(Outcome.SUCCESS)),
        "collision_rate": _finite(field.share(Outcome.COLLISION)),
        "timeout_rate": _finite(field.share(Outcome.TIMEOUT)),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def table_bytes(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """Rows as CSV."""
    return csv_text([columns, *rows]).encode()

"""Runs of a robot past a person who stands, and rows of them, as a lab might have recorded them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from desirepath.recordings.mapping import Mapping
from desirepath.recordings.recording import RecordingError

RUNS = {"straight": 0.0, "wide": 1.2, "other_side": -1.8}
"""Name -> how far (m) to the left of the straight line the robot is half-way."""
SECONDS = 8.0
SPEED_M_S = 0.7
ANNA = (3.0, 0.9, math.pi)


def robot_at(time_s: float, aside_m: float) -> tuple[float, float, float]:
    """x, y (m), yaw (rad)."""
    share = time_s / SECONDS
    slope = aside_m * math.pi / SECONDS * math.cos(math.pi * share) / SPEED_M_S
    return SPEED_M_S * time_s, aside_m * math.sin(math.pi * share), math.atan(slope)


def times(rate_hz: float = 10.0) -> np.ndarray:
    return np.arange(0.0, SECONDS + 1e-9, 1 / rate_hz)


def rows(rate_hz: float = 10.0) -> Iterator[tuple[str, str, float, float, float, float]]:
    """run, who, time (s), x, y (m), yaw (rad)."""
    for run, aside in RUNS.items():
        for t in times(rate_hz):
            yield (run, "robot", float(t), *robot_at(float(t), aside))
            yield (run, "anna", float(t), *ANNA)


def csv_of(heads: str, lines: Iterator[tuple[object, ...]] | list[tuple[object, ...]]) -> str:
    return heads + "\n" + "".join(",".join(map(str, line)) + "\n" for line in lines)


def refusal(read: Callable[[Path, Mapping], object], file: Path) -> str:
    """The file that a refusal names, "" where it is read. Anything else that is raised is a fault of the reader."""
    try:
        read(file, Mapping())
    except RecordingError as said:
        return said.file
    return ""

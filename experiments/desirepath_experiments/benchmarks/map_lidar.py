"""How many scans of a map a lidar takes in a second, and whether they are those of the same walls as boxes:
`desirepath benchmark lidar`."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from desirepath.simulation import kernels as k
from desirepath.simulation.fast import beams_of
from desirepath.simulation.ground_maps import GroundMap, framed
from desirepath.simulation.scene import Obstacle, Person, Pose, Scene
from desirepath.simulation.scenes import scene_to_row
from desirepath.simulation.setups import Setup, get_setup
from desirepath_experiments.benchmarks.results import Progress

ROUNDS = 15
POSES = 4_000
COMPARED = 300
WALL_CELLS = 2


@dataclass(frozen=True)
class LidarConfig:
    """The map and the lidar."""

    side_m: Annotated[float, Field(ge=2, le=100, description="Of the map, which is square.")] = 20.0
    cell_m: Annotated[float, Field(ge=0.01, le=0.5)] = 0.05
    beams: Annotated[int, Field(ge=1, le=7_200)] = 360
    sectors: Annotated[int, Field(ge=1, le=7_200)] = 36
    range_m: Annotated[float, Field(gt=0, le=100)] = 6.0
    seed: int = 0


def rooms(config: LidarConfig) -> GroundMap:
    """A floor with eight walls that have doors, and thirty blocks, on whole cells."""
    random, n = np.random.default_rng(config.seed), round(config.side_m / config.cell_m)
    occupied = np.zeros((n, n), dtype=np.bool_)
    occupied[:WALL_CELLS] = occupied[-WALL_CELLS:] = occupied[:, :WALL_CELLS] = occupied[:, -WALL_CELLS:] = True
    for wall in range(8):
        at, begin = int(random.integers(n // 10, n - n // 10)), int(random.integers(0, n // 2))
        along = np.zeros(n, dtype=np.bool_)
        along[begin : begin + int(random.integers(n // 5, n // 2))] = True
        door = int(random.integers(begin, begin + n // 5))
        along[door : door + max(1, round(1 / config.cell_m))] = False
        (occupied if wall % 2 else occupied.T)[at : at + WALL_CELLS, along] = True
    for _ in range(30):
        (i, j), (length, width) = (
            random.integers(n // 40, n - n // 10, 2),
            random.integers(n // 100 + 1, n // 20 + 1, 2),
        )
        occupied[i : i + length, j : j + width] = True
    half = config.side_m / 2
    return framed(occupied, np.zeros_like(occupied), config.cell_m, (-half, -half))


def poses_in(here: GroundMap, config: LidarConfig) -> NDArray[np.float64]:
    """(POSES, 3) anywhere with 0.3 m room, m and rad."""
    random = np.random.default_rng(config.seed)
    roomy = np.argwhere(here.apart_m > 0.3)
    cells = roomy[random.integers(len(roomy), size=POSES)]
    return np.column_stack([(cells + 0.5) * here.cell_m + here.origin, random.uniform(-np.pi, np.pi, POSES)])


def benchmark_lidar(config: LidarConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Scans per second of one thread, the best and the median of some rounds of the same scans; processor time.

    off_m: of single beams, how far they are from those that the same walls have as boxes, at the median and for 99 %:
    a ray that grazes a corner passes it in one and meets it in the other.
    """
    del progress
    here, plain = rooms(config), get_setup("study_room")
    lidar = replace(plain.robot.lidar, beams=config.beams, sectors=config.sectors, range_m=config.range_m)
    setup = replace(plain, robot=replace(plain.robot, lidar=lidar))
    poses, row, pooled = poses_in(here, config), _row(), beams_of(setup)
    k.seen_along(row, poses[:10], pooled, here.ground)  # compiles
    rates = []
    for _ in range(ROUNDS):
        begun = time.process_time()
        k.seen_along(row, poses, pooled, here.ground)
        rates.append(POSES / (time.process_time() - begun))
    off = _off_m(here, setup, poses[:COMPARED])
    return {
        "scans_per_s": max(rates),
        "median_scans_per_s": float(np.median(rates)),
        "off_m": {"median": float(np.median(off)), "p99": float(np.quantile(off, 0.99))},
        "map": {"side_m": config.side_m, "cell_m": config.cell_m, "walls": len(here.walls)},
        "lidar": {"beams": config.beams, "sectors": config.sectors, "range_m": config.range_m},
    }


def _row(*walls: Obstacle) -> k.Row:
    """A scene in which nothing stands but these walls and what its map has."""
    return scene_to_row(Scene("study_room", 0, Pose(0, 0), Pose(1, 1), 0.3, Person(Pose(1e6, 1e6)), walls))


def _off_m(here: GroundMap, setup: Setup, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(poses, beams) difference of a map's ranges and those of the same rectangles as boxes, m."""
    walls = [Obstacle("wall", Pose((a + c) / 2, (b + d) / 2), c - a, d - b, 2.0) for a, b, c, d in here.walls.tolist()]
    bare, boxed, beams = _row(), _row(*walls), beams_of(setup, pooled=False)
    off = np.empty((len(poses), beams.number))
    on_grid, on_boxes = np.empty(beams.number), np.empty(beams.number)
    for difference, (x, y, yaw) in zip(off, poses, strict=True):
        k.scan(bare, x, y, yaw, beams, on_grid, here.ground)
        k.scan(boxed, x, y, yaw, beams, on_boxes)
        difference[:] = np.abs(on_grid - on_boxes)
    return off

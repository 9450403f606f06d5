"""The flow field of a policy in one scene (thesis 6.4.6): where it would head, and roll out, from everywhere.

Here live the grid, the settled headings, the roll-outs from every cell and the difference of two fields, as numbers.
Pictures of them are drawn in `scene_plots.py`. A policy is anything that acts on observations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import kernels as k
from desirepath.simulation.acting import ActFunction, EpisodicPolicy, begin
from desirepath.simulation.fast import Floats, make_engine, rollout
from desirepath.simulation.scene import Pose, Scene, SceneError
from desirepath.simulation.scenes import check_scene, ground_of, scene_to_row
from desirepath.simulation.setups import CONTROL_DT_S, Setup, get_setup, require_same
from desirepath.simulation.trajectory import Outcome, Trajectory

Doubles = NDArray[np.float64]
Flags = NDArray[np.bool_]

CELL_M = 0.25  # thesis 6.4.6
SMALLEST_CELL_M, MOST_CELLS = 0.05, 20_000  # ours: beyond that a field takes minutes
MARGIN_M = 1.0  # ours: an open field is shown this far around everything in it
SETTLING_STEPS = 60  # ours: 12 s, six full turns at the fastest
WINDOW_STEPS = 30  # ours: an oscillation's range is taken over the last 6 s
STILL_STEPS, STILL_RAD = 10, 0.01  # ours: turned less than this within 2 s: settled, no need to wait any longer
PATH_POINTS_PER_CELL = 5  # ours: a rollout is looked at this often per cell, so that it jumps over no cell
NOTHING = -1
"""`outcome` of a cell that nothing was rolled out from."""


@dataclass(frozen=True)
class Grid:
    """Square cells of `cell_m`; cell (row, column) is centred at (xs[column], ys[row]), metres."""

    cell_m: float
    xs: Doubles
    ys: Doubles

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return len(self.ys), len(self.xs)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """left, right, bottom, top edge, metres."""
        half = self.cell_m / 2
        return float(self.xs[0] - half), float(self.xs[-1] + half), float(self.ys[0] - half), float(self.ys[-1] + half)

    def cells_of(self, points: Doubles) -> NDArray[np.int64]:
        """points (n, 2) -> (n,) index of the cell in row-major order, -1 outside the grid."""
        left, _, bottom, _ = self.extent
        column = np.floor((points[:, 0] - left) / self.cell_m).astype(np.int64)
        row = np.floor((points[:, 1] - bottom) / self.cell_m).astype(np.int64)
        rows, columns = self.shape
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.where(inside, row * columns + column, -1)


@dataclass(frozen=True)
class FlowField:
    """What a policy does in one scene; every array has the grid's shape (rows, columns).

    free: the robot's disc, centred in the cell, touches nothing. heading: rad in (-pi, pi], NaN where nothing is free
    or the robot never stops turning round. speed: m/s that it would drive with that heading, NaN likewise.
    oscillation: rad, the range in which the heading keeps swinging, 0 where it stands still, NaN where it turns round.
    outcome: how the rollout from there ended (`Outcome`), NOTHING where none began. traversals: how often they entered
    the cell, a rollout's first cell included; staying in a cell counts once, coming back counts again.
    """

    scene: Scene
    grid: Grid
    free: Flags
    heading: Floats
    speed: Floats
    oscillation: Floats
    outcome: NDArray[np.int8]
    traversals: NDArray[np.int32]

    @property
    def rollouts(self) -> int:
        """How many rollouts there were: one from every free cell outside the goal."""
        return int((self.outcome != NOTHING).sum())

    def share(self, outcome: Outcome) -> float:
        """The share of rollouts that ended like this; NaN without any."""
        return float((self.outcome == outcome).sum() / self.rollouts) if self.rollouts else math.nan

    def velocity(self) -> tuple[Floats, Floats]:
        """Components along x and y, m/s, of the vector field; NaN where there is none."""
        return self.speed * np.cos(self.heading), self.speed * np.sin(self.heading)

    def rows(self) -> Iterator[tuple[object, ...]]:
        """One row per cell, in the order of COLUMNS; empty where there is no value."""
        for (row, column), free in np.ndenumerate(self.free):
            outcome = int(self.outcome[row, column])
            yield (
                *_place(self.grid, row, column),
                int(free),
                *(_round(values.item(row, column)) for values in (self.heading, self.speed, self.oscillation)),
                "" if outcome == NOTHING else Outcome(outcome).name.lower(),
                int(self.traversals[row, column]),
            )


COLUMNS = (
    *("row", "column", "x_m", "y_m", "free"),
    *("heading_rad", "speed_m_s", "oscillation_rad", "outcome", "traversals"),
)
DIFFERENCE_COLUMNS = ("row", "column", "x_m", "y_m", "heading_difference_rad", "traversals_difference")


@dataclass(frozen=True)
class FlowDifference:
    """`second` against `first` in the same scene and grid.

    heading: (rows, columns) rad in (-pi, pi], by how much the heading turns from first to second, NaN where either has
    none. traversals: (rows, columns), second - first.
    """

    first: FlowField
    second: FlowField
    heading: Floats
    traversals: NDArray[np.int32]

    @property
    def mean_angle(self) -> float:
        """Mean absolute angle between the headings, rad, over the cells where both have one; NaN without any."""
        return float(np.nanmean(np.abs(self.heading))) if np.isfinite(self.heading).any() else math.nan

    def rows(self) -> Iterator[tuple[object, ...]]:
        """One row per cell, in the order of DIFFERENCE_COLUMNS."""
        for (row, column), angle in np.ndenumerate(self.heading):
            place = _place(self.first.grid, row, column)
            yield (*place, _round(float(angle)), int(self.traversals[row, column]))


def _place(grid: Grid, row: int, column: int) -> tuple[object, ...]:
    return row, column, round(float(grid.xs[column]), 6), round(float(grid.ys[row]), 6)


def _round(value: float) -> object:
    return round(float(value), 6) if math.isfinite(value) else ""


def grid_of(scene: Scene, cell_m: float = CELL_M) -> Grid:
    """The grid over a scene's room, or over everything in an open field and MARGIN_M around it.

    Cell edges lie at whole multiples of cell_m. Raises ValueError for a cell size that makes no sensible grid.
    """
    if not cell_m >= SMALLEST_CELL_M:
        raise ValueError(f"cell_m = {cell_m}: must be at least {SMALLEST_CELL_M} m")
    if scene.room is not None:
        reach = np.array([[scene.room.length, scene.room.width]]) / 2
        points = np.concatenate([-reach, reach])
    else:
        poses = (scene.start, scene.goal, scene.person.pose)
        corners = [corner for solid in scene.obstacles for corner in solid.corners()]
        points = np.array([*((pose.x, pose.y) for pose in poses), *corners])
        points = np.concatenate([points - MARGIN_M, points + MARGIN_M])
    # Rounded, so that a wall on a multiple of the cell does not add a row of cells behind it.
    low = np.floor(np.round(points.min(0) / cell_m, 6)).astype(int)
    high = np.ceil(np.round(points.max(0) / cell_m, 6)).astype(int)
    cells = int(np.prod(high - low))
    if cells > MOST_CELLS:
        raise ValueError(f"cell_m = {cell_m}: gives {cells} cells in this scene, at most {MOST_CELLS}; make it larger")
    xs, ys = ((np.arange(low[axis], high[axis]) + 0.5) * cell_m for axis in (0, 1))
    return Grid(cell_m, xs, ys)


def free_cells(scene: Scene, grid: Grid) -> Flags:
    """(rows, columns): whether the robot's disc, centred in the cell, overlaps neither box, wall nor person."""
    places = np.stack(np.meshgrid(grid.xs, grid.ys), axis=-1)
    free = np.zeros(places.shape[:2], dtype=np.bool_)
    k.mark_free(scene_to_row(scene), places, get_setup(scene.setup).robot.radius_m, free, ground_of(scene))
    return free


def flow_field(act: ActFunction | EpisodicPolicy, setup: Setup, scene: Scene, *, cell_m: float = CELL_M) -> FlowField:
    """The policy's flow field in one scene, all cells at once.

    Settling: in every free cell, first facing the goal, the robot follows the angular command alone. Its observation
    says what is true then: forward velocity 0, angular velocity the one just executed (where the setup observes
    velocities). It has settled when it turns less than STILL_RAD in STILL_STEPS; after SETTLING_STEPS the middle of
    the range of the last WINDOW_STEPS counts; a robot that never reverses within them turns round and has no heading.
    The goal ends nothing while settling. The speed is the forward command of a robot that stands there with its
    settled heading. Roll-outs begin standing with that heading (facing the goal where there is none), in every free
    cell outside the goal, and end as an episode does. A policy that remembers settles by what it does without memory.

    Raises SetupError where scene and setup differ, SceneError for a bad scene, ValueError for a bad cell size.
    """
    require_same(policy=setup.name, scene=scene.setup)
    if setup.robot.limits.v_min != 0:
        raise ValueError(
            f"setup {setup.name}: v_min = {setup.robot.limits.v_min}; a robot that cannot stand cannot settle"
        )
    check_scene(scene)
    grid = grid_of(scene, cell_m)
    free = free_cells(scene, grid)
    rows, columns = np.nonzero(free)
    places = np.stack([grid.xs[columns], grid.ys[rows]], axis=1)
    to_goal = np.array([scene.goal.x, scene.goal.y]) - places
    facing = np.arctan2(to_goal[:, 1], to_goal[:, 0])
    heading, oscillation, speed = _settle(act, setup, scene, places, facing)
    start = np.where(np.isnan(heading), facing, heading)
    outside = np.linalg.norm(to_goal, axis=1) > scene.goal_radius
    outcomes, traversals = _roll_out(act, setup, scene, grid, np.column_stack([places, start])[outside])

    def on_grid(values: Doubles) -> Floats:
        spread = np.full(grid.shape, np.nan, dtype=np.float32)
        spread[free] = values
        return spread

    outcome = np.full(grid.shape, NOTHING, dtype=np.int8)
    outcome[rows[outside], columns[outside]] = outcomes
    return FlowField(scene, grid, free, on_grid(heading), on_grid(speed), on_grid(oscillation), outcome, traversals)


def _settle(
    act: ActFunction | EpisodicPolicy, setup: Setup, scene: Scene, places: Doubles, facing: Doubles
) -> tuple[Doubles, Doubles, Doubles]:
    """Heading, oscillation (rad) and speed (m/s) of robots at places (n, 2): (n,) each, NaN where one never settles."""
    n = len(places)
    if n == 0:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    still_scene = replace(scene, goal_radius=1e-9)  # nothing arrives while it only turns
    engine = make_engine(setup, n, auto_reset=False, scenes=[still_scene] * n)
    engine.start_at(np.column_stack([places, facing]))
    turned = np.zeros((SETTLING_STEPS + 1, n))  # unwrapped, since the beginning
    turning = np.ones(n, dtype=np.bool_)
    actions = np.zeros((n, 2), dtype=np.float32)
    actions[:, 0] = -1.0  # stand
    last = np.zeros(n, dtype=np.int64)  # step at which each one was looked at last
    for step in range(1, SETTLING_STEPS + 1):
        moving = np.flatnonzero(turning)
        if not len(moving):
            break
        actions[:, 1] = 0.0
        actions[moving, 1] = np.clip(begin(act, n, engine)(engine.observations[moving], moving)[:, 1], -1.0, 1.0)
        before = engine.poses[moving, 2].copy()
        engine.step(actions)
        turned[step] = turned[step - 1]
        turned[step, moving] += _wrap(engine.poses[moving, 2] - before)
        last[moving] = step
        if step >= STILL_STEPS:
            recent = turned[step - STILL_STEPS : step + 1, moving]
            turning[moving] = np.ptp(recent, axis=0) > STILL_RAD
    heading, oscillation = np.empty(n), np.zeros(n)
    heading[:] = facing + turned[last, np.arange(n)]
    swinging = np.flatnonzero(turning)
    window = turned[-WINDOW_STEPS - 1 :, swinging]
    steps = np.diff(window, axis=0)
    round_and_round = ~((steps > 0).any(axis=0) & (steps < 0).any(axis=0)) | (np.ptp(window, axis=0) >= 2 * math.pi)
    middle = (window.min(axis=0) + window.max(axis=0)) / 2
    heading[swinging] = np.where(round_and_round, np.nan, facing[swinging] + middle)
    oscillation[swinging] = np.where(round_and_round, np.nan, np.ptp(window, axis=0))
    heading = _wrap(heading)
    known = np.flatnonzero(np.isfinite(heading))
    observed = engine.start_at(np.column_stack([places, np.where(np.isnan(heading), facing, heading)]))
    limits, speed = setup.robot.limits, np.full(n, np.nan)
    if len(known):
        forward = np.clip(begin(act, n, engine)(observed[known], known)[:, 0], -1.0, 1.0)
        speed[known] = limits.v_min + (forward + 1) / 2 * (limits.v_max - limits.v_min)
    return heading, oscillation, speed


def _roll_out(
    act: ActFunction | EpisodicPolicy, setup: Setup, scene: Scene, grid: Grid, poses: Doubles
) -> tuple[NDArray[np.int8], NDArray[np.int32]]:
    """Roll out from every pose (n, 3) to the end: outcomes (n,) and how often each cell was entered (rows, columns)."""
    counts = np.zeros(grid.shape[0] * grid.shape[1], dtype=np.int64)
    n = len(poses)
    if n == 0:
        return np.zeros(0, dtype=np.int8), counts.astype(np.int32).reshape(grid.shape)
    engine = make_engine(setup, n, auto_reset=False, scenes=[scene] * n)
    engine.start_at(poses)
    cells = grid.cells_of(poses[:, :2])
    np.add.at(counts, cells, 1)
    points = max(1, math.ceil(setup.robot.limits.v_max * CONTROL_DT_S / (grid.cell_m / PATH_POINTS_PER_CELL)))
    actions = np.zeros((n, 2), dtype=np.float32)
    steer = begin(act, n, engine)
    while not engine.dones.all():
        running = np.flatnonzero(~engine.dones)
        actions[running] = steer(engine.observations[running], running)
        before = engine.poses[running, :2].copy()
        engine.step(actions)
        step = engine.poses[running, :2] - before
        for part in range(1, points + 1):
            now = grid.cells_of(before + step * (part / points))
            entered = (now != cells[running]) & (now >= 0)
            np.add.at(counts, now[entered], 1)
            cells[running] = now
    return engine.outcomes.copy(), counts.astype(np.int32).reshape(grid.shape)


def _wrap(angle: Doubles) -> Doubles:
    """The same angles in (-pi, pi]."""
    return -((-angle + math.pi) % (2 * math.pi) - math.pi)


def difference(first: FlowField, second: FlowField) -> FlowDifference:
    """`second` against `first`. Raises ValueError unless both show the same scene on the same grid."""
    if first.scene != second.scene or first.grid.shape != second.grid.shape or first.grid.cell_m != second.grid.cell_m:
        raise ValueError(
            f"fields of two scenes or grids: {first.scene.setup} {first.scene.seed} with cells of "
            f"{first.grid.cell_m} m, {second.scene.setup} {second.scene.seed} with {second.grid.cell_m} m"
        )
    turn = _wrap(second.heading.astype(np.float64) - first.heading)
    return FlowDifference(first, second, turn.astype(np.float32), second.traversals - first.traversals)


def spread_starts(scene: Scene, count: int) -> list[Scene]:
    """The scene with `count` starts: its own, then each time the free cell farthest from all starts and the goal.

    Every start faces the goal and can reach it; fewer come back where the scene has no more such cells.
    """
    if count < 1:
        raise ValueError(f"count = {count}: must be at least 1")
    grid = grid_of(scene)
    rows, columns = np.nonzero(free_cells(scene, grid))
    places = np.stack([grid.xs[columns], grid.ys[rows]], axis=1)
    goal = np.array([scene.goal.x, scene.goal.y])
    apart = np.linalg.norm(places - goal, axis=1)
    chosen = [scene]
    apart = np.minimum(apart, np.linalg.norm(places - (scene.start.x, scene.start.y), axis=1))
    while len(chosen) < count and apart.size and apart.max() > scene.goal_radius:
        farthest = int(apart.argmax())
        x, y = places[farthest]
        yaw = math.atan2(goal[1] - y, goal[0] - x)
        candidate = replace(scene, start=Pose(float(x), float(y), yaw))
        try:
            check_scene(candidate)
        except SceneError:  # a pocket that nothing leads out of
            apart[farthest] = 0.0
            continue
        chosen.append(candidate)
        apart = np.minimum(apart, np.linalg.norm(places - places[farthest], axis=1))
    return chosen


def rollouts_from(
    acts: Mapping[str, ActFunction | EpisodicPolicy], setup: Setup, starts: Sequence[Scene]
) -> dict[str, list[Trajectory]]:
    """Every policy, by name, from every start: one trajectory per start, in order."""
    return {name: rollout(setup, act, starts) for name, act in acts.items()}

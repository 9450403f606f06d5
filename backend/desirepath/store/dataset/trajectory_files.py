"""The trajectories of a data set: NPZ files, episodes, rows, metrics, control steps. Which: `writing.py` decides."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from desirepath.simulation.observation_bounds import ACTION_SIZE
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.dataset.columns import FLOATS, TRAJECTORY_FOLDER, VIDEO_FOLDER, video_name
from desirepath.store.dataset.minari_episodes import MinariWriter
from desirepath.store.dataset.preference_pairs import prompt_of, text_of
from desirepath.store.dataset.tables import STEPS
from desirepath.store.models import TrajectoryRow

Row = dict[str, Any]
STEPS_AT_ONCE = 4096  # rows of a row group
MEASURED = {
    "time_s": "time",
    "path_length_m": "path_length",
    "mean_speed_m_per_s": "mean_speed",
    "accumulated_angle_rad": "accumulated_angle",
    "min_human_distance_m": "min_human_distance",
    "min_obstacle_distance_m": "min_obstacle_distance",
    "path_area_m2": "path_area",
    "straight_distance_m": "straight_distance",
    "relative_path_length": "relative_path_length",
}
"""Column of the table of metrics -> field of `TrajectoryMetrics`."""
SOCIAL = {
    "personal_space_violations": "personal_space_violations",
    "personal_space_time_s": "personal_space_time",
    "min_time_to_collision_s": "min_time_to_collision",
    "stalled_time_s": "stalled_time",
    "mean_jerk_m_per_s3": "mean_jerk",
    "path_irregularity_rad_per_m": "path_irregularity",
    "spl": "spl",
}
"""Column of the table of metrics -> field of `SocialMetrics`."""


@dataclass
class WrittenTrajectories:
    """rows, metrics: of the tables `trajectories` and `trajectory_metrics`. steps: rows of the table of steps.
    prompts: scene hash -> text; texts: trajectory -> text, for preference pairs."""

    rows: list[Row] = field(default_factory=list)
    metrics: list[Row] = field(default_factory=list)
    steps: int = 0
    prompts: dict[str, str] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)


def write_trajectories(files: ArtefactStore, stored: Sequence[TrajectoryRow], out: Path) -> WrittenTrajectories:
    """Write the NPZ files, Minari's episodes and the table of steps into the data set's folder. Raises ArtefactError if
    a file is gone."""
    (out / TRAJECTORY_FOLDER).mkdir()
    written, episodes = WrittenTrajectories(), MinariWriter(out)
    with pq.ParquetWriter(out / f"{STEPS.name}.parquet", STEPS.schema()) as writer:
        waiting: list[pa.Table] = []
        for row in stored:
            content = files.get(row.id)
            (out / TRAJECTORY_FOLDER / f"{row.id}.npz").write_bytes(content)
            trajectory = Trajectory.from_bytes(content)
            if (shown := trajectory.recorded.video if trajectory.recorded else None) is not None:
                (out / VIDEO_FOLDER).mkdir(exist_ok=True)
                (out / VIDEO_FOLDER / video_name(shown)).write_bytes(files.get(shown.sha256))
            written.rows.append(_row(row, trajectory))
            written.metrics.append(_metrics(row.id, trajectory))
            written.prompts.setdefault(row.scene_hash, prompt_of(trajectory))
            written.texts[row.id] = text_of(trajectory)
            episodes.add(row, trajectory)
            waiting.append(_steps(row.id, trajectory))
            written.steps += row.steps
            if sum(map(len, waiting)) >= STEPS_AT_ONCE:
                writer.write_table(pa.concat_tables(waiting).combine_chunks())
                waiting = []
        writer.write_table(pa.concat_tables([*waiting, STEPS.schema().empty_table()]).combine_chunks())
    episodes.close()
    return written


def _row(row: TrajectoryRow, trajectory: Trajectory) -> Row:
    return {
        "trajectory": row.id,
        "setup": row.setup,
        "scene_hash": row.scene_hash,
        "scene": json.dumps(trajectory.scene.as_dict(), sort_keys=True),
        "outcome": Outcome(row.outcome).name.lower(),
        "steps": row.steps,
        "dt_s": trajectory.dt,
        "robot_radius_m": get_setup(row.setup).robot.radius_m,
        "duration_s": row.duration_s,
        "self_intersections": trajectory.self_intersections,
        "made_by": row.made_by,
        "created_at": row.created_at,
    }


def _metrics(trajectory_id: str, trajectory: Trajectory) -> Row:
    if trajectory.recorded is not None and "poses" not in trajectory.recorded.has:  # nobody measures a video
        unknown = dict.fromkeys((*MEASURED, *SOCIAL)) | {"time_s": trajectory.duration_s}
        return {"trajectory": trajectory_id, "outcome": Outcome(trajectory.outcome).name.lower(), **unknown}
    from desirepath.analysis.metrics import measure  # brings the simulator, which a start need not wait for

    metrics = measure([trajectory])
    values = {column: float(getattr(metrics, name)[0]) for column, name in MEASURED.items()}
    values |= {column: float(getattr(metrics.social, name)[0]) for column, name in SOCIAL.items()}
    return {
        "trajectory": trajectory_id,
        "outcome": Outcome(trajectory.outcome).name.lower(),
        **{column: value if math.isfinite(value) else None for column, value in values.items()},
    }


def _steps(trajectory_id: str, trajectory: Trajectory) -> pa.Table:
    """A row per control step, in the columns of `STEPS`."""
    count = len(trajectory.actions)
    steps = np.arange(count)
    poses, actions = trajectory.poses.astype(np.float64), trajectory.actions.astype(np.float64)
    if not actions.shape[1]:  # not recorded: no numbers
        actions = np.full((count, ACTION_SIZE), np.nan)
    columns: dict[str, Any] = {
        "trajectory": pa.array([trajectory_id] * count, pa.string()),
        "step": steps,
        "time_s": steps * trajectory.dt,
        **{name: poses[:-1, k] for k, name in enumerate(("x_m", "y_m", "yaw_rad"))},
        **{name: poses[1:, k] for k, name in enumerate(("next_x_m", "next_y_m", "next_yaw_rad"))},
        "action_linear": actions[:, 0],
        "action_angular": actions[:, 1],
        "reward": trajectory.rewards.astype(np.float64),
        "done": trajectory.dones.astype(np.bool_),
        "observation": _lists(trajectory.observations),
        "next_observation": _lists(trajectory.next_observations),
    }
    schema = STEPS.schema()
    return pa.Table.from_arrays(
        [pa.array(columns[column.name], column.type, from_pandas=True) for column in schema], schema=schema
    )


def _lists(values: np.ndarray[Any, Any]) -> pa.Array:
    """(steps, n) as a list of n numbers per step."""
    flat = pa.array(np.ascontiguousarray(values, dtype=np.float32).ravel())
    offsets = np.arange(len(values) + 1, dtype=np.int32) * values.shape[1]
    return pa.ListArray.from_arrays(pa.array(offsets), flat, type=FLOATS)

"""The trajectories of a data set as episodes that Minari opens: one Minari dataset per setup, in its Parquet format.

Written without Minari, which studies need not install; that it opens them is tested with it. Which trajectories there
are, and their exact arrays, are `trajectory_files.py`'s.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from desirepath.simulation.observation_bounds import ACTION_SIZE, observation_bounds
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.store.models import TrajectoryRow

FOLDER = "minari"
NAMESPACE = "desirepath"
MINARI_VERSION = "0.5.4"  # whose format this is


class MinariWriter:
    """Writes episodes as they come into `out`; `close` says of every setup what there is.

    `MINARI_DATASETS_PATH=OUT/minari`, then `minari.load_dataset("desirepath/SETUP-v0")`.
    """

    def __init__(self, out: Path) -> None:
        self._folder = out / FOLDER / NAMESPACE
        self._steps: dict[str, list[int]] = {}
        self._bytes: dict[str, int] = {}

    def add(self, row: TrajectoryRow, trajectory: Trajectory) -> None:
        """One more episode of its setup; none of a rollout that was kept without its observations."""
        if not trajectory.observations.shape[1]:
            return
        of_setup = self._steps.setdefault(row.setup, [])
        number = len(of_setup)
        folder = self._data(row.setup) / str(number)
        folder.mkdir(parents=True)
        pq.write_table(_episode(trajectory), folder / "part-0.parquet")
        of_setup.append(len(trajectory.actions))
        metadata = {
            "id": number,
            "total_steps": len(trajectory.actions),
            "trajectory": row.id,
            "scene_hash": row.scene_hash,
            "outcome": Outcome(row.outcome).name.lower(),
            "made_by": row.made_by,
        }
        _write(folder / "metadata.json", metadata)
        self._bytes[row.setup] = self._bytes.get(row.setup, 0) + (folder / "part-0.parquet").stat().st_size

    def close(self) -> None:
        """Write each setup's metadata."""
        for name, steps in self._steps.items():
            metadata = {
                "dataset_id": f"{NAMESPACE}/{name}-v0",
                "total_episodes": len(steps),
                "total_steps": sum(steps),
                "data_format": "parquet",
                "jpeg_encoding": False,
                "observation_space": json.dumps(_box(*observation_bounds(get_setup(name)))),
                "action_space": json.dumps(_box(-np.ones(ACTION_SIZE), np.ones(ACTION_SIZE))),
                "minari_version": MINARI_VERSION,
                "dataset_size": round(self._bytes[name] / 1e6, 1),  # MB, as Minari counts
                "description": f"Rollouts shown in a study, setup {name}: control steps of 0.2 s, core reward.",
            }
            _write(self._data(name) / "metadata.json", metadata)

    def _data(self, setup: str) -> Path:
        return self._folder / f"{setup}-v0" / "data"


def _episode(trajectory: Trajectory) -> pa.Table:
    """One more observation than steps, so that of the rest the last row is none (Minari leaves it out).

    Ends are terminations, running out of steps as well, for which the core reward charges; a rollout that was cut
    before its end is truncated. infos: the robot's pose at each observation.
    """
    steps = len(trajectory.actions)
    ended = np.append(trajectory.dones, False)
    cut = np.zeros(steps + 1, dtype=bool)
    cut[max(0, steps - 1)] = not trajectory.dones.any()
    observations = np.concatenate([trajectory.observations, trajectory.next_observations[-1:]])
    shape = {"shape": b"3"}
    poses = _rows(trajectory.poses)
    return pa.table(
        {
            "observations": _rows(observations),
            "actions": _rows(np.concatenate([trajectory.actions, np.zeros((1, ACTION_SIZE))])),
            "rewards": np.append(trajectory.rewards, 0).astype(np.float64),
            "terminations": ended,
            "truncations": cut,
            "infos": pa.StructArray.from_arrays([poses], fields=[pa.field("pose", poses.type, metadata=shape)]),
        }
    )


def _rows(values: NDArray[Any]) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(values, dtype=np.float32).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _box(low: NDArray[Any], high: NDArray[Any]) -> dict[str, Any]:
    """A Gymnasium box as Minari writes it."""
    ends = {"low": low.astype(np.float32).tolist(), "high": high.astype(np.float32).tolist()}
    return {"type": "Box", "dtype": "float32", "shape": list(low.shape), **ends}


def _write(path: Path, metadata: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(metadata, sort_keys=True) + "\n", encoding="utf-8", newline="")

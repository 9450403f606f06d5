"""Trajectories out again, for the tools of others: a file each as SocNav3 or MCAP, or all as one LeRobotDataset v3."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from desirepath.recordings.bags import MCAP, to_mcap
from desirepath.recordings.episodes import INFO, LEROBOT, LEROBOT_VERSION
from desirepath.recordings.resampling import body_speeds
from desirepath.recordings.socnav3 import FORMAT as SOCNAV3
from desirepath.recordings.socnav3 import to_socnav3
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Trajectory

ExportFormat = Literal["socnav3", "mcap", "lerobot"]
TASK = "drive to the goal past people"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
PLACE = ["x", "y", "yaw"]
Doubles = NDArray[np.float64]


def export_trajectories(trajectories: Sequence[Trajectory], kind: ExportFormat, out: Path) -> list[str]:
    """Write them into an empty or new folder; the names of the files. Raises ValueError for none, or another folder."""
    if not trajectories:
        raise ValueError("trajectories: none to export")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"--out {out}: must be a new or an empty folder")
    out.mkdir(parents=True, exist_ok=True)
    if kind == LEROBOT:
        _write_lerobot(trajectories, out)
    else:
        suffix, to_bytes = _FORMATS[kind]
        for number, one in enumerate(trajectories):
            (out / f"{number:04d}_{one.digest()[:12]}{suffix}").write_bytes(to_bytes(one))
    return sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())


def unlike(trajectories: Iterable[Trajectory]) -> list[Trajectory]:
    """Each once, in order: pairs share trajectories."""
    return list({one.digest(): one for one in trajectories}.values())


def _socnav3(one: Trajectory) -> bytes:
    radius = get_setup(one.scene.setup).robot.radius_m
    return json.dumps(to_socnav3(one, radius), allow_nan=False).encode()


_FORMATS: dict[str, tuple[str, Callable[[Trajectory], bytes]]] = {
    SOCNAV3: (".json", _socnav3),
    MCAP: (".mcap", to_mcap),
}


# ---- LeRobotDataset v3 -----------------------------------------------------------------------------------------------


def _write_lerobot(trajectories: Sequence[Trajectory], out: Path) -> None:
    """A frame per pose. observation.state: x, y (m), yaw (rad); observation.velocity: ahead, to the left (m/s), turning
    (rad/s), between poses; observation.person: as the state, where every scene has one. Where each is from, and its
    scene, is in meta/desirepath.json."""
    lengths = [len(one.poses) for one in trajectories]
    poses = [one.poses.astype(np.float64) for one in trajectories]
    values = {
        "observation.state": np.concatenate(poses),
        "observation.velocity": np.concatenate([body_speeds(of, CONTROL_DT_S) for of in poses]),
    }
    names = {"observation.state": PLACE, "observation.velocity": ["ahead", "left", "turning"]}
    if all(one.scene.has_person for one in trajectories):
        values["observation.person"] = np.concatenate([one.scene.person_poses(one.times) for one in trajectories])
        names["observation.person"] = PLACE
    episode = np.repeat(np.arange(len(lengths)), lengths)
    frame = np.concatenate([np.arange(n) for n in lengths])
    indices = {"frame_index": frame, "episode_index": episode, "index": np.arange(len(frame)), "task_index": 0 * frame}
    columns: dict[str, pa.Array] = {
        name: pa.FixedSizeListArray.from_arrays(pa.array(of.astype(np.float32).ravel()), of.shape[1])
        for name, of in values.items()
    }
    columns["timestamp"] = pa.array((frame * CONTROL_DT_S).astype(np.float32))
    columns |= {name: pa.array(of.astype(np.int64)) for name, of in indices.items()}
    _write(pa.table(columns), out / DATA.format(chunk_index=0, file_index=0))
    features: dict[str, Any] = {name: {"dtype": "float32", "shape": [3], "names": names[name]} for name in values} | {
        "timestamp": {"dtype": "float32", "shape": [1], "names": None}
    }
    features |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in indices}
    flat = values | {name: of[:, None] for name, of in indices.items()} | {"timestamp": frame[:, None] * CONTROL_DT_S}
    ends = list(accumulate(lengths))
    number = pa.int64()
    zeros = pa.array([0] * len(lengths), number)
    _write(
        pa.table(
            {
                "episode_index": pa.array(range(len(lengths)), number),
                "tasks": pa.array([[TASK]] * len(lengths), pa.list_(pa.string())),
                "length": pa.array(lengths, number),
                "dataset_from_index": pa.array([end - n for end, n in zip(ends, lengths, strict=True)], number),
                "dataset_to_index": pa.array(ends, number),
                **{f"{of}/{part}_index": zeros for of in ("data", "meta/episodes") for part in ("chunk", "file")},
            }
        ),
        out / EPISODES,
    )
    _write_tasks(out / "meta" / "tasks.parquet")
    about = {
        "codebase_version": LEROBOT_VERSION,
        "robot_type": get_setup(trajectories[0].scene.setup).robot.name,
        "total_episodes": len(lengths),
        "total_frames": len(frame),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": round(1 / CONTROL_DT_S),
        "splits": {"train": f"0:{len(lengths)}"},
        "data_path": DATA,
        "video_path": None,
        "features": features,
    }
    _write_json(about, out / INFO)
    _write_json({name: _stats(of) for name, of in flat.items()}, out / "meta" / "stats.json")
    described = [
        {
            "trajectory": one.digest(),
            "scene": one.scene.as_dict(),
            "recorded": one.recorded.as_dict() if one.recorded else None,
        }
        for one in trajectories
    ]
    _write_json({"episodes": described}, out / "meta" / "desirepath.json")


def _stats(values: NDArray[Any]) -> dict[str, list[float]]:
    """Of (n, k): what lerobot normalises by."""
    found = {name: getattr(values, name)(axis=0).astype(float).tolist() for name in ("min", "max", "mean", "std")}
    quantiles = {f"q{share:02d}": np.quantile(values, share / 100, axis=0).tolist() for share in (1, 10, 50, 90, 99)}
    return {**found, "count": [len(values)], **quantiles}


def _write_tasks(path: Path) -> None:
    """The texts of tasks are the table's index, as pandas says it in a Parquet file."""

    def column(name: str, kind: str, of: str) -> dict[str, Any]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": of, "metadata": None}

    said = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": pa.array([TASK])})
    _write(table.replace_schema_metadata({"pandas": json.dumps(said)}), path)


def _write(table: pa.Table, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)


def _write_json(data: dict[str, Any], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data, sort_keys=True, indent=1) + "\n", encoding="utf-8", newline="")

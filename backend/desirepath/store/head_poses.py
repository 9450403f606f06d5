"""How heads moved in headsets: what a part of a recording may be, and its way into a data set and back.

What a row holds stands in `models`, what its columns mean in `tables.yaml`. Which parts a session takes is
`study/session/head_poses.py`'s.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.store.dataset.rows import stored_columns
from desirepath.store.dataset.tables import HEAD_POSES
from desirepath.store.models import HeadPose

Row = dict[str, Any]
POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
MOST_SAMPLES = 400  # of a part; ours: client/head_pose.js sends 150
LONGEST_S = 30.0  # of a part; ours
FASTEST_HZ = 45.0  # ours; 30 are recorded
SLACK = 10  # samples that may come faster, after a picture that came late
FARTHEST_M = 1_000.0  # ours; no scene is as large
ABOUT_ONE = 0.01  # how far a quaternion may be from length 1


class HeadPoseError(ValueError):
    """A recording of a data set that no head can have made."""


def samples_problem(times_s: Sequence[float], poses: Sequence[Sequence[float]]) -> str | None:
    """What no head can have done: times from 0, rising, not denser than they are recorded; positions in metres and
    unit quaternions (x, y, z, w). None: nothing."""
    if not 1 <= len(times_s) == len(poses) <= MOST_SAMPLES or any(len(pose) != len(POSE) for pose in poses):
        return f"must have as many times as poses of {len(POSE)} numbers, 1 to {MOST_SAMPLES}"
    if not all(math.isfinite(value) for numbers in (times_s, *poses) for value in numbers):
        return "must be finite numbers"
    if times_s[0] != 0 or any(later <= earlier for earlier, later in itertools.pairwise(times_s)):
        return "times_s must begin with 0 and rise"
    if times_s[-1] > LONGEST_S:
        return f"lasts {times_s[-1]:.1f} s, at most {LONGEST_S:.0f} s"
    if len(times_s) > SLACK + FASTEST_HZ * times_s[-1]:
        return f"has {len(times_s)} poses in {times_s[-1]:.2f} s, at most {FASTEST_HZ:.0f} a second"
    if any(abs(value) > FARTHEST_M for pose in poses for value in pose[:3]):
        return f"positions must be within {FARTHEST_M:.0f} m"
    if any(abs(math.hypot(*pose[3:]) - 1) > ABOUT_ONE for pose in poses):
        return "orientations must be unit quaternions"
    return None


def head_pose_rows(s: Session, sessions: Mapping[str, Any], of_session: Callable[[str], Row]) -> Iterator[Row]:
    """Rows of the table `head_poses` of these sessions (by id), in the sessions' order; one part at a time is read."""
    for session_id in sessions:
        parts = select(HeadPose).where(HeadPose.session_id == session_id)
        for stored in s.scalars(parts.order_by(HeadPose.created_at, HeadPose.wearing, HeadPose.part)):
            poses = zip(*stored.recorded["poses"], strict=True)
            yield {
                **stored_columns(HEAD_POSES, stored),
                **of_session(session_id),
                "step": stored.step_key,
                "trial": stored.trial_id,
                "times_s": np.array(stored.recorded["times_s"], dtype=np.float32),
                **{name: np.array(values, dtype=np.float32) for name, values in zip(POSE, poses, strict=True)},
            }


def add_head_poses(s: Session, rows: Iterable[Row]) -> None:
    """Import rows of the table `head_poses`. Raises HeadPoseError for what no head can have done."""
    for row in rows:
        columns = [row[name] or [] for name in POSE]
        if len({len(column) for column in columns}) != 1:
            raise HeadPoseError("head_poses.parquet: columns of a part have different lengths")
        poses = [list(pose) for pose in zip(*columns, strict=True)]
        times = row["times_s"] or []
        if problem := samples_problem(times, poses):
            raise HeadPoseError(f"head_poses.parquet: part {row['part']}: {problem}")
        s.add(
            HeadPose(
                session_id=row["session"],
                step_key=row["step"],
                trial_id=row["trial"],
                samples=len(times),
                recorded={"times_s": times, "poses": poses},
                **{name: row[name] for name in HEAD_POSES.kept_in(HeadPose)},
            )
        )
    s.flush()

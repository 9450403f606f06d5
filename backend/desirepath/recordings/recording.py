"""One run of a robot as somebody recorded it, before it becomes a trajectory; what goes wrong with files; how large
they may be. No file is read here.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
MIB = 2**20


class RecordingError(ValueError):
    """A recording that cannot be used: names file, place, value and what would work."""

    def __init__(self, file: str, where: str, value: object, problem: str) -> None:
        self.file, self.where, self.value, self.problem = file, where, value, problem
        place = f"{file}, {where}" if where else file
        given = "" if value is None else f" = {_short(value)}"
        super().__init__(f"{place}{given}: {problem}")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


@dataclass(frozen=True)
class Bounds:
    """How much is read, all ours. file_bytes: of a file that is read as a whole, bag_bytes: of one that is not;
    all_bytes: of all of an import; unpacked_bytes: of what is compressed; rows: of a table, messages of a topic;
    poses: in all messages of a bag;
    runs, people, things: of a recording; run_s: how long a run may be: people watch it to its end; gap_s: how long
    nothing may be known of a robot, over that it is not one run.
    """

    files: int = 2_000
    file_bytes: int = 512 * MIB
    bag_bytes: int = 8_192 * MIB
    all_bytes: int = 16_384 * MIB
    json_bytes: int = 64 * MIB
    unpacked_bytes: int = 16_384 * MIB
    rows: int = 2_000_000
    poses: int = 2_000_000
    topics: int = 500
    message_bytes: int = 16 * MIB
    runs: int = 2_000
    people: int = 21  # with the scene's own, as many as a crowd may have
    things: int = 500
    run_s: float = 300.0
    gap_s: float = 1.0
    reach_m: float = 10_000.0  # from the origin: farther away, float32 poses are coarser than a millimetre
    fastest_m_s: float = 15.0


BOUNDS = Bounds()


@dataclass(frozen=True)
class Source:
    """Where it was read. file: its name; sha256: of its bytes."""

    file: str
    format: str
    sha256: str


@dataclass(frozen=True)
class Track:
    """Somebody's or something's way. times_s (n,): rising; poses (n, 3): x, y (m), yaw (rad; NaN: not recorded)."""

    times_s: Doubles
    poses: Doubles


@dataclass(frozen=True)
class Thing:
    """An oriented box on the floor, m and rad. height: None where it was not recorded."""

    kind: str
    x: float
    y: float
    yaw: float
    length: float
    width: float
    height: float | None = None


@dataclass(frozen=True)
class Goal:
    """Where the robot was to go. radius: m, None where it was not recorded."""

    x: float
    y: float
    yaw: float = 0.0
    radius: float | None = None


@dataclass(frozen=True)
class Recording:
    """One run. scene: runs of the same name were made in the same place. people: by their ids. also: further parts of
    `simulation.recorded.PARTS` that the file has and that are not imported. how: what its reader did, in sentences.
    """

    source: Source
    run: str
    scene: str
    robot: Track
    people: Mapping[str, Track] = field(default_factory=dict)
    things: tuple[Thing, ...] = ()
    goal: Goal | None = None
    how: tuple[str, ...] = ()


def read_bounded(path: Path, most: int = BOUNDS.file_bytes) -> bytes:
    """A file's bytes. Raises RecordingError for none, an empty one, or more than `most`."""
    try:
        if not path.is_file():
            raise RecordingError(path.name, "", None, "is no file; name a file or a folder of them")
        size = path.stat().st_size
        if size == 0:
            raise RecordingError(path.name, "", None, "is empty (0 bytes)")
        if size > most:
            raise RecordingError(path.name, "bytes", size, f"at most {most} are read; cut or thin the recording")
        with path.open("rb") as opened:
            content = opened.read(most + 1)
    except OSError as problem:
        raise RecordingError(path.name, "", None, f"cannot be read: {problem.strerror}") from None
    if len(content) > most:
        raise RecordingError(path.name, "bytes", len(content), f"at most {most} are read; cut or thin the recording")
    return content


def file_sha256(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def sha256_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def track(
    file: str,
    who: str,
    times_s: Doubles,
    poses: Doubles,
    where: Callable[[int], str],
    *,
    bounds: Bounds = BOUNDS,
    gaps: bool = False,
) -> Track:
    """A checked track of times (n,) and poses (n, 3), rows at one time and place once. where: says in which line or
    message row k stands. gaps: whether it may be away meanwhile, as people may.

    Raises RecordingError for numbers that are not finite (a yaw may be NaN throughout), time that goes back, places
    beyond reach and jumps that no robot or person makes.
    """
    for name, values in (("time", times_s), ("x", poses[:, 0]), ("y", poses[:, 1])):
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            k = int(wrong[0])
            raise RecordingError(
                file, f"{where(k)}, {name} of {who}", float(values[k]), "must be a finite number; leave such rows out"
            )
    known = np.isfinite(poses[:, 2])
    if known.any() and not known.all():
        k = int(np.flatnonzero(~known)[0])
        raise RecordingError(
            file, f"{where(k)}, yaw of {who}", float(poses[k, 2]), "is known elsewhere; give it everywhere or nowhere"
        )
    far = np.flatnonzero(np.abs(poses[:, :2]).max(axis=1) > bounds.reach_m)
    if len(far):
        k = int(far[0])
        raise RecordingError(
            file,
            f"{where(k)}, place of {who}",
            [float(v) for v in poses[k, :2]],
            f"more than {bounds.reach_m:g} m from the origin; is the frame a map's, the unit metres? "
            "`origin: [x, y]` in the mapping is subtracted",
        )
    steps = np.diff(times_s)
    back = np.flatnonzero(steps < 0)
    if len(back):
        k = int(back[0]) + 1
        raise RecordingError(
            file,
            f"{where(k)}, time of {who}",
            float(times_s[k]),
            f"goes back from {times_s[k - 1]:.6g} s; sort by time",
        )
    same = np.flatnonzero(steps == 0) + 1
    differs = same[np.abs(poses[same, :2] - poses[same - 1, :2]).max(axis=1) > 1e-6] if len(same) else same
    if len(differs):
        k = int(differs[0])
        problem = f"{who} is at two places at one time; are there two of that name, or runs that are not named apart?"
        raise RecordingError(file, f"{where(k)}, time of {who}", float(times_s[k]), problem)
    kept = np.concatenate([[0], np.flatnonzero(steps > 0) + 1]) if len(times_s) else np.zeros(0, dtype=np.int64)
    times_s, poses = times_s[kept], poses[kept]
    waits = np.diff(times_s)
    long = np.flatnonzero(waits > bounds.gap_s)
    if len(long) and not gaps:
        k = int(long[0]) + 1
        raise RecordingError(
            file,
            f"{where(int(kept[k]))}, time of {who}",
            float(times_s[k]),
            f"nothing is known of {who} for {waits[k - 1]:.3g} s before; at most {bounds.gap_s:g} s, so cut there: a "
            "run each (`runs` in the mapping, or a column run)",
        )
    moved = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    fast = np.flatnonzero(moved > bounds.fastest_m_s * np.maximum(waits, 0.02))
    if len(fast):
        k = int(fast[0]) + 1
        raise RecordingError(
            file,
            f"{where(int(kept[k]))}, place of {who}",
            [float(v) for v in poses[k, :2]],
            f"jumps {moved[k - 1]:.3g} m in {waits[k - 1]:.3g} s; is the unit right, are frames or runs mixed?",
        )
    return Track(times_s, poses)

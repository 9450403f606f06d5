"""Videos of a robot: what is looked at before one is kept (magic bytes, a picture track, how long it is), bounded.

Nobody re-encodes anything: browsers play the file as it is. MP4 (ISO 14496-12: boxes) and WebM (Matroska: EBML).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO

import numpy as np

from desirepath.recordings.recording import BOUNDS, MIB, Bounds, RecordingError, file_sha256
from desirepath.simulation.recorded import Recorded, Video
from desirepath.simulation.scene import Pose, Scene, UnrecordedPerson
from desirepath.simulation.setups import CONTROL_DT_S, Setup
from desirepath.simulation.trajectory import Outcome, Trajectory

FORMAT = "video"
MOST_APART_S = 2.0  # a video and its poses
MEDIA = {".mp4": "video/mp4", ".webm": "video/webm"}
VIDEO_BYTES = 256 * MIB  # of one; it is read into memory once, when it is kept
SHORTEST_S = 0.5
MOST_PARTS = 20_000  # boxes or elements that are looked at
DEEPEST = 8
WHOLE = 4_096  # bytes of a box or element that is read as a whole
_EBML, _DOCTYPE, _SEGMENT, _INFO, _TRACKS, _CLUSTER = 0x1A45DFA3, 0x4282, 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675
_SCALE, _DURATION, _ENTRY, _TRACK_TYPE = 0x2AD7B1, 0x4489, 0xAE, 0x83
Part = tuple[bytes | int, int, int]
"""Name, where its content begins, where it ends."""


def is_video(path: Path) -> bool:
    return path.suffix.lower() in MEDIA


def read_video(path: Path, seconds: float | None = None, bounds: Bounds = BOUNDS) -> Video:
    """What a file is. seconds: how long it is, for one that does not say it itself, as browsers record them.

    Raises RecordingError for another format than its name says, a file that was cut, one without pictures, too large or
    too long.
    """
    media = MEDIA.get(path.suffix.lower())
    if media is None:
        raise RecordingError(path.name, "format", path.suffix, "is no video; MP4 and WebM are shown")
    if not path.is_file():
        raise RecordingError(path.name, "", None, "there is no such video")
    size = path.stat().st_size
    if not 0 < size <= VIDEO_BYTES:
        raise RecordingError(
            path.name, "bytes", size, f"must be 1 to {VIDEO_BYTES}; cut the video or encode it smaller"
        )
    try:
        with path.open("rb") as opened:
            said, pictures = (_mp4 if media == "video/mp4" else _webm)(path.name, opened, size)
    except (struct.error, IndexError):
        raise RecordingError(path.name, "", None, "is cut: it ends within a part") from None
    if not pictures:
        raise RecordingError(path.name, "tracks", None, "has no pictures; sound alone cannot be shown")
    if said is not None and seconds is not None and abs(said - seconds) > 0.5:
        raise RecordingError(
            path.name, "seconds", seconds, f"the file itself says {said:.2f} s; leave the column empty"
        )
    lasts = said if said is not None else seconds
    if lasts is None:
        problem = "the file does not say how long it is; a column seconds_a or seconds_b in pairs.csv does"
        raise RecordingError(path.name, "duration", None, problem)
    if not SHORTEST_S <= lasts <= bounds.run_s:
        problem = f"must be {SHORTEST_S:g} to {bounds.run_s:g} s, since people watch it to its end"
        raise RecordingError(path.name, "duration", round(lasts, 2), problem)
    return Video(file_sha256(path), media, size, round(lasts, 3))


# ---- MP4 -------------------------------------------------------------------------------------------------------------


def _mp4(file: str, opened: IO[bytes], size: int) -> tuple[float | None, bool]:
    """Seconds, None where they are not said, and whether there are pictures."""
    seconds, pictures, seen = None, False, set()
    for name, begin, end in _boxes(file, opened, 0, size, first=b"ftyp"):
        seen.add(name)
        if name != b"moov":
            continue
        for inner, at, until in _boxes(file, opened, begin, end):
            if inner == b"mvhd":
                seconds = _mvhd(_whole(opened, at, until)) or seconds
            elif inner == b"mvex":  # of a file in fragments
                for part, where, stop in _boxes(file, opened, at, until):
                    if part == b"mehd":
                        scale = _timescale(_header(file, opened, begin, end))
                        seconds = seconds or _mehd(_whole(opened, where, stop), scale)
            elif inner == b"trak":
                pictures = pictures or _is_of_pictures(file, opened, at, until)
    if not {b"moov", b"mdat"} <= seen:
        missing = "index (moov)" if b"moov" not in seen else "pictures (mdat)"
        raise RecordingError(file, "", None, f"has no {missing}; was it cut? Write it anew with its index at the front")
    return seconds, pictures


def _boxes(file: str, opened: IO[bytes], begin: int, end: int, first: bytes | None = None) -> Iterator[Part]:
    """The boxes between two places. Raises RecordingError where one reaches beyond, or there are too many."""
    at = begin
    for _ in range(MOST_PARTS):
        if at >= end:
            return
        opened.seek(at)
        head = opened.read(16)
        length, name = struct.unpack(">I4s", head[:8])
        content = at + 8
        if length == 1:
            (length,) = struct.unpack(">Q", head[8:16])
            content = at + 16
        if first is not None and name != first:
            raise RecordingError(
                file, "bytes 4 to 8", name, f"is no MP4, which begins with {first.decode()!r}; was it renamed?"
            )
        first = None
        length = length or end - at
        if length < content - at or at + length > end:
            raise RecordingError(
                file, f"byte {at}", name, f"is cut: this part has {length} bytes, {end - at} are there"
            )
        yield name, content, at + length
        at += length
    raise RecordingError(file, "parts", MOST_PARTS, "at most so many are looked at")


def _whole(opened: IO[bytes], at: int, until: int) -> bytes:
    opened.seek(at)
    return opened.read(min(until - at, WHOLE))


def _header(file: str, opened: IO[bytes], begin: int, end: int) -> bytes:
    return next(
        (_whole(opened, at, until) for name, at, until in _boxes(file, opened, begin, end) if name == b"mvhd"), b""
    )


def _timescale(mvhd: bytes) -> int:
    (scale,) = struct.unpack_from(">I", mvhd, 20 if mvhd[0] == 1 else 12)
    return int(scale)


def _mvhd(content: bytes) -> float | None:
    long = content[0] == 1
    (units,) = struct.unpack_from(">Q" if long else ">I", content, 24 if long else 16)
    scale = _timescale(content)
    unknown = units in (0, 2**64 - 1 if long else 2**32 - 1)
    return units / scale if scale and not unknown else None


def _mehd(content: bytes, scale: int) -> float | None:
    (units,) = struct.unpack_from(">Q" if content[0] == 1 else ">I", content, 4)
    return units / scale if scale and units else None


def _is_of_pictures(file: str, opened: IO[bytes], begin: int, end: int) -> bool:
    for name, at, until in _boxes(file, opened, begin, end):
        if name == b"mdia":
            for inner, where, stop in _boxes(file, opened, at, until):
                if inner == b"hdlr":
                    return _whole(opened, where, stop)[8:12] == b"vide"
    return False


# ---- WebM ------------------------------------------------------------------------------------------------------------


def _webm(file: str, opened: IO[bytes], size: int) -> tuple[float | None, bool]:
    """Seconds, None where they are not said, and whether there are pictures. Clusters are not looked into."""
    if opened.read(4) != _EBML.to_bytes(4, "big"):
        raise RecordingError(
            file, "bytes 0 to 4", None, "is no WebM: it does not begin with an EBML header; was it renamed?"
        )
    seconds, pictures, clusters = None, False, False
    for name, begin, end in _elements(file, opened, 0, size):
        if name == _EBML:
            kind = {part: _whole(opened, at, until) for part, at, until in _elements(file, opened, begin, end)}
            doc = kind.get(_DOCTYPE, b"").rstrip(b"\0")
            if doc != b"webm":
                raise RecordingError(
                    file, "DocType", doc, "must be webm; other Matroska files are not shown by browsers"
                )
        if name != _SEGMENT:
            continue
        for inner, at, until in _elements(file, opened, begin, end, stop_at=_CLUSTER):
            if inner == _INFO:
                seconds = _info({part: _whole(opened, *place) for part, *place in _elements(file, opened, at, until)})
            elif inner == _TRACKS:
                pictures = any(
                    _uint(_whole(opened, *place)) == 1
                    for entry, where, stop in _elements(file, opened, at, until)
                    if entry == _ENTRY
                    for part, *place in _elements(file, opened, where, stop)
                    if part == _TRACK_TYPE
                )
            clusters = clusters or inner == _CLUSTER
        break
    if not clusters:
        raise RecordingError(file, "", None, "has no pictures (Cluster); was it cut?")
    return seconds, pictures


def _elements(file: str, opened: IO[bytes], begin: int, end: int, stop_at: int | None = None) -> Iterator[Part]:
    """The elements between two places; of an unknown size: to the end. stop_at: the last one that is looked at."""
    at = begin
    for _ in range(MOST_PARTS):
        if at >= end:
            return
        opened.seek(at)
        head = opened.read(12)
        name, used = _vint(head, keep_marker=True)
        length, more = _vint(head[used:], keep_marker=False)
        content = at + used + more
        if length == 2 ** (7 * more) - 1:
            length = end - content
        if length > end - content:
            raise RecordingError(
                file, f"byte {at}", None, f"is cut: this part has {length} bytes, {end - content} are there"
            )
        yield name, content, content + length
        if name == stop_at:
            return
        at = content + length
    raise RecordingError(file, "parts", MOST_PARTS, "at most so many are looked at")


def _vint(head: bytes, *, keep_marker: bool) -> tuple[int, int]:
    """A number of EBML, and of how many bytes it is."""
    length = 9 - head[0].bit_length()
    if not 1 <= length <= 8 or len(head) < length:
        raise struct.error
    value = int.from_bytes(head[:length], "big")
    return (value if keep_marker else value & (2 ** (7 * length) - 1)), length


def _uint(content: bytes) -> int:
    return int.from_bytes(content[:8], "big")


def _info(parts: dict[bytes | int, bytes]) -> float | None:
    """Duration is in units of TimestampScale nanoseconds, 10^6 unless said."""
    raw = parts.get(_DURATION)
    if raw is None or len(raw) not in (4, 8):
        return None
    (units,) = struct.unpack(">f" if len(raw) == 4 else ">d", raw)
    scale = _uint(parts[_SCALE]) if _SCALE in parts else 1_000_000
    seconds = float(units) * scale * 1e-9
    return seconds if 0 < seconds < 1e9 else None


# ---- as trajectories -------------------------------------------------------------------------------------------------


def of_video(file: str, run: str, video: Video, setup: Setup) -> Trajectory:
    """A trajectory of which nothing is known but its video: its poses are NaN, nothing stands around it."""
    steps = max(1, math.ceil(video.duration_s / CONTROL_DT_S))
    nowhere = Pose(0.0, 0.0, 0.0)
    return Trajectory(
        scene=Scene(setup.name, 0, nowhere, nowhere, setup.goal_radius_m, UnrecordedPerson()),
        outcome=Outcome.RUNNING,
        poses=np.full((steps + 1, 3), np.nan, dtype=np.float32),
        observations=np.zeros((steps, 0), dtype=np.float32),
        actions=np.zeros((steps, 0), dtype=np.float32),
        rewards=np.full(steps, np.nan, dtype=np.float32),
        next_observations=np.zeros((steps, 0), dtype=np.float32),
        dones=np.zeros(steps, dtype=np.bool_),
        dt=CONTROL_DT_S,
        recorded=Recorded(file, FORMAT, video.sha256, run, ("video",), (), video),
    )


def with_video(run: Trajectory, file: str, video: Video) -> Trajectory:
    """A recorded run with its video. Raises RecordingError where they are not of one length."""
    recorded = run.recorded
    assert recorded is not None  # noqa: S101  it was recorded
    if abs(run.duration_s - video.duration_s) > MOST_APART_S:
        problem = f"the poses of run {recorded.run!r} take {run.duration_s:.1f} s; cut both to the same"
        raise RecordingError(file, "duration", video.duration_s, problem)
    has = (*recorded.has, "video")
    return replace(run, recorded=replace(recorded, run=file, has=has, video=video))

"""Maps as ROS has them (`map.yaml` beside a PGM or PNG): which cells are occupied, and the tables that rays and
collisions run on. Scenes in a map are drawn in `worlds/ros_map.py`.

A scene's coordinates are the map's frame, metres: x right, y up in the picture, its lower left corner at `origin`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from desirepath.grammar.error_words import parse
from desirepath.grammar.parts import FileName, Part
from desirepath.grammar.source import ProtocolError, Source, file_text
from desirepath.simulation import kernels as k

MOST_CELLS = 4_000 * 4_000  # 200 x 200 m at 5 cm
LONGEST_CELLS = 32_000  # cells are numbered with 16 bits
MOST_BYTES = 64 * 1024**2  # of the picture's file
PICTURES = ("PPM", "PNG", "BMP")  # Pillow's PPM reads PGM
LARGEST_M = 500.0  # side of a plausible building
FARTHEST_M = 10_000.0  # of its origin: poses are float32, which step by half a metre at 5,000 km
MOST_STRETCHES = 100_000  # of wall, or of what is unknown, along y; a hall of 65 x 70 m has 4,700

Bools = NDArray[np.bool_]
Share = Annotated[float, Field(ge=0, le=1)]


class MapFile(Part):
    """`map.yaml` as map_server writes it. Keys that are not used here are no error: nodes add their own."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    image: FileName
    resolution: Annotated[float, Field(ge=0.005, le=1)]  # m
    origin: Annotated[list[float], Field(min_length=2, max_length=3)]
    negate: Annotated[int, Field(ge=0, le=1)] = 0
    occupied_thresh: Share = 0.65
    free_thresh: Share = 0.196
    mode: Literal["trinary", "scale"] = "trinary"


@dataclass(frozen=True, eq=False)
class GroundMap:
    """The cells of a building. occupied, unknown: (columns, lines), x to the right, y up. What is unknown stops robots
    and rays as walls do. cell_m: side of a cell. origin: its lower left corner, m. sha256: of cells and place."""

    occupied: Bools
    unknown: Bools
    cell_m: float
    origin: tuple[float, float]

    @cached_property
    def sha256(self) -> str:
        place = f"{self.occupied.shape} {self.cell_m!r} {self.origin!r}"
        return hashlib.sha256(place.encode() + np.packbits(self.blocked).tobytes()).hexdigest()

    @property
    def blocked(self) -> Bools:
        """(columns, lines) what no robot enters."""
        return self.occupied | self.unknown

    @property
    def size_m(self) -> tuple[float, float]:
        return self.occupied.shape[0] * self.cell_m, self.occupied.shape[1] * self.cell_m

    @cached_property
    def ground(self) -> k.Ground:
        """The tables for the compiled functions."""
        from scipy import ndimage  # a quarter of a second that only maps need

        blocked = self.blocked
        nearest = ndimage.distance_transform_edt(~blocked, return_distances=False, return_indices=True)
        around = ndimage.binary_dilation(blocked, np.ones((3, 3)))
        leaps = np.minimum(ndimage.distance_transform_edt(~around), k.LONGEST_LEAP).astype(np.int8)  # rounded down
        leaps[blocked] = -1
        return k.Ground(
            np.ascontiguousarray(np.moveaxis(nearest, 0, -1), dtype=np.int16), leaps, *self.origin, self.cell_m
        )

    @cached_property
    def apart_m(self) -> NDArray[np.float32]:
        """(columns, lines) from each cell's centre to the nearest blocked cell, metres; 0 in one."""
        from scipy import ndimage

        away = ndimage.distance_transform_edt(~self.blocked) - 0.5
        return np.asarray(np.maximum(away, 0) * self.cell_m, dtype=np.float32)

    def roomy(self, clearance_m: float) -> Bools:
        """(columns, lines) where a disc of that radius fits, in the largest part that hangs together."""
        return largest_part(self.apart_m >= clearance_m)

    @cached_property
    def walls(self) -> NDArray[np.float64]:
        """(n, 4) rectangles that together cover the occupied cells: smallest x and y, largest x and y, metres."""
        return self._rectangles(self.occupied)

    @cached_property
    def unknown_parts(self) -> NDArray[np.float64]:
        """(n, 4) likewise of what is unknown, without the line around the map."""
        inside = self.unknown.copy()
        inside[[0, -1]] = inside[:, [0, -1]] = False
        return self._rectangles(inside)

    def _rectangles(self, cells: Bools) -> NDArray[np.float64]:
        left = cells.copy()
        rectangles = []
        for i, j in np.argwhere(left):
            if not left[i, j]:
                continue
            run: Bools = left[i, j:]
            up = len(run) if run.all() else int(run.argmin())
            column = np.asarray(left[i:, j : j + up].all(axis=1))
            right = len(column) if column.all() else int(column.argmin())
            left[i : i + right, j : j + up] = False
            rectangles.append((i, j, i + right, j + up))
        return self._metres(np.array(rectangles).reshape(-1, 4))

    @cached_property
    def wall_sides(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n, 4) where occupied cells end, each run as a line from x, y to x, y, metres, and (n, 2) which
        way it faces: counter-clockwise around the wall."""
        lines, facing = [], []
        for axis, cells in enumerate((self.occupied, self.occupied.T)):
            for way in (1, -1):
                ends = np.pad(cells & ~np.roll(cells, -way, axis=0), ((0, 0), (1, 1)))  # the edge is never occupied
                begin, end = np.argwhere(ends[:, 1:] & ~ends[:, :-1]), np.argwhere(ends[:, :-1] & ~ends[:, 1:])
                at = begin[:, 0] + (way > 0)
                first, last = (begin[:, 1], end[:, 1]) if (way > 0) == (axis == 0) else (end[:, 1], begin[:, 1])
                lines.append(np.stack((at, first, at, last) if axis == 0 else (first, at, last, at), axis=1))
                facing.append(np.tile((way, 0) if axis == 0 else (0, way), (len(at), 1)))
        return self._metres(np.concatenate(lines)), np.concatenate(facing).astype(np.float64)

    def _metres(self, corners: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.asarray(corners * self.cell_m + np.tile(self.origin, 2))


def largest_part(free: Bools) -> Bools:
    """(columns, lines) of the free cells those of the largest part that hangs together; none where none is free."""
    from scipy import ndimage

    parts, count = ndimage.label(free)
    return np.asarray(parts == 1 + np.argmax(np.bincount(parts.ravel())[1:])) if count else free


def framed(occupied: Bools, unknown: Bools, cell_m: float, origin: tuple[float, float]) -> GroundMap:
    """A map cut down to what is known of it, with one line of unknown cells around: every ray ends."""
    known = np.argwhere(~unknown)
    (i, j), (u, v) = known.min(axis=0), known.max(axis=0) + 1
    inside = (slice(i, u), slice(j, v))
    return GroundMap(
        np.pad(occupied[inside], 1),
        np.pad(unknown[inside], 1, constant_values=True),
        cell_m,
        (float(origin[0] + (i - 1) * cell_m), float(origin[1] + (j - 1) * cell_m)),
    )


def read_map(path: Path) -> GroundMap:
    """The map in that `map.yaml`. Raises ProtocolError naming file, line and field of what is wrong, and what would
    work. Its picture lies in the same folder."""
    source = Source(str(path), file_text(path))
    said = parse(source, MapFile)

    def wrong(field: str, message: str) -> ProtocolError:
        return ProtocolError([source.problem((field,), message)])

    if not all(map(math.isfinite, said.origin)):
        raise wrong("origin", "must be three finite numbers: x, y (m), yaw (rad)")
    if max(map(abs, said.origin[:2])) > FARTHEST_M:
        raise wrong(
            "origin", f"must be within {FARTHEST_M:,.0f} m of 0, 0; subtract a place of your own from all x and y"
        )
    if len(said.origin) == 3 and abs(said.origin[2]) > 1e-6:
        raise wrong("origin", "its yaw must be 0; turn the picture, then write the origin anew")
    if said.free_thresh >= said.occupied_thresh:
        raise wrong("free_thresh", f"must be below occupied_thresh, {said.occupied_thresh:g}")
    folder, picture = path.resolve().parent, (path.parent / said.image).resolve()
    if picture.parent != folder:
        raise wrong("image", "must be the name of a picture in the same folder")
    grey = _read_picture(picture, wrong)
    size = max(grey.shape) * said.resolution
    if size > LARGEST_M:
        raise wrong("resolution", f"makes the map {size:,.0f} m long; at most {LARGEST_M:g} m are plausible")
    share = grey / 255 if said.negate else 1 - grey / 255
    occupied, free = share > said.occupied_thresh, share < said.free_thresh
    if not free.any():
        raise wrong("image", "has no free cell by these thresholds; is `negate` right?")
    unknown = ~(occupied | free)
    for what, cells in (("wall", occupied), ("unknown ground", unknown)):
        stretches = int((cells[:, 1:] & ~cells[:, :-1]).sum())
        if stretches > MOST_STRETCHES:
            message = f"shows {stretches:,} pieces of {what}; at most {MOST_STRETCHES:,} are read: take the noise out"
            raise wrong("image", message)
    return framed(occupied, unknown, said.resolution, (said.origin[0], said.origin[1]))


def _read_picture(picture: Path, refuse: Callable[[str, str], ProtocolError]) -> NDArray[np.float64]:
    """(columns, lines) grey values 0..255, y up; NaN where it is transparent."""
    from PIL import Image, UnidentifiedImageError

    try:
        if picture.stat().st_size > MOST_BYTES:
            raise refuse("image", f"has {picture.stat().st_size:,} bytes; at most {MOST_BYTES:,} are read")
        with Image.open(picture, formats=PICTURES) as image:
            if image.mode.startswith("I") or image.mode == "F":
                raise refuse("image", "has more than 8 bits a cell; save it with 8, as map_server does")
            if max(image.size) > LONGEST_CELLS:
                raise refuse("image", f"is {max(image.size):,} cells long; at most {LONGEST_CELLS:,} are read")
            if image.width * image.height > MOST_CELLS:
                raise refuse("image", f"has {image.width} x {image.height} cells; at most {MOST_CELLS:,} are read")
            grey = np.asarray(image.convert("L"), dtype=np.float64)
            if image.has_transparency_data:
                grey = np.where(np.asarray(image.convert("RGBA"))[..., 3] == 0, np.nan, grey)
    except FileNotFoundError:
        raise refuse("image", f"no file {picture.name} lies beside it") from None
    except Image.DecompressionBombError:
        raise refuse("image", f"has too many cells; at most {MOST_CELLS:,} are read") from None
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as broken:
        raise refuse("image", f"{picture.name} is no whole PGM, PNG or BMP: {broken}") from None
    return grey[::-1].T


@lru_cache(maxsize=8)
def load_map(path: Path) -> GroundMap:
    """`read_map`, once a process for each file."""
    return read_map(path)

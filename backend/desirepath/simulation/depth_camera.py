"""The robot's depth camera in the fast engine: pictures of scenes from poses, and what a real camera makes of them.

What is seen of furniture and people stands in `depth_shapes.py`, the compiled arithmetic in `depth_kernels.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation import depth_kernels as dk
from desirepath.simulation.depth_shapes import MANNEQUIN, pack, seen_of
from desirepath.simulation.scene import Scene

Doubles = NDArray[np.float64]
Frames = NDArray[np.float32]


@dataclass(frozen=True)
class DepthCamera:
    """A forward-facing pinhole. fov_rad: horizontal. Depths are metres along its axis, at most `range_m`.

    Section 3.4.1: 128 x 80 pixels, 87 degrees and 6 m as an Intel RealSense D455; 120 degrees in the ablation. Height
    and place on the robot are ours: those of the sensor bar of the TurtleBot on the stage.
    """

    columns: int = 128
    rows: int = 80
    fov_rad: float = math.radians(87.0)
    range_m: float = 6.0
    height_m: float = 0.345
    ahead_m: float = 0.08

    @property
    def focal_px(self) -> float:
        """Of square pixels."""
        return self.columns / 2 / math.tan(self.fov_rad / 2)

    @cached_property
    def lens(self) -> dk.Lens:
        left: Doubles = (self.columns / 2 - np.arange(self.columns, dtype=np.float64) - 0.5) / self.focal_px
        up: Doubles = (self.rows / 2 - np.arange(self.rows, dtype=np.float64) - 0.5) / self.focal_px
        return dk.Lens(left, up, self.focal_px, self.height_m, self.ahead_m, self.range_m)

    def sees(self, poses: Doubles, people: Doubles) -> NDArray[np.bool_]:
        """(n,) whether the middle of the person (n, 2 or more: x, y) lies within field of view and range.

        Furniture in between does not count, as in the thesis, which takes the detection as given (ours).
        """
        dx, dy = people[:, 0] - poses[:, 0], people[:, 1] - poses[:, 1]
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        ahead, aside = dx * c + dy * s - self.ahead_m, dy * c - dx * s
        within = np.abs(np.arctan2(aside, ahead)) <= self.fov_rad / 2
        found: NDArray[np.bool_] = within & (ahead > 0) & (np.hypot(ahead, aside) <= self.range_m)
        return found


DEPTH_CAMERA = DepthCamera()
WIDE_CAMERA = DepthCamera(fov_rad=math.radians(120.0))  # Microsoft Azure Kinect, VAE-FOV-120


@dataclass(frozen=True)
class CameraNoise:
    """What a stereo depth camera loses (ours, after the D455's data sheet: under 2 % error at 4 m, 0.4 m at least).

    grain: standard deviation of a depth d is grain * d^2 metres: 2.6 cm at 4 m. dropout: share of pixels lost, the
    thesis's 5 %. edge_dropout: share lost beside a jump of more than edge_m.
    """

    grain: float = 0.0016
    dropout: float = 0.05
    edge_m: float = 0.1
    edge_dropout: float = 0.5
    nearest_m: float = 0.3

    def applied(self, frames: Frames, camera: DepthCamera, random: np.random.Generator) -> Frames:
        """Frames (n, rows, columns) as that camera gives them, 0 where it found nothing."""
        out = np.empty_like(frames)
        bits = random.integers(1 << 32, size=frames.shape, dtype=np.uint32)
        limits = self.nearest_m, camera.range_m
        dk.add_noise(frames, bits, _quantiles(), self.grain, self.dropout, self.edge_m, self.edge_dropout, *limits, out)
        return out


@cache
def _quantiles() -> Frames:
    """(65536,) of the standard normal distribution, evenly apart in probability."""
    from scipy.special import ndtri  # only where pictures are taken

    found: Frames = ndtri((np.arange(1 << 16) + 0.5) / (1 << 16)).astype(np.float32)
    return found


class Sights:
    """What stands in some places, ready for pictures: `of` keeps walls and furniture, not the people."""

    def __init__(self, scenes: Sequence[Scene]) -> None:
        found = [seen_of(scene) for scene in scenes]
        self._boxes = pack([boxes for boxes, _ in found], dk.BOX_NUMBERS)
        self._cylinders = pack([cylinders for _, cylinders in found], dk.CYLINDER_NUMBERS)

    def pictures(
        self, camera: DepthCamera, poses: Doubles, people: Doubles, places: NDArray[Any] | None = None
    ) -> Frames:
        """(n, rows, columns) depth frames from robot poses (n, 3) of people (n, 4) x, y, yaw, height (NaN: nobody).

        places (n,): which of the scenes each robot is in; default: one each, in order.
        """
        n = len(poses)
        where = np.arange(n) if places is None else np.asarray(places, dtype=np.int64)
        out = np.empty((n, camera.rows, camera.columns), dtype=np.float32)
        dk.take_pictures(
            camera.lens,
            np.ascontiguousarray(poses, dtype=np.float64),
            where,
            *self._boxes,
            *self._cylinders,
            np.ascontiguousarray(people, dtype=np.float64),
            MANNEQUIN,
            out,
        )
        return out

"""What a robot's depth camera saw along a rollout, as one sheet of small pictures that the page shows in time.

Which pictures those are is the caller's: here they are coloured, put side by side and written as an image.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from desirepath_stage.orders import PictureSheet
from desirepath_stage.surfaces import to_jpeg

_NEAR, _FAR, _NOTHING = (250, 238, 205), (28, 44, 74), (0, 0, 0)  # ours: light is near, black is where it found nothing
COLUMNS = 8
QUALITY = 60


@dataclass(frozen=True)
class CameraPictures:
    """name: the robot's. robot: its place among the rollouts. caption: what they are. frames: (n, rows, columns) metres
    along the camera's axis, 0 where it found nothing; one every `every_s` from the beginning of the rollout on.
    range_m: how far the camera sees.
    """

    name: str
    robot: int
    caption: str
    frames: NDArray[np.float32]
    every_s: float
    range_m: float

    def as_sheet(self, colour: tuple[int, int, int]) -> PictureSheet:
        """colour: the robot's on the stage."""
        count, rows, columns = self.frames.shape
        across = min(COLUMNS, count)
        down = math.ceil(count / across)
        sheet = np.zeros((down * rows, across * columns, 3), np.uint8)
        for number, frame in enumerate(self._coloured()):
            top, left = rows * (number // across), columns * (number % across)
            sheet[top : top + rows, left : left + columns] = frame
        return {
            "name": self.name,
            "colour": list(colour),
            "caption": self.caption,
            "image": f"data:image/jpeg;base64,{base64.b64encode(to_jpeg(sheet, QUALITY)).decode()}",
            "width": columns,
            "height": rows,
            "across": across,
            "count": count,
            "every_s": self.every_s,
        }

    def _coloured(self) -> NDArray[np.uint8]:
        share = np.clip(self.frames / self.range_m, 0.0, 1.0)[..., None]
        mixed = np.asarray(_NEAR) + (np.asarray(_FAR) - np.asarray(_NEAR)) * share
        mixed[self.frames <= 0] = _NOTHING
        return np.asarray(mixed.astype(np.uint8))

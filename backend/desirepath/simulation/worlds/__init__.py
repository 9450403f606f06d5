"""The worlds: what draws a setup's scenes from a seed. A world is one module here, or of another package, named by an
entry point `desirepath.worlds`, and ends with its `WORLD`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from desirepath.registries import Registry

if TYPE_CHECKING:
    from desirepath.simulation.scene import Scene
    from desirepath.simulation.setups import Setup


@dataclass(frozen=True)
class RowWorld:
    """Scenes that a compiled function draws: draw(uniforms, row, spacing) fills the row and says whether the random
    numbers sufficed. number: part of every seed; kinds: of its boxes, in order (`OBSTACLE_KINDS`).
    """

    number: int
    draw: Callable[[NDArray[np.float64], NDArray[np.float64], Any], bool]
    kinds: tuple[str, ...] = ()


@dataclass(frozen=True)
class SceneWorld:
    """Scenes that take milliseconds to draw: draw(setup, seed), the same for the same seed. number: part of the seeds
    of training scenes; boxes: a scene has at most so many obstacles.
    """

    number: int
    draw: Callable[[Setup, int], Scene]
    boxes: int = 32


World = RowWorld | SceneWorld
WORLDS: Registry[World] = Registry("desirepath.worlds", "desirepath.simulation.worlds", "WORLD")

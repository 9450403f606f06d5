"""What a headset has to draw of each setup's scenes, counted from what the stage sends: `desirepath benchmark headset`.

Both eyes are drawn one after the other, so everything counts twice. Nothing is drawn here and no headset was at hand:
how many pictures a second a headset makes of it is not known.
"""

from __future__ import annotations

import io
import json
import struct
from typing import Annotated, Any, cast

from PIL import Image
from pydantic import Field
from pydantic.dataclasses import dataclass

from desirepath.simulation.scenes import draw_scene
from desirepath_experiments.benchmarks.results import Progress
from desirepath_stage import bodies, scene_nodes
from desirepath_stage.views import camera_for

EYES = 2
MOST_CALLS, MOST_TRIANGLES, MOST_TEXTURE_MIB = 100, 150_000, 32  # ours, for a headset without a computer
MIPMAPS = 4 / 3  # a texture with all its smaller versions
PANEL_CALLS = 9  # client/headset_room.js: the panel, the dark, the arrow, and of two hands a ray, a grip and a dot each
PANEL_MIB = 1024 * 640 * 4 / 2**20
SETUPS = (
    *("study_room", "open_field", "explained_room", "home", "corridor", "room"),
    *("crowd_hall", "crowd_corridor", "crowd_home", "crowd_intersection", "crowd_office"),
)


@dataclass(frozen=True)
class HeadsetConfig:
    """How many scenes of each setup."""

    scenes: Annotated[int, Field(ge=1, le=500)] = 20
    seed: Annotated[int, Field(ge=0)] = 0


class _Heard:
    """Stands where viser's scene does, and keeps the files that are sent."""

    def __init__(self) -> None:
        self.files: list[bytes] = []

    def add_glb(self, _name: str, glb: bytes, **_where: object) -> None:
        self.files.append(glb)

    def add_frame(self, _name: str, **_where: object) -> None:
        """Nothing is drawn of it."""


def weight_of(glb: bytes) -> tuple[int, int, float]:
    """Draw calls, triangles and MiB of textures of one file, for one eye."""
    (length,) = struct.unpack_from("<I", glb, 12)
    document, blob = json.loads(glb[20 : 20 + length]), glb[28 + length :]
    parts = [part for mesh in document["meshes"] for part in mesh["primitives"]]
    triangles = sum(document["accessors"][part["indices"]]["count"] // 3 for part in parts)
    texels = 0
    for picture in document.get("images", []):
        view = document["bufferViews"][picture["bufferView"]]
        begin = view.get("byteOffset", 0)
        width, height = Image.open(io.BytesIO(blob[begin : begin + view["byteLength"]])).size
        texels += width * height
    return len(parts), triangles, texels * 4 * MIPMAPS / 2**20


def count_scene(setup: str, seed: int) -> dict[str, float]:
    """One scene as who wears a headset has it before them, with its goal, trail and panel; both eyes."""
    scene, heard = draw_scene(setup, seed), _Heard()
    camera = camera_for(scene, "immersive")
    api = cast("Any", heard)
    nodes = scene_nodes.build(api, "/scene", scene, "immersive", camera, (bodies.NEUTRAL,))
    scene_nodes.add_marks(api, "/scene", scene, nodes.robots)
    calls, triangles, mib = (sum(part) for part in zip(*map(weight_of, heard.files), strict=True))
    return {
        "calls": EYES * (calls + PANEL_CALLS),
        "triangles": EYES * (triangles + 2 * PANEL_CALLS),
        "textures_mib": mib + PANEL_MIB,
    }


def benchmark_headset(config: HeadsetConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Of each setup the most of its scenes, and whether a headset without a computer is expected to manage it."""
    most: dict[str, dict[str, float]] = {}
    for setup in SETUPS:
        if progress is not None:
            progress.tell(setup)
        seen = [count_scene(setup, config.seed + k) for k in range(config.scenes)]
        most[setup] = {name: round(max(scene[name] for scene in seen), 1) for name in seen[0]}
    limits = {"calls": MOST_CALLS, "triangles": MOST_TRIANGLES, "textures_mib": MOST_TEXTURE_MIB}
    over = [f"{setup} {name}" for setup, found in most.items() for name, limit in limits.items() if found[name] > limit]
    return {"scenes": config.scenes, "limits": limits, "most_of_a_scene": most, "over": over}

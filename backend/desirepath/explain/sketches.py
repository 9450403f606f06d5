"""A policy at a glance: five rollouts of it in one scene of its setup, from above, small enough for a table's row.

All policies of a setup are drawn in the same scene and from the same five starts. Those of the policies that come with
the product lie beside them (`datasets/sketches.json`); others are drawn by the process that draws figures
(`web/core/figure_process.py`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

from desirepath.installed import DATASETS

if TYPE_CHECKING:  # the simulator comes with these; whoever only shows what is drawn already need not wait for it
    from desirepath.simulation.acting import ActFunction, EpisodicPolicy
    from desirepath.simulation.scene import Pose, Scene

SHIPPED = DATASETS / "sketches.json"
SKETCHED = 1
"""Goes up when policies are drawn another way, so that browsers ask for new ones."""
ROLLOUTS = 5
ASIDE_M = (0.35, -0.35, 0.7, -0.7, 1.05, -1.05, 0.18, -0.18)  # ours: starts beside the scene's own, as there is room
WIDTH, HEIGHT, MARGIN = 256, 168, 6  # pixels, of a picture that is shown at half the size
APART_PX = 6  # ours: points of a path that lie nearer to the last one drawn are left out
SPARE_M, WALL_M = 1.8, 0.2  # ours: floor that is shown around everything, and of a room's walls
PERSON_M = 0.3  # radius

Scheme = Literal["light", "dark"]
INKS: dict[Scheme, dict[str, str]] = {  # tokens.css: ground, solids, person, path, goal
    "light": {"paper": "#fffdf8", "solid": "#cfc6b2", "person": "#8c7a1e", "path": "#2f6a3d", "goal": "#211f1a"},
    "dark": {"paper": "#22201b", "solid": "#4d483d", "person": "#d6c469", "path": "#8fc79a", "goal": "#ede8dc"},
}
Points = list[tuple[int, int]]
Metres = list[tuple[float, float]]


@dataclass(frozen=True)
class Sketch:
    """Pixels, of WIDTH by HEIGHT. goal, people: x, y, radius each; arrived: which paths came to the goal."""

    solids: list[Points]
    people: list[tuple[int, int, int]]
    goal: tuple[int, int, int]
    paths: list[Points]
    arrived: list[bool]

    def svg(self, scheme: Scheme, title: str = "") -> str:
        """The picture in a scheme's colours; a path that does not arrive is dashed."""
        from html import escape

        ink = INKS[scheme]
        parts = [f'<rect width="{WIDTH}" height="{HEIGHT}" fill="{ink["paper"]}"/>']
        parts += [f'<polygon points="{points_text(one)}" fill="{ink["solid"]}"/>' for one in self.solids]
        x, y, r = self.goal
        parts.append(
            f'<circle cx="{x}" cy="{y}" r="{r}" fill="none" stroke="{ink["goal"]}" stroke-width="2" '
            'stroke-dasharray="4 3"/>'
        )
        parts += [f'<circle cx="{x}" cy="{y}" r="{r}" fill="{ink["person"]}"/>' for x, y, r in self.people]
        for path, arrived in zip(self.paths, self.arrived, strict=True):
            dashed = "" if arrived else ' stroke-dasharray="6 4"'
            parts.append(
                f'<polyline points="{points_text(path)}" fill="none" stroke="{ink["path"]}" stroke-width="3" '
                f'stroke-linejoin="round" stroke-linecap="round"{dashed}/>'
            )
            parts.append(f'<circle cx="{path[0][0]}" cy="{path[0][1]}" r="4" fill="{ink["path"]}"/>')
        said = f"<title>{escape(title)}</title>" if title else ""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
            f'height="{HEIGHT}">{said}{"".join(parts)}</svg>'
        )

    def as_json(self) -> str:
        return json.dumps(asdict(self), separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str | bytes) -> Sketch:
        return cls(**json.loads(text))


def points_text(points: Points) -> str:
    return " ".join(f"{x},{y}" for x, y in points)


@lru_cache(maxsize=1)
def shipped_sketches() -> dict[str, Sketch]:
    """Those of the policies that come with the product, by the sha256 of their files."""
    return {sha: Sketch(**drawn) for sha, drawn in json.loads(SHIPPED.read_text(encoding="utf-8")).items()}


def draw_sketch(act: ActFunction | EpisodicPolicy, scene: Scene) -> Sketch:
    """Roll out in the scene, from its start and from places beside it, and draw that. Raises SceneError."""
    from desirepath.simulation.fast import rollout
    from desirepath.simulation.setups import get_setup
    from desirepath.simulation.trajectory import Outcome

    starts = [replace(scene, start=start) for start in _starts(scene)]
    driven = rollout(get_setup(scene.setup), act, starts)
    paths = [[(float(x), float(y)) for x, y, _ in one.poses] for one in driven]
    arrived = [one.outcome == Outcome.SUCCESS for one in driven]
    return _fit(scene, paths, arrived)


def _starts(scene: Scene) -> list[Pose]:
    """The scene's start and four beside it, across the line to the goal, where a robot may stand."""
    from desirepath.simulation.scene import SceneError
    from desirepath.simulation.scenes import check_scene

    start, found = scene.start, [scene.start]
    across = math.atan2(scene.goal.y - start.y, scene.goal.x - start.x) + math.pi / 2
    for aside in ASIDE_M:
        pose = replace(start, x=start.x + aside * math.cos(across), y=start.y + aside * math.sin(across))
        try:
            check_scene(replace(scene, start=pose))
        except SceneError:
            continue
        found.append(pose)
    return found[:ROLLOUTS]


def _fit(scene: Scene, paths: Sequence[Metres], arrived: list[bool]) -> Sketch:
    """Metres into pixels, everything in the middle."""
    from desirepath.simulation.scenes import walls_of

    people = [(scene.person.pose.x, scene.person.pose.y)] if scene.has_person else []
    people += [one.route[0] for one in (scene.crowd.pedestrians if scene.crowd else ())]
    places = [path[0] for path in paths] + people + [(scene.goal.x, scene.goal.y)]  # alike for all of a setup
    low_edges = [min(one[k] for one in places) - SPARE_M for k in (0, 1)]
    high_edges = [max(one[k] for one in places) + SPARE_M for k in (0, 1)]
    if scene.room is not None:  # no farther than its walls
        half = (scene.room.length / 2 + WALL_M, scene.room.width / 2 + WALL_M)
        low_edges = [max(edge, -most) for edge, most in zip(low_edges, half, strict=True)]
        high_edges = [min(edge, most) for edge, most in zip(high_edges, half, strict=True)]
    (left, low), (right, high) = low_edges, high_edges
    scale = min((WIDTH - 2 * MARGIN) / (right - left), (HEIGHT - 2 * MARGIN) / (high - low))

    def at(x: float, y: float) -> tuple[int, int]:
        across, up = scale * (x - (left + right) / 2), scale * (y - (low + high) / 2)
        return round(WIDTH / 2 + across), round(HEIGHT / 2 - up)

    boxes = [one.corners() for one in scene.solids()]
    boxes += [[(x1, y1), (x2, y1), (x2, y2), (x1, y2)] for x1, y1, x2, y2 in map(list, walls_of(scene))]
    solids = [[at(*corner) for corner in box] for box in boxes]
    solids = [one for one in solids if any(0 <= x <= WIDTH and 0 <= y <= HEIGHT for x, y in one)]
    drawn = []
    for path in paths:
        kept = [at(*path[0])]
        for point in path[1:]:
            if math.dist(at(*point), kept[-1]) >= APART_PX:
                kept.append(at(*point))
        drawn.append([*kept, at(*path[-1])])
    around = [(*at(x, y), round(scale * PERSON_M)) for x, y in people]
    goal = (*at(scene.goal.x, scene.goal.y), round(scale * scene.goal_radius))
    return Sketch(solids, around, goal, drawn, arrived)

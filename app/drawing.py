"""The sheet of paper that a path is drawn on: what the page's pen (`client/draw.js`) has to know of a scene.

Plain geometry and what was drawn before; whether a path can be driven is decided elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from app import furniture
from app.views import View
from backend.simulation.scene import Scene
from backend.simulation.setups import ROBOT_RADIUS_M, get_setup

Points = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Paper:
    """One sheet. id: comes back with the stroke. kept: paths of the same situation, drawn thin, metres.

    drawn, speeds: a stroke that is on it already, metres and m/s. resting: nothing can be drawn now.
    """

    id: str
    kept: Sequence[Points] = ()
    drawn: Points = ()
    speeds: Sequence[float] = ()
    resting: bool = False

    def as_message(self, scene: Scene, view: View) -> dict[str, Any]:
        """Plain data for the page."""
        limits = get_setup(scene.setup).limits
        person = scene.person
        return {
            "id": self.id,
            "start": [scene.start.x, scene.start.y, scene.start.yaw],
            "goal": [scene.goal.x, scene.goal.y, scene.goal_radius],
            "solids": [
                {
                    "name": furniture.name(solid, index),
                    "x": solid.pose.x,
                    "y": solid.pose.y,
                    "yaw": solid.pose.yaw,
                    "length": solid.length,
                    "width": solid.width,
                }
                for index, solid in enumerate(scene.solids())
            ],
            "person": {
                "name": "person" if view == "top_down" else "you",
                "x": person.pose.x,
                "y": person.pose.y,
                "radius": person.radius,
            },
            "robot_radius": ROBOT_RADIUS_M,
            "speeds": [limits.v_min, limits.v_max],
            "kept": [[list(point) for point in path] for path in self.kept],
            "drawn": {"points": [list(point) for point in self.drawn], "speeds": list(self.speeds)}
            if len(self.drawn)
            else None,
            "resting": self.resting,
        }

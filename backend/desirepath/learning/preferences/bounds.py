"""What no policy can better in a scene, whatever it gives up for it: the bound of each objective's measure.

Which bound is whose stands in `objectives.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from desirepath.learning.preferences.measures import CLEARANCE_CAP_M
from desirepath.simulation.crowds.crowd_setups import PED_DEPTH_M
from desirepath.simulation.kernels import surface_distance
from desirepath.simulation.pedestrians import Pedestrian
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import ground_of, scene_to_row
from desirepath.simulation.setups import get_setup


@dataclass(frozen=True)
class SceneBounds:
    """A scene as the bounds see it."""

    scene: Scene

    @cached_property
    def goal_m(self) -> float:
        """From the start to the goal's centre."""
        scene = self.scene
        return math.hypot(scene.goal.x - scene.start.x, scene.goal.y - scene.start.y)

    @property
    def way_m(self) -> float:
        """The straight way to the goal's edge."""
        return self.goal_m - self.scene.goal_radius

    @property
    def robot_m(self) -> float:
        """The robot's radius."""
        return get_setup(self.scene.setup).robot.radius_m


def ceiling_m(bounds: SceneBounds) -> float:
    """Spec 06's ceiling of the distance to the person, to the goal's centre, which its edge may pass by its radius."""
    return bounds.scene.human_distance_ceiling_m()


def contact_m(bounds: SceneBounds) -> float:
    return bounds.scene.person.radius + bounds.robot_m


def straight_left(bounds: SceneBounds) -> float:
    return 1.0


def straight_right(bounds: SceneBounds) -> float:
    return -1.0


def start_clearance_m(bounds: SceneBounds) -> float:
    """What the start has, at most 0.8 m."""
    scene = bounds.scene
    free = surface_distance(scene_to_row(scene), scene.start.x, scene.start.y, ground_of(scene)) - bounds.robot_m
    return min(free, CLEARANCE_CAP_M)


def straight_way_m(bounds: SceneBounds) -> float:
    return bounds.way_m


def turn_to_goal_rad(bounds: SceneBounds) -> float:
    """The turn towards the goal's edge."""
    scene = bounds.scene
    heading = math.atan2(scene.goal.y - scene.start.y, scene.goal.x - scene.start.x)
    bearing = abs((heading - scene.start.yaw + math.pi) % (2 * math.pi) - math.pi)
    return max(0.0, bearing - math.asin(min(1.0, scene.goal_radius / bounds.goal_m)))


def standing_m_s(bounds: SceneBounds) -> float:
    return 0.0


def full_speed_s(bounds: SceneBounds) -> float:
    """The straight way at full speed."""
    return bounds.way_m / get_setup(bounds.scene.setup).robot.limits.v_max


def nearest_ceiling_m(bounds: SceneBounds) -> float:
    """Among pedestrians: to whoever is nearest at the start, and to who stands nearest to the goal."""
    scene = bounds.scene
    people = scene.people_at([0.0])[:, 0]
    at_start = min(math.dist(place, (scene.start.x, scene.start.y)) for place in people)
    standing = [scene.person.pose, *(Pose(*walker.route[0]) for walker in _crowd(scene) if walker.speed == 0)]
    at_goal = min(math.dist((pose.x, pose.y), (scene.goal.x, scene.goal.y)) for pose in standing)
    return min(at_start, at_goal + scene.goal_radius)


def _crowd(scene: Scene) -> tuple[Pedestrian, ...]:
    return scene.crowd.pedestrians if scene.crowd else ()


def touching_m(bounds: SceneBounds) -> float:
    """From centre to centre of a pedestrian's narrow side."""
    return PED_DEPTH_M / 2 + bounds.robot_m


def always(bounds: SceneBounds) -> float:
    return 1.0


def always_behind(bounds: SceneBounds) -> float:
    return -1.0


def never(bounds: SceneBounds) -> float:
    return 0.0

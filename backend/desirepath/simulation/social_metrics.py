"""Metrics of social navigation: what a rollout was like for the person whom it passed, from positions alone.

Definitions as in Francis et al. 2023, "Principles and Guidelines for Evaluating Social Robot Navigation Algorithms"
(arXiv 2306.16740, table 1), where nothing else is said. Distances, times and outcomes: `fast.EpisodeTable`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from desirepath.simulation.kernels import compiled
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup

Doubles = NDArray[np.float64]

PERSONAL_SPACE_M = 1.2  # Hall 1966, centre to centre: where personal space ends and social space begins
STALLED_BELOW_M_S = 0.05
LONGEST_TTC_S = 10.0  # never on the way to contact counts as this, so that a mean exists
_COUNT = 5
_OF_PEOPLE = 3  # of these, the first so many


@dataclass(frozen=True)
class SocialMetrics:
    """Of n rollouts, each array (n,).

    personal_space_violations: how often the robot came into a person's personal space (1.2 m, centre to centre).
    personal_space_time: seconds that it was there.
    min_time_to_collision: least seconds until robot and person would touch if both went on as they move, 0 where they
    touch, at most 10.
    stalled_time: seconds slower than 0.05 m/s.
    mean_jerk: m/s^3, mean absolute second difference of the forward speed, by time.
    path_irregularity: rad/m, turning beyond what facing the goal at the start takes, per metre travelled (Guzzi et al.
    2013); 0 for a robot that did not move.
    spl: success weighted by path length (Anderson et al. 2018), by the straight distance, so obstacles lower it.
    """

    personal_space_violations: Doubles
    personal_space_time: Doubles
    min_time_to_collision: Doubles
    stalled_time: Doubles
    mean_jerk: Doubles
    path_irregularity: Doubles
    spl: Doubles

    def columns(self) -> dict[str, Doubles]:
        """(n,) each, by their names in results."""
        return {name: getattr(self, field) for name, field in COLUMNS.items()}


COLUMNS = {
    "personal_space_violations": "personal_space_violations",
    "personal_space_time_s": "personal_space_time",
    "min_time_to_collision_s": "min_time_to_collision",
    "stalled_time_s": "stalled_time",
    "mean_jerk_m_s3": "mean_jerk",
    "path_irregularity_rad_m": "path_irregularity",
    "spl": "spl",
}
"""Names in results, which give the unit, with the fields of `SocialMetrics`."""


def social_metrics(
    paths: Sequence[NDArray[np.float64]],
    scenes: Sequence[Scene],
    *,
    success: NDArray[np.bool_],
    path_length: NDArray[np.floating],
    accumulated_angle: NDArray[np.floating],
    dt: float | Doubles,
    people: Sequence[Doubles] | None = None,
) -> SocialMetrics:
    """The metrics of n rollouts.

    paths: (steps + 1, 2) m each, a point every dt seconds (of all, or (n,)); success (n,); path_length (n,) m;
    accumulated_angle (n,) rad; people: (people, steps + 1, 2) m each, where everybody was, the scene's own person
    first; None: as the scenes say. What is about people is NaN in a scene recorded without any. Raises ValueError where
    paths and scenes differ in number.
    """
    found = np.zeros((len(scenes), _COUNT))
    straight, facing = np.zeros(len(scenes)), np.zeros(len(scenes))
    steps_s = np.broadcast_to(np.asarray(dt, dtype=np.float64), len(scenes))
    for k, (row, path, scene, step_s) in enumerate(zip(found, paths, scenes, steps_s, strict=True)):
        if not scene.has_person:
            _of_path(np.ascontiguousarray(path), np.full((1, 2), np.nan), 0.0, step_s, row)
            row[:_OF_PEOPLE] = np.nan
            continue
        contact = get_setup(scene.setup).robot.radius_m + scene.person.radius
        everybody = _people(scene, len(path), step_s) if people is None else people[k]
        if len(everybody) == 1:
            _of_path(np.ascontiguousarray(path), np.ascontiguousarray(everybody[0]), contact, step_s, row)
        else:
            _among_people(np.ascontiguousarray(path), everybody, contact, step_s, row)
    for k, scene in enumerate(scenes):
        dx, dy = scene.goal.x - scene.start.x, scene.goal.y - scene.start.y
        straight[k] = math.hypot(dx, dy)
        off = math.atan2(dy, dx) - scene.start.yaw
        facing[k] = abs((off + math.pi) % (2 * math.pi) - math.pi)
    lengths, turned = path_length.astype(np.float64), accumulated_angle.astype(np.float64)
    beyond = np.maximum(0.0, turned - facing)
    violations, inside, soonest, stalled, jerk = found.T
    return SocialMetrics(
        personal_space_violations=violations,
        personal_space_time=inside,
        min_time_to_collision=soonest,
        stalled_time=stalled,
        mean_jerk=jerk,
        path_irregularity=np.divide(beyond, lengths, out=np.zeros_like(beyond), where=lengths > 0),
        spl=success * straight / np.maximum(np.maximum(straight, lengths), 1e-9),
    )


def join(parts: Sequence[SocialMetrics]) -> SocialMetrics:
    """The rollouts of all parts, in order."""
    names = [field.name for field in fields(SocialMetrics)]
    return SocialMetrics(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _among_people(path: Doubles, people: Doubles, contact: float, dt: float, out: Doubles) -> None:
    """Fill out (5,): violations of everybody's space together, time in anybody's, the soonest collision with any."""
    each = np.zeros((len(people), _COUNT))
    for row, places in zip(each, people, strict=True):
        _of_path(path, np.ascontiguousarray(places), contact, dt, row)
    inside = (np.linalg.norm(people - path, axis=2) < PERSONAL_SPACE_M).any(axis=0)[1:].sum() * dt
    out[:] = each[:, 0].sum(), inside, each[:, 2].min(), *each[0, 3:]


def _people(scene: Scene, points: int, dt: float) -> Doubles:
    """(people, points, 2) where everybody is at each pose; (1, 1, 2) for one alone who stands."""
    if scene.walk is None and scene.crowd is None:
        return np.array([[[scene.person.pose.x, scene.person.pose.y]]])
    return scene.people_at(np.arange(points) * dt)


@compiled
def _of_path(path: Doubles, people: Doubles, contact: float, dt: float, out: Doubles) -> None:
    """Fill out (5,) in the order of `SocialMetrics`. people: (1, 2) who stand or (points, 2); contact: of centres."""
    violations, inside, stalled, jerks, was_inside = 0.0, 0.0, 0.0, 0.0, False
    soonest, speed_before, acceleration_before = LONGEST_TTC_S, 0.0, 0.0
    last = people.shape[0] - 1
    for k in range(path.shape[0]):
        now, before = min(k, last), min(max(k - 1, 0), last)
        x, y = people[now, 0] - path[k, 0], people[now, 1] - path[k, 1]
        distance = math.sqrt(x * x + y * y)
        is_inside = distance < PERSONAL_SPACE_M
        if is_inside and not was_inside:
            violations += 1.0
        was_inside = is_inside
        if distance <= contact:
            soonest = 0.0
        if k == 0:
            continue
        if is_inside:
            inside += dt
        robot_x, robot_y = (path[k, 0] - path[k - 1, 0]) / dt, (path[k, 1] - path[k - 1, 1]) / dt
        speed = math.sqrt(robot_x * robot_x + robot_y * robot_y)
        if speed < STALLED_BELOW_M_S:
            stalled += dt
        acceleration = (speed - speed_before) / dt
        if k >= 3:
            jerks += abs(acceleration - acceleration_before) / dt
        speed_before, acceleration_before = speed, acceleration
        vx = (people[now, 0] - people[before, 0]) / dt - robot_x
        vy = (people[now, 1] - people[before, 1]) / dt - robot_y
        closing, pace = -(x * vx + y * vy), vx * vx + vy * vy
        under = closing * closing - pace * (distance * distance - contact * contact)
        if closing > 0.0 and under >= 0.0 and pace > 0.0:
            soonest = min(soonest, max(0.0, (closing - math.sqrt(under)) / pace))
    out[0], out[1], out[2], out[3] = violations, inside, soonest, stalled
    out[4] = jerks / (path.shape[0] - 3) if path.shape[0] > 3 else 0.0

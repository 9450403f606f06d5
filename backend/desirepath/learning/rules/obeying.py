"""The policy that drives by rules: step by step those that hold change the weights of the conditioned policy, and zones
stand as walls in what its lidar sees, around which it is led.

A robot in a zone is led out of it; where there is no other way, or the goal lies in one, it drives through. All ours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.steering import Progress, Recovery, Slowing, stand
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Floats, Policy
from desirepath.learning.rules.homes import ALIASES, DOORWAY, rooms_of
from desirepath.learning.rules.rule import Condition, Rule, Zone, check_rules, weights_by
from desirepath.simulation import kernels as k
from desirepath.simulation.acting import ActFunction, EpisodeActs, Rows, SensingPolicy
from desirepath.simulation.crowds.planning_kernels import arrival_times
from desirepath.simulation.fast import beams_of
from desirepath.simulation.scene import Obstacle, Pose, Scene
from desirepath.simulation.scenes import extent_m, ground_of, scene_to_row
from desirepath.simulation.setups import CONTROL_DT_S, Setup, get_setup

NEAR_THING_M, NEAR_PERSON_M = 1.0, 1.8  # that count as near: to its surface, to the person's middle
BEFORE_M, BESIDE_M = 1.6, 1.4  # how far a zone before or behind somebody reaches, and how wide it is
BETWEEN_M, AROUND_M = 0.6, 0.5  # width of one between a person and a thing; what one at a thing reaches beyond it
WALKS_M_S = 0.1
ZONE_HEIGHT_M = 2.0
CELL_M, WANTED_M, AHEAD = 0.12, 0.3, 7  # of the field of ways around zones, as `way_guide.py` has it
BLOCKED = 60.0  # what a blocked cell costs
FREED_M_S, TURN_PER_S = 0.5, 2.5  # of who is stuck on a way around: at most; of the bearing
OPEN_M = 6.0  # around start and goal, in the open


@dataclass(frozen=True)
class Situation:
    """A moment: robot and person (x, y, yaw), whether they walk; place: which of the scenes, for zones drawn there."""

    scene: Scene
    robot: tuple[float, float, float]
    person: tuple[float, float, float]
    walks: bool
    place: int = 0

    @classmethod
    def at(cls, scene: Scene, robot: Sequence[float], seconds: float, place: int = 0) -> Situation:
        now, after = scene.person_poses([seconds, seconds + CONTROL_DT_S])
        walks = math.dist(now[:2], after[:2]) > WALKS_M_S * CONTROL_DT_S
        x, y, yaw = map(float, robot)
        return cls(scene, (x, y, yaw), (float(now[0]), float(now[1]), float(now[2])), walks, place)

    def holds(self, condition: Condition) -> bool:
        return self._is(condition) == condition.holds

    def _is(self, condition: Condition) -> bool:
        scene, (x, y, _) = self.scene, self.robot
        match condition.kind:
            case "sitting":
                return scene.person.sits
            case "standing":
                return not scene.person.sits and not self.walks
            case "walking":
                return self.walks
            case "others":
                return scene.crowd is not None
            case "room":
                name = ALIASES.get(str(condition.of), condition.of)
                return any(area.name == name and area.holds(x, y) for area in rooms_of(scene))
            case "near":
                if condition.of == "person":
                    return math.dist((x, y), self.person[:2]) <= NEAR_PERSON_M
                return any(float(one.distance_m(x, y)) <= NEAR_THING_M for one in _things(scene, str(condition.of)))
        return False  # nobody tells of time pressure yet

    def where(self, condition: Condition) -> list[Obstacle]:
        """The part of the floor in which the robot is while a condition of a place holds; none of another."""
        if condition.kind == "room" and condition.holds:
            return self._rooms(str(condition.of))
        if condition.kind == "near" and condition.holds and condition.of not in ("person", "wall", "furniture"):
            wider = 2 * NEAR_THING_M
            things = _things(self.scene, str(condition.of))
            return [_box(one.pose, one.length + wider, one.width + wider) for one in things]
        return []

    def in_force(self, rules: Sequence[Rule]) -> list[Rule]:
        """Those that are on, complete, and hold now, in their order."""
        return [rule for rule in rules if rule.on and rule.complete and all(self.holds(one) for one in rule.when)]

    def areas(self, zone: Zone) -> list[Obstacle]:
        """Where a zone is now, as boxes on the floor."""
        x, y, yaw = self.person
        match zone.kind:
            case "front" | "behind":
                ahead = yaw if zone.kind == "front" else yaw + math.pi
                middle = Pose(x + math.cos(ahead) * BEFORE_M / 2, y + math.sin(ahead) * BEFORE_M / 2, ahead)
                return [_box(middle, BEFORE_M, BESIDE_M)]
            case "between":
                things = _things(self.scene, str(zone.of))
                if not things:
                    return []
                to = min(things, key=lambda one: float(one.distance_m(x, y))).pose
                along, length = math.atan2(to.y - y, to.x - x), math.dist((x, y), (to.x, to.y))
                return [_box(Pose((x + to.x) / 2, (y + to.y) / 2, along), length, BETWEEN_M)]
            case "thing":
                wider = 2 * AROUND_M
                return [
                    _box(one.pose, one.length + wider, one.width + wider) for one in _things(self.scene, str(zone.of))
                ]
            case "room":
                return [] if zone.of == DOORWAY else self._rooms(str(zone.of))
        drawn = zone.drawn
        if drawn is None or drawn.place != self.place:
            return []
        return [_box(Pose(drawn.x, drawn.y, drawn.yaw), drawn.length, drawn.width)]

    def _rooms(self, name: str) -> list[Obstacle]:
        """Those of a name, as boxes on the floor."""
        return [
            _box(
                Pose((area.low[0] + area.high[0]) / 2, (area.low[1] + area.high[1]) / 2),
                area.high[0] - area.low[0],
                area.high[1] - area.low[1],
            )
            for area in rooms_of(self.scene)
            if area.name == ALIASES.get(name, name)
        ]


def _box(middle: Pose, length: float, width: float) -> Obstacle:
    return Obstacle("box", middle, length, width, ZONE_HEIGHT_M)


def _things(scene: Scene, name: str) -> list[Obstacle]:
    if name == "wall":
        return [one for one in scene.solids() if one.kind == "wall"]
    if name == "furniture":
        return [one for one in scene.obstacles if one.kind != "wall"]
    alike = {"sofa": ("sofa", "couch"), "box": ("box", "cube")}.get(name, (name,))
    return [one for one in scene.obstacles if one.kind in alike]


class ObeyingPolicy(SensingPolicy):
    """Drives by preference weights and rules. places: of each scene, which place it is, for zones drawn there."""

    def __init__(
        self,
        conditioned: ConditionedPolicy,
        weights: Mapping[str, float],
        rules: Sequence[Rule],
        places: Sequence[int] | None = None,
    ) -> None:
        check_rules(rules)
        self._conditioned = replace(conditioned, slowing=conditioned.slowing or Slowing())
        self._weights, self._rules = dict(weights), list(rules)
        self._places = places
        self._known: dict[tuple[tuple[str, float], ...], Policy] = {}

    def begin_in(self, engine: Any) -> EpisodeActs:
        n, setup = engine.n_envs, engine.setup
        scenes = [engine.scene(i) for i in range(n)]
        places = self._places or [0] * n
        lasts = len(self._usual().recovery_policies) + 1
        progress = Progress(n, lasts, CONTROL_DT_S, Recovery())
        leads, before = [_Around(scene) for scene in scenes], np.zeros(n, dtype=np.bool_)

        def act(observations: Floats, rows: Rows) -> Floats:
            seen = observations.copy()
            left_m = observations[:, 0].astype(np.float64) * setup.distance_scale_m
            led = np.zeros(len(rows), dtype=np.bool_)
            by_weights: dict[tuple[tuple[str, float], ...], list[int]] = {}
            shares = np.ones(len(rows), dtype=np.float32)
            for at, i in enumerate(rows):
                moment = Situation.at(scenes[i], engine.poses[i], engine.steps[i] * CONTROL_DT_S, places[i])
                rules = moment.in_force(self._rules)
                weights, shares[at] = weights_by(self._weights, rules)
                by_weights.setdefault(tuple(sorted(weights.items())), []).append(at)
                goal, zones = scenes[i].goal, [zone for rule in rules for zone in rule.zones]
                areas = [
                    area
                    for zone in zones
                    for area in moment.areas(zone)
                    if zone.kind != "room" or float(area.distance_m(goal.x, goal.y)) > 0  # told to go in there
                ]
                if areas:
                    led[at], left_m[at] = True, leads[i].lead(moment, areas, seen[at])
            progress.begin_anew(rows[led != before[rows]])  # a way around is another distance
            before[rows] = led
            drivers = progress.drivers(left_m, rows)
            actions = np.empty((len(rows), 2), dtype=np.float32)
            for weights_key, some in by_weights.items():
                for driver in np.unique(drivers[some]):
                    these = np.array([at for at in some if drivers[at] == driver])
                    actions[these] = self._driver(weights_key, int(driver))(seen[these])
            stuck = led & (drivers > 0)
            if stuck.any():
                actions[stuck] = self._along(seen[stuck, 1] * math.pi, setup)
            for share in np.unique(shares[shares < 1]):
                slow = shares == share
                actions[slow] = Slowing(most=float(share)).limited(actions[slow], np.zeros(slow.sum(), np.float32))
            return actions

        return act

    def _along(self, bearing: Floats, setup: Setup) -> Floats:
        """(n, 2) actions straight along the way around, as `way_guide.py` drives."""
        limits = setup.robot.limits
        forward = 2 * FREED_M_S / limits.v_max * np.clip(np.cos(bearing), 0, 1) ** 4 - 1
        turning = np.clip(TURN_PER_S * bearing / limits.w_max, -1, 1)
        return np.stack([forward, turning], axis=1).astype(np.float32)

    def _usual(self, key: tuple[tuple[str, float], ...] = ()) -> Policy:
        if key not in self._known:
            self._known[key] = self._conditioned.weighed(dict(key))
        return self._known[key]

    def _driver(self, key: tuple[tuple[str, float], ...], driver: int) -> ActFunction:
        usual = self._usual(key)
        if driver == 0:
            return usual.act
        if driver > len(usual.recovery_policies):
            return stand
        return Policy(usual.setup, usual.shape, usual.recovery_policies[driver - 1], slowing=usual.slowing).act


class _Around:
    """What one robot is made to see of zones, and where it is led around them. Ways are found anew where a zone or the
    person has moved."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._setup = scene, get_setup(scene.setup)
        self._beams, self._ground = beams_of(self._setup), ground_of(scene)
        self._found_for: tuple[list[Obstacle], tuple[float, float, float]] | None = None

    def lead(self, moment: Situation, areas: list[Obstacle], seen: Floats) -> float:
        """Change what is observed (obs,): the lidar's ranges, and which way the goal is. Returns how far the way there
        is, as much as it costs (m)."""
        x, y, yaw = moment.robot
        if self._found_for != (areas, moment.person):
            self._found_for = areas, moment.person
            self._row = scene_to_row(self._with(moment, areas))
            self._find_ways(moment)
        goal, radius = self._scene.goal, self._setup.robot.radius_m
        ahead = self._ahead(x, y)
        seen[1] = math.remainder(math.atan2(ahead[1] - y, ahead[0] - x) - yaw, 2 * math.pi) / math.pi
        i, j = self._cell_of(x, y)
        left_m = float(self._times[i, j]) * CELL_M
        if self._shut:
            return left_m  # no way but through one: it is led, and sees no wall
        walls = [
            one
            for one in areas
            if float(one.distance_m(x, y)) > radius and float(one.distance_m(goal.x, goal.y)) > radius
        ]
        if walls:
            row = scene_to_row(self._with(moment, walls))
            ranges = k.seen_ranges(row, x, y, yaw, self._beams, self._ground)
            first = len(seen) - len(ranges)
            seen[first:] = np.minimum(seen[first:], ranges / self._setup.robot.lidar.range_m)
        return left_m

    def _with(self, moment: Situation, areas: Sequence[Obstacle]) -> Scene:
        person = replace(self._scene.person, pose=Pose(*moment.person))
        return replace(self._scene, person=person, walk=None, obstacles=(*self._scene.obstacles, *areas))

    def _find_ways(self, moment: Situation) -> None:
        goal, (x, y, _) = self._scene.goal, moment.robot
        self._row[k.START_X], self._row[k.START_Y] = x, y
        self._shut = not k.reachable(self._row, self._setup.robot.radius_m, self._ground)
        extent = extent_m(self._scene)
        if extent is None:
            ends = np.array([[x, y], [goal.x, goal.y]])
            extent = ends.min(0) - OPEN_M, ends.max(0) + OPEN_M
        self._low = extent[0]
        size = np.maximum(np.ceil((extent[1] - self._low) / CELL_M).astype(int), 2)
        costs = np.empty(size, dtype=np.float32)
        radius = self._setup.robot.radius_m + 0.05
        k.way_costs(self._row, self._low[0], self._low[1], CELL_M, radius, WANTED_M, BLOCKED, costs, self._ground)
        self._times = np.empty(tuple(size), dtype=np.float32)
        end = (np.array([goal.x, goal.y]) - self._low) / CELL_M
        arrival_times(costs, end[0], end[1], self._times)

    def _ahead(self, x: float, y: float) -> NDArray[np.float64]:
        """Where one comes some cells down the times, from one to the nearest of the eight beside it."""
        times, goal = self._times, np.array([self._scene.goal.x, self._scene.goal.y])
        i, j = self._cell_of(x, y)
        for _ in range(AHEAD):
            left, under = max(i - 1, 0), max(j - 1, 0)
            beside = times[left : i + 2, under : j + 2]
            a, b = divmod(int(beside.argmin()), beside.shape[1])
            if (left + a, under + b) == (i, j):
                return goal
            i, j = left + a, under + b
        return np.asarray(self._low + (np.array([i, j]) + 0.5) * CELL_M)

    def _cell_of(self, x: float, y: float) -> tuple[int, int]:
        cell = ((np.array([x, y]) - self._low) / CELL_M).astype(int)
        i, j = np.clip(cell, 0, np.array(self._times.shape) - 1).tolist()
        return i, j

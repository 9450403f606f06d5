"""The setups: a scene generator, robot limits, observation layout and core reward that belong together.

A policy, buffer or query set belongs to exactly one setup; `require_same` refuses a mix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

CONTROL_DT_S = 0.2  # 5 Hz everywhere


class SetupError(ValueError):
    """An unknown setup, or things of two setups mixed."""


@dataclass(frozen=True)
class Limits:
    """Robot command limits: v in [v_min, v_max] m/s, w in [-w_max, w_max] rad/s. Never backwards."""

    v_min: float
    v_max: float
    w_max: float = math.pi


@dataclass(frozen=True)
class Lidar:
    """`beams` rays over 360 degrees from straight ahead, counter-clockwise, pooled by minimum into `sectors`."""

    beams: int
    sectors: int
    range_m: float
    height_m: float = 0.3


@dataclass(frozen=True)
class Robot:
    """What drives: a disc of `radius_m` on the floor, `height_m` tall, with differential drive."""

    name: str
    radius_m: float
    height_m: float
    limits: Limits
    lidar: Lidar


def _turtlebot2(limits: Limits, lidar: Lidar) -> Robot:
    """The Kobuki TurtleBot 2 of all chapters, as fast as a chapter let it drive."""
    return Robot("turtlebot2", radius_m=0.18, height_m=0.42, limits=limits, lidar=lidar)


@dataclass(frozen=True)
class CoreReward:
    """The task reward r of a setup, without any preference and without the training-only progress term."""

    goal: float
    collision: float
    timeout: float
    self_intersection: float
    time_per_step: float = 0.0
    jerk_weight: float = 0.0


@dataclass(frozen=True)
class NearPenalty:
    """What a step costs that ends with the robot's centre this near to the surface of a wall, an obstacle or a person.

    Beside `CoreReward`, whose fields every exported data set names.
    """

    reward: float
    within_m: float


@dataclass(frozen=True)
class Setup:
    """Everything a policy is bound to. Observation: float32 vector of

    [goal distance / distance_scale_m, goal bearing / pi,
     (person distance / distance_scale_m, person bearing / pi if with_person),
     (of the `pedestrians` nearest ones, the nearest being the person: motion of the nearest along and across the
      robot's heading, m/s; of each of the others distance and bearing likewise, and motion),
     (`path_points` next places of the path, x and y in the robot's frame / distance_scale_m),
     (v / v_max, w / w_max if with_velocity), sector ranges / lidar range ...].

    Where `solids` is above 0 (chapter 2), the robot knows that many walls and obstacles instead of a lidar scan:
    [person distance / distance_scale_m, cos and sin of the person's bearing, of the goal's bearing, of the person's
     heading relative to the robot's, then per solid: distance of its closest point / distance_scale_m, cos and sin of
     that point's bearing]; the four walls (+x, -x, +y, -y) first. Angles as cosine and sine (ours): nothing jumps
    where a bearing passes straight behind.
    """

    name: str
    robot: Robot
    reward: CoreReward
    goal_radius_m: float
    max_steps: int
    gamma: float
    with_velocity: bool
    distance_scale_m: float = 10.0
    self_intersection_min_age_steps: int = 4
    solids: int = 0
    with_person: bool = True
    near: NearPenalty | None = None
    extractors: bool = True  # networks read task part and lidar by an extractor each (ch. 6), or all at once (ch. 8)
    crowded: bool = False  # whether pedestrians walk in its scenes
    pedestrians: int = 0
    path_points: int = 0

    @property
    def polar_size(self) -> int:
        """Length of the task part of the observation (everything before lidar or solids)."""
        if self.solids:
            return 7
        return 2 + 2 * self.with_person + self.pedestrian_inputs + 2 * self.path_points + 2 * self.with_velocity

    @property
    def pedestrian_inputs(self) -> int:
        """How many inputs tell of pedestrians, after distance and bearing of the nearest one."""
        return 4 * self.pedestrians - 2 if self.pedestrians else 0

    @property
    def person_inputs(self) -> tuple[int, int] | None:
        """Where distance and bearing of the person are observed; None where only the lidar tells of them."""
        return (2, 3) if self.with_person and not self.solids else None

    @property
    def surroundings_size(self) -> int:
        """Length of the rest of the observation: lidar sectors, or three numbers per solid."""
        return 3 * self.solids if self.solids else self.robot.lidar.sectors

    @property
    def observation_size(self) -> int:
        return self.polar_size + self.surroundings_size

    def observation_layout(self) -> list[dict[str, object]]:
        """One entry per input, in order: name, unit, scale that was applied; written into every policy's manifest."""
        if self.solids:
            return self._solids_layout()
        polar: list[dict[str, object]] = [
            {"name": "goal_distance", "unit": "m", "divided_by": self.distance_scale_m},
            {"name": "goal_bearing", "unit": "rad", "divided_by": math.pi},
        ]
        if self.with_person:
            polar += [
                {"name": "person_distance", "unit": "m", "divided_by": self.distance_scale_m},
                {"name": "person_bearing", "unit": "rad", "divided_by": math.pi},
            ]
        for k in range(self.pedestrians):
            if k:
                polar += [
                    {"name": f"pedestrian_{k}_distance", "unit": "m", "divided_by": self.distance_scale_m},
                    {"name": f"pedestrian_{k}_bearing", "unit": "rad", "divided_by": math.pi},
                ]
            polar += [
                {"name": f"pedestrian_{k}_{part}", "unit": "m/s", "divided_by": 1.0} for part in ("along", "across")
            ]
        for k in range(self.path_points):
            polar += [{"name": f"path_{k}_{axis}", "unit": "m", "divided_by": self.distance_scale_m} for axis in "xy"]
        if self.with_velocity:
            polar += [
                {"name": "linear_velocity", "unit": "m/s", "divided_by": self.robot.limits.v_max},
                {"name": "angular_velocity", "unit": "rad/s", "divided_by": self.robot.limits.w_max},
            ]
        return polar + [
            {"name": f"lidar_{i}", "unit": "m", "divided_by": self.robot.lidar.range_m}
            for i in range(self.robot.lidar.sectors)
        ]

    def _solids_layout(self) -> list[dict[str, object]]:
        def distance(name: str) -> list[dict[str, object]]:
            return [{"name": f"{name}_distance", "unit": "m", "divided_by": self.distance_scale_m}]

        def angle(name: str) -> list[dict[str, object]]:
            return [{"name": f"{name}_{part}", "unit": "1", "divided_by": 1.0} for part in ("cos", "sin")]

        layout = distance("person") + angle("person_bearing") + angle("goal_bearing") + angle("person_heading")
        for i in range(self.solids):
            layout += distance(f"solid_{i}") + angle(f"solid_{i}_bearing")
        return layout


OPEN_FIELD = Setup(
    name="open_field",  # ch. 6; table 6.1
    robot=_turtlebot2(
        Limits(0.0, 0.5),
        Lidar(beams=360, sectors=30, range_m=6.0),
    ),
    reward=CoreReward(goal=20.0, collision=-1.2, timeout=-20.0, self_intersection=-2.0),
    goal_radius_m=0.4,
    max_steps=500,
    gamma=0.98,
    with_velocity=False,
)
STUDY_ROOM = Setup(
    name="study_room",  # ch. 7; equation 7.1 and the public code
    robot=_turtlebot2(
        Limits(0.0, 1.0),
        Lidar(beams=720, sectors=60, range_m=6.0),
    ),
    reward=CoreReward(
        goal=20.0,
        collision=-20.0,
        timeout=-1.0,
        self_intersection=-2.0,
        time_per_step=-0.001,
        jerk_weight=0.0005,
    ),
    goal_radius_m=0.36,
    max_steps=500,
    gamma=0.98,
    with_velocity=True,
)


def _demonstrated(name: str, solids: int) -> Setup:
    """An environment of chapter 2: rewards of section 2.4.5, limits and episode length of section 2.5 and table 2.1.

    The goal's +5 is paid in demonstration data only (`desirepath.demonstrations`), so reaching it earns nothing here.
    Goal radius, distance scale and the lidar that the dynamic window approach reads are ours.
    """
    return Setup(
        name=name,
        robot=_turtlebot2(
            Limits(0.1, 0.25),
            Lidar(beams=360, sectors=60, range_m=6.0),
        ),
        reward=CoreReward(goal=0.0, collision=-5.0, timeout=-2.5, self_intersection=0.0),
        goal_radius_m=0.3,
        max_steps=300,
        gamma=0.99,
        with_velocity=False,
        distance_scale_m=4.0,
        solids=solids,
    )


CORRIDOR = _demonstrated("corridor", solids=4)
ROOM = _demonstrated("room", solids=7)
EXPLAINED_ROOM = Setup(
    name="explained_room",  # ch. 8, section 8.3.2; goal radius, episode length and discount as in ch. 7 (ours)
    robot=_turtlebot2(
        Limits(0.0, 1.0, 0.6),  # ours: with ch. 7's half turn per second a policy never slows down (mean 0.99 m/s)
        Lidar(beams=360, sectors=15, range_m=6.0),
    ),
    reward=CoreReward(
        goal=20.0,
        collision=-20.0,
        timeout=-1.0,
        self_intersection=0.0,
        time_per_step=-0.001,
        jerk_weight=1e-7,
    ),
    goal_radius_m=0.36,
    max_steps=500,
    gamma=0.98,
    with_velocity=False,
    with_person=False,
    near=NearPenalty(reward=-0.001, within_m=0.4),
    extractors=False,
)
ADAPTABLE = Setup(
    name="adaptable",  # ch. 5, sections 5.3.2.1, 5.3.4.1 and 5.4.1; goal radius ours
    robot=_turtlebot2(
        Limits(0.0, 0.5),
        Lidar(beams=720, sectors=30, range_m=4.0),
    ),
    reward=CoreReward(goal=0.0, collision=-1000.0, timeout=0.0, self_intersection=0.0),  # 125 per metre beside it
    goal_radius_m=0.4,
    max_steps=300,
    gamma=1.0,
    with_velocity=False,
    extractors=False,
)
HOME = Setup(
    name="home",  # ch. 3, sections 3.3.4 and 3.4; the goal's reward is that of exploration, half of a demonstration's
    robot=_turtlebot2(
        Limits(0.0, 0.5),
        Lidar(beams=180, sectors=30, range_m=6.0),  # ours, for the obstacle avoider that records depth frames
    ),
    reward=CoreReward(goal=5.0, collision=-5.0, timeout=-2.5, self_intersection=0.0),
    goal_radius_m=0.3,  # ours, as in ch. 2
    max_steps=150,
    gamma=0.99,
    with_velocity=False,
)
CROWD_CORRIDOR = Setup(
    name="crowd_corridor",  # ch. 4, sections 4.4.3, 4.4.6, 4.5.1; its reward is `crowd_setups.CrowdReward`
    robot=_turtlebot2(
        Limits(0.0, 1.0),
        Lidar(beams=1440, sectors=180, range_m=3.5),
    ),
    reward=CoreReward(goal=0.0, collision=-10.0, timeout=0.0, self_intersection=0.0),
    goal_radius_m=0.2,
    max_steps=150,
    gamma=0.98,
    with_velocity=False,
    with_person=False,
    extractors=False,
    crowded=True,
    path_points=5,
)
CROWD_INTERSECTION = replace(CROWD_CORRIDOR, name="crowd_intersection")
CROWD_OFFICE = replace(CROWD_CORRIDOR, name="crowd_office")
CROWD_HOME = replace(CROWD_CORRIDOR, name="crowd_home")  # never trained in: section 4.5.6
CROWD_HALL = Setup(
    name="crowd_hall",  # ours: the study room's robot and reward in a hall where people walk, for people to judge
    robot=_turtlebot2(
        Limits(0.0, 1.0),
        Lidar(beams=360, sectors=36, range_m=6.0),
    ),
    reward=CoreReward(
        goal=20.0, collision=-20.0, timeout=-20.0, self_intersection=-2.0, time_per_step=-0.02, jerk_weight=0.0
    ),
    goal_radius_m=0.36,
    max_steps=200,
    gamma=0.98,
    with_velocity=True,
    crowded=True,
    pedestrians=3,
)
CROWD_SETUPS = (CROWD_CORRIDOR, CROWD_INTERSECTION, CROWD_OFFICE, CROWD_HOME, CROWD_HALL)
SETUPS = {
    setup.name: setup
    for setup in (OPEN_FIELD, STUDY_ROOM, CORRIDOR, ROOM, EXPLAINED_ROOM, ADAPTABLE, HOME, *CROWD_SETUPS)
}
PREFERENCE_SETUPS = (OPEN_FIELD.name, STUDY_ROOM.name)
DEMONSTRATION_SETUPS = (CORRIDOR.name, ROOM.name)


def get_setup(name: str) -> Setup:
    """The setup of that name. Raises SetupError listing the known ones."""
    try:
        return SETUPS[name]
    except KeyError:
        raise SetupError(f"unknown setup {name!r}; known: {', '.join(SETUPS)}") from None


def require_lidar(setup: Setup) -> None:
    """Raise SetupError for a setup whose observation holds no lidar scan: its inputs mean something else."""
    if setup.solids:
        raise SetupError(
            f"setup {setup.name} observes closest points, no lidar; this needs one of {', '.join(PREFERENCE_SETUPS)}"
        )


def require_person(setup: Setup) -> None:
    """Raise SetupError for a setup whose robot scans its surroundings and is not told where the person is."""
    require_lidar(setup)
    if setup.person_inputs is None:
        raise SetupError(
            f"setup {setup.name} does not observe where the person is; this needs one of {', '.join(PREFERENCE_SETUPS)}"
        )


def require_same(**named: str) -> str:
    """The one setup that all the named things share. Raises SetupError naming who differs."""
    if len(set(named.values())) != 1:
        raise SetupError("setups differ: " + ", ".join(f"{who} is {name}" for who, name in named.items()))
    return next(iter(named.values()))

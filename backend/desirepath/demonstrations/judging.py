"""How well a controller does what was demonstrated, and how it does where nothing was (ch. 2, results to honour).

Distances between paths live in `desirepath.analysis.frechet`, what is compared in `controllers.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.frechet import Deviation, deviation
from desirepath.analysis.metrics import collision_rate, measure, success_rate, timeout_rate
from desirepath.demonstrations.controllers import roll_out
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.learning.policies.policy import Policy
from desirepath.learning.scene_sets import SCENES_PER_SEED, Purpose, first_seed
from desirepath.simulation.scene import Scene, SceneError
from desirepath.simulation.scenes import check_scene, draw_scenes
from desirepath.simulation.trajectory import Outcome, Trajectory

Doubles = NDArray[np.float64]
PROFILE_POINTS = 50
SPARSE_M = 0.1  # spacing at which paths are compared: finer changes distances by less than 1 cm
EXACT_M = 1e-3
CHANGING_M_S = 0.01  # a demonstration whose speed has a smaller standard deviation has no profile to follow
FOLLOWED_M, FOLLOWED_T = 0.25, 0.8  # ours: so close, and so far along, is a demonstration followed
DRAWN_AT_ONCE = 50  # divides a set's 10,000 scenes
NEAREST_GOAL_M = 1.0  # between a drawn start and its goal
KINDS = ("starts", "goals", "people", "anywhere")


@dataclass(frozen=True)
class Likeness:
    """One rollout beside the demonstration it follows best: the one with the highest cost C(t*) of its pair.

    speed_correlation: Pearson's r between the speeds at the same shares of both paths; NaN where the demonstration
    keeps one speed.
    """

    deviation: Deviation
    speed_correlation: float


@dataclass(frozen=True)
class Judgement:
    """A controller's rollouts from the demonstrated starts, against the demonstrations. Medians over them; SI units.

    followed_rate: share of rollouts that arrive and, each by itself, are within FOLLOWED_M of a demonstration at a t*
    of FOLLOWED_T or later. The two medians say less: they may come from different rollouts, and who circles at the
    start stays near every path's beginning, f small at t* = 1. speed_correlation: NaN where none changes speed.
    """

    rollouts: int
    success_rate: float
    collision_rate: float
    timeout_rate: float
    frechet_m: float
    t_star: float
    followed_rate: float
    speed_correlation: float
    min_human_distance_m: float
    relative_path_length: float
    path_area_m2: float

    def as_dict(self) -> dict[str, float | None]:
        """JSON-ready: null for NaN. `drives` is what the first releases called rollouts, in all that is stored."""
        stored = {"drives" if name == "rollouts" else name: value for name, value in asdict(self).items()}
        return {name: None if math.isnan(value) else value for name, value in stored.items()}


def _sparse(poses: NDArray[np.floating]) -> Doubles:
    """(n, 2) about every SPARSE_M along a trajectory."""
    path = np.asarray(poses, dtype=np.float64)[:, :2]
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    places = np.linspace(0.0, lengths[-1], max(2, math.ceil(lengths[-1] / SPARSE_M) + 1))
    return np.stack([np.interp(places, lengths, path[:, axis]) for axis in range(2)], axis=1)


def speed_profile(trajectory: Trajectory) -> Doubles:
    """(PROFILE_POINTS,) m/s at equal shares of the driven path."""
    steps = np.linalg.norm(np.diff(trajectory.poses[:, :2].astype(np.float64), axis=0), axis=1)
    shares = (np.cumsum(steps) - steps / 2) / max(float(steps.sum()), 1e-9)
    return np.asarray(np.interp(np.linspace(0.0, 1.0, PROFILE_POINTS), shares, steps / trajectory.dt))


def likeness(trajectory: Trajectory, demonstrations: Sequence[Demonstration]) -> Likeness:
    """The trajectory beside the best of these demonstrations. Raises ValueError for none."""
    if not demonstrations:
        raise ValueError("demonstrations: none given to compare with")
    path = _sparse(trajectory.poses)
    deviations = [deviation(path, _sparse(d.trajectory.poses), exact_m=EXACT_M) for d in demonstrations]
    best = max(range(len(deviations)), key=lambda i: deviations[i].cost)
    wanted, shown = speed_profile(demonstrations[best].trajectory), speed_profile(trajectory)
    constant = wanted.std() < CHANGING_M_S
    return Likeness(
        deviations[best], math.nan if constant else float(np.corrcoef(wanted, shown)[0, 1]) if shown.std() > 0 else 0.0
    )


def judge(controller: str | Policy, demonstrations: Sequence[Demonstration]) -> Judgement:
    """Roll out once from every demonstrated start and compare with the demonstrations of the same pair."""
    return judge_rollouts(roll_out(controller, [d.scene for d in demonstrations]), demonstrations)


def judge_rollouts(rollouts: Sequence[Trajectory], demonstrations: Sequence[Demonstration]) -> Judgement:
    """`judge` for rollouts that are there already: one from every demonstration's start, in their order."""
    alike = [
        likeness(trajectory, [other for other in demonstrations if other.drawn_in == mine.drawn_in])
        for trajectory, mine in zip(rollouts, demonstrations, strict=True)
    ]
    measured = measure(rollouts)
    followed = [
        trajectory.outcome == Outcome.SUCCESS
        and to_demonstrated.deviation.distance_m <= FOLLOWED_M
        and to_demonstrated.deviation.t_star >= FOLLOWED_T
        for trajectory, to_demonstrated in zip(rollouts, alike, strict=True)
    ]
    correlations = [a.speed_correlation for a in alike if not math.isnan(a.speed_correlation)]
    return Judgement(
        rollouts=len(rollouts),
        success_rate=success_rate(measured.outcome),
        collision_rate=collision_rate(measured.outcome),
        timeout_rate=timeout_rate(measured.outcome),
        frechet_m=float(np.median([a.deviation.distance_m for a in alike])),
        t_star=float(np.median([a.deviation.t_star for a in alike])),
        followed_rate=float(np.mean(followed)),
        speed_correlation=float(np.median(correlations)) if correlations else math.nan,
        min_human_distance_m=float(np.median(measured.min_human_distance)),
        relative_path_length=float(np.median(measured.relative_path_length)),
        path_area_m2=float(np.median(measured.path_area)),
    )


def unseen_scenes(pairs: Sequence[Scene], kind: str, n: int, *, purpose: Purpose, seed: int) -> list[Scene]:
    """n scenes that nobody demonstrated in, from the drawn ones of that purpose and seed.

    kind: what is drawn: `starts` (of the robot), `goals`, `people` (place and heading), or all three: `anywhere`. The
    rest is as in the pairs, in turn. Raises ValueError for another kind, SceneError if too few scenes fit.
    """
    draw: dict[str, Callable[[Scene, Scene], Scene]] = {
        "starts": lambda pair, drawn: replace(pair, start=drawn.start),
        "goals": lambda pair, drawn: replace(pair, goal=drawn.goal),
        "people": lambda pair, drawn: replace(pair, person=drawn.person),
        "anywhere": lambda pair, drawn: drawn,
    }
    if kind not in draw:
        raise ValueError(f"kind {kind!r}: known are {', '.join(draw)}")
    scenes: list[Scene] = []
    first = first_seed(purpose, seed)
    for begin in range(first, first + SCENES_PER_SEED, DRAWN_AT_ONCE):
        for drawn in draw_scenes(pairs[0].setup, range(begin, begin + DRAWN_AT_ONCE)):
            scene = replace(draw[kind](pairs[len(scenes) % len(pairs)], drawn), seed=drawn.seed, walk=None)
            if len(scenes) < n and _drivable(scene):
                scenes.append(scene)
        if len(scenes) == n:
            return scenes
    raise SceneError("seed", seed, f"gave fewer than {n} scenes with random {kind}; ask for fewer or another seed")


def _drivable(scene: Scene) -> bool:
    """Whether the drawn part fits the rest, with some way to go."""
    try:
        check_scene(scene)
    except SceneError:
        return False
    return math.dist((scene.start.x, scene.start.y), (scene.goal.x, scene.goal.y)) >= NEAREST_GOAL_M

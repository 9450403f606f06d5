"""How the person walks while the robot drives a drawn path: chosen before it, or walked by the participant beside it.

What comes from a page is read here and made into a demonstration, outside any transaction; which stroke it belongs to,
and what becomes of that, is `strokes.py`'s. The smooth walk itself is `desirepath.simulation.walks`'s.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from desirepath.grammar.words import PersonMode, View
from desirepath.study.refusals import Refused
from desirepath.study.steps import Step

if TYPE_CHECKING:
    from desirepath.demonstrations.demonstration import Demonstration
    from desirepath.simulation.scene import Scene
    from desirepath.simulation.walks import Walk

PLANNED = (("opposite", 0), ("opposite", 1), ("random", 2))  # mode and seed of the walks to choose from, ours
LEAST_HZ = 20  # poses a second, ours; client/walk.js records 30
MOST_POSES = 4_000
BEGINS_WITHIN_M = 0.3  # of where the person stood
BEGINS_WITHIN_S = 0.2


class PathStep(Step):
    """A step at which a path is drawn. pair: the environment's situation, from 0. optional: it can be left out."""

    environment: str
    pair: int
    view: View
    person: PersonMode = "still"
    optional: bool = False


@dataclass(frozen=True)
class Walked:
    """A walk beside a trajectory as it came, and what can be made of both: a demonstration or the problem with it.

    duration_s: of the recording.
    """

    stored: dict[str, Any]
    duration_s: float
    demonstration: Demonstration | None
    problem: dict[str, Any] | None


def beside_view(step: PathStep) -> View:
    """The view in which the participant walks: from their own eyes."""
    return "immersive" if step.view == "immersive" else "first_person"


def scene_with(scene: Scene, walk: Mapping[str, Any] | None) -> Scene:
    """The scene with the person who walks so (`StrokeRow.walk`); the scene itself where they stand."""
    from desirepath.simulation.scene import Person, Pose
    from desirepath.simulation.walks import Walk

    if walk is None:
        return scene
    spline = Walk(**{name: tuple(knots) for name, knots in walk["spline"].items()})
    begin = Pose(*(float(value) for value in spline.poses_at([0.0])[0]))
    return replace(scene, walk=spline, person=Person(begin, scene.person.radius, scene.person.height))


@lru_cache(maxsize=8)  # all situations that there are
def plan_walks(environment: str, pair: int) -> tuple[dict[str, Any], ...]:
    """The walks that can be chosen in a situation, as they are stored; the same for everybody."""
    from desirepath.demonstrations.planned_walks import walking_scene  # numba comes with it
    from desirepath.simulation.demonstration_scenes import demonstration_scene

    scene = demonstration_scene(environment, pair)
    walks = []
    for mode, seed in PLANNED:
        walk = walking_scene(scene, mode, seed).walk
        assert walk is not None  # noqa: S101  that is what it was asked for
        walks.append({"source": "planned", "mode": mode, "seed": seed, "spline": _knots(walk)})
    return tuple(walks)


def offer_walks(step: PathStep) -> tuple[dict[str, Any], ...]:
    """The walks that the participant chooses from before drawing, none where there is no choice."""
    return plan_walks(step.environment, step.pair) if step.person == "recorded" else ()


def choose_walk(step: PathStep, sent: Mapping[str, Any]) -> dict[str, Any] | None:
    """The walk that a stroke is drawn for, None where the person stands. Raises Refused for a choice there is not."""
    walks = offer_walks(step)
    if not walks:
        return None
    choice = sent.get("walk")
    if isinstance(choice, bool) or not isinstance(choice, int) or not 0 <= choice < len(walks):
        raise Refused(422, "bad_value", f"must be the number of a walk, 0 to {len(walks) - 1}", field="walk")
    return walks[choice]


def combine_with_walk(
    scene: Scene, drawn: Mapping[str, Any], beside: str | None, recorded: Any, *, simulated: bool
) -> Walked:
    """A recorded walk with the path it was walked beside: what they make together; touches no table (about 0.1 s).

    recorded: {"times_s": [...], "poses": [[x, y, yaw], ...]} from the page. beside: the trajectory shown. Raises
    Refused for what nobody can have walked there.
    """
    from desirepath.demonstrations.demonstration import demonstration_from  # numba comes with it
    from desirepath.demonstrations.stroke import Stroke, StrokeProblem
    from desirepath.simulation.walks import Walk, WalkError

    times, poses = _recording(recorded)
    stands = scene.person.pose
    if not 0 <= times[0] <= BEGINS_WITHIN_S or math.dist(poses[0][:2], (stands.x, stands.y)) > BEGINS_WITHIN_M:
        raise _bad(f"must begin with the rollout, within {BEGINS_WITHIN_M} m of where the person stood")
    try:
        spline = Walk.recorded([0.0, *times[1:]], poses)
    except WalkError as problem:
        raise _bad(str(problem)) from None
    stored = {
        "source": "walked",
        "times_s": times,
        "poses": poses,
        "spline": _knots(spline),
        "beside": beside,
        **({"simulated": True} if simulated else {}),
    }
    try:
        demonstration = demonstration_from(Stroke.of(**drawn), scene_with(scene, stored))
    except StrokeProblem as problem:
        return Walked(stored, times[-1], None, problem_of(problem))
    return Walked(stored, times[-1], demonstration, None)


def problem_of(problem: Any) -> dict[str, Any]:
    """A StrokeProblem as it is stored and sent."""
    described = {"code": problem.code, "message": str(problem), "thing": problem.thing, **problem.numbers}
    return described | {"at": list(problem.at) if problem.at else None}


def _knots(walk: Walk) -> dict[str, list[float]]:
    """A walk as JSON holds it."""
    return {field.name: list(getattr(walk, field.name)) for field in fields(walk)}


def _recording(sent: Any) -> tuple[list[float], list[list[float]]]:
    """Times and poses as plain numbers. Raises Refused naming what is wrong."""
    try:
        times = [float(value) for value in sent["times_s"]]
        poses = [[float(value) for value in pose] for pose in sent["poses"]]
    except (TypeError, ValueError, KeyError, OverflowError):
        raise _bad("must be {times_s: [...], poses: [[x, y, yaw], ...]}") from None
    if not 2 <= len(times) == len(poses) <= MOST_POSES or any(len(pose) != 3 for pose in poses):
        raise _bad(f"must have as many times as poses of three numbers, 2 to {MOST_POSES}")
    if not all(math.isfinite(value) for pose in (times, *poses) for value in pose):
        raise _bad("must be finite numbers")
    if any(later <= earlier for earlier, later in itertools.pairwise(times)):
        raise _bad("times_s must rise")
    rate = (len(times) - 1) / (times[-1] - times[0])
    if rate < LEAST_HZ:
        raise _bad(f"has {rate:.1f} poses a second, at least {LEAST_HZ} are needed")
    return times, poses


def _bad(message: str) -> Refused:
    return Refused(422, "bad_value", message, field="walk")

"""What a robot does by somebody's rules in one of the homes, and where on the floor they apply, for pages to draw.

Nothing is stored here; the kind of step is `kinds/rules.py`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from desirepath.learning.rules.rule import Rule, acted_on, collisions
from desirepath.learning.words.lexicon import Language
from desirepath.study.personalising.live_rollouts import LivePath, path_of

if TYPE_CHECKING:  # numba and the simulator come with these
    from desirepath.simulation.scene import Obstacle
    from desirepath.simulation.trajectory import Trajectory

LEAST_SEEN = 0.1
"""By how much more of the steps a rule must be obeyed in one picture than in the other."""


def driven_by(rules: Sequence[Rule], place: int) -> Trajectory:
    return _driven(acted_on(rules), place)


@lru_cache(maxsize=256)
def _driven(rules: tuple[Rule, ...], place: int) -> Trajectory:
    from desirepath.learning.rules.homes import rule_places
    from desirepath.learning.rules.obedience import drive_by

    return drive_by(rules, [rule_places()[place]], [place])[0]


def told(path: LivePath) -> dict[str, Any]:
    """As the reply `LiveRollout`."""
    return {"track": path.track, "arrives": path.arrives, "looks_at": []}


def paths_of(rule: Rule, place: int) -> tuple[LivePath, LivePath] | None:
    """The rule obeyed and broken there; None where it makes no difference that can be seen."""
    from desirepath.learning.rules.obedience import obeyed_steps

    on = rule.model_copy(update={"on": True})
    own, usual = driven_by((on,), place), driven_by((), place)
    (held, did), (held_usual, did_usual) = (obeyed_steps(on, one, place) for one in (own, usual))
    if not held or not held_usual or did / held <= did_usual / held_usual + LEAST_SEEN:
        return None
    return path_of(own), path_of(usual)


def read(sentence: str, language: Language) -> dict[str, Any]:
    """A sentence as the reply `RuleReply`. The caller has bounded its length."""
    from desirepath.learning.rules.reading import read_rule

    got = read_rule(sentence, language)
    asked = [
        {"about": one.about, "text": sentence[one.start : one.end], "offered": list(one.offered)} for one in got.asked
    ]
    return {"rule": got.rule.model_dump(mode="json"), "asked": asked}


def picture(rules: Sequence[Rule], place: int) -> dict[str, Any]:
    """The reply `RulesReply` without what was asked besides."""
    from desirepath.learning.rules.homes import rule_places

    trajectory = driven_by(rules, place)
    clashes = [{"first": i, "second": j, "about": about} for i, j, about in collisions(rules)]
    return {
        "floor": _floor(place),
        "shown": [_shown(rule, trajectory, place, rule_places()) for rule in rules],
        "collisions": clashes,
        "path": told(path_of(trajectory)),
    }


@lru_cache(maxsize=16)
def _floor(place: int) -> dict[str, Any]:
    from desirepath.learning.rules.homes import rule_places

    scene = rule_places()[place]
    assert scene.room is not None  # noqa: S101  homes have one
    half = [scene.room.length / 2, scene.room.width / 2]
    person = scene.person.pose
    return {
        "low": [-half[0], -half[1]],
        "high": half,
        "walls": [_outline(one) for one in scene.obstacles if one.kind == "wall"],
        "things": [_outline(one) for one in scene.obstacles if one.kind != "wall"],
        "person": [person.x, person.y, person.yaw],
        "does": "sits" if scene.person.sits else "walks" if scene.walk else "stands",
        "start": [scene.start.x, scene.start.y],
        "goal": [scene.goal.x, scene.goal.y],
    }


def _outline(box: Obstacle) -> list[list[float]]:
    return [[round(x, 3), round(y, 3)] for x, y in box.corners()]


def _shown(rule: Rule, trajectory: Trajectory, place: int, homes: Any) -> Mapping[str, Any]:
    from desirepath.learning.rules.homes import unavailable
    from desirepath.learning.rules.obedience import obeyed_steps
    from desirepath.learning.rules.obeying import Situation

    scene = trajectory.scene
    moment = Situation.at(scene, trajectory.poses[0], 0.0, place)
    return {
        "zones": [_outline(area) for zone in rule.zones for area in moment.areas(zone)],
        "holds_in": [_outline(area) for condition in rule.when for area in moment.where(condition)],
        "unavailable": [condition.label for condition in unavailable(rule, homes)],
        "held": obeyed_steps(rule, trajectory, place)[0] > 0,
    }

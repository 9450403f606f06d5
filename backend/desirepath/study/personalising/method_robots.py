"""The robots that one participant's methods resulted in: which preference weights each taught, and where they drive.

A method is a way to say how the robot should drive: choices between pairs, drawn paths, a sentence, sliders. All end in
weights for the setup's conditioned policy. Which steps a method has is `protocol/methods.py`'s, how its robots are
compared `kinds/method_comparison.py`'s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any, Literal, get_args

from sqlalchemy import select

from desirepath.store.events import log_event
from desirepath.store.models import Event, Response, StrokeRow
from desirepath.study.personalising import next_query
from desirepath.study.personalising.live_rollouts import condition_on, roll_out

if TYPE_CHECKING:
    from desirepath.simulation.scene import Scene
    from desirepath.simulation.trajectory import Trajectory
    from desirepath.study.kind import Acting, Moment

Method = Literal["choices", "drawing", "words", "sliders"]
METHODS: tuple[Method, ...] = get_args(Method)
ROBOTS_MADE = "method_robots_made"
CANDIDATES = 16  # ours: scenes looked at until enough are found in which every robot arrives
LONGEST_S = 30.0  # ours, as in other blind comparisons
LARGEST_SEED = 9_999
Weights = dict[str, float]


def weights_by_method(acting: Acting, setup: str, methods: Sequence[str]) -> dict[str, Weights]:
    """Method -> objective -> weight above 0, of the session's own answers; {} of one that taught nothing."""
    known = {"choices": _by_choices, "drawing": _by_drawing, "words": _by_hand, "sliders": _by_hand}
    return {method: known[method](acting, setup, method) for method in methods}


def _by_choices(acting: Acting, setup: str, method: str) -> Weights:
    if not next_query.answers_of(acting.s, acting.session):
        return {}
    from desirepath.learning.preferences.objectives import names_of

    weights = next_query.posterior_of(acting.s, acting.files, acting.session).mean_weights()
    return {name: round(float(weight), 3) for name, weight in zip(names_of(setup), weights, strict=True) if weight > 0}


def _by_drawing(acting: Acting, setup: str, method: str) -> Weights:
    from desirepath.demonstrations.demonstration import Demonstration
    from desirepath.learning.preferences.from_paths import weights_of_drawn

    strokes = acting.s.scalars(
        select(StrokeRow)
        .where(StrokeRow.session_id == acting.session.id, StrokeRow.environment == setup, StrokeRow.state == "kept")
        .order_by(StrokeRow.created_at)
    )
    drawn = [
        (stroke.pair, Demonstration.from_bytes(acting.files.get(stroke.demonstration)).trajectory)
        for stroke in strokes
        if stroke.demonstration is not None
    ]
    return weights_of_drawn(setup, drawn)


def _by_hand(acting: Acting, setup: str, method: str) -> Weights:
    """Of a sentence and of sliders the answer itself."""
    keys = [step.key for step in acting.plan if step.block == method and step.kind in ("words", "tuning")]
    answers = select(Response.value).where(Response.session_id == acting.session.id, Response.step_key.in_(keys))
    value = acting.s.scalars(answers).first() or {}
    return {str(name): float(weight) for name, weight in value.get("weights", {}).items()}


def find_robots(moment: Moment, stage: str) -> dict[str, Any]:
    """What `make_robots` noted for that stage; {} before."""
    noted = select(Event).where(Event.session_id == moment.session.id, Event.kind == ROBOTS_MADE)
    return next((dict(event.data) for event in moment.s.scalars(noted) if event.data.get("stage") == stage), {})


def make_robots(acting: Acting, stage: str, setup: str, methods: Sequence[str], count: int) -> dict[str, Any]:
    """Note, once, each method's weights and the scenes in which the robots are compared: weights: method -> weights;
    scenes: seeds; flawed: how many of the rollouts there are none that other comparisons would show.
    """
    before = find_robots(acting, stage)
    if before:
        return before
    weights = weights_by_method(acting, setup, methods)
    scenes, flawed = choose_scenes(setup, list(weights.values()), count, acting.session.seed % (LARGEST_SEED + 1))
    robots: dict[str, Any] = {"stage": stage, "setup": setup, "weights": weights, "scenes": scenes, "flawed": flawed}
    log_event(acting.s, ROBOTS_MADE, session_id=acting.session.id, **robots)
    return robots


def choose_scenes(setup: str, weights: Sequence[Mapping[str, float]], count: int, seed: int) -> tuple[list[int], int]:
    """Seeds of `count` fresh scenes, first the ones in which most of the robots arrive soon and without touching
    anything, of those the ones in which most of them can be told apart, and how many of their rollouts there are none
    that other comparisons would show.
    """
    from desirepath.learning.queries.queries import QueryConfig, flaw, look_alike
    from desirepath.learning.scene_sets import Purpose, scene_set
    from desirepath.simulation.fast import rollout
    from desirepath.simulation.setups import get_setup

    rules = QueryConfig(max_duration_s=LONGEST_S)
    scenes = scene_set(setup, CANDIDATES, purpose=Purpose.COMPARISON, seed=seed)
    rollouts = [rollout(get_setup(setup), condition_on(setup, weight).rollout_policy, scenes) for weight in weights]
    flaws, alike = [], []
    for of_scene in zip(*rollouts, strict=True):
        flaws.append(sum(flaw(trajectory, rules) is not None for trajectory in of_scene))
        alike.append(sum(look_alike(first, second, rules) for first, second in combinations(of_scene, 2)))
    chosen = sorted(range(len(scenes)), key=lambda k: (flaws[k], alike[k]))[:count]
    return [scenes[k].seed for k in chosen], sum(flaws[k] for k in chosen)


def rollouts_in(robots: Mapping[str, Any], place: int, methods: Sequence[str]) -> list[Trajectory]:
    """The robots of these methods in one of the compared scenes."""
    scene = _scene(robots["setup"], robots["scenes"][place])
    return [roll_out(condition_on(robots["setup"], robots["weights"][method]), scene) for method in methods]


def _scene(setup: str, seed: int) -> Scene:
    from desirepath.simulation.scenes import draw_scene

    return draw_scene(setup, seed)


def hard_to_tell(a: Trajectory, b: Trajectory) -> bool:
    """Whether a person can hardly tell the two apart."""
    from desirepath.learning.queries.queries import QueryConfig, look_alike

    return look_alike(a, b, QueryConfig())

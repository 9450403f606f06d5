"""A drawn path becomes a drive: what spec 02 asks of the processing, for any stroke a hand might draw."""

from __future__ import annotations

import contextlib
import math

import numpy as np
import pytest
from hypothesis import assume, event, given, settings
from hypothesis import strategies as st

from desirepath.demonstrations.demonstration import (
    Demonstration,
    as_actions,
    augment,
    commands_along,
    demonstration_from,
    execute,
)
from desirepath.demonstrations.stroke import Stroke, StrokeProblem
from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath.simulation.fast import replay
from desirepath.simulation.scene import Scene, SceneError
from desirepath.simulation.setups import CONTROL_DT_S, demonstration_setups, get_setup
from desirepath.simulation.trajectory import Outcome


def arched(scene: Scene, height: float, *, wave: float = 0.0, jitter: float = 0.0, slow: float = 0.1) -> Stroke:
    """From robot to goal with a bulge to the left (m), a snake in it, a trembling hand, slow in the middle."""
    share = np.linspace(0, 1, 160)
    start, goal = np.array([scene.start.x, scene.start.y]), np.array([scene.goal.x, scene.goal.y])
    along = goal - start
    left = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    aside = height * np.sin(np.pi * share) ** 2 + wave * np.sin(6 * np.pi * share) * np.sin(np.pi * share)
    tremble = np.random.default_rng(1).normal(0, jitter, (160, 2)) if jitter else 0.0
    points = start + share[:, None] * along + aside[:, None] * left + tremble
    return Stroke.of(points, slow + (0.25 - slow) * np.abs(2 * share - 1), 8 * share)


PAIRS = 4
CLEAR = demonstration_scene("room", 0), 1.3


def refusal(stroke: Stroke, scene: Scene) -> StrokeProblem:
    with pytest.raises(StrokeProblem) as caught:
        demonstration_from(stroke, scene)
    return caught.value


@pytest.mark.parametrize("setup", demonstration_setups())
@pytest.mark.parametrize("pair", range(PAIRS))
def test_every_pair_can_be_passed_on_some_side_and_ends_in_success(setup: str, pair: int) -> None:
    scene = demonstration_scene(setup, pair)
    heights = (0.9, -0.9) if setup == "corridor" else (1.4, -1.2)
    made = []
    for height in heights:
        with contextlib.suppress(StrokeProblem):  # where the person stands in the way
            made.append(demonstration_from(arched(scene, height), scene))
    assert made
    assert all(d.trajectory.outcome == Outcome.SUCCESS for d in made)


@settings(max_examples=25, deadline=None)
@given(
    setup=st.sampled_from(demonstration_setups()),
    pair=st.integers(0, PAIRS - 1),
    height=st.floats(-1.5, 1.5),
    wave=st.floats(0, 0.25),
    jitter=st.floats(0, 0.02),
    slow=st.floats(0.1, 0.25),
)
def test_the_executed_commands_follow_the_spline_and_its_speeds(
    setup: str, pair: int, height: float, wave: float, jitter: float, slow: float
) -> None:
    scene = demonstration_scene(setup, pair)
    try:
        made = demonstration_from(arched(scene, height, wave=wave, jitter=jitter, slow=slow), scene)
    except StrokeProblem as problem:
        event(problem.code)
        assume(False)
        return
    poses = made.trajectory.poses.astype(float)
    limits = get_setup(setup).robot.limits
    steps = len(made.trajectory.actions)
    # Where the robot is after every step against the nearest point of the spline, and how fast it went there.
    dense = np.linspace(0, made.spline.length_m, 4000)
    path = made.spline.points(dense)
    for t in range(steps + 1):
        apart = np.linalg.norm(path - poses[t, :2], axis=1)
        assert apart.min() <= 0.02
        if t < steps:
            turned = (poses[t + 1, 2] - poses[t, 2] + math.pi) % (2 * math.pi) - math.pi
            chord = math.dist(poses[t + 1, :2], poses[t, :2])
            arc = chord * (turned / 2) / math.sin(turned / 2) if abs(turned) > 1e-4 else chord
            wanted = float(made.spline.speeds(dense[[np.argmin(apart)]])[0])
            assert arc / CONTROL_DT_S == pytest.approx(wanted, rel=0.02)
            assert limits.v_min - 1e-6 <= made.commands[t, 0] <= limits.v_max + 1e-6
    assert math.dist(poses[-1, :2], path[-1]) <= made.scene.goal_radius + limits.v_max * CONTROL_DT_S


def test_every_transition_comes_again_bit_for_bit_from_stroke_and_scene_and_from_commands() -> None:
    scene, height = CLEAR
    stroke = arched(scene, height, jitter=0.01)
    once, again = demonstration_from(stroke, scene, seed=4), demonstration_from(stroke, scene, seed=4)
    assert once.to_bytes() == again.to_bytes()
    for first, second in zip(augment(once), augment(again), strict=True):
        assert first.to_bytes() == second.to_bytes()
    setup = get_setup(scene.setup)
    (replayed,) = replay(setup, [once.scene], [as_actions(setup, once.commands)])
    assert replayed.to_bytes() == once.trajectory.to_bytes()
    assert demonstration_from(arched(scene, height + 0.05, jitter=0.01), scene).to_bytes() != once.to_bytes()


def test_augmentation_begins_fifteenths_of_a_step_further_on_and_reaches_the_same_goal() -> None:
    scene, height = CLEAR
    made = demonstration_from(arched(scene, height), scene)
    drives = augment(made)
    assert len(drives) == 15
    step = made.commands[0, 0] * CONTROL_DT_S
    path = made.spline.points(np.linspace(0, made.spline.length_m, 4000))
    for j, drive in enumerate(drives):
        apart = np.linalg.norm(drive.poses[:, None, :2] - path[None], axis=2).min(axis=1)
        assert apart.max() <= 0.02
        assert math.dist(drive.poses[0, :2], made.trajectory.poses[0, :2]) == pytest.approx(j * step / 15, abs=1e-4)
        assert drive.outcome == Outcome.SUCCESS
        assert (drive.scene.goal, drive.scene.person) == (made.scene.goal, made.scene.person)
    assert len({drive.digest() for drive in drives}) == 15


def test_the_goal_moves_to_where_the_drawn_path_ends() -> None:
    scene, height = CLEAR
    stroke = arched(scene, height)
    moved = Stroke(
        stroke.points + np.linspace(0, 1, 160)[:, None] ** 3 * np.array([0.0, 0.5]), stroke.speeds, stroke.times_s
    )
    made = demonstration_from(moved, scene)
    end = np.array([made.scene.goal.x, made.scene.goal.y])
    assert np.linalg.norm(end - moved.points[-1]) < 0.06
    assert made.drawn_in.goal == scene.goal


def test_a_beginning_beside_the_robot_is_drawn_to_it() -> None:
    scene, height = CLEAR
    stroke = arched(scene, height)
    beside = Stroke(stroke.points + np.array([0.2, 0.3]), stroke.speeds, stroke.times_s)
    made = demonstration_from(beside, scene)
    assert math.dist(made.trajectory.poses[0, :2], (scene.start.x, scene.start.y)) < 0.01
    late = made.spline.points(np.array([made.spline.length_m / 2]))[0]
    assert np.linalg.norm(beside.points - late, axis=1).min() < 0.03


def test_a_demonstration_is_kept_as_a_file_with_everything_it_was_made_from(tmp_path) -> None:
    scene, height = CLEAR
    made = demonstration_from(arched(scene, height), scene, seed=7, style="field_of_view")
    made.save(tmp_path / "one.npz")
    again = Demonstration.load(tmp_path / "one.npz")
    assert again.digest() == made.digest()
    assert (again.drawn_in, again.seed, again.style, again.simulated) == (scene, 7, "field_of_view", True)
    assert (again.stroke.points == made.stroke.points).all()
    assert (commands_along(again.spline) == made.commands).all()
    (tmp_path / "two.npz").write_bytes(b"nothing of that kind")
    with pytest.raises(ValueError, match="not a desirepath demonstration"):
        Demonstration.load(tmp_path / "two.npz")


@settings(max_examples=60, deadline=None)
@given(
    setup=st.sampled_from(demonstration_setups()),
    pair=st.integers(0, PAIRS - 1),
    between=st.lists(st.tuples(st.floats(-3.4, 3.4), st.floats(-1.4, 1.4)), max_size=12),
    speeds=st.lists(st.floats(-1, 3), min_size=14, max_size=14),
    each=st.integers(1, 30),
)
def test_whatever_is_scribbled_is_driven_or_kindly_refused(
    setup: str, pair: int, between: list[tuple[float, float]], speeds: list[float], each: int
) -> None:
    scene = demonstration_scene(setup, pair)
    corners = np.array([(scene.start.x, scene.start.y), *between, (scene.goal.x, scene.goal.y)])
    places = np.linspace(0, len(corners) - 1, each * len(corners))
    points = np.stack([np.interp(places, np.arange(len(corners)), corners[:, axis]) for axis in range(2)], axis=1)
    wanted = np.interp(places, np.arange(len(corners)), speeds[: len(corners)])
    try:
        made = demonstration_from(Stroke.of(points, wanted, places), scene)
    except StrokeProblem as problem:
        event(problem.code)
        return
    event("driven")
    assert made.trajectory.outcome == Outcome.SUCCESS
    assert Demonstration.from_bytes(made.to_bytes()).digest() == made.digest()


# --- kind refusals ----------------------------------------------------------------------------------------------------


def test_what_cannot_be_driven_is_named_with_the_place() -> None:
    scene, height = CLEAR
    good = arched(scene, height)

    def changed(points: np.ndarray, speeds: np.ndarray | None = None) -> Stroke:
        return Stroke.of(points, good.speeds[: len(points)] if speeds is None else speeds, good.times_s[: len(points)])

    away = refusal(changed(good.points + np.array([0.8, 0.0])), scene)
    assert (away.code, away.numbers["distance_m"]) == ("starts_away", pytest.approx(0.8))
    assert refusal(changed(good.points[:100]), scene).code == "ends_away"
    short = refusal(changed(good.points[:3]), scene)
    assert (short.code, short.numbers["limit_m"]) == ("too_short", 0.5)
    out = refusal(changed(good.points * np.array([1.0, 3.0])), scene)
    assert out.code in {"leaves_room", "starts_away"}
    assert refusal(arched(scene, 2.6), scene).code == "leaves_room"


def test_what_is_touched_is_named() -> None:
    scene, _ = CLEAR
    through = refusal(arched(scene, 0.0), scene)
    assert (through.code, through.thing) == ("collides", "person")
    assert math.dist(through.at or (9, 9), (scene.person.pose.x, scene.person.pose.y)) < 0.5
    couch = refusal(arched(scene, -1.9), scene)
    assert (couch.code, couch.thing) == ("collides", "couch")
    assert couch.at is not None
    assert couch.at[1] < -1.0


def test_a_path_too_long_for_an_episode_is_too_slow() -> None:
    scene, height = CLEAR
    stroke = arched(scene, height, wave=0.25)
    slow = refusal(Stroke(stroke.points, np.full(160, 0.1), stroke.times_s), scene)
    assert (slow.code, slow.numbers["limit_s"]) == ("too_slow", 60.0)
    assert slow.numbers["duration_s"] > 60


def test_bends_that_the_robot_cannot_follow_are_too_tight() -> None:
    scene, height = CLEAR
    stroke = arched(scene, height)
    points = stroke.points.copy()
    points = np.concatenate([points[:90], points[70:90][::-1], points[70:]])  # forth, back on the spot, and forth
    problem = refusal(Stroke.of(points, np.full(len(points), 0.25), np.arange(len(points))), scene)
    assert problem.code == "too_tight"


@pytest.mark.parametrize(
    "broken",
    [
        ([], [], []),
        ([[0, 0]], [0.2], [0]),
        ([[0, 0], [1, math.nan]], [0.2, 0.2], [0, 1]),
        ([[0, 0], [1, 1]], [0.2], [0, 1]),
        ("no", "stroke", "at all"),
    ],
)
def test_what_is_no_stroke_is_unreadable(broken) -> None:
    with pytest.raises(StrokeProblem) as caught:
        Stroke.of(*broken)
    assert caught.value.code == "unreadable"


def test_unknown_places_are_refused() -> None:
    with pytest.raises(SceneError, match="pair"):
        demonstration_scene("room", 4)
    with pytest.raises(SceneError, match="known: corridor, home, room, study_room"):
        demonstration_scene("open_field", 0)


def test_driving_in_empty_space_is_what_the_engine_does() -> None:
    scene, height = CLEAR
    made = demonstration_from(arched(scene, height), scene)
    poses = execute(made.scene.start, made.commands)
    steps = len(made.trajectory.actions)
    assert np.abs(poses[: steps + 1, :2] - made.trajectory.poses[:, :2]).max() < 1e-4

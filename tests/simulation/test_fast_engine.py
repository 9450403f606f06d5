"""The fast engine against arithmetic done by other means: arcs, rays, endings, rewards, episode numbers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from desirepath.simulation import kernels
from desirepath.simulation.acting import ActionError
from desirepath.simulation.fast import FastEngine, evaluate, make_engine, raw_ranges, rollout, table_of
from desirepath.simulation.scene import Obstacle, Person, Pose, Scene, SceneError
from desirepath.simulation.scenes import draw_scene, draw_scenes, scene_to_row
from desirepath.simulation.setups import SETUPS, Setup, SetupError, get_setup, preference_setups
from desirepath.simulation.trajectory import Outcome, Trajectory
from tests.simulation.simple_policies import towards_goal

PREFERENCE_SETUPS = preference_setups()

OPEN_FIELD = get_setup("open_field")
STUDY_ROOM = get_setup("study_room")

NAMES = list(SETUPS)
EMPTY = Scene("open_field", 0, Pose(0.0, 0.0, 0.3), Pose(50.0, 0.0), 0.4, Person(Pose(0.0, 40.0)))


def standing(observations: NDArray[np.float32]) -> NDArray[np.float32]:
    """Stay where you are."""
    return np.tile(np.array([-1.0, 0.0], dtype=np.float32), (len(observations), 1))


def drive(scene: Scene, actions: list[tuple[float, float]], setup: Setup = OPEN_FIELD) -> FastEngine:
    """One robot after these actions."""
    engine = make_engine(setup, 1, auto_reset=False, scenes=[scene])
    for action in actions:
        engine.step(np.array([action], dtype=np.float32))
    return engine


def test_angles_are_wrapped_to_above_minus_pi_and_up_to_pi() -> None:
    """Spec 00: (-pi, pi]."""
    for angle, wrapped in ((math.pi, math.pi), (-math.pi, math.pi), (0.0, 0.0), (3.2, 3.2 - 2 * math.pi)):
        assert kernels.wrap(angle) == pytest.approx(wrapped, abs=1e-12)
    assert kernels.wrap(-3.2) == pytest.approx(2 * math.pi - 3.2)
    assert kernels.wrap(-7.0) == pytest.approx(2 * math.pi - 7.0)


# --- motion -----------------------------------------------------------------------------------------------------------


@given(v=st.floats(-1, 1), w=st.floats(-1, 1), yaw=st.floats(-3, 3))
@settings(max_examples=60, deadline=None)
def test_twenty_equal_steps_end_where_the_circle_says(v: float, w: float, yaw: float) -> None:
    engine = drive(replace(EMPTY, start=Pose(1.0, -2.0, yaw)), [(v, w)] * 20)
    speed, turn = (float(np.float32(v)) + 1) / 2 * 0.5, float(np.float32(w)) * math.pi
    t = 20 * 0.2
    if abs(turn) < 1e-6:
        x, y = speed * t * math.cos(yaw), speed * t * math.sin(yaw)
    else:
        x = speed / turn * (math.sin(yaw + turn * t) - math.sin(yaw))
        y = speed / turn * (math.cos(yaw) - math.cos(yaw + turn * t))
    assert engine.poses[0, :2] == pytest.approx([1.0 + x, -2.0 + y], abs=2e-5)
    assert math.cos(engine.poses[0, 2] - yaw - turn * t) == pytest.approx(1.0, abs=1e-9)
    assert -math.pi < engine.poses[0, 2] <= math.pi


def test_actions_beyond_one_are_clipped_and_the_robot_never_backs_up() -> None:
    assert drive(EMPTY, [(7.0, 0.0)]).poses[0] == pytest.approx(drive(EMPTY, [(1.0, 0.0)]).poses[0])
    assert drive(EMPTY, [(-1.0, 0.0)] * 3).poses[0] == pytest.approx([0.0, 0.0, 0.3])


@pytest.mark.parametrize("bad", [[[math.nan, 0.0]], [[0.0, math.inf]], [[0.0, 0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]])
def test_actions_that_are_no_actions_are_refused(bad: list[list[float]]) -> None:
    engine = make_engine(OPEN_FIELD, 1, scenes=[EMPTY])
    before = engine.poses.copy()
    with pytest.raises(ActionError, match="actions"):
        engine.step(np.array(bad, dtype=np.float32))
    assert (engine.poses == before).all()


@given(
    heading=st.floats(-math.pi, math.pi),
    width=st.floats(0.002, 0.5),
    away=st.floats(0.2, 0.6),
    offset=st.floats(-0.6, 0.6),
)
@settings(max_examples=80, deadline=None)
def test_no_wall_however_thin_is_tunnelled_and_the_robot_stops_at_it(
    heading: float, width: float, away: float, offset: float
) -> None:
    ahead = (away + width / 2, offset)
    c, s = math.cos(heading), math.sin(heading)
    wall = Obstacle("wall", Pose(ahead[0] * c - ahead[1] * s, ahead[0] * s + ahead[1] * c, heading), width, 2.0, 1.0)
    scene = Scene(
        "study_room", 0, Pose(0.0, 0.0, heading), Pose(-30.0 * c, -30.0 * s), 0.36, Person(Pose(-9 * s, 9 * c)), (wall,)
    )
    engine = drive(scene, [(1.0, 0.0)] * 5, STUDY_ROOM)
    assert engine.outcomes[0] == Outcome.COLLISION
    assert np.hypot(*engine.poses[0, :2]) == pytest.approx(away - 0.18, abs=6e-4)
    assert -1e-6 <= engine.obstacle_clearance[0] <= 6e-4


def test_the_person_stops_the_robot_half_a_metre_before() -> None:
    scene = replace(EMPTY, start=Pose(0.0, 0.0, 0.0), person=Person(Pose(1.0, 0.0)))
    engine = drive(scene, [(1.0, 0.0)] * 10)
    assert engine.outcomes[0] == Outcome.COLLISION
    assert engine.human_distance[0] == pytest.approx(0.48, abs=6e-4)
    assert math.isinf(engine.obstacle_clearance[0])


# --- lidar ------------------------------------------------------------------------------------------------------------


def rays_by_hand(setup: Setup, scene: Scene, pose: Pose) -> NDArray[np.float64]:
    """Every beam against every body, one by one, by the slab method."""
    seen = np.full(setup.robot.lidar.beams, setup.robot.lidar.range_m)
    for beam in range(setup.robot.lidar.beams):
        angle = pose.yaw + 2 * math.pi * beam / setup.robot.lidar.beams
        dx, dy = math.cos(angle), math.sin(angle)
        for solid in scene.solids():
            c, s = math.cos(solid.pose.yaw), math.sin(solid.pose.yaw)
            px, py = pose.x - solid.pose.x, pose.y - solid.pose.y
            near, far = -math.inf, math.inf
            for start, step, half in (
                (px * c + py * s, dx * c + dy * s, solid.length / 2),
                (py * c - px * s, dy * c - dx * s, solid.width / 2),
            ):
                low, high = sorted(((-half - start) / (step or 1e-300), (half - start) / (step or 1e-300)))
                near, far = max(near, low), min(far, high)
            if near <= far and far > 0:
                seen[beam] = min(seen[beam], max(near, 0.0))
        to_x, to_y = scene.person.pose.x - pose.x, scene.person.pose.y - pose.y
        along = to_x * dx + to_y * dy
        inside = along**2 - to_x**2 - to_y**2 + scene.person.radius**2
        if inside >= 0 and along > 0:
            seen[beam] = min(seen[beam], along - math.sqrt(inside))
    return seen


@pytest.mark.parametrize("name", PREFERENCE_SETUPS)
def test_each_beam_and_each_sector_equal_rays_traced_by_hand(name: str) -> None:
    setup, rng = SETUPS[name], np.random.default_rng(0)
    compared = 0
    for scene in draw_scenes(name, range(12)):
        row = scene_to_row(scene)
        while True:
            pose = Pose(rng.uniform(-3.5, 3.5), rng.uniform(-5, 5), rng.uniform(-4, 4))
            free = min(
                kernels.surface_distance(row, pose.x, pose.y), kernels.person_distance(row, pose.x, pose.y) - 0.3
            )
            if free > 0.18:
                break
        by_hand = rays_by_hand(setup, scene, pose)
        assert raw_ranges(setup, scene, pose) == pytest.approx(by_hand, abs=1e-9)
        moved = make_engine(setup, 1, scenes=[replace(scene, start=pose)])
        pooled = by_hand.reshape(setup.robot.lidar.sectors, -1).min(axis=1) / setup.robot.lidar.range_m
        assert moved.observations[0, setup.polar_size :] == pytest.approx(pooled, abs=1e-6)
        compared += int((by_hand < setup.robot.lidar.range_m).sum())
    assert compared > 500


def test_the_observation_is_laid_out_as_the_setup_says() -> None:
    scene = Scene("study_room", 0, Pose(0.0, 0.0, math.pi / 2), Pose(0.0, 3.0), 0.36, Person(Pose(-2.0, 0.0)))
    engine = make_engine(STUDY_ROOM, 1, auto_reset=False, scenes=[scene])
    assert engine.observations[0, :6] == pytest.approx([0.3, 0.0, 0.2, 0.5, 0.0, 0.0], abs=1e-6)
    assert engine.observations.shape == (1, len(STUDY_ROOM.observation_layout()))
    ahead_left = engine.observations[0, 6:]
    assert ahead_left[14:16].min() == pytest.approx(1.7 / 6, abs=1e-4)  # the person, a quarter turn to the left
    assert ahead_left[0] == 1.0
    engine.step(np.array([[0.0, -0.5]], dtype=np.float32))
    assert engine.observations[0, 4:6] == pytest.approx([0.5, -0.5], abs=1e-6)


# --- endings and rewards ----------------------------------------------------------------------------------------------


def test_goal_collision_and_timeout_end_the_episode_with_the_setups_reward() -> None:
    near = replace(EMPTY, start=Pose(0.0, 0.0, 0.0), goal=Pose(0.49, 0.0))
    engine = drive(near, [(1.0, 0.0)])
    assert (engine.outcomes[0], engine.dones[0], engine.rewards[0]) == (Outcome.SUCCESS, True, 20.0)
    blocked = replace(EMPTY, start=Pose(0.0, 0.0, 0.0), person=Person(Pose(0.55, 0.0)))
    engine = drive(blocked, [(1.0, 0.0)])
    assert (engine.outcomes[0], engine.rewards[0]) == (Outcome.COLLISION, pytest.approx(-1.2))
    engine = drive(EMPTY, [(-1.0, 0.0)] * 499)
    assert (engine.outcomes[0], engine.rewards[0]) == (Outcome.RUNNING, 0.0)
    engine.step(np.array([[-1.0, 0.0]], dtype=np.float32))
    assert (engine.outcomes[0], engine.rewards[0], engine.steps[0]) == (Outcome.TIMEOUT, -20.0, 500)


def test_progress_pays_per_metre_and_only_when_asked() -> None:
    scene = replace(EMPTY, start=Pose(0.0, 0.0, 0.0))
    engine = make_engine(OPEN_FIELD, 1, scenes=[scene], progress_weight=2.0)
    engine.step(np.array([[1.0, 0.0]], dtype=np.float32))
    assert engine.rewards[0] == pytest.approx(2.0 * 0.1, abs=1e-5)
    assert drive(scene, [(1.0, 0.0)]).rewards[0] == 0.0


def test_study_room_charges_time_and_jerk_as_spec_07_says() -> None:
    scene = Scene("study_room", 0, Pose(0.0, 0.0), Pose(60.0, 0.0), 0.36, Person(Pose(0.0, 40.0)))
    engine = make_engine(STUDY_ROOM, 1, auto_reset=False, scenes=[scene])
    rng = np.random.default_rng(3)
    actions = rng.uniform(-1, 1, (12, 2)).astype(np.float32)
    actions[:, 1] *= 0.1
    commands = np.zeros((14, 2))
    commands[2:] = np.stack([(actions[:, 0] + 1) / 2, actions[:, 1] * math.pi], axis=1)
    jerk = (((commands[2:] - 2 * commands[1:-1] + commands[:-2]) * 5.0**2) ** 2).sum(axis=1)
    expected = -0.001 - 0.0005 * jerk / np.maximum.accumulate(jerk)
    rewards = []
    for action in actions:
        engine.step(action[None])
        rewards.append(engine.rewards[0])
    assert rewards == pytest.approx(expected, abs=1e-6)


def test_closing_a_loop_costs_two_once_and_is_counted() -> None:
    spiral = [(1.0, 0.5)] * 12 + [(1.0, -0.5)] * 2
    engine = make_engine(OPEN_FIELD, 1, auto_reset=False, scenes=[EMPTY])
    rewards = []
    for action in spiral:
        engine.step(np.array([action], dtype=np.float32))
        rewards.append(float(engine.rewards[0]))
    path = engine.path(0)
    by_hand = [crossing_by_hand(path[: k + 1]) for k in range(1, len(path))]
    assert rewards == [-2.0 if crossed else 0.0 for crossed in by_hand]
    assert engine.self_intersections[0] == sum(by_hand)


def crossing_by_hand(path: NDArray[np.float64]) -> bool:
    """Whether the last segment properly crosses one that is more than four steps older, by orientations."""

    def left(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> float:
        return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

    a, b = path[-2], path[-1]
    newest = len(path) - 2
    return any(
        left(a, b, path[k]) * left(a, b, path[k + 1]) < 0
        and left(path[k], path[k + 1], a) * left(path[k], path[k + 1], b) < 0
        for k in range(newest)
        if newest - k > 4
    )


@given(seed=st.integers(0, 2**32))
@settings(max_examples=25, deadline=None)
def test_self_intersections_of_long_random_paths_are_found_like_by_hand(seed: int) -> None:
    rng = np.random.default_rng(seed)
    actions = [(float(rng.uniform(-1, 1)), float(rng.uniform(-0.2, 0.6))) for _ in range(90)]
    path = drive(EMPTY, actions).path(0)
    for steps in range(1, len(path)):
        mine = kernels.crosses_itself(path, steps, 4, 0.1)
        assert mine == crossing_by_hand(path[: steps + 1])


def test_a_straight_path_and_a_standing_robot_never_cross_themselves() -> None:
    for yaw in np.linspace(-3, 3, 9):
        scene = replace(EMPTY, start=Pose(0.0, 0.0, float(yaw)))
        assert drive(scene, [(1.0, 0.0)] * 60).self_intersections[0] == 0
    assert drive(EMPTY, [(-1.0, 1.0)] * 60).self_intersections[0] == 0


# --- the batch --------------------------------------------------------------------------------------------------------


def random_actions(count: int, n_envs: int) -> NDArray[np.float32]:
    rng = np.random.default_rng(1)
    return np.asarray(rng.uniform(-1, 1, (count, n_envs, 2)) * [1.0, 0.3], dtype=np.float32)


def history(engine: FastEngine, actions: NDArray[np.float32]) -> list[NDArray[np.float64]]:
    """All that the engine tells, after each step."""
    told = []
    for action in actions:
        engine.step(action)
        numbers = [engine.observations, engine.next_observations, engine.poses]
        columns = [engine.rewards, engine.dones, engine.outcomes, engine.steps, engine.min_human_distance]
        told.append(np.concatenate([*numbers, *(np.asarray(c, dtype=float)[:, None] for c in columns)], axis=1))
    return told


@pytest.mark.parametrize("name", NAMES)
def test_same_seed_is_bit_identical_and_another_is_not(name: str) -> None:
    actions = random_actions(150, 16)
    a, b, c = (history(make_engine(SETUPS[name], 16, seed=seed), actions) for seed in (4, 4, 5))
    assert all((x == y).all() for x, y in zip(a, b, strict=True))
    assert any((x != y).any() for x, y in zip(a, c, strict=True))


@pytest.mark.parametrize("name", [name for name in NAMES if not SETUPS[name].crowded])  # whose engine has one thread
def test_threads_change_nothing_but_the_last_digits(name: str) -> None:
    actions = random_actions(80, 24)
    serial = history(make_engine(SETUPS[name], 24, seed=2), actions)
    threaded = history(make_engine(SETUPS[name], 24, seed=2, parallel=True), actions)
    for x, y in zip(serial, threaded, strict=True):
        assert x == pytest.approx(y, abs=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_ended_environments_restart_in_fresh_scenes_and_report_their_last_episode(name: str) -> None:
    engine = make_engine(SETUPS[name], 32, seed=0)
    seen: set[int] = {engine.scene(i).seed for i in range(32)}
    ended = 0
    for action in random_actions(200, 32):
        lengths, ends = engine.steps.copy(), []
        engine.step(action)
        for i in np.flatnonzero(engine.dones):
            ends.append(i)
            assert engine.outcomes[i] != Outcome.RUNNING
            assert (engine.next_observations[i] != engine.observations[i]).any()
            scene = engine.scene(i)
            assert engine.poses[i] == pytest.approx([scene.start.x, scene.start.y, scene.start.yaw])
            assert draw_scene(name, scene.seed) == scene
            seen.add(scene.seed)
        running = ~engine.dones
        assert (engine.observations[running] == engine.next_observations[running]).all()
        assert ((engine.steps == lengths + 1) | (engine.steps == 1)).all()
        ended += len(ends)
    assert ended >= 8
    assert len(seen) == 32 + ended


def test_without_auto_reset_an_ended_environment_rests() -> None:
    near = replace(EMPTY, start=Pose(0.0, 0.0, 0.0), goal=Pose(0.49, 0.0))
    engine = make_engine(OPEN_FIELD, 2, auto_reset=False, scenes=[near, EMPTY])
    engine.step(np.ones((2, 2), dtype=np.float32) * [1.0, 0.0])
    at_goal = engine.poses[0].copy()
    engine.step(np.ones((2, 2), dtype=np.float32) * [1.0, 0.0])
    assert engine.dones.tolist() == [True, False]
    assert engine.rewards[0] == 0.0
    assert (engine.poses[0] == at_goal).all()
    assert engine.steps.tolist() == [1, 2]


def test_engines_refuse_what_is_not_theirs() -> None:
    with pytest.raises(SetupError, match="study_room"):
        make_engine(STUDY_ROOM, 1, scenes=[draw_scene("open_field", 0)])
    with pytest.raises(SceneError, match="start"):
        make_engine(OPEN_FIELD, 1, scenes=[replace(EMPTY, start=Pose(math.nan, 0.0))])
    with pytest.raises(ValueError, match="1 given for 2"):
        make_engine(OPEN_FIELD, 2, scenes=[EMPTY])
    with pytest.raises(ValueError, match="n_envs"):
        make_engine(OPEN_FIELD, 0)


def test_scenes_with_more_boxes_than_the_generators_draw_fit_too() -> None:
    boxes = tuple(Obstacle("pillar", Pose(3.0 + i, 2.0), 0.3, 0.3, 1.0) for i in range(20))
    engine = make_engine(OPEN_FIELD, 2, scenes=[replace(EMPTY, obstacles=boxes), EMPTY])
    assert engine.obstacle_clearance[0] == pytest.approx(math.hypot(2.85, 1.85) - 0.18)
    assert math.isinf(engine.obstacle_clearance[1])
    engine.reset(draw_scenes("open_field", range(2)))
    assert np.isfinite(engine.obstacle_clearance).all()


# --- rollouts and tables ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_rollouts_hold_every_step_and_agree_with_the_table(name: str) -> None:
    setup, scenes = SETUPS[name], draw_scenes(name, range(60))
    trajectories, table = rollout(setup, towards_goal(setup), scenes), evaluate(towards_goal(setup), setup, scenes)
    for t, scene in zip(trajectories, scenes, strict=True):
        steps = len(t.actions)
        assert t.scene == scene
        assert t.poses.shape == (steps + 1, 3)
        assert t.observations.shape == t.next_observations.shape == (steps, setup.observation_size)
        assert (t.observations[1:] == t.next_observations[:-1]).all()
        assert t.dones.tolist() == [False] * (steps - 1) + [True]
        assert Trajectory.from_bytes(t.to_bytes()).digest() == t.digest()
    again = table_of(trajectories)
    for column in ("outcome", "steps", "self_intersections"):
        assert (getattr(again, column) == getattr(table, column)).all()
    for column in ("path_length", "min_clearance", "accumulated_angle", "path_area"):
        assert getattr(again, column) == pytest.approx(getattr(table, column), abs=2e-4)
    # a crash ends the last step early, where pedestrians walk: what follows is of the whole step
    whole = (table.outcome != Outcome.COLLISION) | (not setup.crowded)
    assert again.min_human_distance[whole] == pytest.approx(table.min_human_distance[whole], abs=2e-4)
    assert again.min_human_distance == pytest.approx(table.min_human_distance, abs=0.25)
    for name, values in vars(table.social).items():
        assert getattr(again.social, name) == pytest.approx(values, abs=2e-3), name
    for column in ("total_reward", "straight_distance", "ceiling"):
        assert getattr(again, column) == pytest.approx(getattr(table, column), abs=1e-4)
    assert table.success.sum() == (table.outcome == Outcome.SUCCESS).sum()
    assert table.success.any() or setup.crowded  # who looks at nobody meets somebody
    assert table.time == pytest.approx(table.steps * 0.2)


def test_a_rollout_can_be_cut_short_and_is_then_still_running() -> None:
    (cut,) = rollout(OPEN_FIELD, standing, [EMPTY], max_steps=7)
    assert (cut.outcome, len(cut.actions), bool(cut.dones.any())) == (Outcome.RUNNING, 7, False)
    (whole,) = rollout(OPEN_FIELD, standing, [EMPTY])
    assert (whole.outcome, len(whole.actions)) == (Outcome.TIMEOUT, 500)


def test_a_policy_of_the_wrong_shape_is_named() -> None:
    with pytest.raises(ActionError, match="shape"):
        evaluate(lambda o: np.zeros((len(o), 3), dtype=np.float32), OPEN_FIELD, [EMPTY])
    with pytest.raises(ValueError, match="none given"):
        evaluate(standing, OPEN_FIELD, [])
    assert rollout(OPEN_FIELD, standing, []) == []

"""The two engines, one meaning: the same scenes and actions through the fast engine and PyBullet in velocity mode.

Prints its bounds (`pytest -s tests/simulation/test_parity.py`); spec 01 sets them.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from desirepath.simulation import kernels
from desirepath.simulation.fast import make_engine, raw_ranges, rollout
from desirepath.simulation.reference import ReferenceEngine, rollout_reference
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import draw_scenes, scene_to_row
from desirepath.simulation.setups import SETUPS, demonstration_setups, preference_setups
from desirepath.simulation.trajectory import Outcome
from tests.simulation.simple_policies import towards_goal

PREFERENCE_SETUPS = preference_setups()

SCENES = 100
NAMES = PREFERENCE_SETUPS


def say(what: str, **bounds: float | int) -> None:
    """Print one line of bounds."""
    print(f"\n  {what}: " + ", ".join(f"{name} = {value:.6g}" for name, value in bounds.items()), end="")


def signed_gap(row: NDArray[np.float64], x: float, y: float) -> float:
    """Distance (m) between the robot's body at (x, y) and the nearest thing, negative when they overlap."""
    person = kernels.person_distance(row, x, y) - row[kernels.PERSON_RADIUS]
    return min(kernels.surface_distance(row, x, y), person) - SETUPS["study_room"].robot.radius_m


def place(scene: Scene, rng: np.random.Generator, *, free: bool) -> Pose:
    """A pose near the scene's things; with `free`, one the robot can stand at."""
    row = scene_to_row(scene)
    centres = [(o.pose.x, o.pose.y) for o in scene.obstacles]
    centres += [(scene.person.pose.x, scene.person.pose.y), (scene.start.x, scene.start.y)]
    while True:
        x, y = np.array(centres[rng.integers(len(centres))]) + rng.uniform(-1.1, 1.1, 2)
        inside = scene.room is None or (abs(x) < scene.room.length / 2 and abs(y) < scene.room.width / 2)
        if inside and (not free or signed_gap(row, x, y) > 0):
            return Pose(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))


@pytest.mark.parametrize("name", NAMES)
def test_raw_rays_agree_within_a_centimetre_at_the_99th_percentile(name: str) -> None:
    setup, rng = SETUPS[name], np.random.default_rng(0)
    gaps = []
    with ReferenceEngine(setup) as reference:
        for scene in draw_scenes(name, range(SCENES)):
            reference.reset(scene)
            pose = place(scene, rng, free=True)
            gaps.append(np.abs(reference.raw_ranges(pose) - raw_ranges(setup, scene, pose)))
    every = np.concatenate(gaps)
    p99 = float(np.percentile(every, 99))
    say(
        f"{name} rays (m)",
        rays=every.size,
        p50=np.median(every),
        p99=p99,
        max=every.max(),
        over_1cm=(every > 0.01).sum(),
    )
    assert every.size == SCENES * setup.robot.lidar.beams
    assert p99 <= 0.01


@pytest.mark.parametrize("name", NAMES)
def test_collision_flags_agree_outside_a_millimetre_of_contact(name: str) -> None:
    setup, rng = SETUPS[name], np.random.default_rng(1)
    apart, touching, poses, undecided = 0, 0, 0, 0
    with ReferenceEngine(setup) as reference:
        for scene in draw_scenes(name, range(SCENES)):
            reference.reset(scene)
            row = scene_to_row(scene)
            for _ in range(20):
                pose = place(scene, rng, free=False)
                gap = signed_gap(row, pose.x, pose.y)
                poses += 1
                if abs(gap) < 0.001:
                    undecided += 1
                    continue
                touching += gap < 0
                apart += reference.touches(pose) != (gap < 0)
    say(f"{name} collision flags", poses=poses, touching=touching, within_1mm=undecided, different=apart)
    assert 0.1 < touching / poses < 0.9
    assert apart == 0


def wandering(scene: Scene, rng: np.random.Generator) -> NDArray[np.float32]:
    """Twenty random actions of any speed and turn."""
    return np.asarray(rng.uniform(-1, 1, (20, 2)), dtype=np.float32)


@pytest.mark.parametrize("name", NAMES)
def test_poses_agree_within_five_millimetres_after_twenty_steps(name: str) -> None:
    setup, rng = SETUPS[name], np.random.default_rng(2)
    position, heading, compared = [], [], 0
    with ReferenceEngine(setup) as reference:
        for scene in draw_scenes(name, range(SCENES)):
            reference.reset(scene)
            fast = make_engine(setup, 1, auto_reset=False, scenes=[scene])
            for action in wandering(scene, rng):
                reference.step(action)
                fast.step(action[None])
                assert reference.done == bool(fast.dones[0]), (scene.seed, reference.steps)
                if reference.done:
                    break
            gap = reference.pose - fast.poses[0]
            position.append(float(np.hypot(gap[0], gap[1])))
            heading.append(abs(kernels.wrap(gap[2])))
            compared += reference.steps == 20
    say(f"{name} poses", whole_drives=compared, position_max_m=max(position), heading_max_rad=max(heading))
    assert compared > SCENES / 2
    assert max(position) <= 0.005
    assert max(heading) <= math.pi / 240  # a collision is noticed at 240 Hz


@pytest.mark.parametrize("name", demonstration_setups())
def test_the_environments_of_chapter_2_are_the_same_in_both_engines(name: str) -> None:
    setup, scenes = SETUPS[name], draw_scenes(name, range(6))
    act = towards_goal(setup)
    for fast, reference in zip(rollout(setup, act, scenes), rollout_reference(setup, act, scenes), strict=True):
        assert (fast.outcome, len(fast.actions)) == (reference.outcome, len(reference.actions))
        assert np.abs(fast.poses[:-1, :2] - reference.poses[:-1, :2]).max() < 0.005
        assert np.abs(fast.observations - reference.observations).max() < 0.02


def test_the_room_of_chapter_8_is_the_same_in_both_engines_its_rewards_too() -> None:
    setup, scenes = SETUPS["explained_room"], draw_scenes("explained_room", range(6))
    act = towards_goal(setup)
    for fast, reference in zip(rollout(setup, act, scenes), rollout_reference(setup, act, scenes), strict=True):
        assert (fast.outcome, len(fast.actions)) == (reference.outcome, len(reference.actions))
        assert np.abs(fast.poses[:-1, :2] - reference.poses[:-1, :2]).max() < 0.005
        assert np.quantile(np.abs(fast.observations - reference.observations), 0.99) < 0.01  # a ray may miss a corner
        assert fast.rewards == pytest.approx(reference.rewards, abs=1e-4)
        near = fast.observations[1:, setup.polar_size :].min(axis=1) * setup.robot.lidar.range_m < 0.39
        assert (fast.rewards[:-1][near] < -0.0019).all()  # time and nearness, each 0.001


@pytest.mark.parametrize("name", NAMES)
def test_drives_end_at_the_same_step_in_the_same_way(name: str) -> None:
    setup, scenes = SETUPS[name], draw_scenes(name, range(SCENES))
    act = towards_goal(setup)
    fast, reference = rollout(setup, act, scenes), rollout_reference(setup, act, scenes)
    later = [abs(len(a.actions) - len(b.actions)) for a, b in zip(fast, reference, strict=True)]
    ends = [math.dist(a.poses[-1, :2], b.poses[-1, :2]) for a, b in zip(fast, reference, strict=True)]
    gained = [abs(float(a.rewards.sum() - b.rewards.sum())) for a, b in zip(fast, reference, strict=True)]
    outcomes = [a.outcome for a in fast]
    say(
        f"{name} endings",
        drives=len(scenes),
        successes=outcomes.count(Outcome.SUCCESS),
        collisions=outcomes.count(Outcome.COLLISION),
        steps_apart_max=max(later),
        end_apart_max_m=max(ends),
        return_apart_max=max(gained),
    )
    assert outcomes == [b.outcome for b in reference]
    assert {Outcome.SUCCESS, Outcome.COLLISION} <= set(outcomes)
    assert max(later) == 0
    assert max(ends) <= 0.006  # a collision is noticed at 240 Hz: up to 4 mm before contact at 1 m/s
    assert max(gained) <= 0.01


def test_running_out_of_time_is_the_same_step_too() -> None:
    setup, (scene,) = SETUPS["study_room"], draw_scenes("study_room", [3])
    turning = np.array([-1.0, 0.3], dtype=np.float32)
    (fast,) = rollout(setup, lambda o: np.tile(turning, (len(o), 1)), [scene])
    with ReferenceEngine(setup) as reference:
        reference.reset(scene)
        reference.raw_ranges = lambda pose=None: np.full(
            setup.robot.lidar.beams, 6.0
        )  # rays do not matter here, and cost
        while not reference.done:
            reference.step(turning)
    assert (fast.outcome, len(fast.actions)) == (reference.outcome, reference.steps) == (Outcome.TIMEOUT, 500)
    assert reference.reward == pytest.approx(float(fast.rewards[-1]), abs=1e-5)


@pytest.mark.parametrize(("v", "w"), [(0.0, 1.0), (0.5, 0.5), (0.5, -1.0), (0.2, 2.0), (1.0, 2.0), (1.0, 0.0)])
def test_wheels_drive_and_turn_as_commanded_within_two_percent(v: float, w: float) -> None:
    empty = Scene("study_room", 0, Pose(0.0, 0.0), Pose(60.0, 60.0), 0.36, draw_scenes("study_room", [0])[0].person)
    far_person = type(empty.person)(Pose(-60.0, 60.0))
    scene = Scene("study_room", 0, empty.start, empty.goal, 0.36, far_person)
    turned = travelled = 0.0
    with ReferenceEngine(SETUPS["study_room"], drive_mode="wheels") as engine:
        engine.reset(scene)
        for step in range(25):
            before = engine.pose.copy()
            engine.step(np.array([2 * v - 1, w / math.pi]))
            if step >= 5:  # the motors need a moment to reach the command
                turned += kernels.wrap(engine.pose[2] - before[2])
                travelled += math.dist(engine.pose[:2], before[:2])
    seconds = 20 * 0.2
    chord = math.sin(w * 0.1) / (w * 0.1) if w else 1.0
    say(f"wheels v={v} w={w}", turn_rate=turned / seconds, speed=travelled / seconds / chord)
    assert turned / seconds == pytest.approx(w, rel=0.02, abs=0.002)
    assert travelled / seconds / chord == pytest.approx(v, rel=0.02, abs=0.002)

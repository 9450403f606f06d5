"""What real robots get wrong, in the fast engine: nothing where it is off, what is said where it is on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from desirepath.learning.policies.policy import Policy
from desirepath.simulation.disturbed import RANDOMISED, Disturbances, DisturbedEngine, randomised_engine
from desirepath.simulation.fast import FastEngine, make_engine
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import CONTROL_DT_S, SetupError, get_setup

SETUP = get_setup("open_field")
AHEAD = np.array([1.0, 0.0], dtype=np.float32)
STAND = np.array([-1.0, 0.0], dtype=np.float32)


def engine_with(setup: str = "open_field", **of: float) -> DisturbedEngine:
    scenes = draw_scenes(setup, range(4))
    return DisturbedEngine(get_setup(setup), 4, Disturbances(**of), auto_reset=False, scenes=scenes)


def drive(engine: FastEngine, *actions: np.ndarray) -> list[float]:
    """How far the first robot came in each step, of what it would at full speed."""
    went = []
    for action in actions:
        before = engine.poses[0, :2].copy()
        engine.step(np.tile(action, (engine.n_envs, 1)))
        went.append(float(np.linalg.norm(engine.poses[0, :2] - before)) / (SETUP.robot.limits.v_max * CONTROL_DT_S))
    return went


@pytest.mark.parametrize("name", ["open_field", "study_room"])
def test_with_nothing_wrong_it_is_the_fast_engine_bit_for_bit(name: str) -> None:
    setup = get_setup(name)
    plain, off = make_engine(setup, 16, seed=3), DisturbedEngine(setup, 16, Disturbances(), seed=3)
    random = np.random.default_rng(0)
    for _ in range(120):  # some episodes end and begin anew
        actions = random.uniform(-1, 1, (16, 2)).astype(np.float32)
        plain.step(actions)
        off.step(actions)
        np.testing.assert_array_equal(plain.observations, off.observations)
        np.testing.assert_array_equal(plain.rewards, off.rewards)


def test_slow_wheels_drive_and_are_observed_slower() -> None:
    assert drive(engine_with(slow=0.3), AHEAD) == pytest.approx([0.7], abs=1e-6)
    engine = engine_with("study_room", slow=0.3)
    drive(engine, AHEAD)
    assert engine.observations[0, engine.setup.polar_size - 2] == pytest.approx(0.7, abs=1e-6)


def test_odometry_says_how_fast_wheels_turn_at_the_end_of_a_step_and_sees_no_slip() -> None:
    engine = engine_with("study_room", delay_s=0.1, slip=0.5)
    drive(engine, AHEAD)
    assert engine.observations[0, engine.setup.polar_size - 2] == 1


@pytest.mark.parametrize(
    ("delay_s", "expected"), [(0.1, [0.5, 1, 1, 0.5, 0]), (0.2, [0, 1, 1, 1, 0]), (0.5, [0, 0, 0.5, 1, 1])]
)
def test_a_command_acts_so_much_later(delay_s: float, expected: list[float]) -> None:
    assert drive(engine_with(delay_s=delay_s), AHEAD, AHEAD, AHEAD, STAND, STAND) == pytest.approx(expected, abs=1e-6)


def test_slipping_wheels_move_less_and_turn_a_robot_told_to_go_straight() -> None:
    engine = engine_with(slip=0.4)
    went = drive(engine, *[AHEAD] * 20)
    assert 0.6 <= min(went) < max(went) < 1
    assert engine.accumulated_angle.min() > 0
    again = engine_with(slip=0.4)
    drive(again, *[AHEAD] * 20)
    np.testing.assert_array_equal(engine.poses, again.poses)


def test_the_lidar_is_as_noisy_as_said() -> None:
    exact, noisy = engine_with(), engine_with(noise_m=0.05)
    apart = (noisy.observations - exact.observations)[:, SETUP.polar_size :]
    seen = exact.observations[:, SETUP.polar_size :] < 0.9
    assert seen.any()
    assert 0 < np.abs(apart[seen]).mean() * SETUP.robot.lidar.range_m < 0.2
    assert (exact.observations[:, : SETUP.polar_size] == noisy.observations[:, : SETUP.polar_size]).all()


def test_to_train_in_every_episode_has_its_own_up_to_the_most() -> None:
    setup = get_setup("study_room")
    engine = randomised_engine(setup, 64, seed=1)
    engine.step(np.tile(AHEAD, (64, 1)))
    engine.step(np.tile(AHEAD, (64, 1)))
    share = engine.observations[~engine.dones, setup.polar_size - 2]  # of full speed
    assert len(np.unique(share)) == len(share) > 50
    assert (1 - RANDOMISED.slow) * (1 - RANDOMISED.slip) - 1e-6 <= share.min() < 0.75
    assert 0.9 < share.max() <= 1


def test_a_shipped_policy_still_arrives_with_slow_wheels_and_noise() -> None:
    policy = Policy.load(Path(__file__).parents[2] / "datasets/open_field/base.npz")
    scenes = draw_scenes("open_field", range(100))
    engine = DisturbedEngine(SETUP, 100, Disturbances(0.02, 0.1, 0.1, 0.3), auto_reset=False, scenes=scenes)
    while not engine.dones.all():
        engine.step(policy.act(engine.observations))
    assert (engine.outcomes == 1).mean() > 0.8


def test_what_no_robot_does_and_crowds_are_refused() -> None:
    with pytest.raises(SetupError, match=r"slip = 1: must be from 0 to 0\.9"):
        Disturbances(slip=1.0)
    with pytest.raises(SetupError, match="pedestrians"):
        randomised_engine(get_setup("crowd_hall"), 2)

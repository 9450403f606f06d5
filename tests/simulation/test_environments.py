"""The engines as Gymnasium environments and as an SB3 VecEnv, checked by those libraries' own checkers."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import TD3
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from desirepath.simulation.acting import ActionError
from desirepath.simulation.environments import FastVecEnv, NavigationEnv
from desirepath.simulation.fast import make_engine
from desirepath.simulation.reference import ReferenceEngine
from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.setups import SETUPS, get_setup
from desirepath_experiments.benchmarks.engines import SimulateConfig, benchmark_simulate

STUDY_ROOM = get_setup("study_room")

NAMES = list(SETUPS)


@pytest.mark.parametrize(
    ("name", "engine"),
    [(name, e) for name in NAMES for e in ("fast", "pybullet") if not SETUPS[name].crowded or e == "fast"],
)
def test_gymnasium_and_sb3_find_nothing_to_complain_about(name: str, engine: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", message=".*render.*")
        warnings.filterwarnings("ignore", message=".*spec.*")
        env = NavigationEnv(name, engine=engine)
        check_env(env, skip_render_check=True, skip_close_check=True)
        sb3_check_env(env)
        env.close()


@pytest.mark.parametrize("engine", ["fast", "pybullet"])
@pytest.mark.parametrize(("time_limit", "ends"), [(None, (False, True)), ("terminated", (True, False))])
def test_an_episode_out_of_steps_is_truncated_or_what_was_asked_for(
    engine: str, time_limit: str | None, ends: tuple[bool, bool]
) -> None:
    env = NavigationEnv("study_room", engine=engine, **({"time_limit": time_limit} if time_limit else {}))
    observation, info = env.reset(options={"scene": draw_scene("study_room", 5)})
    assert info["outcome"] == "running"
    terminated = truncated = False
    while not (terminated or truncated):
        observation, _, terminated, truncated, info = env.step(np.array([-1.0, 0.1], dtype=np.float32))
    assert (info["outcome"], terminated, truncated) == ("timeout", *ends)
    assert observation in env.observation_space
    env.close()


def test_an_episode_that_ends_by_itself_is_terminated() -> None:
    env = NavigationEnv("study_room")
    env.reset(options={"scene": draw_scene("study_room", 5)})
    ends = (False, False)
    while not any(ends):
        _, _, *ends, info = env.step(np.array([1.0, 0.0], dtype=np.float32))  # into a wall
    assert (info["outcome"], ends) == ("collision", [True, False])
    with pytest.raises(ValueError, match="time_limit = 'never': must be 'truncated' or 'terminated'"):
        NavigationEnv("study_room", time_limit="never")


def test_unknown_engines_and_drive_modes_are_named() -> None:
    with pytest.raises(ValueError, match="engine = 'mujoco'"):
        NavigationEnv("study_room", engine="mujoco")
    with pytest.raises(ValueError, match=r"drive_mode = 'legs'.*velocity, wheels"):
        ReferenceEngine(STUDY_ROOM, drive_mode="legs")


def test_the_reference_engine_refuses_bad_actions_and_steps_after_the_end() -> None:
    with ReferenceEngine(STUDY_ROOM) as engine:
        with pytest.raises(RuntimeError, match="reset"):
            engine.step(np.zeros(2))
        engine.reset(draw_scene("study_room", 0))
        for bad in (np.array([np.nan, 0.0]), np.zeros(3)):
            with pytest.raises(ActionError, match="action"):
                engine.step(bad)


@pytest.mark.parametrize("name", NAMES)
def test_vec_env_keeps_the_contract(name: str) -> None:
    env, engine = FastVecEnv(name, 16, seed=3), make_engine(SETUPS[name], 16, seed=3)
    first = env.reset()
    engine.reset()  # the engine has started once on its own, as the VecEnv's has
    assert (first == engine.observations).all()
    rng = np.random.default_rng(0)
    returns, ended = np.zeros(16), 0
    for _ in range(320):  # every episode of the shortest setup ends
        actions = (rng.uniform(-1, 1, (16, 2)) * [1.0, 0.2]).astype(np.float32)
        observations, rewards, dones, infos = env.step(actions)
        engine.step(actions)
        returns += rewards
        assert observations.dtype == rewards.dtype == np.float32
        assert (observations == engine.observations).all()
        assert (dones == engine.dones).all()
        for i, info in enumerate(infos):
            assert bool(info) == bool(dones[i])
            if info:
                assert (info["terminal_observation"] == engine.next_observations[i]).all()
                assert info["TimeLimit.truncated"] is False
                assert info["episode"] == {"r": pytest.approx(returns[i]), "l": engine.steps[i]}
                returns[i], ended = 0.0, ended + 1
    assert ended > 5
    assert len(env.get_attr("setup")) == 16
    with pytest.raises(NotImplementedError, match="share one engine"):
        env.env_method("reset")


def test_seeding_a_vec_env_repeats_its_scenes() -> None:
    env = FastVecEnv("study_room", 4)
    env.seed(11)
    first = env.reset()
    assert (env.reset() != first).any()
    env.seed(11)
    assert (env.reset() == first).all()


def test_results_of_a_step_are_not_overwritten_by_the_next() -> None:
    env = FastVecEnv("open_field", 4)
    env.reset()
    forward = np.tile(np.array([1.0, 0.1], dtype=np.float32), (4, 1))
    observations, rewards, dones, _ = env.step(forward)
    kept = observations.copy(), rewards.copy(), dones.copy()
    env.step(forward)
    assert all((now == then).all() for now, then in zip((observations, rewards, dones), kept, strict=True))


def test_sb3_td3_learns_on_it() -> None:
    env = FastVecEnv("open_field", 8, seed=0, progress_weight=1.0)
    model = TD3("MlpPolicy", env, learning_starts=64, batch_size=32, train_freq=4, buffer_size=1000, seed=0)
    before = [p.detach().clone() for p in model.actor.parameters()]
    model.learn(160)
    assert any((a != b).any() for a, b in zip(before, model.actor.parameters(), strict=True))


def test_the_benchmark_reports_both_engines_from_one_run() -> None:
    report = benchmark_simulate(SimulateConfig("open_field", n_envs=16, seconds=0.5))
    assert report["fast_steps_per_s"] > 0
    for mode in ("", "_velocity_mode"):
        pybullet = report["pybullet_steps_per_s" + mode]
        assert pybullet > 0
        assert report["ratio" + mode] == pytest.approx(report["fast_steps_per_s"] / pybullet)
    assert (report["pybullet_substeps"], report["pybullet_ray_threads"], report["lidar_beams"]) == (48, 1, 360)

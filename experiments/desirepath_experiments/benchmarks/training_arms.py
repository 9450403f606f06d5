"""The trainings that `base_training.py` compares: each runs until 94 % success is confirmed, or gives up.

Nothing is compared here. Each goes on by a chunk when it is asked to, so that several can take turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
import pydantic
from pydantic import Field
from stable_baselines3 import TD3
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise

from desirepath.analysis.metrics import success_rate
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.sb3 import actor_layers, critic_layers, read_layers, sb3_td3
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import BaseConfig, BaseTraining
from desirepath.learning.td3.td3 import Td3Config
from desirepath.simulation.environments import FastVecEnv
from desirepath.simulation.fast import evaluate
from desirepath.simulation.setups import Setup, get_setup

TARGET = 0.94
CONFIRM_SCENES = 2_000
FIRST_CONFIRM_SEED, CONFIRM_SEEDS = 10_000, 500  # reporting scenes that no card uses: so many tries per training seed
LAST, AVERAGED = "last", "averaged"
Arm = Literal["fast", "unguided", "sb3_fast"]
ARMS: tuple[Arm, ...] = get_args(Arm)


@pydantic.dataclasses.dataclass(frozen=True)
class TrainBenchmarkConfig:
    """What is trained how often. keep: a file of finished trainings, so that a broken run goes on."""

    setup: Annotated[str, Field(description="study_room or open_field.")] = "open_field"
    seeds: Annotated[int, Field(ge=1, description="Number of trainings per arm.")] = 1
    arms: Annotated[
        tuple[Arm, ...],
        Field(
            min_length=1,
            description="Any of fast (as setups are trained), unguided (the same TD3 from nothing), sb3_fast.",
        ),
    ] = ("fast", "sb3_fast")
    keep: Annotated[
        Path | None, Field(description="Keep finished trainings in this file; a broken run goes on from there.")
    ] = None
    updates_per_check: Annotated[int, Field(ge=1, description="Between two checks of success.")] = 600
    check_scenes: Annotated[int, Field(ge=1, description="In which success is checked.")] = 500
    max_updates: Annotated[int, Field(ge=1, description="After which a training gives up.")] = 40_000
    max_seconds: Annotated[float, Field(gt=0, description="Of one training, processor time; then it gives up.")] = 240.0


@dataclass(frozen=True)
class Progress:
    """Where a training is: its policies by weights (`last`, `averaged`), its work and the processor seconds it took.

    updates: those that clone a guide included. seconds: all of training; update_seconds: of it, in updates with their
    sampling; the rest is stepping environments.
    """

    policies: dict[str, Policy]
    updates: int
    transitions: int
    seconds: float
    wall_seconds: float
    update_seconds: float


@dataclass(frozen=True)
class Reached:
    """One training judged by one kind of weights: the work until the confirmed 94 %, or until it gave up (None).

    seconds, seconds_to_94: processor time of training, checks not counted. wall_seconds: the same by the wall clock.
    """

    arm: str
    weights: str
    seed: int
    seconds_to_94: float | None
    seconds: float
    wall_seconds: float
    updates: int
    transitions: int
    held_out_success: float | None
    tries: int
    ms_per_update: float
    ms_per_transition: float


class Spent(NamedTuple):
    """Seconds by both clocks."""

    seconds: float = 0.0
    wall_seconds: float = 0.0


class Stopwatch:
    """Wraps a function and adds up the processor and wall-clock seconds spent in it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.spent = Spent()
        self._function = function

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        began, began_wall = time.process_time(), time.perf_counter()
        try:
            return self._function(*arguments, **named)
        finally:
            seconds, wall = time.process_time() - began, time.perf_counter() - began_wall
            self.spent = Spent(self.spent.seconds + seconds, self.spent.wall_seconds + wall)


Training = Generator[None, None, list[Reached]]
"""Trains by one chunk whenever it is asked to go on; returns what it reached."""


def take_turns(trainings: Mapping[str, Training]) -> dict[str, list[Reached]]:
    """Run them all, chunk by chunk in turns: what is slow on this machine for a while is slow for all of them."""
    reached: dict[str, list[Reached]] = {}
    while len(reached) < len(trainings):
        for name, training in trainings.items():
            if name not in reached:
                try:
                    next(training)
                except StopIteration as ended:
                    reached[name] = ended.value
    return reached


def train_until_target(
    arm: str, setup: Setup, seed: int, chunk: Callable[[], Progress], config: TrainBenchmarkConfig
) -> Training:
    """Alternate training chunks and checks (not timed) until 94 % is confirmed for every kind of weights, or give up.

    Every try to confirm takes 2,000 scenes that served nothing before.
    """
    check = scene_set(setup.name, config.check_scenes, purpose=Purpose.BENCHMARK, seed=seed)
    reached: dict[str, Reached] = {}
    tries = 0
    while True:
        now = chunk()
        for weights, policy in now.policies.items():
            if weights in reached or success_rate(evaluate(policy.act, setup, check).outcome) < TARGET:
                continue
            fresh = FIRST_CONFIRM_SEED + CONFIRM_SEEDS * seed + tries
            tries += 1
            scenes = scene_set(setup.name, CONFIRM_SCENES, purpose=Purpose.REPORT, seed=fresh)
            confirmed = success_rate(evaluate(policy.act, setup, scenes).outcome)
            if confirmed >= TARGET:
                reached[weights] = _judge_training(arm, weights, seed, now, confirmed, tries)
        given_up = now.updates >= config.max_updates or now.seconds >= config.max_seconds
        if given_up or len(reached) == len(now.policies):
            return [reached.get(w) or _judge_training(arm, w, seed, now, None, tries) for w in now.policies]
        yield


def _judge_training(arm: str, weights: str, seed: int, now: Progress, confirmed: float | None, tries: int) -> Reached:
    return Reached(
        arm=arm,
        weights=weights,
        seed=seed,
        seconds_to_94=None if confirmed is None else now.seconds,
        seconds=now.seconds,
        wall_seconds=now.wall_seconds,
        updates=now.updates,
        transitions=now.transitions,
        held_out_success=confirmed,
        tries=tries,
        ms_per_update=now.update_seconds / now.updates * 1e3,
        ms_per_transition=(now.seconds - now.update_seconds) / now.transitions * 1e3,
    )


def train_ours(arm: str, base: BaseConfig, config: TrainBenchmarkConfig) -> Training:
    """Base training, judged by its last and by its averaged weights: `train_base` considers both."""
    training = BaseTraining(base)
    whole = Stopwatch(training.vector_step)
    stepping = Stopwatch(training.collector.step)
    training.collector.step = stepping  # type: ignore[method-assign]

    def made() -> int:
        return training.cloning_updates + training.agent.updates

    def chunk() -> Progress:
        goal = made() + config.updates_per_check
        while made() < goal:
            whole()
        policies = {AVERAGED: training.policy(averaged=True), LAST: training.policy()}
        updating = whole.spent.seconds - stepping.spent.seconds
        return Progress(policies, made(), training.transitions, *whole.spent, updating)

    return train_until_target(arm, training.setup, base.seed, chunk, config)


def train_unguided(arm: str, base: BaseConfig, config: TrainBenchmarkConfig) -> Training:
    """The same without the guide that knows the scene: what Stable-Baselines3 does, by our code."""
    return train_ours(arm, _alone(base), config)


def _alone(base: BaseConfig) -> BaseConfig:
    """TD3 from nothing, by its own settings."""
    if base.cloned:
        return BaseConfig(base.setup, base.seed, base.heads)
    return replace(base, guided_share=0.0, guidance=0.0)


def train_sb3(arm: str, base: BaseConfig, config: TrainBenchmarkConfig) -> Training:
    """Stable-Baselines3 with the same network, shaping, environments, noise and updates per step."""
    use_one_thread()
    base, setup = _alone(base), get_setup(base.setup)
    td3 = Td3Config(setup.gamma, base.batch_size, base.learning_rate, base.tau)
    model = sb3_td3(
        FastVecEnv(setup, base.n_envs, seed=base.seed, progress_weight=base.progress_weight),
        setup,
        td3,
        heads=base.heads,
        seed=base.seed,
        buffer_size=base.buffer_size,
        updates_per_step=base.updates_per_step,
        learning_starts=base.random_transitions,
    )
    noise = VectorizedActionNoise(NormalActionNoise(np.zeros(2), np.ones(2)), base.n_envs)
    noise.noises = [
        NormalActionNoise(np.zeros(2), np.full(2, sigma)) for sigma in np.geomspace(*base.exploration, base.n_envs)
    ]
    model.action_noise = noise
    updating, learning = Stopwatch(model.train), Stopwatch(model.learn)
    model.train = updating  # type: ignore[method-assign]
    vector_steps = -(-config.updates_per_check // base.updates_per_step)

    def chunk() -> Progress:
        first = model.num_timesteps == 0
        steps = vector_steps * base.n_envs + (base.random_transitions if first else 0)
        learning(steps, reset_num_timesteps=first)
        policies = {LAST: policy_of_sb3(model, setup, base.heads)}
        return Progress(policies, model._n_updates, model.num_timesteps, *learning.spent, updating.spent.seconds)

    return train_until_target(arm, setup, base.seed, chunk, config)


def policy_of_sb3(model: TD3, setup: Setup, heads: tuple[int, ...]) -> Policy:
    """The policy that an SB3 model trained by `sb3_td3` has reached."""
    return Policy(
        setup.name, NetworkShape.of(setup, heads), read_layers(actor_layers(model)), read_layers(critic_layers(model))
    )

"""How long base training takes on this machine, and what it reaches. Ratios come from one run.

Clocks live here and in `benchmark_align.py`, nowhere else in this room.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import TD3
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise

from backend.analysis.metrics import success_rate
from backend.learning.base import BaseConfig, BaseTraining
from backend.learning.errors import LearningError
from backend.learning.networks import use_one_thread
from backend.learning.policy import Policy
from backend.learning.sb3 import actor_layers, policy_of_sb3, read_layers, sb3_td3
from backend.learning.scene_sets import Purpose, scene_set
from backend.learning.td3 import Td3Config
from backend.simulation.environments import FastVecEnv, NavigationEnv
from backend.simulation.fast import evaluate
from backend.simulation.setups import Setup, get_setup

TARGET = 0.94
ARMS = ("fast", "sb3_fast", "sb3_pybullet")
CHECK_SCENES, CONFIRM_SCENES = 500, 2_000
FIRST_CONFIRM_SEED, CONFIRM_SEEDS = 10_000, 500  # reporting scenes that no card uses: so many tries per training seed
LAST, AVERAGED = "last", "averaged"
WEIGHTS = {"fast": AVERAGED, "sb3_fast": LAST}
"""Which weights an arm is judged by: ours averages as base training does, SB3 has no such thing. The other weights of
the same training are checked beside them, so that what averaging brings can be told apart."""


@dataclass(frozen=True)
class TrainBenchmarkConfig:
    """Base training's own hyper-parameters, checked often; a training gives up after `max_updates`."""

    updates_per_check: int = 600
    max_updates: int = 40_000
    pybullet_steps: int = 600


@dataclass(frozen=True)
class Progress:
    """Where a training is: its policies by weights (`last`, `averaged`), its work and the seconds that took.

    seconds: all of training; update_seconds: of it, in updates with their sampling; the rest is stepping environments.
    """

    policies: dict[str, Policy]
    updates: int
    transitions: int
    seconds: float
    update_seconds: float


@dataclass(frozen=True)
class Reached:
    """One training judged by one kind of weights: the work until the confirmed 94 %, or until it gave up (None)."""

    arm: str
    weights: str
    seed: int
    seconds_to_94: float | None
    updates: int
    transitions: int
    held_out_success: float | None
    tries: int
    ms_per_update: float
    ms_per_transition: float


def _train_until_target(
    arm: str, setup: Setup, seed: int, chunk: Callable[[], Progress], config: TrainBenchmarkConfig
) -> list[Reached]:
    """Alternate training chunks and checks (not timed) until 94 % is confirmed for the weights the arm is judged by.

    Every try to confirm takes 2,000 scenes that served nothing before. The other weights are null where they were not
    confirmed until then.
    """
    check = scene_set(setup.name, CHECK_SCENES, purpose=Purpose.BENCHMARK, seed=seed)
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
                reached[weights] = _reached(arm, weights, seed, now, confirmed, tries)
        if WEIGHTS[arm] in reached or now.updates >= config.max_updates:
            return [reached.get(w) or _reached(arm, w, seed, now, None, tries) for w in now.policies]


def _reached(arm: str, weights: str, seed: int, now: Progress, confirmed: float | None, tries: int) -> Reached:
    return Reached(
        arm=arm,
        weights=weights,
        seed=seed,
        seconds_to_94=None if confirmed is None else now.seconds,
        updates=now.updates,
        transitions=now.transitions,
        held_out_success=confirmed,
        tries=tries,
        ms_per_update=now.update_seconds / now.updates * 1e3,
        ms_per_transition=(now.seconds - now.update_seconds) / now.transitions * 1e3,
    )


class _Stopwatch:
    """Wraps a function and adds up the seconds spent in it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.seconds = 0.0
        self._function = function

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        began = time.perf_counter()
        try:
            return self._function(*arguments, **named)
        finally:
            self.seconds += time.perf_counter() - began


def _fast_arm(base: BaseConfig, config: TrainBenchmarkConfig) -> list[Reached]:
    training = BaseTraining(base)
    whole = _Stopwatch(training.vector_step)
    stepping = _Stopwatch(training.explorer.step)
    training.explorer.step = stepping  # type: ignore[method-assign]

    def chunk() -> Progress:
        goal = training.agent.updates + config.updates_per_check
        while training.agent.updates < goal:
            whole()
        policies = {AVERAGED: training.policy(averaged=True), LAST: training.policy()}
        return Progress(
            policies, training.agent.updates, training.transitions, whole.seconds, whole.seconds - stepping.seconds
        )

    return _train_until_target("fast", training.setup, base.seed, chunk, config)


def _sb3_arm(base: BaseConfig, config: TrainBenchmarkConfig) -> list[Reached]:
    """Stable-Baselines3 with the same network, shaping, environments, noise and updates per step."""
    use_one_thread()
    setup = get_setup(base.setup)
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
    average = _AveragedActor(model, base.average_decay**base.updates_per_step)
    updating = _Stopwatch(model.train)

    def train_and_average(*arguments: Any, **named: Any) -> None:
        updating(*arguments, **named)
        average.take_up()

    model.train = train_and_average  # type: ignore[method-assign]
    learning = _Stopwatch(model.learn)
    vector_steps = -(-config.updates_per_check // base.updates_per_step)

    def chunk() -> Progress:
        first = model.num_timesteps == 0
        steps = vector_steps * base.n_envs + (base.random_transitions if first else 0)
        learning(steps, reset_num_timesteps=first)
        policy = policy_of_sb3(model, setup, base.heads)
        policies = {LAST: policy, AVERAGED: replace(policy, actor=average.arrays())}
        seconds = learning.seconds - average.seconds
        return Progress(policies, model._n_updates, model.num_timesteps, seconds, updating.seconds)

    return _train_until_target("sb3_fast", setup, base.seed, chunk, config)


class _AveragedActor:
    """The running average of an SB3 model's actor, taken up once per vector step; its own seconds are not SB3's."""

    def __init__(self, model: TD3, decay: float) -> None:
        self._model, self._decay = model, decay
        self._kept = [parameter.detach().clone() for parameter in model.actor.parameters()]
        self.seconds = 0.0

    def take_up(self) -> None:
        began = time.perf_counter()
        with torch.no_grad():
            for kept, parameter in zip(self._kept, self._model.actor.parameters(), strict=True):
                kept.lerp_(parameter, 1 - self._decay)
        self.seconds += time.perf_counter() - began

    def arrays(self) -> tuple[np.ndarray[Any, np.dtype[np.float32]], ...]:
        """The averaged actor in our order of layers."""
        current = [parameter.detach().clone() for parameter in self._model.actor.parameters()]
        with torch.no_grad():
            for parameter, kept in zip(self._model.actor.parameters(), self._kept, strict=True):
                parameter.copy_(kept)
            arrays = read_layers(actor_layers(self._model))
            for parameter, was in zip(self._model.actor.parameters(), current, strict=True):
                parameter.copy_(was)
        return arrays


def _pybullet_seconds_per_step(setup: Setup, steps: int) -> float:
    """Wheel motors, restarts included: what a user's training would pay per step, without network and updates."""
    env = NavigationEnv(setup, engine="pybullet", drive_mode="wheels", progress_weight=1.0)
    random = np.random.default_rng(0)
    env.reset(seed=0)
    began = time.perf_counter()
    for _ in range(steps):
        _, _, terminated, _, _ = env.step(random.uniform(-1, 1, 2).astype(np.float32))
        if terminated:
            env.reset()
    seconds = (time.perf_counter() - began) / steps
    env.close()
    return seconds


class _Kept:
    """Finished trainings in a JSON file, so that a long run can be taken up again; nothing is kept without a file."""

    def __init__(self, path: Path | None, settings: dict[str, Any]) -> None:
        self._path, self._settings = path, settings
        self.runs: dict[str, list[Reached]] = {}
        if path is not None and path.exists():
            stored = json.loads(path.read_text(encoding="utf-8"))
            if stored["settings"] != settings:
                raise LearningError(f"{path} holds a benchmark with other settings; name another file or delete it")
            self.runs = {name: [Reached(**entry) for entry in entries] for name, entries in stored["runs"].items()}

    def run(self, name: str, training: Callable[[], list[Reached]]) -> list[Reached]:
        if name not in self.runs:
            self.runs[name] = training()
            if self._path is not None:
                runs = {name: [asdict(entry) for entry in entries] for name, entries in self.runs.items()}
                self._path.write_text(json.dumps({"settings": self._settings, "runs": runs}), encoding="utf-8")
        return self.runs[name]


def benchmark_train(
    *,
    setup: str = "open_field",
    seeds: int = 1,
    arms: Sequence[str] = ARMS,
    config: TrainBenchmarkConfig | None = None,
    base: BaseConfig | None = None,
    keep: Path | None = None,
) -> dict[str, Any]:
    """Seconds of training until a base policy reaches 94 %, ours (`fast`) against SB3 on the same fast engine and on
    PyBullet. One thread each, one after the other, evaluations not counted.

    Ours is judged by its averaged weights, as base training uses them; SB3 by its last weights, since it does not
    average. Both trainings are also judged by the other weights (`per_seed`, `causes`). `seconds_to_94` and
    `held_out_success` are medians of the first arm named (null if a training never got there).
    The PyBullet arm is not trained: one environment with wheel motors; steps to 94 % of SB3 on the fast engine (of
    ours, where that arm did not run) times measured seconds per PyBullet step, plus that arm's seconds of updates;
    `sb3_pybullet_note` says so.
    keep: file that finished trainings are kept in; a broken run goes on from there.
    """
    unknown = [arm for arm in arms if arm not in ARMS]
    if unknown or not arms or seeds < 1:
        raise LearningError(f"arms = {list(arms)}, seeds = {seeds}: known arms are {', '.join(ARMS)}; at least 1 seed")
    config = config or TrainBenchmarkConfig()
    chosen = base or BaseConfig(setup=setup)
    if chosen.setup != setup:
        raise LearningError(f"base.setup = {chosen.setup!r} but setup = {setup!r}")
    kept = _Kept(keep, {"base": json.loads(json.dumps(chosen.as_dict())), "config": asdict(config)})
    trained = [arm for arm in arms if arm != "sb3_pybullet"] or ["fast"]
    entries: list[Reached] = []
    for seed in range(seeds):  # seed by seed: what is slow on this machine for a while is slow for all arms
        for arm in trained:
            run = partial(_fast_arm if arm == "fast" else _sb3_arm, replace(chosen, seed=seed), config)
            entries += kept.run(f"{arm} {seed}", run)
    judged = {arm: [e for e in entries if e.arm == arm and e.weights == WEIGHTS[arm]] for arm in trained}
    medians = {arm: _median([e.seconds_to_94 for e in found]) for arm, found in judged.items()}
    note = None
    if "sb3_pybullet" in arms:
        steps_of = "sb3_fast" if "sb3_fast" in judged else "fast"
        per_step = _pybullet_seconds_per_step(get_setup(setup), config.pybullet_steps)
        medians["sb3_pybullet"] = _median(
            [
                None if e.seconds_to_94 is None else e.transitions * per_step + e.updates * e.ms_per_update / 1e3
                for e in judged[steps_of]
            ]
        )
        note = (
            f"not trained: steps to 94 % of arm {steps_of} times {per_step * 1e3:.2f} ms per step of one PyBullet "
            f"environment with wheel motors (measured over {config.pybullet_steps} steps, restarts included), plus "
            "that arm's time for updates"
        )
    first = arms[0] if arms[0] in judged else trained[0]
    return {
        "setup": setup,
        "seeds": seeds,
        "seconds_to_94": medians[first],
        "held_out_success": _median([e.held_out_success for e in judged[first]]),
        "seconds_to_94_per_arm": medians,
        "judged_by_weights": {arm: WEIGHTS[arm] for arm in judged},
        "per_seed": [asdict(entry) for entry in entries],
        "ratio_vs_sb3_fast": _ratio(medians.get("sb3_fast"), medians.get("fast")),
        "ratio_vs_sb3_pybullet": _ratio(medians.get("sb3_pybullet"), medians.get("fast")),
        "causes": _causes(entries) if {"fast", "sb3_fast"} <= set(judged) else None,
        "sb3_pybullet_note": note,
        "network_heads": list(chosen.heads),
        "scenes": {"check": CHECK_SCENES, "confirm": CONFIRM_SCENES, "confirm_scenes_are": "new at every try"},
    }


def _causes(entries: Sequence[Reached]) -> dict[str, Any]:
    """Where the gain over SB3 on the same engine comes from: medians over seeds, and SB3's divided by ours."""

    def of(arm: str, weights: str, name: str) -> float | None:
        found = [e for e in entries if (e.arm, e.weights) == (arm, weights)]
        return _median([None if e.seconds_to_94 is None else getattr(e, name) for e in found])

    def compared(name: str, *, ours: str = AVERAGED, theirs: str = LAST) -> dict[str, float | None]:
        fast, sb3 = of("fast", ours, name), of("sb3_fast", theirs, name)
        return {"fast": fast, "sb3_fast": sb3, "ratio": _ratio(sb3, fast)}

    return {
        "ms_per_update": compared("ms_per_update"),
        "ms_per_transition_stepped": compared("ms_per_transition"),
        "updates_needed": compared("updates"),
        "updates_needed_if_both_average": compared("updates", theirs=AVERAGED),
        "updates_needed_if_neither_averages": compared("updates", ours=LAST),
    }


def _median(values: Sequence[float | None]) -> float | None:
    """The median, where a training that never got there counts as infinitely long."""
    middle = statistics.median(float("inf") if value is None else value for value in values)
    return None if middle == float("inf") else middle


def _ratio(slow: float | None, fast: float | None) -> float | None:
    return None if slow is None or fast is None else slow / fast

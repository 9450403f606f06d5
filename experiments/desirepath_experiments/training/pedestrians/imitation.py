"""Learning to move among pedestrians by imitation: the chapter's networks, another learner. Ours.

A search that is told the building and how everybody moves (`foresight.constant_velocity`) says what each command costs
wherever the learner's own driving leads (DAgger, Ross et al. 2011, with the costs of all commands as in AggreVaTe, Ross
and Bagnell 2014); the network predicts those costs from what the robot senses. Chapter 4's learner is
`crowd_training.py`.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from desirepath.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds
from desirepath.learning.pedestrians.crowd_networks import COMMANDS, VARIANTS, Chooser, actor_acts
from desirepath.learning.pedestrians.crowd_states import PATH_POINTS, SECTORS, SIZES, Given, states
from desirepath.learning.policies.mirroring import Mirror
from desirepath.learning.scene_sets import Purpose
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.simulation.crowds.crowd_engine import COARSE_RANGES, GROUPS, CrowdEngine
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath_experiments.training.pedestrians.crowd_training import CrowdPool
from desirepath_experiments.training.pedestrians.foresight import MIRRORED, MOST_M, costs_by_velocity

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class ImitationConfig:
    """labels: states whose commands' costs are said, with updates_per_step for every n_envs of them. dearest_m: costs
    above the best count as this at most, so that a collision is as bad as so much of a detour: with more the robot
    waits for ever, with less it collides; all are learned at once, the middle one drives, and which is kept is chosen
    on selection scenes. led: of the labels, the first part, in which the search drives. mirrored_share: of each batch,
    left and right exchanged. moving: pedestrians in training scenes, from-to. The learning rate falls to 0 in a line.
    Raises ValueError for numbers that cannot be."""

    variant: str = "ours"
    seed: int = 0
    labels: int = 250_000
    n_envs: int = 128
    updates_per_step: int = 4
    batch_size: int = 128
    learning_rate: float = 2e-3
    dearest_m: tuple[float, ...] = (1.0, 2.0, 4.0)
    led: float = 0.01
    mirrored_share: float = 0.5
    moving: tuple[int, int] = (1, 4)
    evaluations: int = 2
    evaluation_episodes: int = 200

    def __post_init__(self) -> None:
        for name in ("labels", "n_envs", "updates_per_step", "batch_size", "evaluations", "evaluation_episodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: must be at least 1")
        if not self.dearest_m or not all(0 < cost <= MOST_M for cost in self.dearest_m):
            raise ValueError(f"dearest_m = {self.dearest_m}: needs lengths above 0 m, at most {MOST_M:g} m")

        if not 0 <= self.mirrored_share <= 1:
            raise ValueError(f"mirrored_share = {self.mirrored_share}: must be 0 to 1")

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass
class Imitated:
    """actor: after the last update. history: a row per evaluation on selection scenes of the published setting, of who
    drives; the last rows are of each of dearest_m. bfloat16: whether products were in it, by the processor."""

    actor: Chooser
    history: list[dict[str, float]]
    bfloat16: bool


def imitate(config: ImitationConfig, on_progress: OnProgress = no_progress) -> Imitated:
    """Train one network. Raises KeyError for an unknown variant."""
    torch.manual_seed(config.seed)
    torch.set_num_threads(1)
    given = VARIANTS[config.variant].given
    actor = Chooser(config.variant, len(config.dearest_m), which=len(config.dearest_m) // 2)
    act, commands = actor_acts(actor), actor.get_buffer("actions").numpy()
    pool = CrowdPool(TRAINED_SETUPS, config.seed * 1_000, CrowdConditions(moving=config.moving))
    engine = CrowdEngine(n_envs=config.n_envs, pool=pool)
    judged = crowd_scene_set(config.evaluation_episodes, PUBLISHED, purpose=Purpose.SELECT, seed=config.seed)
    rng = np.random.default_rng([config.seed, 4])
    steps = -(-config.labels // config.n_envs)
    adam = torch.optim.Adam(actor.parameters(), config.learning_rate)
    rate = torch.optim.lr_scheduler.LinearLR(adam, 1.0, 0.0, steps * config.updates_per_step)
    seen = np.zeros((steps * config.n_envs, SIZES[given]), np.float16)
    targets = np.zeros((steps * config.n_envs, len(COMMANDS)), np.float16)
    dearest = torch.tensor(config.dearest_m)[:, None]
    mirror, turned = mirror_of_state(given), round(config.mirrored_share * config.batch_size)
    history: list[dict[str, float]] = []
    bfloat16 = multiplies_in_bfloat16()
    began = time.perf_counter()

    def judge(count: int) -> float:
        rates = evaluate_crowds(act, given, judged).rates()
        row = {"labels": float(count), "dearest_m": config.dearest_m[actor.which], **rates}
        history.append(row | {"seconds": time.perf_counter() - began})
        on_progress(count / len(seen), history[-1])
        return rates["success"]

    for step in range(steps):
        rows, count = slice(step * config.n_envs, (step + 1) * config.n_envs), (step + 1) * config.n_envs
        state, costs = states(engine, given), costs_by_velocity(engine)
        seen[rows], targets[rows] = state, costs
        engine.step(commands[costs.argmin(axis=1)] if step < config.led * steps else act(state))
        if engine.dones.any():
            engine.restart()
        for _ in range(config.updates_per_step):
            batch = rng.integers(count, size=config.batch_size)
            some, aims = seen[batch].astype(np.float32), targets[batch].astype(np.float32)
            some[:turned], aims[:turned] = mirror_batch(some[:turned], aims[:turned], mirror)
            learn_from(actor, adam, torch.as_tensor(some), torch.as_tensor(aims), dearest, bfloat16=bfloat16)
            rate.step()
        if (step + 1) * config.evaluations // steps > step * config.evaluations // steps and step + 1 < steps:
            judge(count)
    successes = []
    for actor.which in range(len(config.dearest_m)):
        successes.append(judge(len(seen)))
    actor.which = int(np.argmax(successes))
    return Imitated(actor.alone(), history, bfloat16)


def mirror_batch(seen: Floats, targets: Floats, mirror: Mirror) -> tuple[Floats, Floats]:
    """States and what commands cost there, (b, 24) m, left and right exchanged; NaN for a command without a mirror."""
    mirrored = targets[:, MIRRORED]
    mirrored[:, MIRRORED < 0] = np.nan
    return seen[:, mirror.order] * mirror.signs, mirrored


def multiplies_in_bfloat16() -> bool:
    """Whether this processor does (x86; of others nothing is known here): attention networks then learn in a third to
    half of the time; where it does not, torch takes fifteen times as long as in single precision."""
    can = torch.cpu.get_capabilities()
    return any(can.get(name, False) for name in ("amx_bf16", "avx512_bf16"))


def learn_from(
    actor: Chooser, adam: torch.optim.Adam, seen: Tensor, targets: Tensor, dearest: Tensor, *, bfloat16: bool = False
) -> None:
    """One step. targets: (b, 24) m, NaN where nothing is known. bfloat16: products in it."""
    with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
        predicted = actor.costs(seen)
    off = predicted.float() - (targets[:, None] / dearest).clamp(max=1.0)
    loss = torch.where(off.isnan(), 0.0, off).square().mean()
    adam.zero_grad()
    torch.autograd.backward(loss)
    adam.step()


def mirror_of_state(given: Given) -> Mirror:
    """How such states are mirrored, in the order of `states`: all is exact but scans, which look one beam beside."""
    point, ray = np.array([1.0, -1.0]), np.ones(1)
    scan, groups = np.arange(SECTORS)[::-1], -np.arange(GROUPS) % GROUPS
    layouts: dict[Given, list[tuple[NDArray[np.int64], NDArray[np.float64]]]] = {
        "points_and_groups": [(scan, point), (groups, np.tile(point, 2))],
        "points": [(scan, point)],
        "two_scans": [(scan, point)] * 2,
        "three_scans": [(scan, ray)] * 3,
        "coarse": [(np.arange(COARSE_RANGES)[::-1], ray), (np.zeros(1, np.int64), point)],
        "ranges": [(scan, ray)],
    }
    order, signs = np.zeros(0, np.int64), np.zeros(0)
    for rows, sign in (*layouts[given], (np.arange(PATH_POINTS), point)):
        order = np.append(order, len(order) + rows[:, None] * len(sign) + np.arange(len(sign)))
        signs = np.append(signs, np.tile(sign, len(rows)))
    return Mirror(order, signs.astype(np.float32))

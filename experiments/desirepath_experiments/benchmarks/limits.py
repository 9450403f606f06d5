"""How far a training update and the simulator are from what one core of this machine could do.

What is counted: multiplications and additions of the matrix products, bytes that must be read or written at least once.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.td3.base import BaseConfig, BaseTraining
from desirepath.simulation.scenes import row_columns
from desirepath.simulation.setups import Setup, get_setup
from desirepath_experiments.benchmarks.engines import fast_stepper, steps_in

LARGE = 768  # side of the square matrices whose product stands for the core's peak
COPIED_MB = 256  # more than any cache holds
RATE_ROUNDS = 5  # of which the fastest counts: others may be using the machine


def benchmark_limits(setup: str = "open_field") -> dict[str, Any]:
    """Base training's update and the fast engine beside the core's matrix products and memory, one thread.

    `share_of_peak`: of the rate of large float32 products by the same library. `share_of_memory`: of the measured rate
    of copying. `matmul_gflops_torch`: what Stable-Baselines3's networks run on. `openblas_coretype`: which kernels
    NumPy's library was told to use (null: its own choice). Seconds are processor time.
    """
    use_one_thread()
    chosen = get_setup(setup)
    config = BaseConfig(setup=setup, buffer_size=100_000)
    shape = NetworkShape.of(chosen, config.heads)
    peak, copied = matmul_gflops(LARGE), _copied_gb_per_s()
    training = BaseTraining(config)
    while training.agent.updates == 0:
        training.vector_step()
    agent, buffer, sampler = training.agent, training.buffer, torch.Generator().manual_seed(0)
    ms = 1e3 * _fastest(lambda: agent.update(buffer.sample(config.batch_size, sampler)), calls=100)
    gflop = update_flops(shape, config.batch_size) / 1e9
    update_bytes = _update_bytes(shape, config.batch_size)
    made, took = steps_in(2.0, fast_stepper(chosen, config.n_envs, seed=0))
    steps_per_s, step_bytes = made / took, _step_bytes(chosen)
    return {
        "setup": setup,
        "seconds_are": "processor time, fastest of several rounds",
        "openblas_coretype": os.environ.get("OPENBLAS_CORETYPE"),
        "matmul_gflops": peak,
        "matmul_gflops_layer": matmul_gflops(config.batch_size),
        "matmul_gflops_torch": matmul_gflops_torch(LARGE),
        "memory_gb_per_s": copied,
        "update": {
            "batch_size": config.batch_size,
            "ms": ms,
            "gflop": gflop,
            "gflops": gflop / ms * 1e3,
            "share_of_peak": gflop / ms * 1e3 / peak,
            "share_of_memory": update_bytes / ms / 1e6 / copied,
        },
        "simulator": {
            "steps_per_s": steps_per_s,
            "ns_per_beam": 1e9 / steps_per_s / chosen.robot.lidar.beams,
            "bytes_per_step": step_bytes,
            "share_of_memory": step_bytes * steps_per_s / 1e9 / copied,
        },
    }


def _fastest(work: Callable[[], object], calls: int) -> float:
    """Processor seconds of one call, in the fastest of several rounds of that many."""
    work()
    rounds = []
    for _ in range(RATE_ROUNDS):
        began = time.process_time()
        for _ in range(calls):
            work()
        rounds.append((time.process_time() - began) / calls)
    return min(rounds)


def matmul_gflops(side: int) -> float:
    """1e9 operations per second of NumPy's product of two (side, side) float32 matrices."""
    a = np.random.default_rng(0).standard_normal((side, side), dtype=np.float32)
    out = np.empty_like(a)
    return 2 * side**3 / 1e9 / _fastest(lambda: np.matmul(a, a, out=out), calls=1 + 10**8 // side**3)


def matmul_gflops_torch(side: int) -> float:
    """The same of torch's."""
    a = torch.randn(side, side)
    out = torch.empty_like(a)
    return 2 * side**3 / 1e9 / _fastest(lambda: torch.mm(a, a, out=out), calls=1 + 10**8 // side**3)


def _copied_gb_per_s() -> float:
    """1e9 bytes per second that a large copy reads and writes together."""
    a = np.ones(COPIED_MB * 2**20 // 8)
    out = np.empty_like(a)
    return 2 * a.nbytes / 1e9 / _fastest(lambda: np.copyto(out, a), calls=2)


def update_flops(shape: NetworkShape, batch_size: int, policy_delay: int = 2) -> float:
    """Operations in the matrix products of one TD3 update (`td3.py`), the actor's share averaged over updates."""

    def products(sizes: list[tuple[int, int]]) -> int:
        return sum(inputs * outputs for inputs, outputs in sizes)

    actor, critic = shape.actor_layers(), shape.critic_layers()
    one_head = products(shape.critic_layers(n_heads=1))
    firsts = actor[0][0] * actor[0][1] + actor[2][0] * actor[2][1]  # no gradient at the observations is wanted
    actions = 2 * shape.heads[0]  # ... of the critic's head inputs, only those at the extractors or at the actions
    targets = products(actor) + products(critic)
    critic_step = products(critic) + (2 * products(critic) - firsts - 2 * actions)
    through_head = products(critic[4:7]) - critic[4][0] * critic[4][1] + actions
    actor_step = products(actor) + one_head + through_head + (2 * products(actor) - firsts)
    return 2.0 * batch_size * (targets + critic_step + actor_step / policy_delay)


def _update_bytes(shape: NetworkShape, batch_size: int, policy_delay: int = 2) -> float:
    """Weights, gradients, Adam's two averages and targets, read and written once per step; the batch, read once."""
    actor, critic = (sum(i * o + o for i, o in sizes) for sizes in (shape.actor_layers(), shape.critic_layers()))
    step, follow = 4 + 3, 2 + 1  # arrays read and written by an Adam step, by a target's move
    transition = 2 * shape.observation_size + 2 + 2
    floats = step * critic + (step * actor + follow * (actor + critic)) / policy_delay + batch_size * transition
    return 4.0 * floats


def _step_bytes(setup: Setup) -> int:
    """What a step of one environment reads (scene, pose, action) and writes (pose, both observations, results)."""
    read = 8 * (row_columns() + 3) + 4 * 2
    written = 8 * (3 + 2) + 4 * (2 * setup.observation_size + 10)
    return read + written

"""An update's cost is counted as its matrix products are; shares of the machine are shares."""

from __future__ import annotations

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from desirepath.learning.policies.networks import Parameters, actor_forward, critic_forward
from desirepath.learning.policies.shape import NetworkShape
from desirepath.simulation.setups import OPEN_FIELD
from desirepath_experiments.benchmarks.limits import benchmark_limits, update_flops

N = 16


def test_the_operations_of_an_update_are_those_that_torch_counts() -> None:
    shape = NetworkShape.of(OPEN_FIELD)
    actor, critic = (Parameters(s, trainable=True) for s in (shape.actor_layers(), shape.critic_layers()))
    for parameters in (actor, critic):
        parameters.initialise(torch.Generator().manual_seed(0))
    observations, actions = torch.rand(N, shape.observation_size), torch.rand(N, 2)
    with FlopCounterMode(display=False) as counter:
        with torch.no_grad():
            critic_forward(observations, actor_forward(observations, actor.frozen()), critic.frozen())
        torch.stack(critic_forward(observations, actions, critic.layers)).sum().backward()
    critic_step = counter.get_total_flops()
    with FlopCounterMode(display=False) as counter:
        chosen = actor_forward(observations, actor.layers)
        critic_forward(observations, chosen, critic.frozen(), n_heads=1)[0].sum().backward()
    torchs = critic_step + counter.get_total_flops() / 2
    # Torch also differentiates by the inputs that nobody asks for: a little more than ours.
    assert 0.95 * torchs < update_flops(shape, N) <= torchs


@pytest.fixture(scope="module")
def measured() -> dict[str, object]:
    return benchmark_limits("open_field")


def test_shares_follow_from_the_numbers_beside_them(measured: dict[str, object]) -> None:
    update, simulator = measured["update"], measured["simulator"]
    assert isinstance(update, dict)
    assert isinstance(simulator, dict)
    assert update["gflops"] == pytest.approx(update["gflop"] / update["ms"] * 1e3)
    assert update["share_of_peak"] == pytest.approx(update["gflops"] / measured["matmul_gflops"])
    assert simulator["ns_per_beam"] == pytest.approx(1e9 / simulator["steps_per_s"] / OPEN_FIELD.robot.lidar.beams)
    assert 0 < simulator["share_of_memory"] < 1

"""What drives measure can be followed uphill: the motion in torch is the engine's, and its gradients are true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.policies.steerability import Course
from desirepath.learning.preferences.measures import MEASURES
from desirepath.learning.preferences.objectives import OPPOSITES
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import make_engine
from desirepath.simulation.setups import SetupError, get_setup, preference_setups
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.training.through_simulation.differentiable import Rolled, roll_out
from desirepath_experiments.training.through_simulation.sharpening import drawn_weights, mixed, sharpen
from desirepath_experiments.training.through_simulation.uphill import SHARPENING

PREFERENCE_SETUPS = preference_setups()


def _driven(setup: str, act: object, scenes: list, *, kept: float = 1.0) -> Rolled:
    engine = make_engine(get_setup(setup), len(scenes), auto_reset=False, scenes=scenes)
    return roll_out(engine, act, get_setup(setup).max_steps, cut=1e9, kept=kept)


@pytest.mark.parametrize("setup", PREFERENCE_SETUPS)
def test_what_it_measures_is_what_the_engine_measures(setup: str) -> None:
    scenes = scene_set(setup, 40, purpose=Purpose.ALIGN_SELECT, seed=51)
    policy = replace(load_policy(f"{setup}/base"), recovery_policies=())

    def act(task: torch.Tensor, lidar: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(policy.act(torch.cat([task, lidar], 1).detach().numpy()))

    rolled = _driven(setup, act, scenes)
    truth = Course(scenes).rollout(policy)
    ended = (rolled.outcomes == int(Outcome.SUCCESS)).numpy()
    assert ended.mean() > 0.8
    np.testing.assert_array_equal(ended[truth.success], True)
    for name in ("min_human_distance_m", "passing_side", "min_clearance_m", "speed_near_person_m_s", "time_s"):
        k = MEASURES.index(name)
        assert np.median(np.abs(rolled.measured[:, k].numpy() - truth.measured[:, k])[ended]) < 0.01, name
    k = MEASURES.index("path_length_m")
    way = rolled.measured[:, k] + rolled.progress.sum(0)
    assert way.numpy()[ended] == pytest.approx(truth.measured[ended, k], rel=0.03)


@pytest.mark.parametrize(("measure", "tolerance"), [("min_human_distance_m", 0.1), ("accumulated_angle_rad", 0.1)])
def test_its_gradient_is_what_a_small_change_makes(measure: str, tolerance: float) -> None:
    """A driver that steers by the goal alone, whose gain changes a little: nothing of the lidar is in it."""
    scenes = scene_set("open_field", 120, purpose=Purpose.ALIGN_SELECT, seed=52)
    k = MEASURES.index(measure)

    def measured(aside: torch.Tensor) -> tuple[torch.Tensor, np.ndarray]:
        def act(task: torch.Tensor, lidar: torch.Tensor) -> torch.Tensor:
            turn = torch.tanh(0.8 * task[:, 1] + aside * task[:, 0])
            return torch.stack([torch.full_like(turn, 0.8), turn], 1)

        rolled = _driven("open_field", act, scenes)
        return rolled.measured[:, k], rolled.outcomes.numpy()

    aside = torch.tensor(0.15, requires_grad=True)
    values, outcomes = measured(aside)
    step = 2e-4
    (up, there), (down, here) = measured(torch.tensor(0.15 + step)), measured(torch.tensor(0.15 - step))
    same = (outcomes == int(Outcome.SUCCESS)) & (there == outcomes) & (here == outcomes)
    assert same.sum() >= 8
    (gradient,) = torch.autograd.grad(values[torch.from_numpy(same)].median(), aside)
    middle = values[torch.from_numpy(same)].median()
    row = int((values == middle).nonzero()[0])
    by_change = float(up[row] - down[row]) / (2 * step)
    assert float(gradient) == pytest.approx(by_change, rel=tolerance, abs=0.05)


def test_nobody_imagined_prefers_opposites() -> None:
    config = replace(SHARPENING["study_room"], batch=400)
    weights = drawn_weights(config, np.random.default_rng(1))
    assert not any(((weights[:, a] > 0) & (weights[:, b] > 0)).any() for a, b in OPPOSITES)
    assert set((weights > 0).sum(1)) == {0, 1, 2, 3}
    assert (weights.max(1)[weights.any(1)] == 1).all()


def test_sharpening_keeps_success_and_never_a_worse_mixture() -> None:
    start = load_conditioned("study_room/conditioned")
    base = load_policy("study_room/base")
    config = replace(SHARPENING["study_room"], steps=3, batch=16, most_steps=30, selection_scenes=40, shares=(0.5, 1.0))
    found = sharpen(start, base, config)
    assert found.share in (0.0, 0.5, 1.0)
    assert found.selection["score"] >= found.before["score"]
    assert found.selection["mean_success_rate"] >= found.before["mean_success_rate"] - config.max_loss
    assert not found.policy.critic or found.share == 0.0
    with pytest.raises(SetupError, match="open_field"):
        sharpen(start, base, SHARPENING["open_field"])


def test_a_mixture_of_nothing_is_what_it_began_with() -> None:
    start = load_conditioned("study_room/conditioned")
    other = [layer + 1 for layer in start.actor]
    assert all((one == two).all() for one, two in zip(mixed(start, other, 0.0).actor, start.actor, strict=True))
    assert mixed(start, other, 0.5).actor[0] == pytest.approx(start.actor[0] + 0.5)

"""Following measures uphill: an actor is trained on whole episodes by the gradient of what they measure.

How a rollout is differentiated lives in `differentiable.py`; what is trained so, in `sharpening.py` (one policy for all
preferences) and `experts.py` (one for each). All ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.networks import Parameters, actor_features
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.measures import typical_differences
from desirepath.learning.preferences.objectives import NAMES, OBJECTIVES
from desirepath.simulation.fast import make_engine
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.training.through_simulation.differentiable import Rolled, roll_out

Floats = NDArray[np.float32]
RANGES = {
    "study_room": (1.3, 1.2, 1.1, 1.1, 0.85, 0.4, 0.45, 9.5, 0.25),
    "open_field": (2.6, 0.6, 0.5, 0.5, 1.0, 0.4, 0.11, 10.0, 0.4),
}
"""By setup, of each objective: what planned drives gain over the base policy's, in typical differences (about)."""
LEAK = 0.1  # of a gradient that a saturated action lets through


class _Squashed(torch.autograd.Function):
    """tanh, but what leads back from saturation has at least LEAK of its gradient: a robot at full speed could never
    learn to slow down."""

    @staticmethod
    def forward(context: Any, before: Tensor) -> Tensor:
        actions = torch.tanh(before)
        context.save_for_backward(before, actions)
        return actions

    @staticmethod
    def backward(context: Any, *gradients: Tensor) -> Tensor:
        before, actions = context.saved_tensors
        back = (gradients[0] * before > 0).float() * LEAK
        passed: Tensor = gradients[0] * torch.maximum(1 - actions**2, back)
        return passed


@dataclass(frozen=True)
class SharpeningConfig:
    """How a conditioned policy is sharpened.

    steps: of Adam, each after one batch of episodes. picked: how often each objective is the first of a preference.
    aim: what all that can be gained of a preference is worth. cut, kept: of gradients between control steps. person,
    obstacle: (metres, cost per step and square metre) of coming nearer than that. far_off: cost per metre to the goal
    where time ran out. onwards, late: what progress is worth per metre, at any time, and once `late_after` steps are
    gone. like_before: cost of acting otherwise than the policy one began with, per step, and where an obstacle is near.
    shares: of what was trained, that are tried in the mixture; max_loss: success that it may lose on average.
    """

    setup: str
    seed: int = 0
    steps: int = 220
    batch: int = 256
    most_steps: int = 80
    learning_rate: float = 2.5e-4
    final_learning_rate: float = 3e-5
    average: float = 0.03
    largest_gradient: float = 2.0
    neutral_share: float = 0.05
    one_share: float = 0.63
    two_share: float = 0.22
    picked: tuple[float, ...] = (0.1, 0.12, 0.1, 0.1, 0.16, 0.12, 0.12, 0.09, 0.09)
    aim: float = 2.0
    upkeep: float = 0.05  # of time and turning, half of it of length, whatever is preferred: typical differences
    cut: float = 3.0
    kept: float = 0.97
    person: tuple[float, float] = (0.08, 300.0)
    obstacle: tuple[float, float] = (0.06, 250.0)
    far_off: float = 3.0
    onwards: float = 0.2
    late: float = 1.0
    late_after: int = 30
    like_before: tuple[float, float] = (0.02, 0.2)
    shares: tuple[float, ...] = (0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
    max_loss: float = 0.004
    selection_scenes: int = 500

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


SHARPENING = {
    "study_room": SharpeningConfig("study_room"),
    "open_field": SharpeningConfig("open_field", steps=200, batch=192, most_steps=170, kept=0.98, late_after=80),
}
"""How the shipped ones are sharpened, by setup."""

Draw = Callable[[SharpeningConfig, np.random.Generator], Floats]


class Uphill:
    """Adam on episodes in the training pool's scenes, each with drawn preference weights."""

    def __init__(self, start: ConditionedPolicy | Policy, config: SharpeningConfig, draw: Draw) -> None:
        """draw: (config, random numbers) -> (batch, 9) preference weights, which a policy of one preference does not
        see."""
        self._config, self._draw = config, draw
        self._conditioned = isinstance(start, ConditionedPolicy)
        self._actor = Parameters(start.shape.actor_layers(), trainable=True)
        self._actor.load_arrays(start.actor)
        self._before = Parameters(start.shape.actor_layers(), trainable=False)
        self._before.load_arrays(start.actor)
        self._adam = torch.optim.Adam([self._actor.flat], lr=config.learning_rate)
        self._average = self._actor.flat.detach().clone()
        self._engine = make_engine(get_setup(config.setup), config.batch, seed=900 + config.seed, auto_reset=False)
        self._random = np.random.default_rng([config.seed, 73])
        self._typical = torch.tensor(typical_differences(config.setup), dtype=torch.float32)
        self._ranges = torch.tensor(RANGES[config.setup])

    def step(self, number: int) -> dict[str, float]:
        """One batch of episodes, one step of Adam."""
        config = self._config
        late = max(0.0, 2.5 * number / config.steps - 1) / 1.5
        for group in self._adam.param_groups:
            group["lr"] = config.learning_rate + late * (config.final_learning_rate - config.learning_rate)
        weights = torch.from_numpy(self._draw(config, self._random))
        self._engine.reset()
        rolled = roll_out(
            self._engine,
            lambda task, lidar: self._act(task, lidar, weights),
            config.most_steps,
            cut=config.cut,
            kept=config.kept,
        )
        loss = self._losses(rolled, weights).sum()
        self._actor.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        gradient = self._actor.grad
        assert gradient is not None  # noqa: S101  it is trainable
        gradient.div_(config.batch)
        size = float(gradient.norm())
        if np.isfinite(size):
            gradient.mul_(min(1.0, config.largest_gradient / max(size, 1e-9)))
            self._adam.step()
            self._average.lerp_(self._actor.flat.detach(), config.average)
        arrived = (rolled.outcomes == int(Outcome.SUCCESS)).float().mean()
        return {"loss": float(loss.detach()) / config.batch, "success_rate": float(arrived), "gradient": size}

    def averaged(self) -> list[Floats]:
        """The running average of the actor's arrays."""
        with torch.no_grad():
            self._actor.flat.copy_(self._average)
        return self._actor.to_arrays()

    def _act(self, task: Tensor, lidar: Tensor, weights: Tensor) -> Tensor:
        before_tanh = actor_features(self._seen(task, lidar, weights), self._actor.layers)
        actions: Tensor = _Squashed.apply(before_tanh)  # type: ignore[no-untyped-call]
        return actions

    def _seen(self, task: Tensor, lidar: Tensor, weights: Tensor) -> Tensor:
        return torch.cat([task, weights, lidar] if self._conditioned else [task, lidar], 1)

    def _losses(self, rolled: Rolled, weights: Tensor) -> Tensor:
        """(n,) of each episode: what is preferred where it arrived, and what everybody pays."""
        config, on = self._config, rolled.running
        measured = rolled.measured / self._typical
        signs = torch.tensor([float(one.sign) for one in OBJECTIVES])
        gained = measured[:, [one.measure for one in OBJECTIVES]] * signs
        shares = weights / weights.sum(1, keepdim=True).clamp(min=1e-6)
        scale = config.aim / (shares * self._ranges).sum(1).clamp(min=1e-6)
        neutral = (weights.sum(1) == 0).float()
        upkeep = sum(
            part * measured[:, OBJECTIVES[NAMES.index(name)].measure]
            for name, part in (("faster", 1.0), ("smoother", 1.0), ("shorter", 0.5))
        )
        worth = (shares * gained).sum(1) * scale - config.upkeep * (1 + 3 * neutral) * upkeep
        arrived = (rolled.outcomes == int(Outcome.SUCCESS)).float()
        near = torch.zeros_like(worth)
        for free, (margin, cost) in ((rolled.person, config.person), (rolled.clearance, config.obstacle)):
            near = near + (torch.relu(margin - free) ** 2 * on).sum(0) * cost
        out_of_time = torch.where(rolled.outcomes == int(Outcome.RUNNING), config.far_off * rolled.rest, torch.zeros(1))
        late = (torch.arange(len(on))[:, None] >= config.late_after).float() * (1 - arrived)[None]
        onwards = (config.onwards + config.late * late) * (rolled.progress - rolled.progress.detach())
        return (near + out_of_time - worth * arrived).clamp(max=60) + self._unlike(rolled, weights) - onwards.sum(0)

    def _unlike(self, rolled: Rolled, weights: Tensor) -> Tensor:
        """(n,) what acting otherwise than before costs."""
        usual, near_obstacle = self._config.like_before
        with torch.no_grad():
            before = torch.stack(
                [
                    torch.tanh(actor_features(self._seen(task, lidar, weights), self._before.layers))
                    for task, lidar in rolled.observed
                ]
            )
            cost = torch.where(rolled.clearance < 0.3, near_obstacle, usual) * rolled.running
        unlike: Tensor = (((rolled.actions - before) ** 2).sum(2) * cost).sum(0)
        return unlike

"""A policy with attention, cloned from a planner among pedestrians: small enough to ship, to look at attention.

Chapter 4's learner is `crowd_training.py`; this one learns by imitation, from what the robot senses, what ORCA does,
which is told everybody's motion. Ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from backend.learning.pedestrians.attention_policy import VARIANT, AttentionPolicy
from backend.learning.pedestrians.crowd_evaluation import CrowdPlan
from backend.learning.pedestrians.crowd_networks import VARIANTS, Actor, actor_acts
from backend.learning.pedestrians.crowd_planners import PLANNERS
from backend.learning.pedestrians.crowd_states import SIZES, Given, states
from backend.learning.pedestrians.crowd_training import actor_to_arrays
from backend.simulation.crowds.crowd_engine import CrowdEngine, CrowdPool
from backend.simulation.crowds.crowd_scenes import CrowdConditions
from backend.simulation.crowds.crowd_setups import TRAINED_SETUPS

Floats = NDArray[np.float32]
Tell = Callable[[str], None]


@dataclass(frozen=True)
class CloneConfig:
    """planner: who is imitated. rounds: of collecting; in the first the planner drives, in later ones the clone, and
    the planner says what it would have done (DAgger, Ross et al. 2011). steps: of all environments in a round. updates:
    of the network after each."""

    planner: str = "orca"
    seed: int = 0
    rounds: int = 2
    steps: int = 160
    n_envs: int = 48
    moving: tuple[int, int] = (1, 4)
    updates: int = 900
    batch_size: int = 128
    learning_rate: float = 1e-3

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def clone(config: CloneConfig, tell: Tell = lambda words: None) -> AttentionPolicy:
    """Imitate the planner. Raises KeyError for an unknown one."""
    torch.manual_seed(config.seed)
    torch.set_num_threads(1)
    plan, given = PLANNERS[config.planner], VARIANTS[VARIANT].given
    actor = Actor(VARIANT)
    steps = torch.optim.Adam(actor.parameters(), config.learning_rate)
    rng = np.random.default_rng([config.seed, 4])
    seen, done = np.zeros((0, SIZES[given]), np.float32), np.zeros((0, 2), np.float32)
    for turn in range(config.rounds):
        states_of, actions_of = _collected(config, turn, None if turn == 0 else actor, plan, given)
        seen, done = np.concatenate([seen, states_of]), np.concatenate([done, actions_of])
        for _ in range(config.updates):
            rows = rng.integers(len(seen), size=config.batch_size)
            loss = (actor(torch.as_tensor(seen[rows])) - torch.as_tensor(done[rows])).square().mean()
            steps.zero_grad()
            torch.autograd.backward(loss)
            steps.step()
        tell(f"round {turn + 1} of {config.rounds}: {len(seen)} steps, loss {loss.item():.4f}")
    arrays = {name: value.astype(np.float16) for name, value in actor_to_arrays(actor).items()}
    return AttentionPolicy(TRAINED_SETUPS[0], arrays)


def _collected(
    config: CloneConfig, turn: int, actor: Actor | None, plan: CrowdPlan, given: Given
) -> tuple[Floats, Floats]:
    """(n, states), (n, 2): what was sensed and what the planner would do then. actor: who drives; None: the planner."""
    pool = CrowdPool(TRAINED_SETUPS, config.seed * 1_000 + turn, CrowdConditions(moving=config.moving))
    engine = CrowdEngine(n_envs=config.n_envs, pool=pool)
    act = actor_acts(actor) if actor is not None else None
    seen, done = [], []
    for _ in range(config.steps):
        state, planned = states(engine, given), plan(engine)
        seen.append(state)
        done.append(planned)
        engine.step(act(state) if act is not None else planned)
        if engine.dones.any():
            engine.restart()
    return np.concatenate(seen), np.concatenate(done)

"""DDPG as published (section 4.4.2) and our TD3 beside it, for every network of chapter 4, with its curriculum.

DDPG: y = r + gamma Q'(s', pi'(s')); L = (y - Q(s, a))^2; the actor climbs Q(s, pi(s)). TD3 (Fujimoto et al. 2018):
the lower of two critics, noise on the target's action, an actor updated every second time. Networks: `crowd_networks`.
"""

from __future__ import annotations

import copy
import io
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from desirepath.learning.pedestrians.crowd_evaluation import CrowdTable, evaluate_crowds, selection_scenes
from desirepath.learning.pedestrians.crowd_networks import VARIANTS, Actor, Critic
from desirepath.learning.pedestrians.crowd_states import SIZES, Given, states
from desirepath.simulation.crowds.crowd_engine import CrowdEngine
from desirepath.simulation.crowds.crowd_scenes import draw_crowd_scene
from desirepath.simulation.crowds.crowd_setups import CURRICULUM, CURRICULUM_SUCCESS, TRAINED_SETUPS
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath.simulation.scene import Scene
from desirepath_experiments.training.pedestrians.crowd_planners import follow

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class CrowdTrainingConfig:
    """Settings of one training. Thesis: gamma, learning_rate, buffer_size, curriculum; all others ours.

    progress: reward per metre along the path, as in the other chapters' training (`td3/base.py`). Without, equation 4.1
    pays a standing robot per step as much as one that moves on (its guidance point stays 0.6 m ahead), and the goal is
    too far away for a short training to see. along_path: of the first environments, whose random actions are noise
    around following the path: some of them arrive. exploration: std of the action noise, from the first environment to
    the last.
    """

    variant: str = "ours"
    learner: Literal["ddpg", "td3"] = "td3"
    seed: int = 0
    updates: int = 60_000
    gamma: float = 0.98
    learning_rate: float = 1e-4
    buffer_size: int = 2_000_000
    batch_size: int = 128
    tau: float = 0.01
    n_envs: int = 32
    updates_per_step: int = 8  # of all environments: one update per four transitions
    random_transitions: int = 5_000
    exploration: tuple[float, float] = (0.05, 0.5)
    along_path: float = 0.5
    target_noise: float = 0.2
    target_clip: float = 0.5
    icp: bool = True
    evaluate_every: int = 2_000
    evaluation_episodes: int = 100
    device: str = "cpu"
    progress: float = 0.0

    @property
    def transitions(self) -> int:
        """Of a training that is not interrupted."""
        return self.random_transitions + (self.updates // self.updates_per_step + 2) * self.n_envs

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


class StateMemory:
    """Transitions in a ring, states in half precision: 2e6 of 490 numbers are 3.9 GB, half of it for what follows."""

    def __init__(self, size: int, width: int) -> None:
        self.size, self.count, self._next = size, 0, 0
        self.states, self.after = np.zeros((2, size, width), np.float16)
        self.actions = np.zeros((size, 2), np.float32)
        self.rewards, self.ended = np.zeros((2, size), np.float32)

    def add(self, state: Floats, action: Floats, reward: Floats, after: Floats, ended: NDArray[np.bool_]) -> None:
        where = (self._next + np.arange(len(state))) % self.size
        self.states[where], self.actions[where], self.rewards[where] = state, action, reward
        self.after[where], self.ended[where] = after, ended
        self._next = int((self._next + len(state)) % self.size)
        self.count = min(self.count + len(state), self.size)

    def sample(self, rng: np.random.Generator, batch: int, device: str) -> tuple[Tensor, ...]:
        rows = rng.integers(self.count, size=batch)
        parts = (self.states[rows], self.actions[rows], self.rewards[rows], self.after[rows], self.ended[rows])
        return tuple(torch.as_tensor(part, device=device).float() for part in parts)


class CrowdLearner:
    """Actor and critics with their slow copies; one `update` per call."""

    def __init__(self, config: CrowdTrainingConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.actor = Actor(config.variant).to(config.device)
        critics = 1 if config.learner == "ddpg" else 2
        self.critics = torch.nn.ModuleList([Critic(config.variant) for _ in range(critics)]).to(config.device)
        self.slow_actor, self.slow_critics = copy.deepcopy(self.actor), copy.deepcopy(self.critics)
        self.actor_steps = torch.optim.Adam(self.actor.parameters(), config.learning_rate)
        self.critic_steps = torch.optim.Adam(self.critics.parameters(), config.learning_rate)
        self.updates = 0

    def update(self, batch: tuple[Tensor, ...]) -> None:
        """One step of the critics; of the actor and the slow copies too, with TD3 every second time."""
        state, action, reward, after, ended = batch
        c = self.config
        with torch.no_grad():
            next_action = self.slow_actor(after)
            if c.learner == "td3":
                noise = (torch.randn_like(next_action) * c.target_noise).clamp(-c.target_clip, c.target_clip)
                next_action = (next_action + noise).clamp(-1, 1)
            values = torch.stack([critic(after, next_action) for critic in self.slow_critics])
            target = reward + c.gamma * (1 - ended) * values.min(dim=0).values
        loss = torch.stack([(critic(state, action) - target).square().mean() for critic in self.critics]).sum()
        self.critic_steps.zero_grad()
        torch.autograd.backward(loss)
        self.critic_steps.step()
        self.updates += 1
        if c.learner == "td3" and self.updates % 2:
            return
        climbed = -self.critics[0](state, self.actor(state)).mean()
        self.actor_steps.zero_grad()
        torch.autograd.backward(climbed)
        self.actor_steps.step()
        with torch.no_grad():
            for fast, slow in ((self.actor, self.slow_actor), (self.critics, self.slow_critics)):
                for new, old in zip(fast.parameters(), slow.parameters(), strict=True):
                    old.lerp_(new, c.tau)

    def act(self, states_seen: Floats) -> Floats:
        with torch.no_grad():
            actions: Floats = self.actor(torch.as_tensor(states_seen, device=self.config.device)).cpu().numpy()
        return actions

    def parts(self) -> dict[str, Any]:
        return {
            "actor": self.actor, "critics": self.critics, "slow_actor": self.slow_actor,
            "slow_critics": self.slow_critics, "actor_steps": self.actor_steps, "critic_steps": self.critic_steps,
        }  # fmt: skip


@dataclass
class CrowdTrained:
    """actor: the best on the selection scenes of the highest level reached. history: a row per evaluation. state: to go
    on from."""

    actor: Actor
    history: list[dict[str, Any]]
    level: int
    transitions: int
    state: bytes


def ended_for_good(outcomes: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Whose value ends: reaching the goal and colliding do; running out of steps says nothing of the state."""
    return np.isin(outcomes, (1, 2))


def train_crowd(
    config: CrowdTrainingConfig,
    *,
    until: int | None = None,
    state: bytes | None = None,
) -> CrowdTrained:
    """Train one network. The pedestrians' number rises (2, 4, 8) once success on the selection scenes passes 70 %.

    until: stop after so many updates in all; state: what an earlier part of this training ended with, from which it
    goes on, with an empty memory that is filled anew before the next update. Raises KeyError for an unknown variant.
    """
    given: Given = VARIANTS[config.variant].given
    learner = CrowdLearner(config)
    torch.set_num_threads(1)
    record: dict[str, Any] = {"level": 0, "history": [], "best": None, "best_success": -1.0}
    record |= {"transitions": 0, "seconds": 0.0}
    if state is not None:
        record = _load(state, learner)
    last = config.updates if until is None else min(until, config.updates)
    rng = np.random.default_rng([config.seed, learner.updates])
    torch.manual_seed(config.seed * 1_000_003 + learner.updates)
    memory = StateMemory(min(config.buffer_size, config.transitions), SIZES[given])
    began = time.perf_counter() - record["seconds"]
    engine = _engine(config, record["level"], learner.updates)
    seen = states(engine, given)
    noise = np.geomspace(*config.exploration, config.n_envs)[:, None]
    while learner.updates < last:
        filling = memory.count < config.random_transitions
        if filling and learner.updates == 0:
            action = _first_actions(config, engine, rng)
        else:
            noisy = learner.act(seen) + noise * rng.normal(0, 1, (config.n_envs, 2))
            action = np.clip(noisy, -1, 1).astype(np.float32)
        left = engine.path_left_m()
        engine.step(action)
        after, ended = states(engine, given), ended_for_good(engine.outcomes)
        shaped = config.progress * (left - engine.path_left_m())
        memory.add(seen, action, (engine.rewards + shaped).astype(np.float32), after, ended)
        record["transitions"] += config.n_envs
        seen = after
        if engine.dones.any():
            engine.restart()
            seen = states(engine, given)
        if filling:
            continue
        before = learner.updates
        for _ in range(config.updates_per_step):
            learner.update(memory.sample(rng, config.batch_size, config.device))
        done = learner.updates >= last
        if done or learner.updates // config.evaluate_every > before // config.evaluate_every:
            level = record["level"]
            _evaluate(config, learner, record, time.perf_counter() - began)
            if record["level"] > level:
                engine = _engine(config, record["level"], learner.updates)
                seen = states(engine, given)
    stopped = _state(learner, record)
    if record["best"] is not None:
        learner.actor.load_state_dict(record["best"])
    return CrowdTrained(learner.actor.cpu(), record["history"], record["level"], record["transitions"], stopped)


def _first_actions(config: CrowdTrainingConfig, engine: CrowdEngine, rng: np.random.Generator) -> Floats:
    """(n, 2) before anything is learned: uniform, or noise around the path's direction."""
    action = rng.uniform(-1, 1, (config.n_envs, 2))
    along = round(config.along_path * config.n_envs)
    action[:along] = follow(engine)[:along] + rng.normal(0, 0.4, (along, 2))
    return np.clip(action, -1, 1).astype(np.float32)


def _engine(config: CrowdTrainingConfig, level: int, updates: int) -> CrowdEngine:
    conditions = CrowdConditions(moving=(1, CURRICULUM[level]))
    pool = CrowdPool(TRAINED_SETUPS, config.seed * 1_000 + updates % 997, conditions)
    return CrowdEngine(n_envs=config.n_envs, pool=pool, icp=config.icp)


def _evaluate(config: CrowdTrainingConfig, learner: CrowdLearner, record: dict[str, Any], seconds: float) -> None:
    """Judge on the level's selection scenes, keep the best of the highest level, raise the level."""
    scenes = selection_scenes(config.evaluation_episodes, CURRICULUM[record["level"]], config.seed)
    table: CrowdTable = evaluate_crowds(learner.act, VARIANTS[config.variant].given, scenes, icp=config.icp)
    row = {"updates": learner.updates, "pedestrians": CURRICULUM[record["level"]], **table.rates(), "seconds": seconds}
    record["history"].append(row)
    record["seconds"] = seconds
    success = row["success"] / 100
    if success >= record["best_success"]:
        record["best"] = {name: value.cpu().clone() for name, value in learner.actor.state_dict().items()}
        record["best_success"] = success
    if success > CURRICULUM_SUCCESS and record["level"] + 1 < len(CURRICULUM):
        record["level"] += 1
        record["best_success"] = -1.0


def _state(learner: CrowdLearner, record: dict[str, Any]) -> bytes:
    whole = {name: part.state_dict() for name, part in learner.parts().items()}
    file = io.BytesIO()
    torch.save({"parts": whole, "updates": learner.updates, "kept": record}, file)
    return file.getvalue()


def _load(state: bytes, learner: CrowdLearner) -> dict[str, Any]:
    stored = torch.load(io.BytesIO(state), weights_only=True)
    for name, part in learner.parts().items():
        part.load_state_dict(stored["parts"][name])
    learner.updates = stored["updates"]
    record: dict[str, Any] = stored["kept"]
    return record


class CrowdPool:
    """Training scenes of some setups in turn, drawn when needed; once full, any of them at random.

    Their seeds lie above 2^32, so no evaluation scene is among them.
    """

    def __init__(self, setups: Sequence[str], seed: int, conditions: CrowdConditions, size: int = 2_048) -> None:
        self._random = np.random.Generator(np.random.PCG64([seed, 0x9004, *conditions.moving]))
        self._setups, self._conditions, self._size = tuple(setups), conditions, size
        self._scenes: list[Scene] = []

    def take(self) -> Scene:
        if len(self._scenes) == self._size:
            return self._scenes[int(self._random.integers(self._size))]
        setup = self._setups[len(self._scenes) % len(self._setups)]
        scene = draw_crowd_scene(setup, int(self._random.integers(2**32, 2**53 - 1)), self._conditions)
        self._scenes.append(scene)
        return scene

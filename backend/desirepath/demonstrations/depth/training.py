"""TD3+BC on latents (section 3.3.1, table 3.1): the same loss as chapter 2's, `td3_bc/loss.py`, on another state.

With c = 10: a collision costs c/2, the goal earns c in demonstrations and c/2 in exploration, every demonstrated state
earns c/100, running out of time costs c/4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from desirepath.demonstrations.demonstration import Demonstration, augment
from desirepath.demonstrations.depth.depth_controller import DepthController
from desirepath.demonstrations.depth.episodes import EpisodePool, Episodes, people_of
from desirepath.demonstrations.depth.states import DepthConfiguration, Floats, Senses, goals_of
from desirepath.demonstrations.td3_bc.loss import Balance, update
from desirepath.demonstrations.td3_bc.returns import ReturnsBuffer, returns_along
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.shape import FAST_HEADS
from desirepath.learning.td3.td3 import Batch, Td3Agent, Td3Config
from desirepath.perception.beta_vae import DepthEncoder
from desirepath.perception.predictor import PersonPredictor
from desirepath.simulation.depth_camera import CameraNoise, Sights
from desirepath.simulation.fast import make_engine
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.trajectory import Trajectory

HOME = get_setup("home")

DEPARTURES = [
    "Many environments at once in a fast kinematic engine, far fewer updates, larger learning rate of the actor.",
    "Rewards of six steps at once (n-step returns), as chapter 2's controllers here.",
    "+0.5 per metre towards the goal while exploring: with so few interactions sparse rewards alone teach nothing.",
    "State, goal and latent are read by two small extractors, then two layers.",
    "Homes are drawn by rules (no iGibson), people and demonstrators are programmed, their paths Dijkstra's.",
]


@dataclass(frozen=True)
class DepthTrainingConfig:
    """Sources: table 3.1 and section 3.3.4, where not marked ours."""

    seed: int = 0
    heads: tuple[int, ...] = FAST_HEADS  # ours
    updates: int = 12_000  # ours
    n_envs: int = 64  # ours; the thesis has one
    updates_per_step: int = 8  # ours
    random_transitions: int = 5_000
    buffer_size: int = 200_000
    batch_each: int = 64
    exploration: tuple[float, float] = (0.05, 0.4)  # ours: spread over the environments around the thesis's 0.2
    target_noise: float = 0.05
    goal_boost: float = 5.0  # c in demonstrations, c/2 beside
    state_boost: float = 0.1  # c/100
    rl_weight: float = 30 / 4
    bc_weight: float = 10 / 4
    actor_learning_rate: float = 5e-4  # ours; the thesis has 1e-4
    final_learning_rate: float = 5e-5  # ours: linearly from half of the updates on, as chapter 2's controllers here
    critic_learning_rate: float = 8e-4
    progress_weight: float = 0.5  # per metre, ours
    steps_at_once: int = 6  # ours
    augmentation: int = 5
    demonstrated_share: float = 0.3  # of episodes in demonstrated scenes, ours

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


MODE_SHARES = {"opposite": 0.4, "random": 0.2, "static": 0.25, "absent": 0.15}
"""Of the explored homes' episodes, ours: most where most is to be learned. The thesis does not say."""
MakeSenses = Callable[[Sights, bool], Senses]
"""(what stands where, whether it is judged) -> senses of one configuration."""


def senses_of(
    configuration: DepthConfiguration, encoder: DepthEncoder, predictor: PersonPredictor | None, seed: int = 0
) -> MakeSenses:
    """How robots of that configuration see, with a real camera's noise."""

    def make(sights: Sights, evaluating: bool) -> Senses:
        return Senses(configuration, encoder, predictor, sights, seed=seed, noise=CameraNoise(), evaluating=evaluating)

    return make


def batch_demonstrations(
    demonstrations: Sequence[Demonstration], make: MakeSenses, config: DepthTrainingConfig
) -> Batch:
    """The demonstration buffer: the depth states along every augmented rollout, rewarded as above."""
    rollouts = [rollout for d in demonstrations for rollout in augment(d, config.augmentation)]
    parts = []
    for trajectory, seen in zip(rollouts, _states_along(rollouts, make), strict=True):
        boosted = trajectory.rewards + config.state_boost + np.where(trajectory.dones, config.goal_boost, 0.0)
        seen_rollout = replace(trajectory, observations=seen[:-1], next_observations=seen[1:])
        led_to = returns_along(seen_rollout, boosted, config.steps_at_once, HOME.gamma)
        parts.append((seen[:-1], trajectory.actions, *led_to))
    observations, actions, rewards, following, continues = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Batch(*map(torch.from_numpy, (observations, actions, rewards, following, continues)))


def _states_along(rollouts: Sequence[Trajectory], make: MakeSenses) -> list[Floats]:
    """Of every rollout (its poses, size): all of them side by side, step by step; who has arrived waits there."""
    scenes = [rollout.scene for rollout in rollouts]
    senses, n = make(Sights(scenes), False), len(rollouts)
    lengths = np.array([len(rollout.poses) for rollout in rollouts])
    times = np.arange(lengths.max()) * CONTROL_DT_S
    people = np.stack([scene.person_poses(times) for scene in scenes])
    heights = np.array([[scene.person.height] for scene in scenes])
    goals = np.array([[scene.goal.x, scene.goal.y] for scene in scenes])
    states: list[Floats] = []
    for t in range(len(times)):
        at = np.minimum(t, lengths - 1)
        poses = np.stack([rollout.poses[i].astype(np.float64) for rollout, i in zip(rollouts, at, strict=True)])
        where = np.concatenate([people[np.arange(n), at], heights], axis=1)
        states.append(senses.states(poses, goals, where, np.arange(n), np.full(n, t == 0)))
        actions = [rollout.actions[min(i, len(rollout.actions) - 1)] for rollout, i in zip(rollouts, at, strict=True)]
        senses.acted(np.stack(actions))
    whole = np.stack(states, axis=1)
    return [whole[i, :length] for i, length in enumerate(lengths)]


def train_depth_controller(
    configuration: DepthConfiguration,
    make: MakeSenses,
    homes: Episodes,
    demonstrations: Sequence[Demonstration],
    config: DepthTrainingConfig,
    on_progress: Callable[[float], None] = lambda done: None,
) -> DepthController:
    """Train one configuration. homes: what is explored beside the demonstrated scenes. Raises ValueError for none."""
    if configuration.demonstrations and not demonstrations:
        raise ValueError(f"demonstrations: none given; configuration {configuration.name} needs one at least")
    use_one_thread()
    shown = Episodes(tuple(d.scene for d in demonstrations), ("replayed",) * len(demonstrations))
    episodes = Episodes(homes.scenes + shown.scenes, homes.modes + shown.modes)
    share = config.demonstrated_share if len(shown) else 0.0
    of_homes = np.array([MODE_SHARES[mode] / homes.modes.count(mode) for mode in homes.modes])
    weights = np.concatenate([(1 - share) * of_homes / of_homes.sum(), np.full(len(shown), share / max(1, len(shown)))])
    engine = make_engine(
        HOME,
        config.n_envs,
        seed=config.seed,
        pool=EpisodePool(episodes, config.seed, weights, varied=True),
        progress_weight=config.progress_weight,
    )
    td3 = Td3Config(
        gamma=HOME.gamma,
        batch_size=2 * config.batch_each,
        learning_rate=config.actor_learning_rate,
        tau=0.05,
        target_noise=config.target_noise,
    )
    shape = configuration.shape(config.heads)
    agent = Td3Agent(shape, td3, seed=config.seed)
    demonstrated = batch_demonstrations(demonstrations, make, config) if configuration.demonstrations else None
    buffer = ReturnsBuffer(
        config.buffer_size, shape.observation_size, n_envs=config.n_envs, steps=config.steps_at_once, gamma=HOME.gamma
    )
    random = np.random.default_rng([config.seed, 0xDE97])
    sampler = torch.Generator().manual_seed(config.seed + 1)
    noise = np.geomspace(*config.exploration, config.n_envs)[:, None]
    balance = Balance(config.rl_weight, config.bc_weight)
    average = agent.actor.flat.clone()
    senses = make(episodes.sights(), False)

    def look(begins: np.ndarray) -> Floats:
        return senses.states(engine.poses, goals_of(engine.rows), people_of(engine.rows), engine.seeds, begins)

    states, transitions = look(np.ones(config.n_envs, dtype=bool)), 0
    while agent.updates < config.updates:
        warm = transitions >= config.random_transitions
        if warm:
            wanted = np.clip(agent.act(states) + random.normal(size=(config.n_envs, 2)) * noise, -1, 1)
        else:
            wanted = random.uniform(-1, 1, (config.n_envs, 2))
        actions: Floats = wanted.astype(np.float32)
        senses.acted(actions)
        engine.step(actions)
        # After a step that ended an episode this is the next one's beginning: nothing is learned from it there.
        following = look(engine.dones)
        buffer.add(states, actions, engine.rewards, following, engine.dones)
        states, transitions = following, transitions + config.n_envs
        falling = max(0.0, 2 * agent.updates / config.updates - 1)
        rate = config.actor_learning_rate + falling * (config.final_learning_rate - config.actor_learning_rate)
        agent.set_learning_rate(rate, critic=config.critic_learning_rate)
        for _ in range(config.updates_per_step if warm else 0):
            if demonstrated is None:
                agent.update(buffer.sample(2 * config.batch_each, sampler))
            else:
                rows = torch.randint(len(demonstrated.rewards), (config.batch_each,), generator=sampler)
                chosen = Batch(*(part.index_select(0, rows) for part in demonstrated))
                update(agent, buffer.sample(config.batch_each, sampler), chosen, balance)
            average.lerp_(agent.actor.flat, 1e-3)
        on_progress(agent.updates / config.updates)
    agent.actor.flat.copy_(average)
    return DepthController(configuration, shape, tuple(agent.actor.to_arrays()))

"""EnQuery's ensemble: four policies from one base policy, pushed apart by the goal-modulated diversity term.

Thesis 6.4.1. What the ensemble is for (queries) lives in `queries.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from desirepath.analysis.metrics import action_diversity, success_rate
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.networks import Parameters, use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shape import ACTION_SIZE
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.backprop import Floats, Weights, move_towards
from desirepath.learning.td3.base import OnProgress, no_progress, policy_of
from desirepath.learning.td3.checkpoints import checkpoints
from desirepath.learning.td3.replay import ReplayBuffer, ReplayCollector, collect
from desirepath.learning.td3.td3 import CRITIC_ALONE, Td3Agent, Td3Config, act, held_to
from desirepath.simulation.fast import evaluate, make_engine
from desirepath.simulation.setups import get_setup, require_same

HELD_LOOSELY = 0.1  # at most, to a base policy that is held: as much as that one is, members hardly differ; ours

OnMembers = Callable[[int, list[Policy]], None]
"""(steps done, the members as they are then, without critics)."""


def keep_no_members(steps: int, members: list[Policy]) -> None:
    """The callback of who only wants the end."""


@dataclass(frozen=True)
class PolicyEnsembleConfig:
    """How an ensemble is trained. Sources: table 6.1 unless marked ours."""

    seed: int = 0
    members: int = 4
    kappa: float = 0.0625
    steps: int = 25_000  # interactions and updates of each member
    n_envs: int = 25  # ours: environments of one member, stepped together; then 25 updates, the others held
    gamma: float | None = None  # the setup's
    learning_rate: float = 3e-4  # ours
    tau: float = 0.005  # SB3's default
    batch_size: int = 128  # ours
    exploration: tuple[float, float] = (0.05, 0.3)  # ours
    base_transitions: int = 200_000  # ours: of the regenerated base buffer that each member starts with
    average_decay: float = 0.999  # ours: running average of each actor's weights, per update; candidates are averages
    checkpoints: int = 12  # ours: candidates per member, spread over the training: diversity may cost success later
    selection_scenes: int = 500  # ours: in which the candidates' success is measured
    min_success: float = 0.93  # ours: of a candidate in the selection scenes, while a member has one that reaches it

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class EnsembleResult:
    """The chosen members, the steps each was taken at, their success rates (selection scenes: optimistic), and the

    ensemble's mean action diversity.
    """

    members: list[Policy]
    steps: list[int]
    success_rates: list[float]
    diversity: float
    base_buffer_sha256: str


def goal_modulation(goal_distance_m: Floats) -> Floats:
    """alpha(d_g) = d_g / 8 + 1/4: far from the goal members may differ, near it they all should arrive."""
    return goal_distance_m / np.float32(8) + np.float32(0.25)


def diversity_gradient(actions: Floats, others: Sequence[Floats], goal_distance_m: Floats, kappa: float) -> Floats:
    """The gradient (n, 2), at the actions of member i, of equation 6.2's batch mean.

    L_i = -(kappa / |A|^2) alpha(d_g) sum_{j != i} ||a_i - a_j||^2. actions: (n, 2) of member i. others: (n, 2) each, of
    the other members, constants for member i. goal_distance_m: (n,).
    """
    apart = len(others) * actions - np.sum(others, axis=0)
    scale = -2 * kappa / ACTION_SIZE**2 / len(actions)
    gradient: Floats = np.float32(scale) * goal_modulation(goal_distance_m)[:, None] * apart
    return gradient


def agent_of(policy: Policy, config: Td3Config, *, seed: int, updates: int) -> Td3Agent:
    """A learner that goes on from a policy's actor and critic, by so many updates. Raises LearningError if the policy
    has no critic."""
    if not policy.critic:
        raise LearningError("policy has no critic: training goes on only from a file that was saved with one")
    agent = Td3Agent(policy.shape, config, seed=seed)
    agent.actor.load_arrays(policy.actor)
    agent.critic.load_arrays(policy.critic)
    agent.synchronise_targets()
    before_first = updates // 13  # the actor has moved at the first of twelve checkpoints
    agent.actor_waits = min(CRITIC_ALONE, before_first) if policy.held else 0
    return agent


class _Member:
    """A member while it learns, with environments, a buffer and random streams of its own.

    average: running average of its actor's weights. shown: the actor that the others see, held while they learn.
    """

    def __init__(self, k: int, base: Policy, start: ReplayBuffer, config: PolicyEnsembleConfig) -> None:
        setup = get_setup(base.setup)
        td3 = Td3Config(
            gamma=config.gamma or setup.gamma,
            batch_size=config.batch_size,
            learning_rate=config.learning_rate,
            tau=config.tau,
        )
        seed = config.seed * 1000 + k
        self.config = config
        self.agent = agent_of(base, td3, seed=seed, updates=config.steps)
        self.average = self.agent.actor.flat.clone()
        self.shown = Parameters(base.shape.actor_layers(), trainable=False)
        self._buffer = ReplayBuffer(start.size + config.steps, setup.observation_size)
        self._buffer.add_batch(start.filled())
        engine = make_engine(setup, config.n_envs, seed=seed + 100)
        self._collector = ReplayCollector(engine, noise=config.exploration, seed=seed + 100)
        self._sampler = torch.Generator().manual_seed(seed + 200)
        self._distance_scale_m = np.float32(setup.distance_scale_m)
        self._hold = held_to(base.actor, base.shape, min(base.held, HELD_LOOSELY))

    def interact(self) -> None:
        """One step of its environments; from now on the others see its actor as it is now."""
        self._collector.step(self.agent.act, self._buffer)
        self.shown.flat.copy_(self.agent.actor.flat)

    def learn(self, others: Sequence[Weights]) -> None:
        """As many updates as there are environments. Touches nothing that belongs to the other members."""

        def term(observations: Floats, actions: Floats) -> Floats:
            goal_distance_m = observations[:, 0] * self._distance_scale_m
            gradient = diversity_gradient(
                actions, [act(observations, other) for other in others], goal_distance_m, self.config.kappa
            )
            return gradient if self._hold is None else gradient + self._hold(observations, actions)

        share = np.float32(1 - self.config.average_decay)
        for _ in range(self.config.n_envs):
            self.agent.update(self._buffer.sample(self.config.batch_size, self._sampler), term)
            move_towards(self.average.numpy(), self.agent.actor.flat.numpy(), share)


def train_ensemble(
    base: Policy,
    config: PolicyEnsembleConfig | None = None,
    on_progress: OnProgress = no_progress,
    *,
    marks: Sequence[int] = (),
    on_members: OnMembers = keep_no_members,
    threads: int = 2,
) -> EnsembleResult:
    """Train all members side by side on the core reward, each on its own environments and buffer, then choose.

    Members oscillate: of each, the averaged weights at several checkpoints are candidates, and the candidates with
    enough success that together differ most are kept (`choose_candidates`).
    marks: numbers of steps (multiples of `n_envs`) at which `on_members` is given the members as they are then, neither
    averaged nor chosen. threads: how many members learn at the same time; the result is the same for any number.
    """
    config = config or PolicyEnsembleConfig()
    if config.members < 2:
        raise LearningError(f"members = {config.members}: diversity needs at least 2")
    use_one_thread()
    setup = get_setup(require_same(base=base.setup))
    start = collect(base, config.base_transitions, noise=config.exploration, seed=config.seed)
    members = [_Member(k, base, start, config) for k in range(config.members)]
    others = [[other.shown.weights for other in members if other is not member] for member in members]
    candidates: list[list[Policy]] = []
    taken_at: list[int] = []
    done = 0

    def step() -> int:
        nonlocal done
        for member in members:
            member.interact()
        for _ in pool.map(_Member.learn, members, others):
            pass  # waits for all; what fails in one is raised here
        done += config.n_envs
        if done % (40 * config.n_envs) == 0:
            on_progress(min(1.0, done / config.steps), {"steps": done})
        if done in marks:
            on_members(done, [policy_of(m.agent, setup.name).without_critic() for m in members])
        return done

    # A candidate is taken after whole steps of the environments, at most one after each.
    each = config.checkpoints * config.n_envs
    taken = sorted({-(-config.steps * (k + 1) // each) * config.n_envs for k in range(config.checkpoints)})
    with ThreadPoolExecutor(threads) as pool:
        for steps in checkpoints(step, taken, lambda _: None):
            taken_at.append(steps)
            candidates.append([policy_of(m.agent, setup.name, m.average).without_critic() for m in members])
    scenes = scene_set(setup.name, config.selection_scenes, purpose=Purpose.SELECT, seed=config.seed)
    success = np.array([[success_rate(evaluate(c.act, setup, scenes).outcome) for c in row] for row in candidates])
    sampler = torch.Generator().manual_seed(config.seed)
    states = start.sample(1_000, sampler).observations.numpy()  # thesis 6.5.1.1: 1,000 states from the replay buffer
    actions = np.stack([np.stack([c.act(states) for c in row]) for row in candidates])
    chosen = choose_candidates(success, actions, config.min_success)
    return EnsembleResult(
        [candidates[row][k] for k, row in enumerate(chosen)],
        [taken_at[row] for row in chosen],
        [float(success[row, k]) for k, row in enumerate(chosen)],
        action_diversity([actions[row, k] for k, row in enumerate(chosen)]),
        start.digest(),
    )


def choose_candidates(success: NDArray[np.float64], actions: Floats, min_success: float) -> list[int]:
    """For each member the checkpoint to keep: with enough success, and together as diverse as can be found.

    success: (checkpoints, members). actions: (checkpoints, members, states, 2), what each candidate would do in the
    same states. A member none of whose candidates succeeds often enough keeps its most successful one. Members are
    improved in turn until none can be: a good choice, not provably the best of all checkpoints ** members.
    """
    n_checkpoints, n_members = success.shape
    flat = actions.reshape(n_checkpoints * n_members, -1).astype(np.float64)
    squares = (flat**2).sum(1)
    apart = (squares[:, None] + squares[None] - 2 * flat @ flat.T).reshape(*success.shape, *success.shape)
    allowed = [np.flatnonzero(success[:, k] >= min_success) for k in range(n_members)]
    allowed = [rows if len(rows) else np.array([success[:, k].argmax()]) for k, rows in enumerate(allowed)]
    chosen = [int(rows[-1]) for rows in allowed]
    changed = True
    while changed:
        changed = False
        for k in range(n_members):
            others = [j for j in range(n_members) if j != k]
            gain = sum(apart[allowed[k], k, chosen[j], j] for j in others)
            best = int(allowed[k][np.argmax(gain)])
            current = sum(apart[chosen[k], k, chosen[j], j] for j in others)
            if np.max(gain) > current + 1e-9:
                chosen[k], changed = best, True
    return chosen

"""MO-TD3 written out by hand: gradients are torch's, targets the equation, the interpolator is exact at its nodes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from desirepath.learning.adaptable.objectives import (
    KEY_PREFERENCES,
    NAMES,
    part_of,
    sample_preferences,
    sample_preferences_in,
    scalarise,
    thesis_vectors,
)
from desirepath_experiments.training.adaptable import vector_td3
from desirepath_experiments.training.adaptable.vector_td3 import (
    Imitated,
    Interpolator,
    VectorBatch,
    VectorReplayBuffer,
    VectorTd3Agent,
    VectorTd3Config,
    inputs_of,
    relabel,
    twins,
    unit,
    vector_actor_gradients,
    vector_critic_gradients,
    vector_targets,
    with_core,
    without_solutions,
)

N, OBSERVED, SPLIT, HEADS = 20, 9, 4, (16, 16)
SOLUTIONS = np.array([[-0.1, -0.9, -0.4], [-0.5, -0.1, -0.6], [-0.4, -0.6, -0.2]], dtype=np.float32)
INTERPOLATOR = Interpolator(SOLUTIONS)


@pytest.fixture(scope="module")
def agent() -> VectorTd3Agent:
    return VectorTd3Agent(OBSERVED, SPLIT, HEADS, VectorTd3Config(gamma=0.9), seed=1)


def random_batch(n: int = N) -> VectorBatch:
    random = np.random.default_rng(4)
    floats = lambda *shape: random.uniform(-1, 1, shape).astype(np.float32)  # noqa: E731
    observations = floats(n, OBSERVED)
    observations[:, 0] = np.abs(observations[:, 0])
    return VectorBatch(
        observations, floats(n, 2), floats(n, 4), floats(n, OBSERVED), (random.random(n) > 0.3).astype(np.float32),
        sample_preferences(n, random),
    )  # fmt: skip


def torch_head(x: Tensor, layers: list[tuple[Tensor, Tensor]]) -> Tensor:
    for weight, bias in layers[:-1]:
        x = torch.relu(x @ weight + bias)
    return x @ layers[-1][0] + layers[-1][1]


def torch_layers(arrays: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[Tensor, Tensor]]:
    return [tuple(torch.tensor(part, requires_grad=True) for part in layer) for layer in arrays]  # type: ignore[misc]


def assert_equal_gradients(ours: list[tuple[np.ndarray, np.ndarray]], theirs: list[tuple[Tensor, Tensor]]) -> None:
    for mine, other in zip(ours, theirs, strict=True):
        for a, b in zip(mine, other, strict=True):
            np.testing.assert_allclose(a, b.grad.numpy(), atol=2e-5)


def test_the_gradient_of_the_vector_critic_is_torchs(agent: VectorTd3Agent) -> None:
    batch = random_batch()
    inputs, targets = inputs_of(batch.observations, batch.preferences, SPLIT), batch.rewards
    loss = vector_critic_gradients(inputs, batch.actions, targets, agent.critic.weights, agent.critic.gradients)
    layers = torch_layers(agent.critic.weights)
    joined = torch.tensor(np.concatenate([inputs, batch.actions], axis=1))
    both = [torch_head(joined, part) for part in (layers[: len(layers) // 2], layers[len(layers) // 2 :])]
    theirs = sum(((q - torch.tensor(targets)) ** 2).sum(1).mean() for q in both)
    theirs.backward()
    assert loss == pytest.approx(theirs.item(), rel=1e-5)
    assert_equal_gradients(agent.critic.gradients, layers)


@pytest.mark.parametrize("angle_weight", [0.0, 0.7])
def test_the_actor_climbs_the_weighed_values_and_turns_towards_the_interpolated_preference(
    agent: VectorTd3Agent, angle_weight: float
) -> None:
    batch = random_batch()
    inputs, goal_m = inputs_of(batch.observations, batch.preferences, SPLIT), batch.observations[:, 0] * 10
    value, angle = vector_actor_gradients(
        inputs, batch.preferences, goal_m, agent.actor.weights, agent.critic.weights, agent.actor.gradients,
        INTERPOLATOR, angle_weight=angle_weight,
    )  # fmt: skip
    layers = torch_layers(agent.actor.weights)
    judge = [tuple(torch.tensor(p) for p in layer) for layer in twins(agent.critic.weights)[0]]
    actions = torch.tanh(torch_head(torch.tensor(inputs), layers))
    q = torch_head(torch.cat([torch.tensor(inputs), actions], 1), judge)
    weighed = (q * torch.tensor(with_core(batch.preferences))).sum(1).mean()
    per_m = q[:, 1:] / torch.tensor(goal_m).clamp(min=1.0)[:, None]
    normalised = ((per_m - torch.tensor(INTERPOLATOR.low)) / torch.tensor(INTERPOLATOR.span)).clamp(min=1e-3)
    cosine = torch.cosine_similarity(normalised, torch.tensor(INTERPOLATOR(batch.preferences)), dim=1)
    turned = torch.arccos(cosine.clamp(-0.999, 0.999)).mean()
    (-weighed + angle_weight * turned).backward()
    assert value == pytest.approx(weighed.item(), abs=1e-5)
    assert angle == pytest.approx(turned.item(), abs=1e-4)
    assert_equal_gradients(agent.actor.gradients, layers)


def test_the_actor_is_drawn_to_what_is_imitated_unless_that_would_lose_much(
    agent: VectorTd3Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vector_td3, "CORE_LOST", 0.0)  # so that an untrained critic tells the actions apart
    batch = random_batch()
    inputs, goal_m = inputs_of(batch.observations, batch.preferences, SPLIT), batch.observations[:, 0] * 10
    given = (inputs, batch.preferences, goal_m, agent.actor.weights, agent.critic.weights)
    without, drawn = ([tuple(np.zeros_like(part) for part in layer) for layer in agent.actor.weights] for _ in range(2))
    vector_actor_gradients(*given, without, INTERPOLATOR, angle_weight=0.1)
    imitated = Imitated(batch.actions, 0.5 * batch.preferences[:, 0])
    vector_actor_gradients(*given, drawn, INTERPOLATOR, angle_weight=0.1, imitated=imitated)

    layers = torch_layers(agent.actor.weights)
    judge = [tuple(torch.tensor(p) for p in layer) for layer in twins(agent.critic.weights)[0]]
    actions, wished = torch.tanh(torch_head(torch.tensor(inputs), layers)), torch.tensor(batch.actions)
    own, of_wished = (torch_head(torch.cat([torch.tensor(inputs), a], 1), judge)[:, 0] for a in (actions, wished))
    gains = (of_wished > own).float()
    assert 0 < gains.sum() < N
    (gains * torch.tensor(imitated.weights) * ((actions - wished) ** 2).sum(1)).mean().backward()
    between = [tuple(a - b for a, b in zip(*both, strict=True)) for both in zip(drawn, without, strict=True)]
    assert_equal_gradients(between, layers)


def test_targets_take_the_twin_that_is_worth_less_under_the_preference(agent: VectorTd3Agent) -> None:
    batch, noise = random_batch(), np.zeros((N, 2), dtype=np.float32)
    following = inputs_of(batch.following, batch.preferences, SPLIT)
    found = vector_targets(batch, following, noise, agent.actor.weights, agent.critic.weights, agent.config)
    actions = torch.tanh(torch_head(torch.tensor(following), torch_layers(agent.actor.weights)))
    joined = torch.cat([torch.tensor(following), actions], 1)
    first, second = (torch_head(joined, torch_layers(layers)) for layers in twins(agent.critic.weights))
    weights = torch.tensor(with_core(batch.preferences))
    for k in range(N):
        lower = first[k] if (first[k] * weights[k]).sum() <= (second[k] * weights[k]).sum() else second[k]
        expected = batch.rewards[k] + 0.9 * batch.continues[k] * lower.detach().numpy()
        np.testing.assert_allclose(found[k], expected, atol=1e-5)


def test_hindsight_changes_whose_preference_it_was_and_nothing_that_happened() -> None:
    random = np.random.default_rng(0)
    trajectory = random_batch(50)._replace(preferences=np.tile(np.float32([1, 0, 0]), (50, 1)))
    seen = relabel(trajectory, 0.4, random)
    assert (seen.preferences[20:] == trajectory.preferences[20:]).all()
    assert (seen.preferences[:20] != trajectory.preferences[:20]).any(axis=1).all()
    for name in ("observations", "actions", "rewards", "following", "continues"):
        assert getattr(seen, name) is getattr(trajectory, name)
    # The return under a preference is that preference of the vector of returns, however it is added up.
    other = seen.preferences[:1]
    stepwise = scalarise(seen.rewards, np.repeat(other, 50, axis=0)).sum()
    assert stepwise == pytest.approx(scalarise(seen.rewards.sum(axis=0, keepdims=True), other)[0], abs=1e-4)


def test_the_interpolator_is_exact_at_its_nodes_and_unit_long_between() -> None:
    at_nodes = INTERPOLATOR(np.eye(3, dtype=np.float32))
    normalised = (SOLUTIONS - SOLUTIONS.min(axis=0)) / np.ptp(SOLUTIONS, axis=0)
    np.testing.assert_allclose(at_nodes, normalised / np.linalg.norm(normalised, axis=1, keepdims=True), atol=1e-6)
    between = INTERPOLATOR(sample_preferences(100, np.random.default_rng(2)))
    np.testing.assert_allclose(np.linalg.norm(between, axis=1), 1, atol=1e-5)
    plain, expected = without_solutions()(KEY_PREFERENCES), unit(KEY_PREFERENCES)
    np.testing.assert_allclose(plain, expected, atol=1e-6)


def test_three_groups_explore_three_thirds_of_the_triangle() -> None:
    parts = np.arange(3_000) % 3
    found = sample_preferences_in(parts, np.random.default_rng(1))
    assert (part_of(found) == parts).all()
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(found.mean(axis=0), 1 / 3, atol=0.02)


def test_the_thesis_tests_thirty_three_preferences_on_three_edges() -> None:
    found = thesis_vectors()
    assert found.shape == (33, 3)
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-6)
    assert (found.min(axis=1) == 0).all()
    for k in range(len(NAMES)):
        assert (found[:, k] == 1).sum() == 2


def test_the_buffer_overwrites_its_oldest() -> None:
    buffer, batch = VectorReplayBuffer(30, OBSERVED), random_batch()
    for _ in range(2):
        buffer.add(VectorBatch(*batch))
    assert buffer.size == 30
    drawn = buffer.sample(200, np.random.default_rng(0))
    assert {tuple(row) for row in drawn.actions.tolist()} == {tuple(row) for row in batch.actions.tolist()}

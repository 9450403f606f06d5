"""Rewards of several steps at once: what is stored is what the definition says, in the buffer and along a drive."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desirepath.demonstrations.td3_bc.returns import ReturnsBuffer, returns_along
from desirepath.learning.td3.replay import ReplayBuffer

GAMMA = 0.9


def stored(buffer: ReplayBuffer) -> list[tuple[float, ...]]:
    """(where begun, reward, where led to, continues) of every transition, in order of where they began."""
    parts = buffer.filled()
    rows = zip(
        parts.observations[:, 0].tolist(),
        parts.rewards.tolist(),
        parts.next_observations[:, 0].tolist(),
        parts.continues.tolist(),
        strict=True,
    )
    return sorted(rows)


@settings(max_examples=30, deadline=None)
@given(steps=st.integers(1, 7), seed=st.integers(0, 1_000))
def test_the_buffer_holds_what_the_definition_says(steps: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    length, n_envs = 25, 3
    rewards = random.normal(size=(length, n_envs)).astype(np.float32)
    dones = random.random((length, n_envs)) < 0.15
    at = 100 * np.arange(n_envs) + np.arange(length + 1)[:, None]  # tells time and environment
    buffer = ReturnsBuffer(1_000, 1, n_envs=n_envs, steps=steps, gamma=GAMMA)
    for t in range(length):
        buffer.add(
            at[t][:, None].astype(np.float32),
            np.zeros((n_envs, 2), np.float32),
            rewards[t],
            at[t + 1][:, None].astype(np.float32),
            dones[t],
        )
    expected = []
    for env in range(n_envs):
        for t in range(length):
            ends = [i for i in range(t, length) if dones[i, env]]
            last = min([t + steps - 1, *ends[:1]])
            if last < length:
                reward = sum(GAMMA ** (i - t) * rewards[i, env] for i in range(t, last + 1))
                continues = 0.0 if dones[last, env] else GAMMA ** (last - t)
                expected.append((at[t, env], reward, at[last + 1, env], continues))
    assert np.allclose(stored(buffer), sorted(expected), atol=1e-5)


def test_one_step_at_a_time_is_what_was_driven(slow_ones) -> None:
    drive = slow_ones[0].trajectory
    rewards, led_to, continues = returns_along(drive, drive.rewards, 1, GAMMA)
    assert np.allclose(rewards, drive.rewards)
    assert (led_to == drive.next_observations).all()
    assert (continues == ~drive.dones).all()


def test_far_along_a_drive_little_is_as_exact_as_at_its_beginning(slow_ones) -> None:
    drive = slow_ones[0].trajectory
    rewards, _, continues = returns_along(drive, np.ones(len(drive.rewards)), 2, 1e-9)
    assert rewards == pytest.approx(np.ones(len(drive.rewards)))
    assert continues[:-2] == pytest.approx(np.full(len(drive.rewards) - 2, 1e-9))


def test_along_a_drive_it_is_what_the_buffer_stores(slow_ones) -> None:
    drive = slow_ones[0].trajectory
    paid = drive.rewards + np.arange(len(drive.rewards)) % 3
    buffer = ReturnsBuffer(1_000, drive.observations.shape[1], n_envs=1, steps=4, gamma=GAMMA)
    for t, reward in enumerate(paid.astype(np.float32)):
        one = slice(t, t + 1)
        buffer.add(
            drive.observations[one], drive.actions[one], reward[None], drive.next_observations[one], drive.dones[one]
        )
    rewards, led_to, continues = returns_along(drive, paid, 4, GAMMA)
    kept = buffer.filled()
    assert kept.rewards.sum() == pytest.approx(rewards.sum(), rel=1e-5)
    assert np.allclose(sorted(kept.rewards.tolist()), sorted(rewards.tolist()), atol=1e-5)
    assert (kept.continues == 0).sum() == (continues == 0).sum() == 4
    assert {row.tobytes() for row in kept.next_observations.numpy()} == {row.tobytes() for row in led_to}

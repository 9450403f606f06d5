"""Laplace's approximation finds the mode whatever the strength, and its evidence is about what integration gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit

from desirepath.learning.preferences.advantage_process import AdvantageProcess


@pytest.mark.parametrize("strength", [8.0, 64.0, 512.0])
def test_the_mode_is_found_however_much_the_answers_surprise(strength: float) -> None:
    random = np.random.default_rng(3)
    features = random.normal(0, 0.3, (15, 10))
    expected = random.normal(0, 1.0, 15)
    signs = np.where(expected + random.normal(0, 1.0, 15) > 0, -1.0, 1.0)  # mostly against what was expected
    process = AdvantageProcess.after(strength, (expected, features), signs)
    f = np.sqrt(strength) * expected + strength * features @ features.T @ process.gradient
    assert process.gradient == pytest.approx(signs * (1 - expit(signs * f)), abs=1e-3)
    assert process.log_evidence < 0


def test_the_evidence_is_about_what_integrating_gives() -> None:
    features, signs = np.array([[1.0], [0.5], [-0.7], [1.2]]), np.array([1.0, 1.0, -1.0, -1.0])
    process = AdvantageProcess.after(8.0, (np.zeros(4), features), signs)
    weights = np.linspace(-40, 40, 20_001)
    likely = expit(signs[:, None] * features * weights)
    density = np.exp(-np.square(weights) / 16) / np.sqrt(16 * np.pi)
    assert process.log_evidence == pytest.approx(np.log(np.trapezoid(likely.prod(0) * density, weights)), abs=0.35)


def test_what_is_drawn_together_is_spread_as_what_is_believed() -> None:
    random = np.random.default_rng(3)
    seen, pairs = random.normal(size=(5, 3)), random.normal(size=(4, 3))
    process = AdvantageProcess.after(4.0, (np.zeros(5), seen), np.array([1.0, -1, 1, 1, -1]))
    for of in (process, AdvantageProcess.after(4.0, (np.zeros(0), np.zeros((0, 3))), np.zeros(0))):
        mean, variance = of.advantages((np.zeros(4), pairs))
        drawn = of.sampled((np.zeros(4), pairs), np.random.default_rng(4), 40_000)
        np.testing.assert_allclose(drawn.mean(1), mean, atol=0.08)
        np.testing.assert_allclose(drawn.var(1), variance, rtol=0.05)

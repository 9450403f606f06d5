"""Alignment: the reward is the recipe's, the policy moves where the answers point, both algorithms keep what they
should.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from desirepath.learning.alignment.fine_tuning import FineTuningConfig, FineTuningReward
from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.alignment.relabelling import RelabelledBuffer, align
from desirepath.learning.alignment.thesis import ThesisConfig, thesis_config
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.rewards.linear import LinearRewardModel, fit_linear
from desirepath.learning.rewards.mlp import MlpConfig, fit_mlp
from desirepath.learning.td3.base import BaseResult
from desirepath.learning.td3.replay import collect
from desirepath.simulation.setups import SetupError, get_setup

STUDY_ROOM = get_setup("study_room")

TINY = FineTuningConfig(
    updates=120,
    checkpoints=2,
    replay_transitions=3_000,
    selection_scenes=20,
    gate=GateRule(scenes=30),
    weighing_scenes=20,
)


@pytest.fixture(scope="module")
def base() -> Policy:
    return load_policy("study_room/base")


@pytest.fixture(scope="module")
def model(distance_answers: list[Preference]) -> LinearRewardModel:
    return fit_linear(distance_answers[:15])


def test_fine_tuning_adds_a_penalty_that_never_pays_for_loitering(base: Policy, model: LinearRewardModel) -> None:
    replay = collect(base, 4_000, noise=(0.05, 0.5), seed=0).filled()
    config = replace(TINY, reward_weight=0.5)
    reward = FineTuningReward(model, config, replay, base)
    added = reward.combined(replay.rewards, reward.preference(replay)) - replay.rewards + config.time_cost
    assert float(added.max()) <= 1e-5  # float32 next to rewards of 20
    assert float(added.min()) >= -0.5 * config.penalty_cap - 1e-4
    assert 0.01 < float((added.abs() < 1e-5).float().mean()) < 0.5  # the best states pay for their time only


def test_the_preference_is_weighed_by_what_is_at_stake(base: Policy, model: LinearRewardModel) -> None:
    replay = collect(base, 4_000, noise=(0.05, 0.5), seed=0).filled()
    half, full = (
        FineTuningReward(model, replace(TINY, preference_share=share), replay, base).weight for share in (0.4, 0.8)
    )
    assert full == pytest.approx(2 * half)
    assert 0.05 < full < STUDY_ROOM.reward.goal


def test_the_thesis_reward_is_equation_6_5(base: Policy, distance_answers: list[Preference]) -> None:
    replay = collect(base, 4_000, noise=(0.05, 0.5), seed=0).filled()
    mlp = fit_mlp(distance_answers[:5], MlpConfig(epochs=1))
    reward = thesis_config().reward(mlp, replay, base)
    combined = reward.combined(replay.rewards, reward.preference(replay))
    raw = mlp.rewards(replay.observations.numpy(), replay.actions.numpy(), replay.next_observations.numpy())
    expected = 0.06 * (raw - raw.mean()) / raw.std() + 0.94 * replay.rewards.numpy()
    np.testing.assert_allclose(combined.numpy(), expected, atol=1e-3)


def test_the_weight_follows_success(base: Policy, model: LinearRewardModel) -> None:
    replay = collect(base, 1_000, noise=(0.05, 0.5), seed=0).filled()
    config = replace(TINY, min_success=0.9, max_selection_loss=0.03, almost_no_loss=0.01)
    reward = FineTuningReward(model, config, replay, base)
    weights = [reward.weight]
    for success in (0.99, 0.96, 0.94):  # of a base policy with 0.98: no loss, some, too much
        reward.adapt(success, 0.98)
        weights.append(reward.weight)
    assert weights[1] == pytest.approx(config.weight_up * weights[0])
    assert weights[2] == weights[1]
    assert weights[3] == pytest.approx(config.weight_down * weights[2])
    fixed = FineTuningReward(model, replace(config, reward_weight=0.3), replay, base)
    fixed.adapt(0.5, 0.98)
    assert fixed.weight == 0.3


def test_a_relabelled_buffer_follows_the_weight(base: Policy, model: LinearRewardModel) -> None:
    fresh = collect(base, 2_000, noise=(0.05, 0.5), seed=0)
    core = fresh.filled().rewards.clone()
    reward = FineTuningReward(model, replace(TINY, reward_weight=0.5, time_cost=0.0), fresh.filled(), base)
    relabelled = RelabelledBuffer(fresh, reward)
    relabelled.take_up()
    added = fresh.filled().rewards - core
    reward.weight = 1.0
    relabelled.reweigh()
    np.testing.assert_allclose((fresh.filled().rewards - core).numpy(), 2 * added.numpy(), atol=1e-4)
    assert float(added.abs().max()) > 0.1


def test_alignment_moves_away_from_the_person_and_reports_on_the_way(
    base: Policy, model: LinearRewardModel, tmp_path: Path
) -> None:
    seen: list[tuple[float, dict[str, float]]] = []
    config = replace(TINY, updates=450, checkpoints=3)
    result = align(base, model, config, lambda *step: seen.append(step), checkpoint_folder=tmp_path)
    assert [fraction for fraction, _ in seen] == sorted(fraction for fraction, _ in seen)
    assert seen[-1][0] == 1.0
    assert len(result.history) == 3
    assert [Policy.load(path).setup for path in sorted(tmp_path.glob("*.npz"))] == ["study_room"] * 3
    assert Policy.load(tmp_path / f"checkpoint_{result.chosen + 1}.npz").digest() == result.policy.digest()
    assert not result.policy.critic
    observations = collect(base, 512, noise=(0.05, 0.5), seed=4).filled().observations.numpy()
    assert np.abs(result.policy.act(observations) - base.act(observations)).mean() > 0.02


def test_the_same_seed_aligns_to_the_same_policy(base: Policy, model: LinearRewardModel) -> None:
    first, second = align(base, model, TINY), align(base, model, TINY)
    assert first.policy.digest() == second.policy.digest()
    assert first.replay_sha256 == second.replay_sha256
    assert first.gate == second.gate


def test_the_thesis_recipe_runs_without_new_interaction(base: Policy, distance_answers: list[Preference]) -> None:
    config = ThesisConfig(
        updates=120, checkpoints=2, replay_transitions=3_000, selection_scenes=20, gate=GateRule(scenes=30)
    )
    result = align(base, fit_mlp(distance_answers[:5], MlpConfig(epochs=1)), config)
    assert result.reward_weight == 0.06
    rates = [entry["success_rate"] for entry in result.history]
    assert rates[result.chosen] == max(rates)


def test_thesis_defaults_are_the_papers() -> None:
    config = thesis_config(epochs=4)
    assert (config.reward_weight, config.updates, config.checkpoints) == (0.06, 40_000, 4)
    assert config.online_share == 0.0


def test_choosing_a_checkpoint() -> None:
    config = FineTuningConfig(min_success=0.94, max_selection_loss=0.02)
    assert config.choose([0.99, 0.97, 0.95, 0.80], 0.98) == 1  # the last near the base policy's 0.98
    assert config.choose([0.90, 0.93, 0.91], 0.98) == 1  # none: the best
    assert ThesisConfig().choose([0.95, 0.99, 0.98], 0.98) == 1


def test_models_and_policies_of_two_setups_are_refused(model: LinearRewardModel) -> None:
    with pytest.raises(SetupError, match="policy is open_field, reward_model is study_room"):
        align(load_policy("open_field/base"), model, TINY)


def test_settings_that_cannot_work_are_refused(base: Policy, model: LinearRewardModel, tiny_base: BaseResult) -> None:
    for change in ({"online_share": 1.0}, {"checkpoints": 500}):
        with pytest.raises(LearningError, match=next(iter(change))):
            align(base, model, replace(TINY, **change))  # type: ignore[arg-type]
    with pytest.raises(LearningError, match="critic"):
        align(base.without_critic(), model, TINY)


def test_what_goes_on_from_a_held_policy_is_drawn_to_it(
    tiny_base: BaseResult, distance_answers: list[Preference]
) -> None:
    base = tiny_base.policy
    model = replace(fit_linear(distance_answers[:4]), setup=base.setup)
    seen = collect(base, 500, noise=(0.05, 0.5), seed=0).filled().observations.numpy()

    def moved(held: float) -> float:
        made = align(replace(base, held=held), model, TINY).policy
        assert made.held == 0  # of an actor alone
        return float(np.abs(made.act(seen) - base.act(seen)).mean())

    assert 0 < moved(1e4) < 0.5 * moved(0.0)

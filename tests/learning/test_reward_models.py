"""Bradley-Terry models: the loss is the equation, the fit recovers preferences, bad input is refused with a reason."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desirepath.learning.errors import LearningError, TooFewAnswers
from desirepath.learning.preferences.features import FEATURE_NAMES, obstacle_clearance_m, step_features
from desirepath.learning.preferences.oracles import ORACLES, make_oracle, min_human_distance_m
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.rewards.held_out import accuracy, held_out_accuracy
from desirepath.learning.rewards.linear import LinearConfig, LinearRewardModel, fit_linear
from desirepath.learning.rewards.mlp import MlpConfig, fit_mlp
from desirepath.learning.rewards.reward_model import RewardModel, bradley_terry_gradient, bradley_terry_loss
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import Setup, SetupError, get_setup

OPEN_FIELD = get_setup("open_field")
STUDY_ROOM = get_setup("study_room")

LEARNED, HELD_OUT = slice(0, 15), slice(15, 200)


def test_loss_is_the_negative_log_of_equation_6_4() -> None:
    chosen, rejected = np.array([1.0, -2.0, 0.5]), np.array([0.0, 1.0, 0.5])
    by_hand = sum(-math.log(1 / (1 + math.exp(r - c))) for c, r in zip(chosen, rejected, strict=True))
    assert bradley_terry_loss(chosen - rejected) == pytest.approx(by_hand, rel=1e-12)
    assert bradley_terry_loss(np.array([0.0])) == pytest.approx(math.log(2))


@given(st.lists(st.floats(-30, 30), min_size=1, max_size=5))
@settings(deadline=None)
def test_gradient_is_the_derivative_of_the_loss(advantages: list[float]) -> None:
    x, step = np.array(advantages), 1e-6
    for k in range(len(x)):
        shift = np.eye(len(x))[k] * step
        numeric = (bradley_terry_loss(x + shift) - bradley_terry_loss(x - shift)) / (2 * step)
        assert bradley_terry_gradient(x)[k] == pytest.approx(numeric, abs=1e-5)


@pytest.mark.parametrize("setup", [OPEN_FIELD, STUDY_ROOM], ids=lambda setup: setup.name)
def test_clearance_read_from_observations_agrees_with_the_engine(setup: Setup) -> None:
    """Where nothing hides behind the person, the nearest other lidar return is the engine's own clearance."""
    engine = make_engine(setup, 400, scenes=draw_scenes(setup, range(400)), auto_reset=False)
    engine.step(np.zeros((400, 2), dtype=np.float32))
    seen = obstacle_clearance_m(engine.next_observations, setup)
    truth = np.minimum(engine.obstacle_clearance, setup.robot.lidar.range_m)
    assert (seen >= truth - 0.03).all()  # beams can pass a corner, never end before it
    assert np.mean(np.abs(seen - truth) < 0.1) > 0.8


def test_features_are_complaints_never_praise() -> None:
    engine = make_engine(STUDY_ROOM, 100, seed=5)
    random = np.random.default_rng(0)
    for _ in range(20):
        actions = random.uniform(-1, 1, (100, 2)).astype(np.float32)
        engine.step(actions)
        features = step_features(actions, engine.next_observations, STUDY_ROOM)
        assert features.shape == (100, len(FEATURE_NAMES))
        assert (features <= 0).all()


def test_fifteen_answers_teach_what_the_oracle_wants(distance_answers: list[Preference]) -> None:
    model = fit_linear(distance_answers[LEARNED])
    assert (model.weights >= 0).all()
    assert accuracy(model, distance_answers[HELD_OUT]) > 0.75
    importance = model.importance()
    assert sum(importance.values()) == pytest.approx(1)
    assert sum(share for name, share in importance.items() if name.startswith("person")) > 0.5


def test_clear_pairs_are_predicted_better_than_all(distance_answers: list[Preference]) -> None:
    model = fit_linear(distance_answers[:60])
    rest = distance_answers[60:]
    clear = [p for p in rest if min_human_distance_m(p.chosen) - min_human_distance_m(p.rejected) > 0.2]
    assert accuracy(model, clear) > max(0.9, accuracy(model, rest))


def test_held_out_accuracy_is_near_chance_for_random_answers(study_queries: QuerySet) -> None:
    random_answers = make_oracle("random", seed=1).answer(study_queries.queries[:100])
    row = held_out_accuracy(random_answers, fit_linear)
    assert (row.n, row.method) == (100, "5_folds")
    assert 0.3 < row.accuracy < 0.7
    assert row.high - row.low == pytest.approx(2 * 1.96 * 0.05, abs=0.02)  # of a share near a half, n = 100


def test_few_answers_are_left_out_one_at_a_time_and_two_cannot_be(distance_answers: list[Preference]) -> None:
    seen: list[int] = []

    def fit(preferences: Sequence[Preference]) -> RewardModel:
        seen.append(len(preferences))
        return fit_linear(preferences)

    row = held_out_accuracy(distance_answers[:6], fit)
    assert (row.n, row.method, seen) == (6, "leave_one_out", [5] * 6)
    assert row.accuracy * 6 == round(row.accuracy * 12) / 2
    assert row.low < row.accuracy <= row.high <= 1
    with pytest.raises(TooFewAnswers, match="2 usable of 2 given; learning needs at least 3"):
        held_out_accuracy(distance_answers[:2], fit)


def test_a_tie_counts_half_and_widens_the_interval(distance_answers: list[Preference]) -> None:
    nothing = np.zeros(len(FEATURE_NAMES), dtype=np.float32)
    indifferent = LinearRewardModel("study_room", nothing, nothing, nothing)
    row = held_out_accuracy(distance_answers[:3], lambda _: indifferent)
    assert row.accuracy == 0.5
    assert row.low < 1 / 3 < 2 / 3 < row.high


def test_the_neural_model_learns_its_answers_and_is_normalised(distance_answers: list[Preference]) -> None:
    answers = distance_answers[:6]
    model = fit_mlp(answers, MlpConfig(epochs=20, learning_rate=1e-3, held_out_share=0.0))
    assert accuracy(model, answers) > accuracy(fit_mlp(answers, MlpConfig(epochs=1, learning_rate=1e-9)), answers)
    trajectories = [trajectory for p in answers for trajectory in (p.chosen, p.rejected)]
    values = np.concatenate([model.rewards(d.observations, d.actions, d.next_observations) for d in trajectories])
    assert values.mean() == pytest.approx(0, abs=1e-3)
    assert values.std() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("reduction", ["sum", "mean"])
def test_reward_models_survive_storage(distance_answers: list[Preference], tmp_path: Path, reduction: str) -> None:
    answers = distance_answers[LEARNED]
    models: list[RewardModel] = [
        fit_linear(answers, LinearConfig(reduction=reduction)),  # type: ignore[arg-type]
        fit_mlp(answers, MlpConfig(epochs=1, reduction=reduction)),  # type: ignore[arg-type]
    ]
    for model in models:
        model.save(tmp_path / "model.npz")
        again = RewardModel.load(tmp_path / "model.npz")
        assert type(again) is type(model)
        assert again.reduction == reduction
        assert again.trajectory_reward(answers[0].chosen) == model.trajectory_reward(answers[0].chosen)


def test_a_file_that_is_no_reward_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("not a zip")
    np.savez(tmp_path / "other.npz", meta=np.frombuffer(b"{}", dtype=np.uint8))
    for name in ("text.npz", "other.npz", "missing.npz"):
        with pytest.raises(LearningError, match="reward model"):
            RewardModel.load(tmp_path / name)


def test_fewer_than_two_usable_answers_are_refused(distance_answers: list[Preference]) -> None:
    one = distance_answers[0]
    says_nothing = Preference(one.chosen, one.chosen)
    for fit in (fit_linear, fit_mlp):
        for answers in ([], [one], [one, says_nothing]):
            with pytest.raises(LearningError, match="at least 2 answers"):
                fit(answers)


def test_answers_from_two_setups_are_refused(distance_answers: list[Preference]) -> None:
    def moved(p: Preference) -> Preference:
        elsewhere = [replace(d, scene=replace(d.scene, setup="open_field")) for d in (p.chosen, p.rejected)]
        return Preference(elsewhere[0], elsewhere[1])

    with pytest.raises(SetupError, match="answer 1 is open_field"):
        fit_linear([distance_answers[0], moved(distance_answers[1])])


def test_oracles_answer_by_their_taste_and_their_noise(study_queries: QuerySet) -> None:
    queries = study_queries.queries[:100]
    for answer in make_oracle("min-human-distance").answer(queries):
        assert min_human_distance_m(answer.chosen) >= min_human_distance_m(answer.rejected)
        assert answer.source == "oracle:min-human-distance"
    clean = [make_oracle("shortest").choose(q) for q in queries]
    oracle = make_oracle("shortest", lapse_rate=0.3, seed=2)
    noisy = [oracle.choose(q) for q in queries]
    flipped = np.mean([a != b for a, b in zip(clean, noisy, strict=True)])
    assert 0.15 < flipped < 0.45
    opposite = make_oracle("shortest", lapse_rate=1.0)
    assert [opposite.choose(q) for q in queries] == [1 - choice for choice in clean]


def test_unknown_oracles_and_impossible_noise_are_refused() -> None:
    with pytest.raises(LearningError, match=", ".join(ORACLES)):
        make_oracle("tallest")
    with pytest.raises(LearningError, match="lapse_rate"):
        make_oracle("random", lapse_rate=1.5)

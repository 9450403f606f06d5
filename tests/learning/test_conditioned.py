"""The conditioned policy: wants fold into an ordinary one, training respects them, the mirrored world is the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import ConditionedPolicy, settings
from desirepath.learning.policies.mirroring import ACTION_SIGNS, mirror_of
from desirepath.learning.policies.policy import Policy, PolicyError
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.preferences.objectives import (
    MIRRORED,
    NAMES,
    OPPOSITES,
    SIZE,
    parse_weights,
    preference_weights,
    shares_of_reward,
    step_terms_of,
)
from desirepath.learning.td3.base import BaseResult
from desirepath.learning.td3.conditioned_training import (
    ConditionedConfig,
    ConditionedResult,
    ConditionedTraining,
    reward_weights_of,
    sample_weights,
    strong_enough,
    train_conditioned,
)
from desirepath.simulation.disturbed import DisturbedEngine
from desirepath.simulation.fast import make_engine
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import SetupError, get_setup

Floats = NDArray[np.float32]
ROOM_WEIGHTS = reward_weights_of(load_policy("study_room/base"))
TINY = ConditionedConfig(
    setup="study_room",
    updates=96,
    batch_size=64,
    base_transitions=2_000,
    buffer_size=5_000,
    n_envs=32,
    checkpoints=2,
    selection_scenes=12,
    strong_scenes=12,
    strong_share=-10.0,
)


@pytest.fixture(scope="module")
def base() -> Policy:
    return load_policy("study_room/base")


@pytest.fixture(scope="module")
def trained(base: Policy) -> ConditionedResult:
    return train_conditioned(base, TINY)


def test_before_any_training_every_want_drives_as_the_base_policy(base: Policy) -> None:
    untrained = ConditionedTraining(base, TINY).policy(averaged=False)
    seen = make_engine(get_setup("study_room"), 64, seed=5).observations
    for weights in settings().values():
        np.testing.assert_array_equal(untrained.at(weights).act(seen), base.act(seen))


def test_with_randomise_weights_are_learned_among_disturbed_robots_too(base: Policy) -> None:
    config = replace(TINY, randomise=True)
    training = ConditionedTraining(base, config)
    training.vector_step()
    assert isinstance(training.collector.engine, DisturbedEngine)
    assert config.as_dict() == TINY.as_dict() | {"randomise": True}


def test_folding_equals_the_full_network(base: Policy) -> None:
    training = ConditionedTraining(base, TINY)
    for _ in range(3):
        training.vector_step()
    policy = training.policy(averaged=False)
    seen = make_engine(training.setup, 64, seed=5).observations
    polar = training.setup.polar_size
    weights = preference_weights({"farther": 1.0, "smoother": 0.4})
    told = np.concatenate([seen[:, :polar], np.tile(weights, (64, 1)), seen[:, polar:]], axis=1)
    folded = policy.at(weights)
    # float32 sums in another order; seen: 1.5e-6
    np.testing.assert_allclose(folded.act(seen), training.agent.act(told), atol=5e-6)
    assert np.abs(folded.act(seen) - policy.at(preference_weights({})).act(seen)).max() > 1e-4
    for full, plain in ((policy.actor, folded.actor), (policy.critic, folded.critic)):
        through = told[:, : polar + SIZE] @ full[0] + full[1]
        np.testing.assert_allclose(seen[:, :polar] @ plain[0] + plain[1], through, atol=1e-5)
        for whole, kept in zip(full[2:], plain[2:], strict=True):
            np.testing.assert_array_equal(whole, kept)


def test_a_stronger_policy_is_conditioned_on_smaller_weights(trained: ConditionedResult) -> None:
    half, whole = preference_weights({"farther": 0.5, "smoother": 1}), preference_weights({"farther": 1, "smoother": 1})
    stronger = trained.policy.stronger("farther", 2.0)
    assert stronger.at(half).digest() == trained.policy.at(whole).digest() != stronger.at(whole).digest()
    assert stronger.scales[0] == 2 * trained.policy.scales[0]
    assert stronger.scales[1:] == trained.policy.scales[1:]


@pytest.mark.parametrize(
    ("share", "success", "strength"),
    [(-10.0, 0.0, 1.0), (10.0, 0.0, 1.5), (10.0, 1.01, 1.0)],
    ids=["goes far enough", "never far enough", "too many failures"],
)
def test_farther_is_made_as_strong_as_asked(
    trained: ConditionedResult, base: Policy, share: float, success: float, strength: float
) -> None:
    config = replace(TINY, strong_share=share, strong_success=success)
    assert strong_enough(trained.policy, base, config) == strength


def test_a_stuck_robot_is_freed_by_the_base_policy_then_by_nothing_wanted(base: Policy) -> None:
    untrained = ConditionedTraining(base, replace(TINY, recovery=True)).policy(averaged=False)
    assert not ConditionedTraining(base, TINY).policy(averaged=False).at(settings()["farther"]).recovery_policies
    told = ConditionedPolicy.from_bytes(untrained.to_bytes()).at(settings()["farther"])
    seen = make_engine(get_setup("study_room"), 16, seed=5).observations
    for recovery_policy in told.recovery_policies:
        np.testing.assert_array_equal(Policy(told.setup, told.shape, recovery_policy).act(seen), base.act(seen))
    assert len(told.recovery_policies) == 2
    assert told.without_critic().recovery_policies == told.recovery_policies


def test_storage_keeps_every_byte(trained: ConditionedResult, tmp_path: Path) -> None:
    path = tmp_path / "conditioned.npz"
    trained.policy.save(path)
    again = ConditionedPolicy.load(path)
    assert again.digest() == trained.policy.digest()
    assert again.scales == ROOM_WEIGHTS.scales
    assert load_policy(f"{path}@farther=1").digest() == trained.policy.at(parse_weights("farther=1")).digest()
    assert load_policy(str(path)).digest() == trained.policy.at(np.zeros(SIZE, dtype=np.float32)).digest()
    with pytest.raises(PolicyError, match="desirepath-conditioned-1"):
        Policy.load(path)
    with pytest.raises(PolicyError, match="desirepath-policy-1"):
        ConditionedPolicy.from_bytes(load_policy("study_room/base").to_bytes())
    with pytest.raises(LearningError, match="takes no preference weights"):
        load_policy("study_room/base@farther=1")


@pytest.mark.parametrize(
    ("wants", "said"),
    [
        ("farther=1,closer=0.5", "farther and closer are opposites"),
        ("person_on_left=0.1,person_on_right=0.1", "opposites"),
        ("farther=1.5", "farther = 1.5: must be between 0 and 1"),
        ("nearer=1", "'nearer' is unknown; known are farther, closer"),
        ("farther", "write it as objective=weight"),
        ("farther=nan", "farther = nan"),
    ],
)
def test_wants_that_cannot_be_are_refused(trained: ConditionedResult, wants: str, said: str) -> None:
    with pytest.raises(LearningError, match=said):
        trained.policy.at(parse_weights(wants))


def test_imagined_people_want_few_things_and_never_opposites() -> None:
    weights = sample_weights(4_000, TINY, np.random.default_rng(1))
    wanted = (weights > 0).sum(1)
    shares = np.bincount(wanted, minlength=4) / len(weights)
    np.testing.assert_allclose(shares, [0.12, 0.4, 0.24, 0.24], atol=0.03)
    for a, b in OPPOSITES:
        assert not (weights[:, a] * weights[:, b]).any()
    assert ((weights == 0) | ((weights >= TINY.smallest_weight) & (weights <= 1))).all()
    assert (weights > 0).any(0).all()


def mirrored_scene(scene: Scene) -> Scene:
    """The same scene reflected at the x axis."""

    def flip(pose: Pose) -> Pose:
        return Pose(pose.x, -pose.y, -pose.yaw)

    return replace(
        scene,
        start=flip(scene.start),
        goal=flip(scene.goal),
        person=replace(scene.person, pose=flip(scene.person.pose)),
        obstacles=tuple(replace(o, pose=flip(o.pose)) for o in scene.obstacles),
    )


@pytest.mark.parametrize("name", ["open_field", "study_room"])
def test_the_mirrored_world_is_the_same_world(name: str) -> None:
    setup, random = get_setup(name), np.random.default_rng(2)
    scenes = draw_scenes(setup, range(40))
    here = make_engine(setup, 40, auto_reset=False, scenes=scenes)
    there = make_engine(setup, 40, auto_reset=False, scenes=[mirrored_scene(scene) for scene in scenes])
    order, signs = mirror_of(setup)
    polar, beam_m = setup.polar_size, []
    for _ in range(25):
        actions = random.uniform(-1, 1, (40, 2)).astype(np.float32)
        here.step(actions)
        there.step(actions * ACTION_SIGNS)
        expected = here.next_observations[:, order] * signs
        np.testing.assert_allclose(there.next_observations[:, :polar], expected[:, :polar], atol=1e-5)
        np.testing.assert_allclose(there.rewards, here.rewards, atol=1e-4)
        np.testing.assert_array_equal(there.outcomes, here.outcomes)
        beam_m.append(
            np.abs(there.next_observations[:, polar:] - expected[:, polar:]).ravel() * setup.robot.lidar.range_m
        )
        terms = step_terms_of(actions, here.next_observations, setup)
        clearance = NAMES.index("clearance")
        mirrored = step_terms_of(actions * ACTION_SIGNS, there.next_observations, setup)
        others = [k for k in range(SIZE) if k != clearance]  # clearance is read from the lidar
        np.testing.assert_allclose(mirrored[:, others], terms[:, MIRRORED][:, others], atol=1e-4)
    # Pooled sectors look through beams that lie one beam beside; only where an edge falls between does it show.
    assert np.median(np.concatenate(beam_m)) < 0.02
    assert np.mean(np.concatenate(beam_m) > 0.2) < 0.05


def test_a_batch_is_judged_by_its_wants(base: Policy) -> None:
    reward_weights = replace(ROOM_WEIGHTS, turning=0.0, time=0.0)
    training = ConditionedTraining(base, replace(TINY, mirrored_share=0.0, reward_weights=reward_weights))
    nothing = replace(
        TINY, mirrored_share=0.0, relabelled_share=0.0, reward_weights=replace(reward_weights, scales=(0.0,) * SIZE)
    )
    plain = ConditionedTraining(base, nothing)
    judged, core = training.batch()[0], plain.batch()[0]
    setup = training.setup
    polar = setup.polar_size
    wants = judged.observations[:, polar : polar + SIZE].numpy()
    following = np.delete(judged.next_observations.numpy(), range(polar, polar + SIZE), axis=1)
    terms = step_terms_of(judged.actions.numpy(), following, setup)
    expected = core.rewards.numpy() + (shares_of_reward(wants) * terms) @ np.array(
        reward_weights.scales, dtype=np.float32
    )
    np.testing.assert_allclose(judged.rewards.numpy(), expected, atol=1e-4)
    assert (wants > 0).any()


def test_training_tells_what_moved_and_comes_out_the_same_again(base: Policy, trained: ConditionedResult) -> None:
    assert len(trained.history) == TINY.checkpoints
    assert trained.history[-1]["updates"] == TINY.updates
    assert set(trained.selection.shares) == set(NAMES)
    assert max(entry["score"] for entry in trained.history) == pytest.approx(trained.selection.score)
    assert train_conditioned(base, TINY).policy.digest() == trained.policy.digest()
    other = train_conditioned(base, replace(TINY, seed=1, strong_share=10.0, strong_success=0.0))
    assert other.policy.digest() != trained.policy.digest()
    assert (trained.strength, other.strength) == (1.0, 1.5)
    assert other.policy.scales[0] == 1.5 * ROOM_WEIGHTS.scales[0]


def test_settings_that_cannot_work_are_refused(base: Policy, tiny_base: BaseResult) -> None:
    for scales in ((1.0,), (1.0, 1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0)):
        with pytest.raises(LearningError, match="scales"):
            train_conditioned(base, replace(TINY, reward_weights=replace(ROOM_WEIGHTS, scales=scales)))
    for change in ({"buffer_size": 100}, {"checkpoints": 0}):
        with pytest.raises(LearningError, match=next(iter(change))):
            train_conditioned(base, replace(TINY, **change))  # type: ignore[arg-type]
    with pytest.raises(LearningError, match="critic"):
        train_conditioned(base.without_critic(), TINY)
    with pytest.raises(SetupError, match="open_field"):
        train_conditioned(tiny_base.policy, TINY)

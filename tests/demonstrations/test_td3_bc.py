"""Learning from demonstrations: the static buffer, the boost, the cloning term, the beginnings, what comes out."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from desirepath.demonstrations.controllers import DWA
from desirepath.demonstrations.demonstration import augment
from desirepath.demonstrations.demonstrators import demonstrate
from desirepath.demonstrations.judging import judge, judge_rollouts, unseen_scenes
from desirepath.demonstrations.planned_walks import walking_scene
from desirepath.demonstrations.td3_bc.configuration import DemonstrationConfig
from desirepath.demonstrations.td3_bc.loss import Balance, balance, cloning_term, demonstration_batch, update
from desirepath.demonstrations.td3_bc.path_guide import PathGuide
from desirepath.demonstrations.td3_bc.placement import Placements
from desirepath.demonstrations.td3_bc.training import DemonstrationTraining, train_with_demonstrations
from desirepath.learning.policies.networks import Layer, actor_forward, critic_forward
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.scene_sets import Purpose
from desirepath.learning.td3.replay import concatenate
from desirepath.learning.td3.td3 import Batch, Td3Agent, Td3Config
from desirepath.learning.td3.way_guide import WayGuide
from desirepath.simulation import kernels as k
from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath.simulation.fast import make_engine, rollout
from desirepath.simulation.scenes import check_scene, row_to_scene
from desirepath.simulation.setups import SetupError, get_setup
from desirepath.simulation.trajectory import Outcome

ROOM = get_setup("room")

QUICK = DemonstrationConfig(updates=96, n_envs=16, random_transitions=256, augmentation=2, selection_scenes=20)


def test_the_demonstration_buffer_rewards_each_goal_and_only_goals(slow_ones) -> None:
    batch = demonstration_batch(slow_ones[:2], QUICK)
    drives = [drive for d in slow_ones[:2] for drive in augment(d, 2)]
    assert len(batch.rewards) == sum(len(drive.actions) for drive in drives)
    one_by_one = demonstration_batch(slow_ones[:2], replace(QUICK, steps_at_once=1))
    assert (one_by_one.rewards != 0).sum() == (one_by_one.continues == 0).sum() == len(drives)
    assert (one_by_one.rewards[one_by_one.continues == 0] == 5.0).all()
    assert (batch.rewards != 0).sum() == (batch.continues == 0).sum() == QUICK.steps_at_once * len(drives)
    assert (demonstration_batch(slow_ones[:2], replace(QUICK, goal_boost=0.0)).rewards == 0).all()


def test_the_cloning_term_is_the_summed_square_over_the_demonstrated_part_alone() -> None:
    demonstrated = torch.tensor([[0.5, 0.0], [0.0, -1.0]])
    actions = torch.tensor([[9.0, 9.0], [0.0, 0.0], [0.0, 0.0]]).requires_grad_(True)
    torch.autograd.backward(2 * ((actions[1:] - demonstrated) ** 2).sum())
    assert actions.grad is not None
    term = cloning_term(demonstrated.numpy(), Balance(10 / 3, 20 / 3))
    gradient = term(np.zeros((3, 1), dtype=np.float32), actions.detach().numpy())
    assert gradient.tolist() == actions.grad.tolist()


def test_one_update_goes_down_the_loss_as_the_thesis_states_it(slow_ones) -> None:
    """Equations 2.1 to 2.5 written out for torch to differentiate, against the hand-written gradients, twice: the actor
    learns with every second update."""
    agent = Td3Agent(NetworkShape.of(get_setup("room"), (32, 32)), Td3Config(gamma=0.99, batch_size=10), seed=1)
    shown = demonstration_batch(slow_ones[:1], QUICK)
    explored, demonstrated = (Batch(*(part[rows] for part in shown)) for rows in (slice(0, 5), slice(-5, None)))
    weights = Balance(10 / 3, 20 / 3)
    update(agent, explored, demonstrated, weights)
    batch, b_d, config = concatenate(explored, demonstrated), len(demonstrated.rewards), agent.config
    b = len(batch.rewards)

    state = agent.generator.get_state()
    noise = torch.randn(b, 2, generator=agent.generator) * config.target_noise
    agent.generator.set_state(state)
    noise = noise.clamp(-config.target_noise_clip, config.target_noise_clip)
    with torch.no_grad():
        following = (actor_forward(batch.next_observations, agent.actor_target.layers) + noise).clamp(-1, 1)
        q_target = critic_forward(batch.next_observations, following, agent.critic_target.layers)
        y = batch.rewards + config.gamma * batch.continues * torch.minimum(*q_target)  # (2.1)
    q = critic_forward(batch.observations, batch.actions, agent.critic.layers)
    l_theta = sum(((y - q_i) ** 2).sum() / b for q_i in q)  # (2.2)
    wanted_of_critics = flat_gradient(l_theta, agent.critic.layers)
    actor = [
        (weight.detach().clone().requires_grad_(), bias.detach().clone().requires_grad_())
        for weight, bias in agent.actor.layers
    ]

    update(agent, explored, demonstrated, weights)
    torch.testing.assert_close(agent.critic.grad, wanted_of_critics, rtol=1e-4, atol=1e-6)
    pi = actor_forward(batch.observations, actor)
    q_1 = critic_forward(batch.observations, pi, agent.critic.frozen())[0]  # the critics learn first
    l_bc = ((pi[-b_d:] - demonstrated.actions) ** 2).sum()  # (2.4)
    l_phi = -weights.rl / b * q_1.sum() + weights.bc * l_bc  # (2.3, 2.5)
    assert agent.actor.grad is not None
    torch.testing.assert_close(weights.rl * agent.actor.grad, flat_gradient(l_phi, actor), rtol=1e-4, atol=1e-5)


def flat_gradient(loss: torch.Tensor, layers: list[Layer]) -> torch.Tensor:
    return torch.cat([part.flatten() for part in torch.autograd.grad(loss, [p for layer in layers for p in layer])])


def test_the_balance_changes_at_epoch_350_of_800() -> None:
    config = DemonstrationConfig()
    assert balance(config, 349 / 800) == (10 / 3, 20 / 3)
    assert balance(config, 350 / 800) == (5.0, 5.0)


def test_exploring_never_changes_the_demonstrations_and_pays_what_it_is_told_for_goals(slow_ones) -> None:
    training = DemonstrationTraining(slow_ones, replace(QUICK, explored_goal=0.0))
    before = training.demonstrated.rewards.clone(), training.demonstrated.observations.clone()
    while training.agent.updates < 48:
        training.vector_step()
    assert (training.demonstrated.rewards == before[0]).all()
    assert (training.demonstrated.observations == before[1]).all()
    assert float(training.explored_buffer.filled().rewards.max()) <= 0.0
    assert DemonstrationTraining(slow_ones, QUICK).setup.reward.goal == QUICK.goal_boost / 2


def test_episodes_begin_near_demonstrations_as_often_as_asked(slow_ones) -> None:
    drives = [d.trajectory for d in slow_ones]
    paths = np.concatenate([drive.poses[:, :2] for drive in drives])

    def near(share: float) -> float:
        rows, seeds = Placements(drives, near=share, seed=0).take(200)
        people = {(round(d.scene.person.pose.x, 6), round(d.scene.person.pose.y, 6)) for d in slow_ones}
        found = 0
        for row, seed in zip(rows, seeds, strict=True):
            check_scene(row_to_scene("room", int(seed), row)) if share == 0 else None
            beside = np.linalg.norm(paths - row[[k.START_X, k.START_Y]], axis=1).min() < 0.6
            known = min(math.dist(p, row[[k.PERSON_X, k.PERSON_Y]]) for p in people) < 0.8
            found += bool(beside and known)
        return found / 200

    assert near(1.0) > 0.97
    assert near(0.0) < 0.4
    assert near(0.0) < near(0.5) < near(1.0)


def test_mixed_episodes_take_each_place_from_a_demonstration_or_from_anywhere(slow_ones) -> None:
    drives = [d.trajectory for d in slow_ones]
    rows, _ = Placements(drives, near=0.0, mixed=1.0, seed=0).take(200)
    drawn, _ = Placements(drives, near=0.0, seed=0).take(200)
    same = np.stack([(rows[:, c] == drawn[:, c]) for c in (k.START_X, k.GOAL_X, k.PERSON_X)], axis=1)
    assert (np.abs(same.mean(axis=0) - 0.5) < 0.15).all()
    assert {tuple(row) for row in same.tolist()} == set(itertools.product([False, True], repeat=3))
    for row in rows:
        assert k.person_distance(row, row[k.GOAL_X], row[k.GOAL_Y]) >= 0.18 + row[k.PERSON_RADIUS]
        assert math.dist(row[[k.START_X, k.START_Y]], row[[k.GOAL_X, k.GOAL_Y]]) > row[k.GOAL_RADIUS]


def test_training_begins_to_follow_and_is_repeatable(slow_ones) -> None:
    config = replace(QUICK, updates=400)
    progress: list[float] = []
    trained = train_with_demonstrations(slow_ones, config, lambda share, _: progress.append(share))
    again = train_with_demonstrations(slow_ones, config)
    assert trained.policy.digest() == again.policy.digest()
    assert trained.history == again.history
    assert [point["updates"] for point in trained.history] == [n for n in (112, 208, 304, 400) for _ in range(2)]
    assert [point["averaged"] for point in trained.history] == [0.0, 1.0] * 4
    assert trained.selection == max(trained.history, key=lambda point: point["score"])
    assert progress == sorted(progress)
    untrained = DemonstrationTraining(slow_ones, config).policy()
    begun, before = judge(trained.policy, slow_ones), judge(untrained, slow_ones)
    assert begun.t_star - begun.frechet_m > before.t_star - before.frechet_m


def test_who_imitates_first_follows_after_few_updates_and_is_held_to_that(slow_ones) -> None:
    config = replace(QUICK, updates=96, imitated=480, actor_learning_rate=1e-4)
    training = DemonstrationTraining(slow_ones, config)
    while training.imitated < config.imitated:
        training.vector_step()
    assert training.agent.updates == 0
    followed = judge(training.policy(), slow_ones)
    assert (followed.frechet_m, followed.t_star) < (0.25, 0.8)
    trained = train_with_demonstrations(slow_ones, config)
    assert trained.policy.digest() == train_with_demonstrations(slow_ones, config).policy.digest()
    assert trained.selection["followed_rate"] >= followed.followed_rate > 0.0


def test_the_guide_drives_down_the_drawn_path_and_back_to_it_and_elsewhere_as_one_that_knows_the_scene(
    slow_ones,
) -> None:
    shown = slow_ones[::2]
    aside = [
        replace(d.scene, start=replace(d.scene.start, x=d.scene.start.x + 0.1, y=d.scene.start.y + 0.1)) for d in shown
    ]
    for scenes in ([d.scene for d in shown], aside):
        engine = make_engine(ROOM, len(scenes), auto_reset=False, scenes=scenes)
        guide, places = PathGuide(engine, [d.trajectory for d in shown]), [engine.poses[:, :2].copy()]
        while not engine.dones.all():
            engine.step(guide.act())
            places.append(engine.poses[:, :2].copy())
        assert (engine.outcomes == Outcome.SUCCESS).all()
        for path, d in zip(np.stack(places, axis=1), shown, strict=True):
            away = np.linalg.norm(path[:, None] - d.trajectory.poses[None, :, :2], axis=2).min(axis=1)
            assert away[len(path) // 3 :].max() < 0.08
    drawn = unseen_scenes([d.drawn_in for d in shown], "anywhere", 8, purpose=Purpose.SELECT, seed=1)
    engine = make_engine(ROOM, len(drawn), auto_reset=False, scenes=drawn)
    assert (PathGuide(engine, [d.trajectory for d in shown]).act() == WayGuide(engine).act()).all()


def test_demonstrations_of_two_environments_do_not_mix(slow_ones) -> None:
    other = replace(
        slow_ones[0], trajectory=replace(slow_ones[0].trajectory, scene=replace(slow_ones[0].scene, setup="corridor"))
    )
    with pytest.raises(SetupError, match="corridor"):
        DemonstrationTraining([slow_ones[0], other], QUICK)
    with pytest.raises(ValueError, match="none given"):
        train_with_demonstrations([], QUICK)


# --- judging ----------------------------------------------------------------------------------------------------------


def test_demonstrations_judged_against_themselves_are_perfect(slow_ones) -> None:
    judged = judge_rollouts([d.trajectory for d in slow_ones], slow_ones)
    assert (judged.success_rate, judged.t_star, judged.followed_rate) == (1.0, 1.0, 1.0)
    assert judged.frechet_m < 0.005
    assert judged.speed_correlation > 0.999
    assert judged.as_dict()["drives"] == len(slow_ones)


def test_who_drives_straight_past_the_person_misses_the_bars(slow_ones) -> None:
    judged = judge(DWA, slow_ones)
    assert judged.success_rate == 1.0
    assert judged.frechet_m > 0.25 or judged.t_star < 0.8
    assert judged.followed_rate < 0.5
    assert judged.speed_correlation < 0.8


def test_who_circles_at_the_start_has_a_small_distance_at_a_late_t_and_yet_follows_nothing(slow_ones) -> None:
    circling = [
        rollout(get_setup("room"), lambda seen: np.tile(np.float32([-1.0, 1.0]), (len(seen), 1)), [d.scene])[0]
        for d in slow_ones[:2]
    ]
    judged = judge_rollouts(circling, slow_ones[:2])
    assert judged.frechet_m <= 0.25
    assert judged.t_star >= 0.8
    assert (judged.success_rate, judged.followed_rate) == (0.0, 0.0)


@pytest.mark.parametrize("kind", ["starts", "goals", "people", "anywhere"])
def test_unseen_scenes_change_what_they_say_and_can_be_driven(slow_ones, kind: str) -> None:
    pairs = [d.drawn_in for d in slow_ones[::2]]
    scenes = unseen_scenes(pairs, kind, 8, purpose=Purpose.REPORT, seed=1)
    assert len(scenes) == 8
    for number, scene in enumerate(scenes):
        check_scene(scene)
        pair = pairs[number % 4]
        same = [scene.start == pair.start, scene.goal == pair.goal, scene.person == pair.person]
        assert (
            same
            == {
                "starts": [False, True, True],
                "goals": [True, False, True],
                "people": [True, True, False],
                "anywhere": [False, False, False],
            }[kind]
        )
    assert unseen_scenes(pairs, kind, 8, purpose=Purpose.SELECT, seed=1) != scenes


def test_who_walked_while_something_was_demonstrated_walks_on_in_exploration() -> None:
    scene = walking_scene(demonstration_scene("room", 0), "opposite", 3)
    shown = demonstrate("field_of_view", scene, 0).trajectory
    people = scene.person_poses(np.arange(600) * 0.2)[:, :2]
    pool = Placements([shown], near=0.5, seed=1)
    rows, _, walks = pool.take_walking(60)
    walking = ~np.isnan(walks[:, 0, 0])
    assert 10 < walking.sum() < 50  # the others are drawn scenes, in which people stand
    for row, walk in zip(rows[walking], walks[walking], strict=True):
        assert walk[0, :2] == pytest.approx(row[k.PERSON_X : k.PERSON_X + 2])
        steps = np.diff(walk[:40, :2], axis=0)
        shifted = [np.abs(np.diff(people[m : m + 40], axis=0) - steps).max() for m in range(200)]
        assert min(shifted) < 1e-9  # the demonstrated walk, from some moment on
    engine = make_engine(ROOM, 32, pool=pool)
    before, going = engine.rows[:, k.PERSON_X : k.PERSON_X + 2].copy(), np.zeros(32, bool)
    for _ in range(5):
        engine.step(np.full((32, 2), [-1.0, 0.0], dtype=np.float32))
        going |= np.abs(engine.rows[:, k.PERSON_X : k.PERSON_X + 2] - before).max(axis=1) > 0.05
    assert going.any()
    standing = Placements([replace(shown, scene=replace(shown.scene, walk=None))], near=0.5, seed=1)
    assert np.isnan(standing.take_walking(60)[2]).all()

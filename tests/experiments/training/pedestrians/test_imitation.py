"""Imitation of a search among pedestrians: what commands cost, what is learned of it, the policy as it is kept."""

import numpy as np
import pytest
import torch

from desirepath.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds
from desirepath.learning.pedestrians.crowd_networks import (
    VARIANTS,
    Chooser,
    actor_acts,
    actor_from_arrays,
    actor_to_arrays,
    attention_weights,
)
from desirepath.learning.pedestrians.crowd_states import SIZES, states
from desirepath.learning.policies.mirroring import ACTION_SIGNS
from desirepath.learning.scene_sets import Purpose
from desirepath.simulation.crowds.crowd_engine import CrowdEngine
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath_experiments.training.pedestrians import foresight
from desirepath_experiments.training.pedestrians.crowd_planners import PLANNERS
from desirepath_experiments.training.pedestrians.foresight import (
    COMMANDS,
    MIRRORED,
    MOST_M,
    actions_of_commands,
    costs_by_velocity,
    ground_of,
)
from desirepath_experiments.training.pedestrians.foresight_kernels import Ground
from desirepath_experiments.training.pedestrians.imitation import (
    ImitationConfig,
    imitate,
    learn_from,
    mirror_batch,
    mirror_of_state,
)


def begun(n: int, **settings: float) -> CrowdEngine:
    engine = CrowdEngine(n_envs=n, **settings)
    engine.reset(crowd_scene_set(n, PUBLISHED, purpose=Purpose.SELECT, seed=9))
    return engine


def test_who_is_told_how_everybody_moves_arrives_far_more_often_than_orca():
    scenes = crowd_scene_set(30, PUBLISHED, purpose=Purpose.SELECT, seed=9)
    informed, orca = (
        evaluate_crowds(None, "ranges", scenes, plan=PLANNERS[name]).rates()["success"]
        for name in ("constant_velocity", "orca")
    )
    assert informed >= 90 > 55 > orca


def test_costs_are_above_the_best_and_the_cheapest_commands_lead_along_the_path():
    engine = begun(12)
    costs = costs_by_velocity(engine)
    assert costs.shape == (12, len(COMMANDS))
    np.testing.assert_array_equal(costs.min(axis=1), 0)
    assert costs.max() <= MOST_M
    moves = actions_of_commands(engine.setup.robot.limits)[costs.argmin(axis=1)]
    before = engine.path_left_m()
    for _ in range(5):
        engine.step(moves)
        moves = actions_of_commands(engine.setup.robot.limits)[costs_by_velocity(engine).argmin(axis=1)]
    assert np.median(before - engine.path_left_m()) > 0.2


def test_a_command_into_somebody_who_comes_is_dearest():
    engine = begun(1)
    x, y, yaw = engine.poses[0]
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    engine.world.people_xy[0, 1] = (x, y) + 1.2 * ahead
    engine.world.people_v[0, 1] = -0.6 * ahead
    engine.world.facing[0, 1] = -ahead
    assert costs_by_velocity(engine)[0, 0] == MOST_M, "straight on, fast"
    engine.world.people_v[0, 1] = 0.9 * ahead
    assert costs_by_velocity(engine)[0, 0] < MOST_M, "behind who goes away there is room"


def test_who_stands_is_foreseen_longer_than_who_walks_and_is_passed(monkeypatch):
    alone = CrowdConditions(moving=(0, 0), standing=(2, 2))
    scenes = crowd_scene_set(30, alone, purpose=Purpose.SELECT, seed=9, setups=("crowd_corridor",))

    def success() -> float:
        return evaluate_crowds(None, "ranges", scenes, plan=PLANNERS["constant_velocity"]).rates()["success"]

    foreseen = success()
    assert foreseen > 90
    monkeypatch.setattr(foresight, "STANDS_M_S", -1.0)
    assert success() < foreseen - 10, "forgotten like who walks"


def in_the_mirror(engine: CrowdEngine) -> CrowdEngine:
    """The same moment with left and right exchanged."""
    other = begun(engine.n_envs, noise_m=0.0)
    for name in ("boxes", "people_xy", "people_v", "facing", "paths", "routes", "robots"):
        getattr(other.world, name)[:] = getattr(engine.world, name)
        getattr(other.world, name)[..., 1] *= -1
    other.world.boxes[..., 5] *= -1
    other.world.robots[:, 2] *= -1
    other._begin(np.arange(engine.n_envs))
    return other


@pytest.mark.parametrize("given", SIZES)
def test_a_mirrored_state_is_what_is_sensed_in_the_mirror(given):
    one = begun(12, noise_m=0.0)
    other, mirror = in_the_mirror(one), mirror_of_state(given)
    moves = np.random.default_rng(0).uniform(-1, 1, (12, 2)).astype(np.float32)
    for _ in range(3):
        one.step(moves)
        other.step(moves * ACTION_SIGNS)
    here, there = states(one, given), states(other, given)
    exact = 12 if given == "coarse" else 10  # path and goal
    np.testing.assert_allclose((here[:, mirror.order] * mirror.signs)[:, -exact:], there[:, -exact:], atol=1e-5)
    apart = np.abs(here[:, mirror.order] * mirror.signs - there)
    assert (apart > 0.03).mean() < 0.02, "a beam beside an edge meets something else"
    assert (np.abs(here - there) > 0.03).mean() > 0.2


def test_costs_are_mirrored_with_their_commands(monkeypatch):
    one, mirror = begun(8, noise_m=0.0), mirror_of_state("ranges")
    turns, known = actions_of_commands(one.setup.robot.limits)[:, 1], MIRRORED >= 0
    np.testing.assert_allclose(turns[MIRRORED[known]], -turns[known])
    assert list(np.flatnonzero(~known)) == [22], "turning about is to the left"
    other, grounds = in_the_mirror(one), {scene: ground_of(scene) for scene in one.scenes}
    unchanged = costs_by_velocity(one)
    _, costs = mirror_batch(states(one, "ranges"), unchanged, mirror)
    assert np.isnan(costs[:, ~known]).all()
    monkeypatch.setattr(foresight, "ground_of", lambda scene: mirrored_ground(grounds[scene]))
    there = costs_by_velocity(other)
    assert np.abs(costs.clip(max=4) - there.clip(max=4))[:, known].mean() < 0.03
    assert np.abs(unchanged.clip(max=4) - there.clip(max=4))[:, known].mean() > 0.1


def mirrored_ground(ground: Ground) -> Ground:
    boxes, last = ground.boxes.copy(), ground.y0 + ground.cell * (ground.length.shape[1] - 1)
    boxes[:, [1, 5]] *= -1
    length, downhill = (np.ascontiguousarray(of[:, ::-1]) for of in (ground.length, -ground.downhill))
    return ground._replace(boxes=boxes, length=length, downhill=downhill, y0=-last, goal_y=-ground.goal_y)


@pytest.mark.parametrize("variant", VARIANTS)
def test_networks_tell_states_apart_before_they_have_learned_anything(variant):
    torch.manual_seed(0)
    actor, engine = Chooser(variant), begun(60)
    for _ in range(3):
        engine.step(np.zeros((60, 2), np.float32))
    with torch.no_grad():
        before_the_last_layer = actor.head[:-1](actor.read(torch.as_tensor(states(engine, VARIANTS[variant].given))))
    assert before_the_last_layer.std(dim=0).mean() > 0.003, "torch's own first numbers: 0.000005 with attention"


def test_an_untrained_network_attends_to_everything_alike_and_predicts_hardly_any_cost():
    torch.manual_seed(0)
    actor, seen = Chooser("ours"), torch.as_tensor(states(begun(20), "points_and_groups"))
    for weights in attention_weights(actor, seen).values():
        assert (weights - 1 / 30).abs().max() < 0.01
    with torch.no_grad():
        assert actor.costs(seen).abs().max() < 0.1


@pytest.mark.parametrize("bfloat16", [False, True])
def test_a_command_without_a_known_cost_is_not_learned(bfloat16):
    engine = begun(8)
    seen, targets = torch.as_tensor(states(engine, "ranges")), torch.zeros(8, len(COMMANDS))
    targets[:, 22] = torch.nan
    torch.manual_seed(0)
    actor = Chooser("b3")
    before = [one.detach().clone() for one in actor.head[-1].parameters()]
    learn_from(actor, torch.optim.Adam(actor.parameters(), 1e-2), seen, targets, torch.ones(1, 1), bfloat16=bfloat16)
    for old, new in zip(before, actor.head[-1].parameters(), strict=True):
        assert torch.equal(old[22], new[22])
        assert not torch.equal(old[21], new[21])
        assert new.isfinite().all()


@pytest.mark.parametrize(
    ("wrong", "named"),
    [({"labels": 0}, "labels"), ({"dearest_m": (20.0,)}, "dearest_m"), ({"mirrored_share": 2.0}, "mirrored_share")],
)
def test_settings_that_cannot_be_name_themselves(wrong, named):
    with pytest.raises(ValueError, match=named):
        ImitationConfig(**wrong)


def test_what_is_told_is_learned():
    engine, random = begun(60), np.random.default_rng(0)
    for _ in range(8):
        engine.step(random.uniform(-1, 1, (60, 2)).astype(np.float32))
    told, seen = (torch.as_tensor(of) for of in (costs_by_velocity(engine), states(engine, "ranges")))
    torch.manual_seed(0)
    actor, dearest = Chooser("b3", tables=2, which=1), torch.tensor([[1.0], [4.0]])
    adam = torch.optim.Adam(actor.parameters(), 2e-3)
    for _ in range(400):
        learn_from(actor, adam, seen, told, dearest)
    with torch.no_grad():
        predicted = actor.costs(seen)
    for table, most in enumerate((1.0, 4.0)):
        should = (told / most).clamp(max=1.0)
        assert (predicted[:, table] - should).square().mean() < 0.5 * should.var(dim=0).mean()


def test_a_training_tells_how_it_goes_and_keeps_one_table():
    rows = []
    config = ImitationConfig("b3", labels=200, n_envs=8, batch_size=8, evaluations=2, evaluation_episodes=2)
    learned = imitate(config, lambda fraction, row: rows.append((fraction, row["labels"], row["dearest_m"])))
    assert rows == [(0.52, 104, 2.0), (1, 200, 1.0), (1, 200, 2.0), (1, 200, 4.0)]
    assert learned.actor.tables == 1


@pytest.mark.parametrize("which", [0, 2])
def test_the_kept_table_acts_as_among_the_others_and_comes_back_from_its_numbers(which):
    torch.manual_seed(0)
    whole = Chooser("b3", tables=3, which=which)
    seen = states(begun(8), "ranges")
    alone = actor_from_arrays("b3", actor_to_arrays(whole.alone()))
    assert isinstance(alone, Chooser)
    with torch.no_grad():
        costs = whole.costs(torch.as_tensor(seen))[:, which]
        torch.testing.assert_close(alone.costs(torch.as_tensor(seen))[:, 0], costs)
    np.testing.assert_array_equal(actor_acts(alone)(seen), actor_acts(whole)(seen))
